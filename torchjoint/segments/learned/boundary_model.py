"""Step 6, method learned: the model that says how likely two regions belong to different objects; and its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from itertools import zip_longest
from pathlib import Path
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from torchjoint.ops.internal import boosted_trees
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.threads import all_threads
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES

MOST_ROUNDS = _MOST_MEMBERS = 100
#: The arrays of trees, and their types.
DTYPES = {
    "feature": torch.int32,
    "threshold": torch.float64,
    "missing_left": torch.bool,
    "left": torch.int32,
    "right": torch.int32,
    "leaf_value": torch.float64,
}


@dataclass(frozen=True, eq=False)
class BoostedTrees:
    """T decision trees, all padded to M nodes; the arguments of :func:`torchjoint.ops.internal.boosted_trees`.

    Attributes:
        feature: [T, M] int32, the feature that an inner node tests.
        threshold: [T, M] float64; a row goes left if its feature is at most the threshold.
        missing_left: [T, M] bool, whether a row goes left if its feature is missing.
        left, right: [T, M] int32, places of the children in the tree; -1 at a leaf.
        leaf_value: [T, M] float64.
        baseline: the sum starts from this number.
    """

    feature: Tensor
    threshold: Tensor
    missing_left: Tensor
    left: Tensor
    right: Tensor
    leaf_value: Tensor
    baseline: float = 0.0

    def arrays(self) -> tuple[Tensor, ...]:
        """The tensors, in the order of the operator's arguments."""
        return tuple(getattr(self, name) for name in DTYPES)

    def score(self, values: Tensor) -> Tensor:
        """The baseline plus the sum over the trees: the log odds of rows [B, F] float32; returns [B] float64."""
        with all_threads():
            return self.baseline + boosted_trees(values, *self.arrays())


@dataclass(frozen=True, eq=False)
class MemberModel:
    """The model of one training seed, for K rounds of merging.

    Attributes:
        thresholds: K numbers in [0, 1]; a round merges regions up to this mean probability.
        feature_names: the F features of a boundary, in the order of the columns.
        rounds: K ensembles of trees, one for each round.
        calibrations: K maps of the trees' probability, each [2, C] float64: C >= 2 knots x (ascending) and y (not
            descending), both in [0, 1]. Between the knots the map is linear, beyond them constant.
    """

    thresholds: tuple[float, ...]
    feature_names: tuple[str, ...]
    rounds: tuple[BoostedTrees, ...]
    calibrations: tuple[Tensor, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.rounds) <= MOST_ROUNDS:
            raise ValueError(f"rounds: expected 1 to {MOST_ROUNDS}, got {len(self.rounds)}")
        for name, of_rounds in (("thresholds", self.thresholds), ("calibrations", self.calibrations)):
            if len(of_rounds) != len(self.rounds):
                raise ValueError(f"{name}: expected one for each of {len(self.rounds)} rounds, got {len(of_rounds)}")
        if not all(0 <= threshold <= 1 for threshold in self.thresholds):
            raise ValueError(f"thresholds: expected numbers in [0, 1], got {list(self.thresholds)}")
        no_rows = torch.empty(0, len(self.feature_names), dtype=torch.float32)
        for number, (trees, calibration) in enumerate(zip(self.rounds, self.calibrations, strict=True)):
            try:
                if not math.isfinite(trees.baseline):
                    raise ValueError(f"baseline: expected a finite number, got {trees.baseline}")
                trees.score(no_rows)  # the operator checks the arrays
                _check_calibration(calibration)
            except (TypeError, ValueError) as error:
                raise type(error)(f"round{number}_{error}") from error

    def probability(self, number: int, values: Tensor) -> Tensor:
        """The probability that two regions belong to different objects.

        Args:
            number: number of the round, from 0.
            values: [B, F] float32, the features of each boundary; NaN = missing.

        Returns:
            [B] float64 in [0, 1].

        Raises:
            TypeError, ValueError: `values` has another dtype, or another number of features than the model.
        """
        if values.dim() != 2 or values.shape[1] != len(self.feature_names):
            raise ValueError(f"values: expected shape [B, {len(self.feature_names)}], got {list(values.shape)}")
        return calibrated(torch.sigmoid(self.rounds[number].score(values)), self.calibrations[number])


@dataclass(frozen=True, eq=False)
class BoundaryModel:
    """The mean of M models of several training seeds. Their random errors partly cancel, so it errs less.

    Attributes:
        members: M models with the same thresholds and features.
    """

    members: tuple[MemberModel, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.members) <= _MOST_MEMBERS:
            raise ValueError(f"members: expected 1 to {_MOST_MEMBERS}, got {len(self.members)}")
        for number, member in enumerate(self.members):
            if (member.thresholds, member.feature_names) != (self.thresholds, self.feature_names):
                raise ValueError(f"members: number {number} has other thresholds or features than number 0")

    @property
    def thresholds(self) -> tuple[float, ...]:
        """K numbers in [0, 1]; a round merges regions up to this mean probability."""
        return self.members[0].thresholds

    @property
    def feature_names(self) -> tuple[str, ...]:
        """The F features of a boundary, in the order of the columns."""
        return self.members[0].feature_names

    def probability(self, number: int, values: Tensor) -> Tensor:
        """The mean of the members' probabilities [B] float64; arguments and errors as :meth:`MemberModel.probability`.

        Each member is calibrated by itself. The mean of their log odds, with one calibration for all, is worse
        (benchmarks/README.md, *Does it carry over?*).
        """
        return torch.stack([member.probability(number, values) for member in self.members]).mean(0)


