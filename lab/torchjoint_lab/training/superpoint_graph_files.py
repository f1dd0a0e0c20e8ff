"""The prepared evidence of labelled scenes on disk, so that an interrupted training continues."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from threading import Lock
from typing import overload

import torch

from torchjoint.runtime.files import read_checked, write_checked
from torchjoint.segments.learned.boundaries import Boundaries
from torchjoint.segments.learned.images import ImageCounts
from torchjoint.segments.learned.occluded_surfaces import Occlusions
from torchjoint.segments.learned.region_statistics import RegionStatistics
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph
from torchjoint_lab.training.boundary_examples import LabelledEvidence

#: The types that a file may contain besides tensors and numbers; none of them runs code when it is made.
_TYPES = (LabelledEvidence, SuperpointGraph, Boundaries, RegionStatistics, ImageCounts, Occlusions)

#: torch keeps the types that are safe for the whole process: the first of two threads to end takes them from the other.
_ONE_AT_A_TIME = Lock()


def save_evidence(path: Path, prepared: LabelledEvidence) -> None:
    """Writes the evidence of one scene with a checksum, atomically."""
    content = io.BytesIO()
    torch.save(prepared, content)
    write_checked(path, content.getvalue())


def load_evidence(path: Path) -> LabelledEvidence:
    """Reads what :func:`save_evidence` wrote; the file cannot run code.

    Raises:
        ValueError: the file is damaged, or contains something else.
    """
    try:
        with _ONE_AT_A_TIME, torch.serialization.safe_globals(list(_TYPES)):
            prepared = torch.load(io.BytesIO(read_checked(path)), weights_only=True)
        if not isinstance(prepared, LabelledEvidence) or not isinstance(prepared.evidence, SuperpointGraph):
            raise TypeError(f"expected the evidence of a scene, got {type(prepared).__name__}")
    except Exception as error:  # a damaged file can raise anything
        first = (str(error).removeprefix(f"{path}: ").splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path}: damaged; delete it and start again ({first})") from error
    return prepared


class SuperpointGraphFiles(Sequence[LabelledEvidence]):
    """The evidence of many scenes, read from disk at each access, so that only one is in memory."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = list(paths)

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, index: int) -> LabelledEvidence: ...
    @overload
    def __getitem__(self, index: slice) -> SuperpointGraphFiles: ...
    def __getitem__(self, index: int | slice) -> LabelledEvidence | SuperpointGraphFiles:
        return (
            SuperpointGraphFiles(self._paths[index]) if isinstance(index, slice) else load_evidence(self._paths[index])
        )
