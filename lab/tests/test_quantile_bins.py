"""Trees grown on the numbers of weighted bins are those that scikit-learn grows on the values."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchjoint_lab.training.boundary_model import trees_of_classifier
from torchjoint_lab.training.quantile_bins import MAX_BINS, QuantileBins


def table(seed, rows=700):
    """Many values; few values; values with some missing, which differ in kind; the answers and the weights."""
    rng = np.random.default_rng(seed)
    values = np.stack([rng.normal(size=rows), rng.integers(0, 9, rows), rng.random(rows) ** 4], 1).astype(np.float32)
    answer = values[:, 0] + 0.2 * values[:, 1] + rng.normal(size=rows) > 1
    values[rng.random(rows) < np.where(answer, 0.4, 0.1), 2] = np.nan
    return values, answer, rng.random(rows) ** 2 + 0.01


@pytest.mark.parametrize("seed", range(3))
def test_trees_of_scikit_learn(seed):
    from sklearn.ensemble import HistGradientBoostingClassifier

    values, answer, weight = table(seed)
    assert len(np.unique(values[:, 0])) > MAX_BINS
    classifier = HistGradientBoostingClassifier(max_iter=8, max_leaf_nodes=9, min_samples_leaf=5, early_stopping=False)
    expected = trees_of_classifier(classifier.fit(values, answer, sample_weight=weight))
    bins = QuantileBins(values, weight)
    found = trees_of_classifier(classifier.fit(bins.numbers(values), answer, sample_weight=weight), bins)
    assert (expected.left >= 0).sum() > 20
    for name, array in vars(expected).items():
        assert torch.equal(torch.as_tensor(getattr(found, name)), torch.as_tensor(array)), name


def test_bins_by_hand():
    values = np.array([[5, 1], [2, np.nan], [9, np.nan], [2, 3]], np.float32)
    bins = QuantileBins(values, np.array([1.0, 1, 0, 1]))  # the row of 9 does not count
    numbers = bins.numbers(values)
    np.testing.assert_array_equal(numbers, [[1, 0], [0, np.nan], [1, np.nan], [0, 1]])
    np.testing.assert_array_equal(bins.thresholds(np.array([0, 1]), np.array([0.5, 0.5])), [3.5, 2])


def test_heavy_rows_have_bins_of_their_own():
    values = np.arange(1000, dtype=np.float32)[:, None]
    weight = np.where(values[:, 0] < 900, 1e-6, 1.0)
    numbers = QuantileBins(values, weight).numbers(values)[:, 0]
    assert numbers.max() < MAX_BINS
    assert len(np.unique(numbers[900:])) == 100
    assert len(np.unique(numbers[:900])) == 1


def test_column_that_is_missing_throughout_is_one_bin():
    values = np.full((4, 1), np.nan, np.float32)
    assert QuantileBins(values, np.ones(4)).numbers(values).tolist() == [[0]] * 4
