"""Steps 7 and 8 for frames with masks of a network: masks keep their outlines, unless the 3D labels contradict."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config
from torchjoint.images.contours import outlines
from torchjoint.labels.geodesic import MIN_POINTS as SPECK
from torchjoint.labels.geodesic import nearest_labels, path_costs
from torchjoint.runtime.groups import best_of_groups, counted_pairs
from torchjoint.scene import Masks
from torchjoint.views.observations import Observation

#: A mask, or an atom of masks, is one object if at least this share of its points have one 3D label. The other points
#: mostly lie beside it; their pixels are wrong by one or two.
ONE_OBJECT = 0.65
#: Path cost of crossing an outline of a mask, pixels: labels leave a mask only to pixels that no other label reaches.
OUTLINE_WEIGHT = 200.0
#: A mask shows an object that is not in the cloud if its points cover less than this share of the usual part of it.
SPARSE = 0.2
#: Smallest number of points that decide the label of a mask or an atom.
MIN_POINTS = 3
#: With at least this many points, a mask may be a part of an object that the image mostly shows elsewhere. Fewer points
#: may lie behind the mask's object, because a cloud has holes.
ENOUGH_POINTS = 8
#: A mask is foreign to its most frequent 3D label if it has less than this share of the label's points in the image.
#: These points lie behind the mask's object, which is not in the cloud. A part that a network split off is larger.
LEAST_PART = 0.1
#: The same share for a mask whose points have several labels: unless it shows two objects, it has a small part of each.
LEAST_PART_OF_SEVERAL = 0.3
#: A mask can be foreign to a label only if another mask has at least this share of the label's other points. Otherwise
#: the network splits the object, and small parts are normal.
WHOLE = 0.75


class _Winners(NamedTuple):
    """The most frequent 3D label of the points in each of K parts of an image; ties: the lowest label."""

    label: Tensor  #: [K] int64; -1 without points
    num_points: Tensor  #: [K] int64
    decides: Tensor  #: [K] bool: the part is one object, and its label is this one
    foreign: Tensor  #: [K] bool: the points lie behind the part's object, which is not in the cloud


class _Shown(NamedTuple):
    """The points of L 3D labels that an image shows."""

    unmasked: Tensor  #: [S] bool: most images show the label without a mask, and no mask confirms it
    num_points: Tensor  #: [L] int64
    in_one_mask: Tensor  #: [L] int64, largest number of these points in one mask


def label_masks(
    seen: Observation, masks: Masks, point_labels: Tensor, spacing: Tensor, unmasked: Tensor, config: Config
) -> tuple[Tensor, int]:
    """Labels an image by its masks and the points that it sees.

    An atom whose points agree gets their label as a whole. An atom with too few points gets the label of the smallest
    mask around it whose points agree. A mask gets an id of its own, from S on, if it has nearly no points, too few to
    decide, or only points behind it. The other pixels (in atoms whose points disagree, or in no mask) get labels by
    geodesic label propagation, where outlines of masks count as boundaries, from the points there whose label no mask
    of the image has.

    Points of such `unmasked` segments lie behind the objects of masks that have other points.

    Args:
        seen: the frame.
        masks: its masks.
        point_labels: [M] int64, 3D label of each visible point.
        spacing: [M] metres, distance of each visible point to its neighbours.
        unmasked: [S] bool, the 3D segments that most images show without a mask, and no mask confirms.
        config: the refinement, and the smoothing of the image graph.

    Returns:
        ([H, W] int32, the next free id); no pixel is -1, unless there is neither a point nor a mask.
    """
    of_atom, num_private = _labels_of_atoms(seen, masks, point_labels, spacing, unmasked)
    of_pixel = of_atom.to(torch.int32)[masks.atom]
    markers = nearest_labels(seen.visible, point_labels, masks.size)
    # Labels of 3D segments spread. Ids that occur only in this image do not.
    whole = torch.where(of_pixel < len(unmasked), of_pixel, -1)
    colors, _, color_weight, _ = path_costs(seen, config)
    outline = outlines(torch.where(masks.covered(), masks.atom, -1))
    # Beside the masks of a thing its points are strays: "no mask" beside a mask says that the thing ends there.
    markers = torch.where(whole >= 0, whole, torch.where(torch.isin(markers, of_atom) & ~masks.covered(), -1, markers))
    labels = ops.propagate_labels(markers, colors, outline, color_weight, OUTLINE_WEIGHT, SPECK)
    return torch.where(of_pixel >= 0, of_pixel, labels), len(unmasked) + num_private


def _labels_of_atoms(
    seen: Observation, masks: Masks, point_labels: Tensor, spacing: Tensor, unmasked: Tensor
) -> tuple[Tensor, int]:
    """The label of each atom, [K] int64, -1 = not one object; and the number of masks with ids of their own."""
    atom = masks.atom[seen.visible.row, seen.visible.column].long()
    # Each point counts for all masks in which it lies.
    member = torch.zeros(masks.num_atoms, len(masks), dtype=torch.bool)
    member[masks.pairs[0], masks.pairs[1]] = True
    point, mask = member[atom].nonzero(as_tuple=True)
    num_shown, (_, of_pair, count) = torch.bincount(point_labels), counted_pairs(mask, point_labels[point])
    shown = _Shown(unmasked, num_shown, torch.zeros_like(num_shown).scatter_reduce_(0, of_pair, count, "amax"))
    of_masks = _winners(mask, point_labels[point], len(masks), shown)
    of_atoms = _winners(atom, point_labels, masks.num_atoms, shown)
    is_covered = member.any(1)

    sparse = _is_sparse(masks, mask, (spacing / seen.visible.z)[point].double().square())
    label = torch.where(of_atoms.decides & is_covered, of_atoms.label, -1)
    few = ~of_atoms.decides & (of_atoms.foreign | (of_atoms.num_points < ENOUGH_POINTS)) & is_covered
    around = masks.smallest(of_masks.decides)
    by_mask = few & (around >= 0)
    label[by_mask] = of_masks.label[around[by_mask]]

    # A mask with too little evidence gets an id of its own, so that no label from around it floods it.
    is_known = ~sparse & (of_masks.decides | (~of_masks.foreign & (of_masks.num_points >= ENOUGH_POINTS)))
    alone = is_covered & ((masks.smallest(~sparse) < 0) | (few & (label < 0) & (masks.smallest(is_known) < 0)))
    kept, number = torch.unique(masks.smallest(torch.ones(len(masks), dtype=torch.bool))[alone], return_inverse=True)
    label[alone] = len(unmasked) + number
    return label, len(kept)


def _is_sparse(masks: Masks, mask: Tensor, size: Tensor) -> Tensor:
    """Whether points cover much less of each mask than of others. Then its object is not in the cloud; they are stray.

    A point covers a square whose side is its spacing, so that things with few points are in the cloud, too.

    Args:
        masks: M masks.
        mask: [P] int64, the masks in which points lie.
        size: [P] float64, size in the image of the square of each; unit: pixels of a camera with a focal length of 1.

    Returns:
        [M] bool; True for masks without points.
    """
    if not len(mask):
        return torch.ones(len(masks), dtype=torch.bool)
    covered = torch.zeros(len(masks), dtype=torch.float64).index_add_(0, mask, size) / masks.areas().clamp(min=1)
    return covered < SPARSE * covered[mask].median()  # less is covered around half of the points


def _winners(part: Tensor, label: Tensor, num_parts: int, shown: _Shown) -> _Winners:
    """The most frequent label of points in each part; `part`, `label`: [P]; `shown`: of each label in the image.

    Points of unmasked labels do not count in a part with ENOUGH_POINTS others: they lie behind.
    """
    masked = ~shown.unmasked[label]
    has_masked = torch.bincount(part[masked], minlength=num_parts) >= ENOUGH_POINTS
    part, label = (values[masked | ~has_masked[part]] for values in (part, label))
    num_points = torch.bincount(part, minlength=num_parts)
    of_pair, labels, count = counted_pairs(part, label)
    winner, most = best_of_groups(of_pair, labels, count, num_parts)
    is_one = most >= ONE_OBJECT * num_points.float()
    all_points, in_one_mask = (torch.cat([values, values.new_ones(1)])[winner] for values in shown[1:])
    is_small = most < torch.where(is_one, LEAST_PART * all_points.float(), LEAST_PART_OF_SEVERAL * all_points.float())
    foreign = (num_points > 0) & is_small & (in_one_mask >= WHOLE * (all_points - most).float())
    decides = (num_points >= MIN_POINTS) & is_one & ~foreign
    chosen = winner.clamp(min=0)
    strongest = torch.zeros(max(1, len(shown.num_points)), dtype=torch.int64)
    strongest.scatter_reduce_(0, chosen, most * decides, "amax")
    decides &= (num_points >= ENOUGH_POINTS) | (most == strongest[chosen])
    return _Winners(winner, num_points, decides, foreign)
