"""Masks: what goes in comes out, overlaps and nesting, sizes, and errors that name what is wrong."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.scene import Masks

EYE = torch.eye(4, dtype=torch.float64)


def frame(**masks: object) -> tj.Frame:
    return tj.Frame(torch.zeros(3, 4, 6), EYE[:3, :3], EYE, **masks)


@few_and_many(20, 200, seed=st.integers(0, 2**32 - 1), count=st.integers(0, 6), height=st.integers(1, 7))
def test_a_stack_comes_back(seed: int, count: int, height: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    stack = torch.rand(count, height, 5, generator=generator) < 0.4
    masks = Masks.from_stack(stack)
    assert torch.equal(masks.stack(), stack)
    assert torch.equal(masks.covered(), stack.any(0) if count else torch.zeros(height, 5, dtype=torch.bool))
    # Atoms are the classes of pixels that lie in the same masks, by first appearance.
    signature = stack.flatten(1).t() if count else torch.zeros(height * 5, 0)
    same = (signature[:, None] == signature[None]).all(2)
    atom = masks.atom.flatten()
    assert torch.equal(atom[:, None] == atom[None], same)
    assert torch.equal(torch.unique_consecutive(atom.long().cummax(0).values), torch.arange(masks.num_atoms))


def test_labels_come_back() -> None:
    labels = torch.tensor([[7, 7, -1], [3, -1, 3]])
    masks = Masks.from_labels(labels, torch.tensor([0.5, 1.0]))
    assert masks.labels().tolist() == [[1, 1, -1], [0, -1, 0]]  # in ascending order of the values
    assert masks.scores.tolist() == [0.5, 1.0]
    assert Masks.from_labels(labels + 1, none=0).labels().tolist() == masks.labels().tolist()


def test_of_nested_masks_the_smallest_is_shown() -> None:
    whole, part = torch.ones(2, 3, dtype=torch.bool), torch.tensor([[True, False, False], [False] * 3])
    assert Masks.from_stack(torch.stack([whole, part])).labels().tolist() == [[1, 0, 0], [0, 0, 0]]
    assert Masks.from_stack(torch.stack([part, whole])).labels().tolist() == [[0, 1, 1], [1, 1, 1]]


def test_labels_divide_the_pixels_outside_masks() -> None:
    masks = Masks.from_stack(torch.tensor([[[1, 1, 0, 0], [0, 1, 0, 0]], [[0, 1, 0, 0], [0, 0, 0, 0]]]).bool())
    divided = masks.divided(torch.tensor([[0, 0, 0, 1], [2, 2, 0, 1]]))
    assert divided.atom.tolist() == [[0, 1, 2, 3], [4, 0, 2, 3]]
    assert torch.equal(divided.stack(), masks.stack())


def test_a_frame_scales_masks_of_another_size() -> None:
    half = torch.tensor([[0, 0, 1], [0, -1, 1]])
    pass_through = frame(masks=torch.where(half < 0, -1, half + 1))
    assert isinstance(pass_through.masks, Masks)
    assert torch.equal(pass_through.masks.labels(), half.repeat_interleave(2, 0).repeat_interleave(2, 1))
    with pytest.warns(UserWarning, match="0 counts as a mask, and no pixel is -1"):
        frame(masks=torch.zeros(4, 6, dtype=torch.int64))
    with pytest.warns(UserWarning, match="65535 is a label; if it was -1"):
        frame(labels=torch.arange(-1, 23).view(4, 6).to(torch.uint16))
    with pytest.warns(UserWarning, match="other aspect ratio"):
        frame(masks=torch.ones(1, 6, 4, dtype=torch.bool))


@pytest.mark.parametrize("kind", [np.uint16, np.uint32, np.uint64])
def test_a_label_map_of_unsigned_integers(kind: type) -> None:
    labels = np.arange(24).reshape(4, 6) % 5 + 1
    assert torch.equal(frame(masks=labels.astype(kind)).masks.labels(), torch.from_numpy(labels) - 1)


def test_one_mask_and_scores() -> None:
    one = torch.zeros(4, 6, dtype=torch.bool)
    one[1:3] = True
    masks = frame(masks=one, mask_scores=torch.tensor([0.25])).masks
    assert isinstance(masks, Masks)
    assert torch.equal(masks.stack()[0], one)
    assert masks.scores.tolist() == [0.25]
    assert repr(masks) == "Masks(1 masks, 4 x 6 pixels, 50% covered)"


BOOLS = torch.zeros(2, 4, 6, dtype=torch.bool)


@pytest.mark.parametrize(
    ("masks", "error", "message"),
    [
        ({"masks": BOOLS.float()}, TypeError, r"masks: expected dtype bool for a stack \[M, H, W\], got torch.float32"),
        ({"masks": BOOLS.byte()}, TypeError, r"masks: expected dtype bool for a stack \[M, H, W\], got torch.uint8"),
        ({"masks": torch.rand(4, 6)}, TypeError, "masks: expected an integer dtype, got torch.float32"),
        ({"masks": BOOLS[:, :0]}, ValueError, "masks: expected at least one pixel, got 0 x 6"),
        ({"masks": BOOLS[None]}, ValueError, r"masks: expected shape \[M, H, W\], got \[1, 2, 4, 6\]"),
        (
            {"masks": BOOLS.tolist()},
            TypeError,
            "masks: expected a torch.Tensor or Masks, got list; see torchjoint.mas",
        ),
        ({"masks": torch.full((4, 6), -2)}, ValueError, "masks: expected labels >= -1"),
        ({"masks": BOOLS, "mask_scores": torch.ones(3)}, ValueError, r"masks' scores: expected shape \[2\], got \[3\]"),
        ({"masks": BOOLS, "mask_scores": torch.tensor([0.1, torch.nan])}, ValueError, "masks' scores: expected finite"),
        ({"masks": BOOLS, "mask_scores": torch.tensor([0.1, 1.5])}, ValueError, r"masks' scores: .* got 0.1 to 1.5"),
        ({"mask_scores": torch.ones(1)}, ValueError, "mask_scores: expected none, because there are no masks"),
    ],
)
def test_errors_name_the_argument(masks: dict[str, object], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        frame(**masks)


@pytest.mark.slow
def test_ten_thousand_masks_of_one_pixel():
    stack = torch.zeros(10_000, 240, 320, dtype=torch.bool)
    stack.view(10_000, -1)[torch.arange(10_000), torch.randperm(240 * 320)[:10_000]] = True
    masks = Masks.from_stack(stack)
    assert (len(masks), masks.num_atoms, int(masks.areas().sum())) == (10_000, 10_001, 10_000)


@pytest.mark.parametrize(
    ("size", "half"), [((12, 15), (6, 7)), ((15, 12), (7, 6)), ((15, 15), (8, 7)), ((9, 9), (5, 5))]
)
def test_half_the_size_is_no_other_aspect(size, half):
    masks = Masks.from_stack(torch.ones(1, *half, dtype=torch.bool))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert masks.resized(size).covered().all()
