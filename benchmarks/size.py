"""How large is the package, folder by folder, and is each within its budget? budgets.toml has the budgets.

Lines of code are lines without blank ones, comments and docstrings.
"""

import ast
import io
import subprocess
import tokenize
import tomllib
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = ROOT / "benchmarks" / "budgets.toml"
_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def code_lines(text: str) -> int:
    """How many lines of a Python file are code."""
    documents: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                documents |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - documents)


def sizes() -> dict[str, tuple[int, int]]:
    """Lines of code and files of each folder of ``torchjoint/``, of those that git knows; "top": beside the folders."""
    listed = subprocess.run(["git", "ls-files", "torchjoint"], cwd=ROOT, check=True, capture_output=True, text=True)
    found: dict[str, list[int]] = defaultdict(list)
    for name in listed.stdout.split():
        parts = Path(name).parts
        folder = parts[1] if len(parts) > 2 else "top"
        if name.endswith(".py"):
            found[folder].append(code_lines(Path(ROOT, name).read_text(encoding="utf-8")))
        elif name.endswith((".cpp", ".h")):
            found["C++"].append(len(Path(ROOT, name).read_text(encoding="utf-8").splitlines()))
    return {folder: (sum(lines), len(lines)) for folder, lines in sorted(found.items())}


def beyond(found: dict[str, tuple[int, int]]) -> list[str]:
    """What is above its budget: a line each. Whoever raises a budget lowers another: their sum has a limit, too."""
    budgets = tomllib.loads(BUDGETS.read_text(encoding="utf-8"))
    total, folders = budgets["total"], budgets["folders"]
    problems = [f"{folder}: no budget in {BUDGETS.name}" for folder in found if folder not in folders]
    for folder, budget in folders.items():
        for name, value in zip(("code", "files"), found.get(folder, (0, 0)), strict=True):
            if value > budget[name]:
                problems.append(f"{folder}: expected at most {budget[name]} ({name}), got {value}")
    for name in ("code", "files"):
        granted = sum(budget[name] for budget in folders.values())
        if granted > total[name]:
            problems.append(f"all budgets: expected at most {total[name]} ({name}), got {granted}")
    return problems
