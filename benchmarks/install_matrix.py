"""Installs a wheel with several versions of Python and torch, and runs .ci/check-install with each: demo, tests.

    pip install uv
    .ci/wheels dist
    python benchmarks/install_matrix.py dist/*.whl --state matrix.json --pages docs/installation.md \
        --python python3.11 --python "chroot /srv/sid python3.14" --torch 2.10.0 --torch 2.15.0

A Python may be a command that runs it elsewhere: what stands before its last word is put before all commands. The
temporary folder, this checkout and uv must be at the same place there. uv makes the environments. It unpacks a package
once for each version of torch (which has 5 GB with what it brings for CUDA). With --quick only the tests of the
operators' contract run. With --state an interrupted run goes on where it was, and cells of earlier runs stay in the
table.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from torchjoint.runtime.files import write_text

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- install matrix -->", "<!-- end install matrix -->"


class FailedError(Exception):
    """A step of a cell failed."""


def run(command: list[str]) -> str:
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise FailedError(done.stdout.strip())
    return done.stdout


def cell(python: str, torch: str, wheel: Path, uv: str, quick: bool) -> tuple[str, str, str]:
    """Version of Python, what stands in the table, and the whole output."""
    *prefix, interpreter = shlex.split(python)
    version = re.findall(r"\d+\.\d+", run([*prefix, interpreter, "--version"]))[0]
    with tempfile.TemporaryDirectory() as folder:
        env = f"{folder}/env"
        try:
            run([*prefix, uv, "venv", "-q", "--seed", "--python", interpreter, env])
            wanted = [str(wheel), f"torch=={torch}"]
            run([*prefix, uv, "pip", "install", "-q", "--python", f"{env}/bin/python", *wanted])
        except FailedError as error:
            return version, "no installation: " + str(error).splitlines()[-1][:80], str(error)
        try:
            options = ["--quick"] * quick
            output = run([*prefix, f"{ROOT}/.ci/check-install", *options, f"{env}/bin/python", str(ROOT)])
        except FailedError as error:
            return version, "failed", str(error)
    passed = re.findall(r"(\d+) passed", output)[-1]
    return version, f"demo, {passed} tests", output


def table(cells: dict[str, str]) -> str:
    keys = [key.split() for key in cells]
    pythons, torches = (
        sorted({key[axis] for key in keys}, key=lambda version: [int(part) for part in version.split(".")])
        for axis in (0, 1)
    )
    lines = ["| | " + " | ".join(f"torch {version}" for version in torches) + " |", "|---" * (len(torches) + 1) + "|"]
    for python in pythons:
        row = (cells.get(f"{python} {version}", "not run") for version in torches)
        lines.append(f"| Python {python} | " + " | ".join(row) + " |")
    return "\n".join(lines)


def fill(page: Path, text: str) -> None:
    before, rest = page.read_text().split(BEGIN)
    write_text(page, f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--python", action="append", default=[])
    parser.add_argument("--torch", action="append", default=[])
    parser.add_argument("--state", type=Path, required=True)
    parser.add_argument("--pages", type=Path, nargs="+", default=[])
    parser.add_argument("--uv", default="uv")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    state: dict[str, Any] = json.loads(arguments.state.read_text()) if arguments.state.is_file() else {}
    done = state.setdefault("done", {})
    for torch in arguments.torch:
        with tempfile.TemporaryDirectory() as cache:
            os.environ["UV_CACHE_DIR"] = cache
            for python in arguments.python:
                if f"{python} {torch}" in done:
                    continue
                version, found, output = cell(python, torch, arguments.wheel.resolve(), arguments.uv, arguments.quick)
                print(f"Python {version}, torch {torch}: {found}", flush=True)
                if "tests" not in found:
                    print(output[-3000:], file=sys.stderr, flush=True)
                done[f"{python} {torch}"] = {"key": f"{version} {torch}", "found": found}
                write_text(arguments.state, json.dumps(state, indent=1))
    text = table({one["key"]: one["found"] for one in done.values()})
    print(text)
    for page in arguments.pages:
        fill(page, text)


if __name__ == "__main__":
    main()
