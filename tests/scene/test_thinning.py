import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.scene.scene import voxel_subsample


@given(st.integers(0, 1000), st.integers(1, 60), st.sampled_from([0.1, 0.3, 2.0]))
def test_against_a_loop(seed, count, size):
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))
    best = {}
    low = points.double().amin(0)
    for index, point in enumerate(points.double()):
        cell = ((point - low) / size).long()
        distance = float(((point - low) / size - cell - 0.5).square().sum())
        key = tuple(cell.tolist())
        if key not in best or distance < best[key][0]:
            best[key] = (distance, index)
    assert voxel_subsample(points, size).tolist() == sorted(index for _, index in best.values())


def test_copies_of_a_point():
    assert voxel_subsample(torch.ones(5, 3), 0.1).tolist() == [0]


@pytest.mark.parametrize(("size", "message"), [(0.0, "expected more than 0"), (1e-9, "too small for a cloud")])
def test_sizes_that_do_not_do(size, message):
    with pytest.raises(ValueError, match=f"size: .*{message}"):
        voxel_subsample(torch.rand(5, 3), size)
