"""A depth image is added to blocks of voxels: against the slow twin, exactly."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.integrate_depth import EXAMPLE, integrate_depth_reference

from torchjoint.ops.internal import UNIT, integrate_depth


@given(st.integers(0, 2**32 - 1))
def test_sums_are_those_of_the_twin(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    depth = 3 * torch.rand(6, 7, generator=generator)
    depth[torch.rand(6, 7, generator=generator) < 0.2] = torch.tensor([0.0, float("nan"), float("inf"), -1.0])[seed % 4]
    pose = torch.eye(4, dtype=torch.float64)
    rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]
    pose[:3, :3], pose[:3, 3] = rotation * torch.linalg.det(rotation), torch.randn(3, generator=generator).double() / 2
    arguments = (
        torch.tensor([0, 2]),
        torch.randint(-2, 2, (2, 3), generator=generator),
        depth,
        torch.randint(256, (6, 7, 3), generator=generator, dtype=torch.uint8),
        torch.tensor([[5.0, 0, 3.2], [0, 4.0, 2.7], [0, 0, 1]], dtype=torch.float64),
        pose,
        *(0.13, 0.5, 2.0),
    )
    ours, twin = (torch.randint(9, (3, 512, 5), dtype=torch.int32).fill_(seed % 3) for _ in range(2))
    integrate_depth(ours, *arguments)
    integrate_depth_reference(twin, *arguments)
    assert torch.equal(ours, twin)
    assert (ours[1] == seed % 3).all()  # the row of no block


def test_a_voxel_by_hand() -> None:
    sums = torch.zeros(2, 512, 5, dtype=torch.int32)
    integrate_depth(**EXAMPLE | {"sums": sums})
    # Voxel (0, 0, 2) of the block: centre (.05, .05, 1.05); pixel round(4 * .05 / 1.05 + 0) = (0, 0); 1.2 m measured.
    ray = (1 + 2 * (0.05 / 1.05) ** 2) ** 0.5
    assert sums[1, 2].tolist() == [round((1.2 - 1.05) * ray / 0.4 * UNIT), 1, 0, 1, 2]
    assert not sums[0].any()
    # Centre (.05, .05, 1.55): .35 m behind the surface. The next one, at 1.65 m, is beyond the truncation.
    assert sums[1, 7, 0] == round((1.2 - 1.55) * (1 + 2 * (0.05 / 1.55) ** 2) ** 0.5 / 0.4 * UNIT)


def test_sums_never_overflow() -> None:
    most = 2**16  # with this weight, a voxel ignores further images
    sums = torch.zeros(2, 512, 5, dtype=torch.int32)
    sums[:, :, 1] = most
    before = sums.clone()
    integrate_depth(**EXAMPLE | {"sums": sums})
    assert torch.equal(sums, before)
    assert UNIT * most < 2**31


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_change_nothing(threads: int) -> None:
    generator = torch.Generator().manual_seed(0)
    block = torch.cartesian_prod(*[torch.arange(-3, 4)] * 3)
    arguments = EXAMPLE | {"row": torch.arange(len(block)), "block": block}
    arguments |= {"depth": torch.rand(3, 4, generator=generator) + 1}
    one, other = (torch.zeros(len(block), 512, 5, dtype=torch.int32) for _ in range(2))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        integrate_depth(**arguments | {"sums": one})
        torch.set_num_threads(3 - threads)
        integrate_depth(**arguments | {"sums": other})
    finally:
        torch.set_num_threads(before)
    assert torch.equal(one, other)
    assert one.any()
