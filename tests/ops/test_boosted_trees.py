"""boosted_trees: against its slow twin and scikit-learn, and the same on any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.boosted_trees import EXAMPLE as BOOSTED_TREES
from reference.boosted_trees import boosted_trees_reference
from torch import Tensor

from torchjoint.ops.internal import boosted_trees


def random_trees(seed: int, trees: int, nodes: int, features: int) -> dict[str, Tensor]:
    """Trees of at most so many nodes: leaves are split at random until there is no place for two more."""
    rng = np.random.default_rng(seed)
    left, right = (np.full((trees, nodes), -1, np.int32) for _ in range(2))
    for tree in range(trees):
        leaves, used = [0], 1
        while used + 2 <= nodes and rng.random() < 0.9:
            leaf = leaves.pop(rng.integers(len(leaves)))
            left[tree, leaf], right[tree, leaf] = rng.permutation([used, used + 1])
            leaves += [used, used + 1]
            used += 2
    shape = (trees, nodes)
    return {
        "feature": torch.from_numpy(rng.integers(features, size=shape).astype(np.int32)),
        "threshold": torch.from_numpy(rng.integers(-2, 3, size=shape) / 2),
        "missing_left": torch.from_numpy(rng.random(shape) < 0.5),
        "left": torch.from_numpy(left),
        "right": torch.from_numpy(right),
        "leaf_value": torch.from_numpy(rng.normal(size=shape)),
    }


def random_rows(seed: int, rows: int, features: int) -> Tensor:
    """Multiples of 1/4, so that some equal a threshold, and infinite and missing ones."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.randint(-6, 7, (rows, features), generator=generator) / 4
    values[values == 1.5] = torch.nan
    values[values == -1.5] = torch.inf
    return values


@few_and_many(
    40,
    300,
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(0, 12) | st.integers(13, 150),  # more than go side by side, more than a block
    trees=st.integers(0, 4),
    nodes=st.integers(1, 15),
    features=st.integers(1, 5),
)
def test_the_twin(seed: int, rows: int, trees: int, nodes: int, features: int) -> None:
    values, arrays = random_rows(seed, rows, features), random_trees(seed, trees, nodes, features)
    assert torch.equal(boosted_trees(values, **arrays), boosted_trees_reference(values, **arrays))


def test_by_hand() -> None:
    expected = torch.tensor([-1.0 + 0.25, 2.0 + 0.25, -1.0 + 0.5], dtype=torch.float64)
    assert torch.equal(boosted_trees(**BOOSTED_TREES), expected)


def test_a_threshold_between_two_float32_numbers() -> None:
    """In float32 the threshold would round to the value, which would then go left."""
    value = torch.tensor([[0.1]])
    below = value.double().view(1, 1) - 1e-12
    trees = {name: array[:1] for name, array in BOOSTED_TREES.items() if name != "values"}
    threshold = torch.cat([below, torch.zeros(1, 2, dtype=torch.float64)], 1)
    assert boosted_trees(value, **trees | {"threshold": threshold}).tolist() == [2.0]
    assert boosted_trees(value, **trees | {"threshold": threshold + 2e-12}).tolist() == [-1.0]


def test_leaves_only_need_no_features() -> None:
    trees = random_trees(0, 3, 1, 1)
    result = boosted_trees(torch.empty(2, 0), **trees)
    assert torch.equal(result, boosted_trees_reference(torch.empty(2, 0), **trees))


def test_the_number_of_threads_changes_nothing(set_threads) -> None:
    values, trees = random_rows(1, 5000, 6), random_trees(1, 50, 31, 6)
    set_threads(1)
    expected = boosted_trees(values, **trees)
    for count in (2, 4):
        set_threads(count)
        assert torch.equal(boosted_trees(values, **trees), expected)


def test_a_row_does_not_depend_on_the_others() -> None:
    values, trees = random_rows(2, 700, 4), random_trees(2, 20, 15, 4)
    whole = boosted_trees(values, **trees)
    assert torch.equal(torch.cat([boosted_trees(part, **trees) for part in values.split(99)]), whole)


def test_any_strides() -> None:
    values, trees = random_rows(3, 30, 4), random_trees(3, 6, 9, 4)
    strided = {name: array.T.contiguous().T for name, array in trees.items()}
    assert torch.equal(boosted_trees(values.T.contiguous().T, **strided), boosted_trees(values, **trees))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the compiler's own
def test_compile_without_graph_breaks() -> None:
    compiled = torch.compile(
        lambda values, trees: boosted_trees(values * 2, **trees).sigmoid(), fullgraph=True, dynamic=True,
        backend="aot_eager",
    )  # fmt: skip
    for rows in (3, 10, 40):
        values, trees = random_rows(rows, rows, 4), random_trees(rows, 6, 9, 4)
        torch.testing.assert_close(compiled(values, trees), boosted_trees(values * 2, **trees).sigmoid())


def test_scikit_learn() -> None:
    """What a fitted HistGradientBoostingClassifier computes, also of rows with missing features."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from torchjoint_lab.training.boundary_model import trees_of_classifier

    rng = np.random.default_rng(0)
    values = rng.normal(size=(600, 5)).astype(np.float32)
    answer = (np.nan_to_num(values[:, 0]) * values[:, 1] + 0.3 * rng.normal(size=600)) > 0
    values[rng.random(values.shape) < 0.2] = np.nan
    values[:, 4] = np.where(answer & (rng.random(600) < 0.5), np.nan, 1)  # can only be split in missing and known
    classifier = HistGradientBoostingClassifier(max_iter=30, max_leaf_nodes=12, min_samples_leaf=5, random_state=0)
    classifier.fit(values, answer)
    trees = trees_of_classifier(classifier)
    assert (trees.threshold == np.finfo(np.float64).max).any()
    others = rng.normal(size=(2000, 5)).astype(np.float32) * 2
    others[rng.random(others.shape) < 0.2] = np.nan
    for rows in (values, others):
        result = trees.baseline + boosted_trees(torch.from_numpy(rows), *trees.arrays())
        np.testing.assert_allclose(result.numpy(), classifier.decision_function(rows), rtol=0, atol=1e-12)
