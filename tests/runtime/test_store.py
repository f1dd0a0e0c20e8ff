"""Packed tensors come back to the last bit."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from torchjoint.runtime.store import pack

SHAPES = hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=6)
ARRAYS = st.sampled_from(["uint8", "int32", "int64", "float32"]).flatmap(lambda dtype: hnp.arrays(dtype, SHAPES))


@given(ARRAYS)
def test_any_tensor_comes_back(array):
    tensor = torch.from_numpy(array)
    packed = pack(tensor)
    back = packed.unpack()
    assert back.dtype == tensor.dtype
    assert back.shape == tensor.shape
    assert back.numpy().tobytes() == array.tobytes()  # NaN, -0 and all
    assert packed.num_bytes == array.nbytes


def test_what_is_unpacked_may_be_written_to():
    for dtype in (torch.uint8, torch.int32, torch.float32):
        back = pack(torch.zeros(2, 3, dtype=dtype)).unpack()
        back[0] = 1
        assert back.sum() == 3


def test_labels_become_small():
    labels = (torch.arange(480)[:, None] // 40 * 16 + torch.arange(640) // 40 - 1).int()
    packed = pack(labels)
    assert packed.stored == "u1"
    assert len(packed.data()) < labels.numel() / 40  # 1/160 of int32


def test_other_types_are_told():
    with pytest.raises(TypeError, match="tensor: expected one of uint8, int32, int64, float32, got bool"):
        pack(torch.zeros(3, dtype=torch.bool))
