"""Masks as networks give them, made from the true instances of an image: from perfect to badly wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, overload

import numpy as np
import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame, Scene
from torchjoint.scene.masks import Masks
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.mask_errors import jittered, merged, split


class _Level(NamedTuple):
    """Probabilities of the errors: of an instance to merge, of a mask to be dropped, split, or given with a part."""

    drop: float
    split: float
    merge: float
    nested: float
    fragments: float  #: share of the void's fragments that get a mask
    most_parts: int
    jitter: tuple[float, float]  #: displacement of outlines, pixels of an image 640 pixels wide


_LEVELS = {
    "perfect": None,
    "sam-like": _Level(0.15, 0.3, 0.08, 0.2, 0.5, 3, (1.0, 2.0)),
    "hard": _Level(0.3, 0.5, 0.2, 0.3, 0.7, 4, (1.5, 3.0)),
}
#: The levels of :func:`with_network_masks`, from best to worst.
MASK_LEVELS = tuple(_LEVELS)

#: The smallest instance of an image is dropped with this multiple of the mean probability, the largest with 2 - it.
_SMALLEST_DROP = 1.8
#: Networks remove smaller masks, pixels of an image of 640 x 480.
_LEAST_AREA = 60.0
#: Area of a fragment of the void, as a share of the image.
_FRAGMENT = 0.04
#: A detector knows only things with less than this share of the cloud's points: no walls, no floor.
_LARGEST_THING = 0.1


@one_thread_per_operation()
def make_network_masks(labels: Tensor, level: str, seed: int = 0, index: int = 0, void: bool = True) -> Masks:
    """Masks of one image as a network gives them.

    "perfect" has one mask for each instance, and none on the void. In "sam-like" and "hard", masks are dropped (small
    instances more often than large ones: probability .15 and .3 in the mean), split in parts (.3 and .5), merged with
    what they touch (.08 and .2) or given together with a part of theirs (.2 and .3). Outlines are off by 1 to 3 pixels
    (of an image 640 pixels wide), so that masks overlap a little. Fragments cover half of the void or more. At each
    level, the order of the masks differs from image to image.

    Args:
        labels: [H, W] integers, the instance of each pixel, -1 = void.
        level: "perfect", "sam-like" or "hard".
        seed: decides the errors, together with `index`.
        index: number of the image.
        void: whether the void gets masks, too, as from networks that segment everything.

    Returns:
        the masks. Scores are 1 if they are perfect; else they grow with the overlap of the mask and an instance.

    Raises:
        ValueError: an unknown level, a negative seed, or labels of another shape.
    """
    if level not in _LEVELS:
        raise ValueError(f"level: expected one of {', '.join(map(repr, _LEVELS))}, got {level!r}")
    if isinstance(seed, bool) or seed < 0:
        raise ValueError(f"seed: expected an integer of at least 0, got {seed!r}")
    if labels.ndim != 2:
        raise ValueError(f"labels: expected shape [H, W], got {list(labels.shape)}")
    rng = np.random.default_rng(np.random.SeedSequence([seed, index]))
    errors = _LEVELS[level]
    instances, number = np.unique(labels.numpy(), return_inverse=True)
    number = number.reshape(labels.shape) - int((instances < 0).sum())
    count = int((instances >= 0).sum())
    if errors is None:
        masks = [number == instance for instance in range(count)]
        scores = np.ones(count)
    else:
        masks = _with_errors(rng, number, count, errors if void else errors._replace(fragments=0.0))
        scores = np.array([_score(rng, mask, number) for mask in masks])
    order = rng.permutation(len(masks))
    stack = np.stack([masks[i] for i in order]) if len(order) else np.zeros((0, *labels.shape), dtype=bool)
    return Masks.from_stack(torch.from_numpy(stack), torch.from_numpy(scores[order].astype(np.float32)))


def with_network_masks(scene: Scene, level: str, seed: int = 0, share: float = 1.0) -> Scene:
    """The scene with frames that carry :func:`make_network_masks` of their true images, and no other segmentation.

    Frames of a list or a tuple get their masks at once; those of any other sequence when they are read.

    Args:
        scene: with a true image for each frame.
        level: "perfect", "sam-like" or "hard".
        seed: decides the errors, together with the number of the frame in this scene.
        share: of the things that get masks; less than 1 as from a detector, which leaves all the rest without masks
            (:func:`known_things`).

    Raises:
        TypeError: not a scene.
        ValueError: an unknown level, a negative seed, or a scene without a true image for each frame.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, such as make_scene(...).scene, got {type(scene).__name__}")
    truths = scene.truth.images if scene.truth is not None else ()
    if len(truths) != len(scene.frames):
        raise ValueError(f"scene: expected a true image for each of {len(scene.frames)} frames, got {len(truths)}")
    make_network_masks(torch.full((1, 1), -1), level, seed)  # wrong arguments must not wait for the first frame
    known = None if share == 1 else known_things(scene, share, seed)
    frames: Sequence[Frame] = _MaskedFrames(scene.frames, truths, level, seed, known)
    return replace(scene, frames=tuple(frames) if isinstance(scene.frames, (list, tuple)) else frames)


