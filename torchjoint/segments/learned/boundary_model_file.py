"""Step 6, method learned: reads and writes the file of a trained model; the package contains one.

A file is an .npz archive of plain arrays. It may come from anyone: reading it runs no code, and every size is checked.
"""

from __future__ import annotations

import io
import math
import zipfile
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import has_file
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES
from torchjoint.segments.learned.boundary_model import DTYPES, MOST_ROUNDS, BoostedTrees, BoundaryModel, MemberModel

#: The model that comes with the package, in torchjoint/models/.
PACKAGED = "boundaries.npz"
#: Largest size of all arrays in a model's file, bytes. The packaged model takes less than 2 MB.
LARGEST = 1 << 28
#: The version of the file's layout, stored in the file.
_FORMAT = 2


def save_boundary_model(path: Path, model: BoundaryModel) -> None:
    """Writes a model as an .npz file of plain arrays, atomically; equal models make equal files."""
    arrays: dict[str, NDArray[Any]] = {
        "format": np.array([_FORMAT]),
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


def load_boundary_model(path: str | Path | None = None) -> BoundaryModel:
    """Reads and checks a model.

    The file may come from anyone: reading it runs no code, and its arrays may take at most LARGEST bytes.

    Args:
        path: a file of :func:`save_boundary_model`; None: the model that comes with the package; a process
            reads it only once.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or its model is for other features; the message names the file and the array.
    """
    if path is None:
        return _packaged_model()
    path = Path(path)
    if not has_file(path):
        raise FileNotFoundError(f"{path}: missing; expected a model of `torchjoint-lab train-boundary-model`, NAME.npz")
    try:
        return _model(_read_arrays(path))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: not a model of boundaries: {error}") from error


@lru_cache(maxsize=1)
def _packaged_model() -> BoundaryModel:
    with as_file(files("torchjoint.models") / PACKAGED) as path:
        return load_boundary_model(path)


def _model(arrays: dict[str, NDArray[Any]]) -> BoundaryModel:
    def take(name: str, kind: str, dimensions: int) -> NDArray[Any]:
        if name not in arrays:
            raise ValueError(f"{name}: missing")
        array = arrays.pop(name)
        if array.dtype.kind != kind or array.ndim != dimensions:
            raise ValueError(f"{name}: expected {dimensions} dimensions of kind {kind!r}, got {array.dtype} "
                             f"{list(array.shape)}")  # fmt: skip
        return array

    version = take("format", "i", 1).tolist()
    if version != [_FORMAT]:
        raise ValueError(f"format: expected [{_FORMAT}], got {version[:3]}; from another version of torchjoint?")
    names = tuple(take("feature_names", "U", 1).tolist())
    if names != FEATURE_NAMES:
        raise ValueError(_other_features(names))
    thresholds = tuple(take("thresholds", "f", 1).tolist())
    baselines = take("baselines", "f", 2)
    if not 1 <= len(thresholds) <= MOST_ROUNDS or baselines.shape[1] != len(thresholds):
        raise ValueError(
            f"baselines: expected [members, rounds] for {len(thresholds)} rounds, got {list(baselines.shape)}"
        )
    members = []
    for place, of_member in enumerate(baselines.tolist()):
        rounds, calibrations = [], []
        for number, baseline in enumerate(of_member):
            of_round = {}
            for name, dtype in DTYPES.items():
                kind = "b" if dtype == torch.bool else "f" if dtype.is_floating_point else "i"
                of_round[name] = torch.from_numpy(take(f"member{place}_round{number}_{name}", kind, 2))
            rounds.append(BoostedTrees(**of_round, baseline=baseline))
            calibrations.append(torch.from_numpy(take(f"member{place}_round{number}_calibration", "f", 2)))
        try:
            members.append(MemberModel(thresholds, names, tuple(rounds), tuple(calibrations)))
        except (TypeError, ValueError) as error:
            raise type(error)(f"member{place}_{error}") from error
    if arrays:
        raise ValueError(f"{min(arrays)}: unexpected array")
    return BoundaryModel(tuple(members))


def _other_features(names: tuple[str, ...]) -> str:
    pairs = zip(names, FEATURE_NAMES, strict=False)
    place = next((i for i, (have, want) in enumerate(pairs) if have != want), min(len(names), len(FEATURE_NAMES)))
    have, want = (repr(all_[place][:80]) if place < len(all_) else "none" for all_ in (names, FEATURE_NAMES))
    return (
        f"feature_names: trained on other features than this version computes ({len(names)} instead of "
        f"{len(FEATURE_NAMES)}; number {place} is {have} instead of {want}); train it again"
    )


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name; checks every declared size before it allocates memory."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > LARGEST:
                raise ValueError(f"expected arrays of at most {LARGEST >> 20} MB")
            return {entry.filename.removesuffix(".npy"): _read_array(archive, entry) for entry in entries}
    except ValueError:
        raise
    except Exception as error:  # zipfile and zlib raise many kinds of errors when a file is damaged
        raise ValueError(f"not a whole .npz file ({' '.join(str(error).split())})") from error


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    # numpy would allocate the declared size before it finds that the file has fewer bytes.
    with archive.open(entry) as file:
        content = io.BytesIO(file.read(LARGEST))
    try:
        if np.lib.format.read_magic(content) != (1, 0):
            raise ValueError("expected version 1.0 of the .npy format")
        shape, in_columns, dtype = np.lib.format.read_array_header_1_0(content)
        count = math.prod(shape)
        if dtype.hasobject or dtype.fields is not None or dtype.itemsize == 0 or not dtype.isnative:
            raise ValueError(f"expected plain numbers or names, got {dtype}")
        left = len(content.getbuffer()) - content.tell()
        if in_columns or min(shape, default=0) < 0 or count * dtype.itemsize != left:
            raise ValueError(f"expected {list(shape)} of {dtype} by rows, got {left} bytes")
        values = np.frombuffer(content.getbuffer()[content.tell() :], dtype) if left else np.empty(count, dtype)
        return values.reshape(shape).copy()
    except Exception as error:  # reading the header of a damaged array can raise anything
        raise ValueError(f"{entry.filename.removesuffix('.npy')}: {' '.join(str(error).split())}") from error