def calibrated(probability: Tensor, calibration: Tensor) -> Tensor:
    """Maps probabilities [B] float64 by a calibration [2, C] float64: linear between its knots, constant beyond."""
    x, y = calibration
    probability = probability.clamp(float(x[0]), float(x[-1]))
    right = torch.searchsorted(x.contiguous(), probability).clamp(1, len(x) - 1)
    return torch.lerp(y[right - 1], y[right], (probability - x[right - 1]) / (x[right] - x[right - 1]))


def _check_calibration(calibration: Tensor) -> None:
    if calibration.dtype != torch.float64:
        raise TypeError(f"calibration: expected dtype torch.float64, got {calibration.dtype}")
    if calibration.dim() != 2 or calibration.shape[0] != 2 or calibration.shape[1] < 2:
        raise ValueError(f"calibration: expected shape [2, C] with C >= 2, got {list(calibration.shape)}")
    if not bool(((calibration >= 0) & (calibration <= 1)).all()):
        raise ValueError("calibration: expected numbers in [0, 1]")
    x, y = calibration.diff(dim=1)
    if not bool((x > 0).all() and (y >= 0).all()):
        raise ValueError("calibration: expected ascending x, and y that do not descend")


#: The models that come with the package, in torchjoint/models/: for clouds alone, and with images.
PACKAGED, OF_IMAGES = "boundaries.npz", "boundaries-images.npz"
#: Largest size of all arrays in a model's file, bytes. The packaged model takes less than 2 MB.
LARGEST = 1 << 28
#: The version of the file's layout, stored in the file.
FORMAT = 2


def load_boundary_model(
    path: str | Path | None = None, features: tuple[str, ...] = FEATURE_NAMES, packaged: str | None = None
) -> BoundaryModel:
    """Reads and checks a model.

    The file may come from anyone: reading it runs no code, and its arrays may take at most LARGEST bytes.

    Args:
        path: a file of :func:`save_boundary_model`; None: the model that comes with the package; a process
            reads it only once.
        features: the names that it must have.
        packaged: name of the model that comes with the package, of PACKAGED if None.
    """
    if path is None:
        return _packaged_model(features, packaged or PACKAGED)
    path = Path(path)
    if not has_file(path):
        raise FileNotFoundError(f"{path}: missing; expected a model of `torchjoint-lab train-boundary-model`, NAME.npz")
    try:
        return _model(read_archive(path, most=LARGEST), features)
    except (ValueError, TypeError) as error:
        told = " ".join(str(error).removeprefix(f"{path}: ").split())
        raise ValueError(f"{path}: not a model of boundaries: {told}") from error


@lru_cache(maxsize=3)
def _packaged_model(features: tuple[str, ...], packaged: str) -> BoundaryModel:
    with as_file(files("torchjoint.models") / packaged) as path:
        return load_boundary_model(path, features)


def _model(arrays: dict[str, NDArray[Any]], features: tuple[str, ...]) -> BoundaryModel:
    def take(name: str, kind: str, dimensions: int) -> NDArray[Any]:
        if name not in arrays:
            raise ValueError(f"{name}: missing")
        array = arrays.pop(name)
        if array.dtype.kind != kind or array.ndim != dimensions:
            raise ValueError(f"{name}: expected {dimensions} dimensions of kind {kind!r}, got {array.dtype} "
                             f"{list(array.shape)}")  # fmt: skip
        return array

    version = take("format", "i", 1).tolist()
    if version != [FORMAT]:
        raise ValueError(f"format: expected [{FORMAT}], got {version[:3]}; from another version of torchjoint?")
    names = tuple(take("feature_names", "U", 1).tolist())
    if names != features:
        have, want = next(pair for pair in zip_longest(names, features) if pair[0] != pair[1])
        told = f"trained on {len(names)} features, of which this version computes others, or in another order"
        raise ValueError(f"feature_names: {told}: expected {want!r}, got {have!r}"[:300] + "; train it again")
    thresholds = tuple(take("thresholds", "f", 1).tolist())
    baselines = take("baselines", "f", 2)
    if not 1 <= len(thresholds) <= MOST_ROUNDS or baselines.shape[1] != len(thresholds):
        told = f"baselines: expected [members, rounds] for {len(thresholds)} rounds"
        raise ValueError(f"{told}, got {list(baselines.shape)}")
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
