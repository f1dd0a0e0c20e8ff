"""Result files: each benchmark of speed or memory writes results/NAME.json, and page.py makes the page of them."""

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"

Cell = str | float | None


class Table(NamedTuple):
    """Measured values; the first cell of a row is its name."""

    columns: Mapping[str, int]  #: names with their units, and the digits behind the point
    rows: Sequence[Sequence[Cell]]
    title: str = ""


def save(name: str, tables: Sequence[Table], about: str = "") -> None:
    """Prints the tables, and writes them with the command, the date, the versions and the kind of machine."""
    import torch  # the page of the benchmarks does not need it

    result = {
        "command": command(sys.argv),
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "versions": {"python": platform.python_version(), "torch": version("torch").split("+")[0]},
        "machine": machine(),
        "threads": torch.get_num_threads(),
        "about": about,
        "tables": [as_json(table) for table in tables],
    }
    print("\n\n".join(markdown(table) for table in result["tables"]), flush=True)
    write(RESULTS / f"{name}.json", result)


def write(file: Path, result: Mapping[str, object]) -> None:
    """Writes a result; a row of a table is one line."""
    text = json.dumps(result, indent=2, ensure_ascii=False)
    rows = re.compile(r"\[\n\s+([^\[\]{}]+?)\n\s+\]")
    text = rows.sub(lambda row: "[" + re.sub(r"\n\s+", " ", row[1]) + "]", text)
    file.write_text(text + "\n", encoding="utf-8")


def command(arguments: Sequence[str]) -> str:
    """The command that was typed; folders and files of this machine have general names."""
    general = [_without_paths(argument) for argument in arguments[1:]]
    return " ".join(["python", f"benchmarks/{Path(arguments[0]).name}", *general])


def _without_paths(argument: str) -> str:
    path = Path(argument)
    return "FOLDER" if path.is_dir() else f"FILE{path.suffix}" if path.is_file() or path.is_absolute() else argument


def commit() -> str:
    """The commit of the checkout."""
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True)
    return done.stdout.strip()


def machine() -> str:
    """The kind of machine, without its name."""
    return f"{os.cpu_count()} cores {platform.machine().replace('_', '-')}"


def as_json(table: Table) -> dict[str, object]:
    """Values keep one digit more than are shown, so that a repeated run changes few of them."""
    digits = table.columns.values()
    rows = [
        [round(cell, kept + 1) if isinstance(cell, float) else cell for cell, kept in zip(row, digits, strict=True)]
        for row in table.rows
    ]
    return {"title": table.title, "columns": dict(table.columns), "rows": rows}


def markdown(table: Mapping) -> str:
    """A table of a result, with numbers aligned to the right."""
    columns = table["columns"]
    lines = [f"| {' | '.join(columns)} |", f"|{'|'.join(['---', *['---:'] * (len(columns) - 1)])}|"]
    lines += [f"| {' | '.join(map(shown, row, columns.values()))} |" for row in table["rows"]]
    return "\n".join([f"{table['title']}:", "", *lines] if table["title"] else lines)


def shown(cell: Cell, digits: int) -> str:
    """A cell as the page shows it."""
    if cell is None or isinstance(cell, str):
        return cell or ""
    return f"{cell:,}" if isinstance(cell, int) else f"{cell:,.{digits}f}"
