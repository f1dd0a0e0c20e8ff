"""Masks of a network in one image: segments that may overlap, nest, and leave pixels uncovered."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.groups import best_of_groups, check_dense, distinct, first_places
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.checks import as_float, as_labels, check_shape

#: The range of ids.
INT64 = torch.iinfo(torch.int64)


@dataclass(frozen=True, eq=False)
class Masks:
    """The masks of one image, stored as a partition: an *atom* is the set of all pixels that lie in the same masks.

    Make it with :meth:`from_stack` or :meth:`from_labels`.

    Attributes:
        atom: [H, W] int32, the atom of each pixel, 0 ... K - 1 by first appearance, row by row.
        pairs: [2, L] int64, pairs (atom, mask): the atom lies in the mask. Atoms without a pair are in no mask.
        scores: [M] float32 in [0, 1], how far each mask can be trusted, compared with the others.
        ids: M numbers that the masks have where they come from; empty: 0 ... M - 1.
        names: M names, such as classes; empty: none.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    atom: Tensor
    pairs: Tensor
    scores: Tensor
    ids: tuple[int, ...] = ()
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.atom.ndim != 2 or self.atom.dtype != torch.int32:
            raise ValueError(f"atom: expected [H, W] int32, got {list(self.atom.shape)} {self.atom.dtype}")
        object.__setattr__(self, "scores", _as_scores(self.scores, len(self.scores), "scores"))
        for name in ("ids", "names"):
            if len(getattr(self, name)) not in (0, len(self)):
                raise ValueError(f"{name}: expected one for each of {len(self)} masks, got {len(getattr(self, name))}")
        if self.pairs.ndim != 2 or self.pairs.shape[0] != 2 or self.pairs.dtype != torch.int64:
            raise ValueError(f"pairs: expected [2, L] int64, got {list(self.pairs.shape)} {self.pairs.dtype}")
        if self.atom.numel() and not 0 <= int(self.atom.min()) <= int(self.atom.max()) < self.atom.numel():
            span = f"{int(self.atom.min())} to {int(self.atom.max())}"
            raise ValueError(f"atom: expected numbers from 0, at most one for each pixel, got {span}")
        if wrong := [one for one in self.ids if not hasattr(one, "__index__") or not INT64.min <= one <= INT64.max]:
            raise ValueError(f"ids: expected integers of 64 bits, got {str(wrong[0])[:60]!r}")
        if self.pairs.numel():
            low, high = self.pairs.amin(1).tolist(), self.pairs.amax(1).tolist()
            if min(low) < 0 or high[0] >= self.num_atoms or high[1] >= len(self):
                told = f"atoms below {self.num_atoms} and masks below {len(self)}"
                raise ValueError(f"pairs: expected {told}, got {low} to {high}")

    @classmethod
    @on_cpu()
    def from_stack(cls, stack: Tensor, scores: Tensor | None = None, name: str = "masks") -> Masks:
        """Masks that may overlap and nest.

        Args:
            stack: [M, H, W] bool; M may be 0.
            scores: optional [M] in [0, 1], how far each mask can be trusted; default 1.
            name: name of the stack in messages.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        check_dense(stack, name)
        if stack.dtype != torch.bool:
            raise TypeError(f"{name}: expected dtype bool for a stack [M, H, W], got {stack.dtype}; use `stack > 0.5`?")
        if stack.ndim != 3:
            raise ValueError(f"{name}: expected shape [M, H, W], got {list(stack.shape)}")
        scores = _as_scores(scores, len(stack), f"{name}' scores")
        # NumPy's: torch's own starts threads for each mask.
        pixels = (np.flatnonzero(mask.numpy()) for mask in stack.cpu())
        return cls.from_pixels(pixels, (stack.shape[1], stack.shape[2]), scores, name)

    @classmethod
    @on_cpu()
    def from_pixels(
        cls, masks: Iterable[npt.NDArray[np.int64]], size: tuple[int, int], scores: Tensor, name: str = "masks"
    ) -> Masks:
        """Masks that may overlap and nest, of which only one has to be in memory at a time.

        Args:
            masks: the pixels of each mask, indices row x W + column.
            size: (H, W) of the image.
            scores: [M] in [0, 1].
            name: name of the masks in messages.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        atom = torch.zeros(size[0] * size[1], dtype=torch.int64)
        members: list[tuple[int, ...]] = [()]
        pairs = 0
        for number, pixels in enumerate(masks):
            inside = torch.from_numpy(pixels)
            before, new = distinct(atom[inside], len(members))
            atom[inside] = new + len(members)  # the part of an atom inside the mask becomes a new atom
            pairs += sum(len(members[old]) + 1 for old in before.tolist())
            bounds.check(pairs, bounds.PAIRS, "parts of masks that lie in several masks", name)
            members += [(*members[old], number) for old in before.tolist()]
        return cls._of_members(atom.view(size), members, _as_scores(scores, len(scores), f"{name}' scores"))

    @classmethod
    @on_cpu()
    def from_labels(cls, labels: Tensor, scores: Tensor | None = None, none: int = -1, name: str = "masks") -> Masks:
        """Masks that do not overlap.

        Args:
            labels: [H, W] integers, a mask for each value.
            scores: optional [M], a score in [0, 1] for each mask, in ascending order of the values; default 1.
            none: the value of pixels without a mask, -1 or 0.
            name: name of the labels in messages.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        if none not in (-1, 0):
            raise ValueError(f"none: expected -1 or 0, got {none}")
        check_dense(labels, name)
        labels = as_labels(labels, tuple(labels.shape), name)
        if labels.ndim != 2:
            raise ValueError(f"{name}: expected shape [H, W], got {list(labels.shape)}")
        values, number = torch.unique(labels, return_inverse=True)
        covered = values > none
        mask = (covered.cumsum(0) - 1).tolist()
        members = [(mask[i],) if is_mask else () for i, is_mask in enumerate(covered.tolist())]
        ids = tuple(values[covered].tolist())
        return cls._of_members(number, members, _as_scores(scores, int(covered.sum()), f"{name}' scores"), ids)

    @classmethod
    @on_cpu()
    def _of_members(
        cls,
        atom: Tensor,
        members: Sequence[Sequence[int]],
        scores: Tensor,
        ids: tuple[int, ...] = (),
        names: tuple[str, ...] = (),
    ) -> Masks:
        """Numbers the atoms that have pixels by first appearance. `members` are the masks of each atom, ascending."""
        first = first_places(atom.reshape(-1), len(members))
        present = [old for old in first.argsort().tolist() if first[old] < atom.numel()]
        number = torch.zeros(len(members), dtype=torch.int32)
        number[present] = torch.arange(len(present), dtype=torch.int32)
        pairs = [(new, mask) for new, old in enumerate(present) for mask in members[old]]
        of_atom = torch.tensor(pairs, dtype=torch.int64).view(-1, 2).t().contiguous()
        return cls(number[atom], of_atom, scores, ids, names)

    def __len__(self) -> int:
        return len(self.scores)

    def __repr__(self) -> str:
        height, width = self.size
        return f"Masks({len(self)} masks, {height} x {width} pixels, {self.covered().float().mean():.0%} covered)"

    @property
    def num_atoms(self) -> int:
        """K, the number of atoms."""
        return int(self.atom.max()) + 1 if self.atom.numel() else 0

    @property
    def size(self) -> tuple[int, int]:
        """(H, W), pixels."""
        return self.atom.shape[0], self.atom.shape[1]

    @on_cpu()
    def covered(self) -> Tensor:
        """[H, W] bool, the pixels in at least one mask."""
        has_mask = torch.zeros(self.num_atoms, dtype=torch.bool)
        has_mask[self.pairs[0]] = True
        return has_mask[self.atom]

    @on_cpu()
    def stack(self) -> Tensor:
        """[M, H, W] bool, the masks."""
        member = torch.zeros(len(self), self.num_atoms, dtype=torch.bool)
        member[self.pairs[1], self.pairs[0]] = True
        return member[:, self.atom]

    @on_cpu()
    def labels(self) -> Tensor:
        """[H, W] int64, the mask of each pixel, -1 = none; where masks overlap, the smallest (ties: the first)."""
        return self.smallest(torch.ones(len(self), dtype=torch.bool))[self.atom]

    @on_cpu()
    def areas(self) -> Tensor:
        """[M] int64, number of pixels of each mask."""
        of_atom = torch.bincount(self.atom.reshape(-1), minlength=self.num_atoms)
        return torch.zeros(len(self), dtype=torch.int64).index_add_(0, self.pairs[1], of_atom[self.pairs[0]])

    @on_cpu()
    def smallest(self, wanted: Tensor) -> Tensor:
        """The smallest mask around each atom (ties: the first) among those `wanted` [M] bool: [K] int64, -1 = none."""
        atom, mask = self.pairs[:, wanted[self.pairs[1]]]
        return best_of_groups(atom, mask, -self.areas()[mask], self.num_atoms)[0]

    @on_cpu()
    def divided(self, labels: Tensor) -> Masks:
        """The same masks; pixels in none are in one atom only if they have one label, too; `labels`: [H, W], >= 0."""
        atom = torch.where(self.covered(), self.atom, self.num_atoms + labels)
        return self._with_atoms(atom, self.num_atoms + int(labels.max()) + 1)

    def resized(self, size: tuple[int, int]) -> Masks:
        """The masks of an image of another size (H, W), by the nearest pixel.

        Warns:
            UserWarning: the aspect ratios differ by more than 2 % and one pixel, so masks and image may show different
                views.
        """
        if size == self.size:
            return self
        (height, width), (own_height, own_width) = size, self.size
        if not self.atom.numel():
            raise ValueError(f"masks: expected at least one pixel, got {own_height} x {own_width}")
        if len(self) and abs(own_height * width / height - own_width) > max(1, 0.02 * own_width):  # half of 15 may be 7
            told = f"masks: {own_height} x {own_width} pixels for an image of {height} x {width}: other aspect ratio"
            warnings.warn(f"{told}; do they show the same view?", stacklevel=2)
        row = ((torch.arange(height, dtype=torch.float32, device="cpu") + 0.5) * own_height / height).long()
        column = ((torch.arange(width, dtype=torch.float32, device="cpu") + 0.5) * own_width / width).long()
        return self._with_atoms(self.atom[row][:, column].long(), self.num_atoms)

    def _with_atoms(self, atom: Tensor, count: int) -> Masks:
        """The same masks in another image of atoms, numbers below `count`; those that are new are in no mask."""
        members: list[list[int]] = [[] for _ in range(count)]
        for number, mask in self.pairs.t().tolist():
            members[number].append(mask)
        return self._of_members(atom, members, self.scores, self.ids, self.names)


def as_masks(masks: Tensor | Masks, size: tuple[int, int], scores: Tensor | None = None, name: str = "masks") -> Masks:
    """Converts a label map, a stack, or :class:`Masks` to masks of an image, scaled to the image's size.

    Args:
        masks: [H, W] integers (-1 = none), [H, W] bool (one mask), or [M, H, W] bool.
        size: (H, W) of the image.
        scores: optional [M] in [0, 1].
        name: name of the masks in messages.
    """
    if isinstance(masks, Masks):
        if scores is not None:
            raise ValueError(f"{name}' scores: expected none, because these Masks have their own")
        return masks.resized(size)
    if not isinstance(masks, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor or Masks, got {type(masks).__name__}; see torchjoint.masks")
    check_dense(masks, name)
    if masks.ndim == 3 and masks.shape[:2] == size and masks.shape[1:] != size:
        raise ValueError(f"{name}: expected [M, H, W], got [H, W, M]? {list(masks.shape)} in an image of {list(size)}")
    if masks.dtype == torch.bool or masks.ndim == 3:
        return Masks.from_stack(masks[None] if masks.ndim == 2 else masks, scores, name).resized(size)
    masks = as_labels(masks, tuple(masks.shape), name)
    if masks.numel() and int(masks.min()) == 0:
        told = f"{name}: 0 counts as a mask, and no pixel is -1 (none)"
        warnings.warn(f"{told}; if 0 means none, use torchjoint.masks.from_labels(labels, none=0)", stacklevel=4)
    return Masks.from_labels(masks, scores, name=name).resized(size)


def _as_scores(scores: Tensor | None, count: int, name: str) -> Tensor:
    if scores is None:
        return torch.ones(count, dtype=torch.float32, device="cpu")
    scores = as_float(scores, name, torch.float32).clone()
    check_shape(scores, (count,), name)
    if count and not 0 <= float(scores.min()) <= float(scores.max()) <= 1:
        came = f"{float(scores.min()):.4g} to {float(scores.max()):.4g}"
        raise ValueError(f"{name}: expected numbers in [0, 1], got {came}")
    return scores
