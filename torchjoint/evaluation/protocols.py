"""Which true instances of ScanNet a benchmark counts: those of its classes; all others are void, as walls and floors.

ScanNet v2 has 18 classes (Dai et al., CVPR 2017), by their number among the 40 of NYU. ScanNet200 has 198 (Rozenberszki
et al., ECCV 2022), by their number in ScanNet's table of labels. Void points never count against a prediction.
"""

from __future__ import annotations

import csv
from collections.abc import Set
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.scannet_truth import read_object_classes

Name = Literal["scannetv2", "scannet200"]
#: The table of labels that ScanNet's download brings.
TABLE = "scannetv2-labels.combined.tsv"


class Protocol(NamedTuple):
    """The classes of a benchmark."""

    column: str  #: of the table, which has the class of a raw category
    classes: Set[int]


def _numbers(text: str) -> Set[int]:
    """Numbers and ranges, such as "3-5 7"."""
    ranges = [word.partition("-")[::2] for word in text.split()]
    return frozenset(number for first, last in ranges for number in range(int(first), int(last or first) + 1))


PROTOCOLS: dict[Name, Protocol] = {
    "scannetv2": Protocol("nyu40id", _numbers("3-12 14 16 24 28 33-34 36 39")),
    "scannet200": Protocol(
        "id",
        _numbers(
            "2 4-11 13-19 21-24 26-29 31-36 38-42 44-52 54-59 62-80 82 84 86-90 93 95-107 110 112 115-116 118 120-122 "
            "125 128 130-132 134 136 138-141 145 148 154-157 159 161 163 165-166 168-170 177 180 185 188 191 193 195 "
            "202 208 213-214 221 229-230 232-233 242 250 261 264 276 283 286 300 304 312 323 325 331 342 356 370 392 "
            "395 399 408 417 488 540 562 570 572 581 609 748 776 1156 1163-1176 1178-1191"
        ),
    ),
}


def find_table(scans: Path) -> Path:
    """The table of labels beside or above the scans.

    Raises:
        FileNotFoundError: there is none.
    """
    for folder in (scans, *scans.resolve().parents[:2]):
        if (folder / TABLE).is_file():
            return folder / TABLE
    raise FileNotFoundError(
        f"{scans / TABLE}: missing, also in the two folders above; it comes with ScanNet's download"
    )


def read_table(file: Path, name: Name) -> dict[str, int]:
    """The class of each raw category.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    if not file.is_file():
        raise FileNotFoundError(f"{file}: missing; expected ScanNet's table of labels")
    column = PROTOCOLS[name].column
    with file.open(encoding="utf-8", errors="replace", newline="") as stream:
        reader = csv.DictReader(stream, delimiter="\t")
        missing = {"raw_category", column} - {*(reader.fieldnames or ())}
        if missing:
            raise ValueError(
                f"{file}: expected columns raw_category and {column}; missing: {', '.join(sorted(missing))}"
            )
        try:
            return {row["raw_category"]: int(row[column]) for row in reader if row[column]}
        except (ValueError, TypeError, csv.Error) as error:
            raise ValueError(f"{file}: {column}: expected whole numbers: {error}") from error


def counted(truth: Tensor, scan: Path, name: Name, table: Path) -> Tensor:
    """The true instances [N] of a scan's points that the benchmark counts; all others are -1.

    Args:
        truth: [N] int64 objectIds, -1: none.
        scan: the scan's folder, or its .sens file.
        name: the benchmark.
        table: ScanNet's table of labels.

    Raises:
        FileNotFoundError, ValueError: the scan has no annotation, or a file is damaged; the message names the file.
    """
    folder, stem = (scan.parent, scan.stem) if scan.is_file() else (scan, scan.name)
    class_of, classes = read_table(table, name), PROTOCOLS[name].classes
    of_object = read_object_classes(folder, stem)
    kept = [one for one, category in of_object.items() if class_of.get(category) in classes]
    return torch.where(torch.isin(truth, torch.tensor(kept, dtype=torch.int64)), truth, -1)
