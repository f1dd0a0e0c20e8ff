"""The tables of the studies: each prints its own, and rewrites its part of lab/studies/README.md when told to."""

import argparse
import platform
import re
from pathlib import Path

import torch

README = Path(__file__).parent / "README.md"


def add_write(parser: argparse.ArgumentParser, what: str = "the table in lab/studies/README.md") -> None:
    """Adds the argument --write: a small run, only to try a study out, must not replace what was measured."""
    parser.add_argument("--write", action="store_true", help=f"also replace {what}")


def show(name: str, text: str, write: bool) -> None:
    """Prints a part of lab/studies/README.md, and replaces it there if `write`."""
    print(text)
    if write:
        write_part(name, text)


def check_part(name: str, page: Path = README) -> None:
    """Raises ValueError if the page does not have this part."""
    if not page.is_file() or not _part(name).search(page.read_text(encoding="utf-8")):
        raise ValueError(f"{page}: no part <!-- {name} --> ... <!-- end {name} -->")


def write_part(name: str, text: str, page: Path = README) -> None:
    """Replaces the text between `<!-- name -->` and `<!-- end name -->`."""
    check_part(name, page)
    before = page.read_text(encoding="utf-8")
    page.write_text(_part(name).sub(lambda match: f"{match[1]}{text.rstrip()}\n{match[2]}", before), encoding="utf-8")


def _part(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {name} -->\n).*?(<!-- end {name} -->)", flags=re.DOTALL)


def table(columns: list[str], rows: list[list[str]]) -> str:
    """Returns a Markdown table with numbers aligned to the right."""
    lines = [f"| {' | '.join(columns)} |", f"|{'|'.join(['---', *['---:'] * (len(columns) - 1)])}|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])


def machine() -> str:
    """Returns one line about the machine that measured the numbers."""
    model = next(
        (line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.processor(),
    )
    return f"{model}, {torch.get_num_threads()} threads, {platform.system()}, torch {torch.__version__.split('+')[0]}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines() if Path(path).is_file() else []
