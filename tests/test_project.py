"""What holds for the files of the project as a whole."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LONGEST = 60


def test_no_test_has_a_long_name() -> None:
    files = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("lab/tests/**/*.py")]
    names = {
        f"{file.relative_to(ROOT)}: {node.name}"
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and len(node.name) > LONGEST
    }
    assert len(files) > 1
    assert sorted(names) == []
