"""Which true instances of ScanNet a benchmark counts: those of its classes; all others are void, as walls and floors.

ScanNet v2 has 18 classes (Dai et al., CVPR 2017), by their number among the 40 of NYU. ScanNet200 has 198 (Rozenberszki
et al., ECCV 2022), by their number in ScanNet's table of labels. Void points never count against a prediction.

ScanNet++ (Yeshwanth et al., ICCV 2023) has 84, by their name; its lists of classes come with the data set, beside its
table. The instances are those of the toolkit (github.com/scannetpp/scannetpp, semantic/transforms/mesh.py).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Set
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.files.text import read_record
from torchjoint.datasets.formats.scannetpp import truth_files
from torchjoint.datasets.truth import OBJECTS, object_id, point_instances
from torchjoint.runtime.foreign_files import dict_of, has_file, read_text

Name = Literal["scannetv2", "scannet200", "scannetpp"]
#: The tables of labels that the downloads of ScanNet and ScanNet++ bring.
TABLE, TABLE_PP = "scannetv2-labels.combined.tsv", "metadata/semantic_benchmark/map_benchmark.csv"
#: Beside the table of ScanNet++: all classes whose objects take vertices, and those whose objects are counted.
CLASSES_PP, INSTANCES_PP = "top100.txt", "top100_instance.txt"


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


def find_table(scans: Path, name: Name) -> Path:
    """The table of a benchmark's labels beside or above the scans.

    Raises:
        FileNotFoundError: there is none.
    """
    table = TABLE_PP if name == "scannetpp" else TABLE
    for folder in (scans, *scans.resolve().parents[:2]):
        if has_file(folder / table):
            return folder / table
    raise FileNotFoundError(f"{scans / table}: missing, also in the two folders above; it comes with the data set")


def read_table(file: Path, name: Name) -> dict[str, int]:
    """The class of each raw category.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    column = PROTOCOLS[name].column
    rows = _pairs(file, "raw_category", column, "\t")
    try:
        return {raw: int(number) for raw, number in rows if number}
    except ValueError as error:
        raise ValueError(f"{file}: {column}: expected whole numbers: {error}") from error


def _pairs(file: Path, first: str, second: str, delimiter: str) -> list[tuple[str, str]]:
    """Two columns of a table, row by row."""
    text = read_text(file, "the data set's table of labels", errors="replace")
    try:
        reader = csv.DictReader(io.StringIO(text), delimiter=delimiter)
        rows, missing = list(reader), {first, second} - {*(reader.fieldnames or ())}
    except csv.Error as error:
        raise ValueError(f"{file}: expected a table: {error}") from error
    if missing:
        raise ValueError(f"{file}: expected columns {first} and {second}; missing: {', '.join(sorted(missing))}")
    return [(row[first], row[second]) for row in rows]


def counted(truth: Tensor, scan: Path, name: Name, table: Path) -> Tensor:
    """The true instances [N] of a scan's points that the benchmark counts; all others are -1.

    Args:
        truth: [N] int64 objectIds, -1: none.
        scan: the scan's folder, or its .sens file; of ScanNet++, the scene's.
        name: the benchmark.
        table: the table of labels; of ScanNet++, beside its lists of classes.

    Raises:
        FileNotFoundError, ValueError: the scan has no annotation, or a file is damaged; the message names the file.
    """
    if name == "scannetpp":
        return _counted_of_scannetpp(truth, scan, table)
    folder, stem = (scan.parent, scan.stem) if has_file(scan) else (scan, scan.name)
    class_of, classes = read_table(table, name), PROTOCOLS[name].classes
    of_object = read_object_classes(folder / f"{stem}{OBJECTS}")
    kept = [one for one, category in of_object.items() if class_of.get(category) in classes]
    return torch.where(torch.isin(truth, torch.tensor(kept, dtype=torch.int64)), truth, -1)


def read_object_classes(objects_file: Path) -> dict[int, str]:
    """Reads the raw category of each annotated object, by its objectId. Some scans of ScanNet list an object twice."""
    groups = read_record(objects_file, "segments of objects").records("segGroups")
    found = dict.fromkeys((object_id(group), group.text("label")) for group in groups)
    return dict_of([*found], f"{objects_file}: objectId with two categories:")


def _counted_of_scannetpp(points: Tensor, scan: Path, table: Path) -> Tensor:
    """A vertex belongs to the smallest of the objects that have one of the benchmark's classes; some do not count."""
    class_of = {raw: to or raw for raw, to in _pairs(table, "class", "semantic_map_to", ",")}
    segments, objects = truth_files(scan)
    of_object = {one: class_of.get(raw) for one, raw in read_object_classes(objects).items()}

    def objects_of(name: str) -> list[int]:
        file = table.with_name(name)
        classes = read_text(file, "the benchmark's classes, a line each", errors="replace").splitlines()
        return [one for one, found in of_object.items() if found in classes]

    truth = point_instances(segments, objects, points, smallest=True, among=set(objects_of(CLASSES_PP)))
    assert truth is not None  # the classes of the objects were read
    return torch.where(torch.isin(truth, torch.tensor(objects_of(INSTANCES_PP), dtype=torch.int64)), truth, -1)
