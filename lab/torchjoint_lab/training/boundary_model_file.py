"""Writes a model of boundaries as the package reads it: NAME.npz."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchjoint.runtime.files import atomic_write
from torchjoint.segments.learned.boundary_model import DTYPES, FORMAT, BoundaryModel


def save_boundary_model(path: Path, model: BoundaryModel) -> None:
    """Writes a model as an .npz file of plain arrays, atomically; equal models make equal files."""
    arrays: dict[str, NDArray[Any]] = {
        "format": np.array([FORMAT]),
        "feature_names": np.array(model.feature_names, dtype=np.str_),
        "thresholds": np.array(model.thresholds, dtype=np.float64),
        "baselines": np.array([[trees.baseline for trees in member.rounds] for member in model.members], np.float64),
    }
    for place, member in enumerate(model.members):
        for number, (trees, calibration) in enumerate(zip(member.rounds, member.calibrations, strict=True)):
            for name, array in zip(DTYPES, trees.arrays(), strict=True):
                arrays[f"member{place}_round{number}_{name}"] = array.numpy()
            arrays[f"member{place}_round{number}_calibration"] = calibration.numpy()
    with atomic_write(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, values in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(values), version=(1, 0), allow_pickle=False)
            # np.savez would store the time of writing.
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, content.getvalue(), compresslevel=9)
