"""Masks with the errors of networks: as perfect, and as wrong, as they claim to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torchjoint_lab.synthetic import MASK_LEVELS, known_things, make_network_masks, with_network_masks
from torchjoint_lab.synthetic.mask_errors import jittered, merged, split
from torchjoint_lab.synthetic.network_masks import _kept

import torchjoint as tj

SIZE = 120, 160


@pytest.fixture(scope="module")
def scene():
    return tj.synthetic.make_scene(0, num_views=2, num_points=500, height=48, width=64).scene


def checkerboard(cell=20):
    """48 instances of cells, and a void border."""
    rows, columns = np.indices(SIZE) // cell
    labels = rows * 8 + columns
    labels[:, :3] = -1
    return torch.from_numpy(labels)


def best_ious(masks, labels):
    """Per mask the instance it fits best, and how well."""
    member = torch.nn.functional.one_hot(labels.flatten() + 1, 49)[:, 1:].float()
    stack = masks.stack().flatten(1).float()
    inside = stack @ member
    best = (inside / (stack.sum(1, keepdim=True) + member.sum(0) - inside)).max(1)
    return list(zip(best.indices.tolist(), best.values.tolist(), strict=True))


def test_perfect_masks_are_the_truth_in_a_shuffled_order():
    labels = checkerboard()
    masks = [make_network_masks(labels, "perfect", 0, index) for index in range(2)]
    for one in masks:
        assert len(one) == 48
        assert torch.equal(one.covered(), labels >= 0)
        assert sorted(best_ious(one, labels)) == [(i, 1.0) for i in range(48)]
        assert (one.scores == 1).all()
    assert not torch.equal(masks[0].labels(), masks[1].labels())


@pytest.mark.parametrize("level", MASK_LEVELS)
def test_equal_arguments_give_equal_masks(level):
    labels = checkerboard()
    first, second = (make_network_masks(labels, level, 3, 5) for _ in range(2))
    assert torch.equal(first.atom, second.atom)
    assert torch.equal(first.pairs, second.pairs)
    assert torch.equal(first.scores, second.scores)
    other = make_network_masks(labels, level, 3, 6)
    assert not torch.equal(first.labels(), other.labels())


def test_levels_are_as_wrong_as_they_say():
    """With 48 instances an image, the shares over 3 images stray from the probabilities by some .04."""
    labels = checkerboard()
    whole = {}
    for level in ("sam-like", "hard"):
        fits = [best_ious(make_network_masks(labels, level, 0, i), labels) for i in range(3)]
        whole[level] = sum(len({which for which, iou in image if iou > 0.7}) for image in fits) / 144
    # Neither dropped, nor split, nor in a union: at most 1 - the probability of each, merged with what it touches.
    assert 0.85 * 0.7 * 0.80 < whole["sam-like"] < 0.85 * 0.7 + 0.1
    assert 0.7 * 0.5 * 0.55 < whole["hard"] < 0.7 * 0.5 + 0.1


def test_small_instances_are_dropped_more_often():
    """The smallest with 1.8 times the mean probability, the largest with .2; 2000 draws stray by some .01."""
    shown = np.repeat([-1, 0, 1, 2], [5, 30, 10, 20])[None]
    rng = np.random.default_rng(0)
    kept = np.bincount([one for _ in range(2000) for one in _kept(rng, shown, 0.3)], minlength=3) / 2000
    assert kept == pytest.approx([1 - 0.06, 1 - 0.54, 1 - 0.3], abs=0.04)


def test_masks_with_errors_nest_and_cover_parts_of_the_void():
    labels = checkerboard()
    labels[60:, 80:] = -1
    masks = make_network_masks(labels, "hard", 0)
    stack = masks.stack()
    inside = (stack[:, None] & stack[None]).sum((2, 3)) / stack.sum((1, 2))[:, None]
    assert ((inside > 0.8).sum(1) > 1).any()
    assert 0.1 < masks.covered()[labels < 0].float().mean() < 1
    assert 0.4 <= float(masks.scores.min()) < float(masks.scores.max()) <= 1


def test_an_outline_is_off_by_about_the_pixels_that_it_should():
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:380, 100:540] = True
    off = jittered(np.random.default_rng(0), mask, 3.0) ^ mask
    outline = 2 * (280 + 440)
    assert 0.5 * outline < off.sum() < 4 * outline  # 3 px in both axes together: a mean of 1.7 px across the outline
    rows, columns = np.nonzero(off)
    depth = np.minimum.reduce([abs(rows - 99.5), abs(rows - 379.5), abs(columns - 99.5), abs(columns - 539.5)])
    assert depth.max() < 12


@pytest.mark.parametrize("seed", range(6))
def test_parts_of_a_split_partition_the_mask(seed):
    mask = np.zeros(SIZE, dtype=bool)
    mask[10:90, 20:100] = True
    parts = split(np.random.default_rng(seed), mask, 3)
    assert 2 <= len(parts) <= 3
    assert (np.sum(parts, axis=0) == mask).all()


def test_only_what_touches_merges():
    labels = np.full(SIZE, -1)
    labels[:20, :20], labels[:20, 20:40], labels[60:80, 60:80] = 0, 1, 2
    group = merged(np.random.default_rng(0), labels, 3, 1.0)
    assert group[0] == group[1]
    assert group[2] == 2


def test_frames_carry_masks_and_no_other_segmentation(scene):
    labelled = tuple(replace(frame, labels=scene.truth.images[0]) for frame in scene.frames)
    masked = with_network_masks(replace(scene, frames=labelled), "sam-like", 4)
    assert isinstance(masked.frames, tuple)
    for index, frame in enumerate(masked.frames):
        assert frame.labels is None
        expected = make_network_masks(scene.truth.images[index], "sam-like", 4, index)
        assert torch.equal(frame.masks.atom, expected.atom)


def test_lazy_frames_stay_lazy(scene):
    class Counting(Sequence):
        read = 0

        def __len__(self):
            return len(scene.frames)

        def __getitem__(self, index):
            Counting.read += 1
            return scene.frames[index]

    masked = with_network_masks(replace(scene, frames=Counting()), "hard")
    assert Counting.read == 0
    assert len(masked.frames[-1].masks)
    assert Counting.read == 1
    assert len(masked.frames[0:2]) == 2


def test_wrong_arguments_are_named(scene):
    with pytest.raises(ValueError, match="level: expected one of 'perfect', 'sam-like', 'hard', got 'easy'"):
        with_network_masks(scene, "easy")
    with pytest.raises(ValueError, match="seed: expected an integer of at least 0, got -1"):
        with_network_masks(scene, "hard", -1)
    with pytest.raises(ValueError, match="scene: expected a true image for each of 2 frames, got 0"):
        with_network_masks(replace(scene, truth=None), "hard")
    with pytest.raises(TypeError, match=r"scene: expected a Scene, such as make_scene.*got NoneType"):
        with_network_masks(None, "hard")
    with pytest.raises(ValueError, match=r"labels: expected shape \[H, W\], got \[4\]"):
        make_network_masks(torch.zeros(4, dtype=torch.int64), "hard")


def test_an_image_of_void_alone_has_no_masks_but_fragments():
    void = torch.full(SIZE, -1)
    assert len(make_network_masks(void, "perfect")) == 0
    assert len(make_network_masks(void, "hard")) > 0


def test_a_detector_masks_some_things_and_nothing_else(scene):
    known = known_things(scene, 0.5, seed=3)
    instances, size = torch.unique(scene.truth.points[scene.truth.points >= 0], return_counts=True)
    things = instances[size < len(scene.points) / 10]
    assert len(known) == (len(things) + 1) // 2
    assert torch.isin(known, things).all()
    assert torch.equal(known_things(scene, 1.0), things)
    masked = with_network_masks(scene, "perfect", 3, share=0.5)
    for frame, labels in zip(masked.frames, scene.truth.images, strict=True):
        assert torch.equal(frame.masks.covered(), torch.isin(labels, known))
    assert not torch.equal(known, known_things(scene, 0.5, seed=4))
    with pytest.raises(ValueError, match=r"share: expected a number in \(0, 1\], got 0"):
        with_network_masks(scene, "hard", share=0)
    with pytest.raises(ValueError, match="scene: expected true labels of the points, got none"):
        known_things(replace(scene, truth=None), 0.5)


def test_the_void_has_no_masks_of_a_detector():
    assert len(make_network_masks(torch.full(SIZE, -1), "hard", void=False)) == 0