def known_things(scene: Scene, share: float, seed: int = 0) -> Tensor:
    """The true instances [K] int64 that a detector knows: some of those with less than a tenth of the points.

    Args:
        scene: with true labels of the points.
        share: of these instances, in (0, 1]; rounded up.
        seed: decides which.

    Raises:
        ValueError: a share outside (0, 1], or a scene without true labels of the points.
    """
    if not 0 < share <= 1:
        raise ValueError(f"share: expected a number in (0, 1], got {share!r}")
    if scene.truth is None or scene.truth.points is None:
        raise ValueError("scene: expected true labels of the points, got none")
    instances, size = torch.unique(scene.truth.points[scene.truth.points >= 0], return_counts=True)
    things = instances[size < _LARGEST_THING * len(scene.points)]
    order = np.random.default_rng(np.random.SeedSequence([seed, 7])).permutation(len(things))
    return things[torch.from_numpy(order[: int(np.ceil(share * len(things)))])].sort().values


class _MaskedFrames(Sequence[Frame]):
    """Frames whose masks are made at each access."""

    def __init__(
        self, frames: Sequence[Frame], truths: Sequence[Tensor], level: str, seed: int, known: Tensor | None
    ) -> None:
        self._frames, self._truths, self._level, self._seed, self._known = frames, truths, level, seed, known

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        place = range(len(self))[index]
        labels, known = self._truths[place], self._known
        if known is not None:
            labels = torch.where(torch.isin(labels, known), labels, -1)
        masks = make_network_masks(labels, self._level, self._seed, place, void=known is None)
        return replace(self._frames[place], labels=None, masks=masks, mask_scores=None)


def _with_errors(rng: Rng, number: Array, count: int, errors: _Level) -> list[Array]:
    """The masks [H, W] bool of instances 0 ... count - 1 and of the void, -1, with the errors of a level."""
    group = merged(rng, number, count, errors.merge)
    shown = np.append(group, -1)[number]  # the last entry is that of -1
    masks: list[Array] = []
    for object_ in _kept(rng, shown, errors.drop):
        whole = shown == object_
        parts = int(rng.integers(2, errors.most_parts + 1))
        kind = rng.random()
        if kind < errors.split:
            masks += split(rng, whole, parts)
        else:
            masks.append(whole)
            if kind < errors.split + errors.nested * (1 - errors.split):
                masks.append(split(rng, whole, parts)[0])
    masks += _fragments(rng, number < 0, errors.fragments)
    least = _LEAST_AREA * number.size / (640 * 480)
    masks = [mask for mask in masks if mask.sum() >= max(least, 1)]
    masks = [jittered(rng, mask, float(rng.uniform(*errors.jitter))) for mask in masks]
    return [mask for mask in masks if mask.any()]


def _kept(rng: Rng, shown: Array, drop: float) -> list[int]:
    """The objects that are not dropped, ascending; the mean probability is `drop`, that of small ones is higher."""
    objects, area = np.unique(shown[shown >= 0], return_counts=True)
    rank = np.argsort(np.argsort(area, kind="stable"))
    relative = rank / max(len(objects) - 1, 1) if len(objects) > 1 else np.full(len(objects), 0.5)
    probability = drop * (_SMALLEST_DROP - 2 * (_SMALLEST_DROP - 1) * relative)
    return [int(o) for o in objects[rng.random(len(objects)) >= probability]]


def _fragments(rng: Rng, void: Array, share: float) -> list[Array]:
    count = int(np.ceil(void.mean() / _FRAGMENT))
    if count == 0:
        return []
    parts = split(rng, void, count) if count > 1 else [void]
    return [part for part in parts if rng.random() < share]


def _score(rng: Rng, mask: Array, number: Array) -> float:
    """What a network predicts: it knows only roughly how well the mask fits an instance."""
    inside = np.bincount(number[mask] + 1)[1:]
    iou = 0.0
    for instance in np.flatnonzero(inside):
        iou = max(iou, inside[instance] / (mask.sum() + (number == instance).sum() - inside[instance]))
    return float(np.clip(0.7 + 0.22 * iou + 0.05 * rng.standard_normal(), 0.4, 1))
