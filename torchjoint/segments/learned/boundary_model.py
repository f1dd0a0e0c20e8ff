"""Step 6, method learned: the trained model of the boundary between two regions.

In each round of merging the model says how probable it is that two neighbouring regions belong to different objects.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchjoint.ops.internal import boosted_trees
from torchjoint.runtime.threads import all_threads

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


def no_calibration() -> Tensor:
    """The calibration that changes nothing: [2, 2] float64."""
    return torch.tensor([[0.0, 1.0], [0.0, 1.0]], dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class MemberModel:
    """The model of one training seed, for K rounds of merging.

    Attributes:
        thresholds: K numbers in [0, 1]; a round merges regions up to this mean probability.
        feature_names: the F features of a boundary, in the order of the columns.
        rounds: K ensembles of trees, one for each round.
        calibrations: K maps of the trees' probability, each [2, C] float64: C >= 2 knots x (ascending) and y (not
            descending), both in [0, 1]. Between the knots the map is linear, beyond them constant. Empty: no map.

    Raises:
        TypeError, ValueError: the arrays do not fit together; the message names round and array.
    """

    thresholds: tuple[float, ...]
    feature_names: tuple[str, ...]
    rounds: tuple[BoostedTrees, ...]
    calibrations: tuple[Tensor, ...] = ()

    def __post_init__(self) -> None:
        if not self.calibrations:
            object.__setattr__(self, "calibrations", tuple(no_calibration() for _ in self.rounds))
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

    Raises:
        ValueError: there is no member, or the members are for other rounds.
    """

    members: tuple[MemberModel, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.members) <= _MOST_MEMBERS:
            raise ValueError(f"members: expected 1 to {_MOST_MEMBERS}, got {len(self.members)}")
        for number, member in enumerate(self.members):
            if (member.thresholds, member.feature_names) != (self.thresholds, self.feature_names):
                raise ValueError(f"members: number {number} has other thresholds or features than number 0")

    @classmethod
    def mean_of(cls, models: Iterable[BoundaryModel]) -> BoundaryModel:
        """The mean of all members of the models."""
        return cls(tuple(member for model in models for member in model.members))

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
    share = (probability - x[right - 1]) / (x[right] - x[right - 1])
    return torch.lerp(y[right - 1], y[right], share)


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
