"""The mean of models: log odds and calibrations are the means of the members', computed here one by one."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.points.boundary_features import FEATURE_NAMES
from torchjoint.points.boundary_model import (
    BoostedTrees,
    BoundaryModel,
    calibrated,
    load_boundary_model,
    no_calibration,
)
from torchjoint.training import save_boundary_model
from torchjoint.training.mean_model import mean_calibration, mean_model, mean_trees


def stumps(count: int, generator: torch.Generator, nodes: int = 3) -> BoostedTrees:
    """Trees of one inner node and two leaves, padded with leaves that nothing reaches."""
    left = torch.full((count, nodes), -1, dtype=torch.int32)
    right = left.clone()
    left[:, 0], right[:, 0] = 1, 2
    return BoostedTrees(
        feature=torch.randint(len(FEATURE_NAMES), (count, nodes), generator=generator, dtype=torch.int32),
        threshold=torch.randn(count, nodes, generator=generator, dtype=torch.float64),
        missing_left=torch.rand(count, nodes, generator=generator) < 0.5,
        left=left,
        right=right,
        leaf_value=torch.randn(count, nodes, generator=generator, dtype=torch.float64),
        baseline=float(torch.randn((), generator=generator)),
    )


@given(st.integers(0, 2**31), st.lists(st.tuples(st.integers(0, 4), st.integers(3, 6)), min_size=1, max_size=4))
def test_trees(seed: int, sizes: list[tuple[int, int]]) -> None:
    generator = torch.Generator().manual_seed(seed)
    members = [stumps(count, generator, nodes) for count, nodes in sizes]
    values = torch.randn(20, len(FEATURE_NAMES), generator=generator)
    values[torch.rand(values.shape, generator=generator) < 0.2] = torch.nan
    expected = torch.stack([one.score(values) for one in members]).mean(0)
    torch.testing.assert_close(mean_trees(members).score(values), expected, rtol=0, atol=1e-12)


def test_calibrations_by_hand() -> None:
    steep = torch.tensor([[0.2, 0.4], [0.0, 1.0]], dtype=torch.float64)
    mean = mean_calibration([steep, no_calibration()])
    assert mean[0].tolist() == [0.0, 0.2, 0.4, 1.0]
    torch.testing.assert_close(mean[1], torch.tensor([0.0, 0.1, 0.7, 1.0], dtype=torch.float64))
    probability = torch.linspace(0, 1, 41, dtype=torch.float64)
    expected = (calibrated(probability, steep) + probability) / 2
    torch.testing.assert_close(calibrated(probability, mean), expected)


def test_a_file_keeps_the_mean(tmp_path) -> None:
    generator = torch.Generator().manual_seed(0)
    members = [BoundaryModel((0.5,), FEATURE_NAMES, (stumps(3, generator, 3 + i),)) for i in range(2)]
    assert mean_model(members[:1]) is members[0]
    mean = mean_model(members)
    save_boundary_model(tmp_path / "mean.npz", mean)
    values = torch.from_numpy(np.random.default_rng(0).normal(size=(9, len(FEATURE_NAMES))).astype(np.float32))
    assert torch.equal(load_boundary_model(tmp_path / "mean.npz").probability(0, values), mean.probability(0, values))
