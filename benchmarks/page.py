"""Writes benchmarks/README.md from page.md and the result files: `python benchmarks/page.py [--check]`.

In page.md, `{{NAME}}` stands for the command and the date of results/NAME.json, and its tables; `{{NAME; ROWS}}` has
only the rows whose names match a pattern. `{{NAME; ROWS; COLUMN}}` stands for one value, or for the least and the
largest, of such rows. With --check nothing is written; the exit code is 1 if the page is not what the files say.
"""

import argparse
import json
import re
import sys
from pathlib import Path

from report import HERE, RESULTS, markdown, shown

PAGE, TEMPLATE = HERE / "README.md", HERE / "page.md"
MARK = re.compile(r"\{\{(.+?)\}\}")


def results(folder: Path = RESULTS) -> dict[str, dict]:
    """The result files by name."""
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.json"))}


def page(template: str, found: dict[str, dict]) -> str:
    """The text with its marks filled; KeyError names a mark without a value."""
    unused = set(found) - {mark.split(";")[0].strip() for mark in MARK.findall(template)}
    if unused:
        raise KeyError(f"{TEMPLATE.name}: expected a mark for each result, got none for {sorted(unused)}")
    return MARK.sub(lambda mark: filled(mark[1], found), template)


def filled(mark: str, found: dict[str, dict]) -> str:
    """What stands for a mark."""
    name, *place = (part.strip() for part in mark.split(";"))
    if name not in found:
        raise KeyError(f"{{{{{mark}}}}}: no file results/{name}.json")
    if len(place) < 2:
        return whole(found[name], *place)
    rows, column = place
    values = [
        (row[list(table["columns"]).index(column)], table["columns"][column])
        for table in found[name]["tables"]
        if column in table["columns"]
        for row in table["rows"]
        if re.fullmatch(rows, row[0])
    ]
    texts = [shown(*value) for value in sorted(value for value in values if value[0] is not None)]
    if not texts:
        raise KeyError(f"{{{{{mark}}}}}: no such row and column in results/{name}.json")
    return texts[0] if texts[0] == texts[-1] else f"{texts[0]} to {texts[-1]}"


def whole(result: dict, rows: str = ".*") -> str:
    """How, when and where a result was measured, and its tables."""
    threads = "1 thread" if result["threads"] == 1 else f"{result['threads']} threads"
    source = (
        f"`{result['command']}`: {result['date']}, {result['machine']}, {threads}, torch {result['versions']['torch']}."
    )
    tables = [
        table | {"rows": [row for row in table["rows"] if re.fullmatch(rows, row[0])]} for table in result["tables"]
    ]
    shown_tables = [markdown(table) for table in tables if table["rows"]]
    return "\n\n".join([f"{source} {result['about']}".rstrip(), *shown_tables])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    text = page(TEMPLATE.read_text(encoding="utf-8"), results())
    if not arguments.check:
        PAGE.write_text(text, encoding="utf-8")
    elif PAGE.read_text(encoding="utf-8") != text:
        sys.exit(f"{PAGE.name} is not what the result files say: run python benchmarks/page.py")


if __name__ == "__main__":
    main()
