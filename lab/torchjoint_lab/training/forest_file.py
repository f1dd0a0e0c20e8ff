"""Writes a trained forest to a file in OpenCV's format, which :func:`torchjoint.images.forest.read_forest` reads."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torchjoint.images.forest import LISTS, OPTIONS, Forest
from torchjoint.runtime.files import atomic_write


def write_forest(path: Path, forest: Forest) -> None:
    """Writes a file (``.yml.gz``) for ``cv2.ximgproc.createStructuredEdgeDetection``, atomically."""
    options = OPTIONS | {
        "numberOfTrees": len(forest.children),
        "numberOfTreesToEvaluate": forest.trees_per_site,
    }
    ends = np.cumsum(forest.boundary_counts.ravel(), dtype=np.int64)
    values: tuple[np.ndarray, ...] = (
        forest.children.ravel(),
        forest.features.ravel(),
        forest.thresholds.ravel(),
        np.concatenate([[0], ends]),
        forest.boundary_pixels,
    )
    # No time in the gzip header: the same forest gives the same file.
    with (
        atomic_write(path) as partial,
        partial.open("wb") as raw,
        gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0) as file,
    ):
        file.write(b"%YAML:1.0\n---\noptions:\n")
        file.writelines(f"   {name}: {value}\n".encode() for name, value in options.items())
        for name, array in zip(LISTS, values, strict=True):
            file.write(f"{name}:\n".encode())
            file.writelines(_rows(array))


def _rows(values: NDArray[np.generic], length: int = 1000) -> Iterator[bytes]:
    """YAML flow lists. They are few and long, because OpenCV reads many short lists more slowly."""
    for start in range(0, len(values), length):
        part = values[start : start + length].tolist()
        numbers = (f"{value:.9g}" for value in part) if values.dtype.kind == "f" else map(str, part)
        yield f"   - [ {', '.join(numbers)} ]\n".encode()
