"""Final labels of images with masks: masks keep their outlines, unless 3D says that they are wrong."""

from __future__ import annotations

from dataclasses import replace

import torch
from hand_graph import graph_of
from torch import Tensor
from torchjoint_lab.synthetic import with_network_masks

import torchjoint as tj
from torchjoint.config import Config
from torchjoint.images.contours import outlines
from torchjoint.labels.image_labels import label_image, unmasked_labels
from torchjoint.scene import Masks
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

SIZE = (8, 12)


def box(top: int, left: int, bottom: int, right: int) -> Tensor:
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[top:bottom, left:right] = True
    return mask


def labelled(
    masks: list[Tensor],
    points: list[tuple[int, int, int]],
    spacing: Tensor | None = None,
    unmasked: tuple[int, ...] = (),
) -> tuple[Tensor, int]:
    """The labels of a grey image with masks, and points (row, column, 3D label), which lie a metre apart by default."""
    row, column, label = (torch.tensor(values) for values in zip(*points, strict=True))
    visible = Visible(torch.arange(len(row)), row, column, column.float(), row.float(), torch.ones(len(row)))
    found = Masks.from_stack(torch.stack(masks) if masks else torch.zeros(0, *SIZE, dtype=torch.bool))
    image, boundary = torch.full((3, *SIZE), 128, dtype=torch.uint8), (outlines(found.atom) * 255).byte()
    seen = Observation("", found.atom, visible, torch.eye(3), torch.eye(4), image, boundary, found)
    graph = graph_of(torch.zeros(len(row), 3), [[0, 1]], torch.zeros(len(row), 3))
    graph = graph if spacing is None else replace(graph, known_spacing=spacing)
    of_label = torch.isin(torch.arange(5), torch.tensor(unmasked))
    return label_image(seen, label, graph, of_label, Config())


def test_points_from_behind_do_not_split_a_mask() -> None:
    mask = box(2, 2, 6, 8)
    points = [(3, 3, 1), (3, 5, 1), (4, 6, 1), (5, 7, 0)] + [(r, c, 0) for r in (0, 7) for c in range(12)]
    labels, _ = labelled([mask], points)
    assert torch.equal(labels == 1, mask)
    assert (labels[~mask] == 0).all()


def test_a_thing_ends_with_its_mask() -> None:
    mask = box(2, 1, 7, 5)
    points = [(r, c, 1) for r in (3, 4, 5) for c in (2, 3, 9, 10)] + [(r, c, 0) for r in (0, 7) for c in range(12)]
    labels, _ = labelled([mask], points)
    assert (labels[mask] == 1).all()
    assert (labels[:, 5:] == 0).all()  # the points of 1 there are strays


def test_a_mask_of_two_objects_is_cut() -> None:
    points = [(r, c, int(c > 5)) for r in (3, 4, 5) for c in (2, 4, 7, 9)]
    labels, _ = labelled([box(2, 1, 7, 11)], points)
    assert (labels[:, 1:5] == 0).all()
    assert (labels[:, 7:11] == 1).all()


def test_what_other_images_show_without_masks_lies_behind() -> None:
    mask = box(2, 1, 7, 11)
    points = [(r, c, int(c > 5)) for r in (3, 4, 5) for c in (2, 4, 7, 9)] * 2
    assert (labelled([mask], points, unmasked=(1,))[0][mask] == 0).all()
    few = [point for point in points if point[2] or point[0] == 3]  # of the other label: too few to know
    assert torch.equal(labelled([mask], few, unmasked=(1,))[0], labelled([mask], few)[0])


def test_what_a_mask_confirms_is_not_unmasked(seen) -> None:
    thing, plain = Masks.from_stack(torch.tensor([[[True, True, False, False]]])), seen(range(4), range(4))
    of_one = replace(plain, labels=thing.atom, masks=thing)
    nothing = Masks.from_stack(torch.zeros(0, 1, 4, dtype=torch.bool))
    frames = [of_one, *[replace(plain, labels=nothing.atom, masks=nothing)] * 4, plain]
    point_labels = torch.tensor([0, 0, 1, 1])
    assert unmasked_labels(frames, point_labels).tolist() == [False, True]
    assert unmasked_labels(frames[1:], point_labels).tolist() == [True, True]
    assert unmasked_labels(frames[-1:], point_labels).tolist() == [False, False]  # no frame has masks


def test_masks_of_one_object_get_one_label() -> None:
    one, other = box(2, 1, 6, 5), box(2, 5, 6, 9)
    labels, _ = labelled([one, other], [(r, c, 2) for r in (3, 4) for c in (2, 3, 6, 7)] + [(0, 0, 0), (7, 11, 0)] * 2)
    assert (labels[one | other] == 2).all()


def test_a_mask_without_points_keeps_an_id_of_its_own() -> None:
    unseen = box(1, 8, 3, 11)
    labels, next_free = labelled([box(1, 1, 6, 6), unseen], [(r, c, 3) for r in (2, 3) for c in (2, 3, 4)])
    assert next_free == 6
    assert torch.equal(labels == 5, unseen)


def test_an_image_without_masks_gets_the_labels_of_its_points() -> None:
    labels, next_free = labelled([], [(r, c, int(c > 5)) for r in (2, 5) for c in (2, 9)])
    assert next_free == 5
    assert set(labels.flatten().tolist()) == {0, 1}


def test_a_few_points_from_behind_do_not_label_a_mask() -> None:
    """The mask's object is not in the cloud. What lies behind it is seen through the hole."""
    large, missing = box(0, 0, 8, 8), box(2, 9, 6, 12)
    of_large = [(r, c, 1) for r in range(8) for c in range(8)] * 2
    labels, next_free = labelled([large, missing], of_large + [(r, c, 1) for r in (3, 4) for c in (9, 10, 11, 9)])
    assert torch.equal(labels == 5, missing)
    assert next_free == 6
    labels, next_free = labelled([large, missing], of_large + [(r, c, 1) for r in range(2, 6) for c in (9, 10, 11, 9)])
    assert (labels == 1).all()  # so many points are a part that the network has split off
    assert next_free == 5


def test_a_small_mask_is_a_part_of_a_thing_split_by_the_network() -> None:
    parts = [box(0, 0, 4, 8), box(4, 0, 8, 8), box(2, 9, 6, 12)]
    of_parts = [(r, c, 1) for r in range(8) for c in range(8)] * 2
    labels, next_free = labelled(parts, of_parts + [(r, c, 1) for r in (3, 4) for c in (9, 10, 11, 9)])
    assert (labels == 1).all()
    assert next_free == 5


def test_a_thing_of_few_points_is_in_the_cloud() -> None:
    """Its points lie far apart, so they cover its mask. Points that lie as close as others do not, and are stray."""
    large, thing = box(0, 0, 8, 8), box(2, 9, 6, 12)
    points = [(r, c, 1) for r in range(8) for c in range(8)] * 2 + [(2, 9, 2), (4, 10, 2), (5, 11, 2)]
    labels, next_free = labelled([large, thing], points, torch.tensor([1.0] * 128 + [2.0] * 3))
    assert (labels[thing] == 2).all()
    assert next_free == 5
    labels, next_free = labelled([large, thing], points)
    assert torch.equal(labels == 5, thing)
    assert next_free == 6


def test_points_of_several_things_behind_a_mask_do_not_divide_it() -> None:
    left, right, missing = box(0, 0, 8, 4), box(0, 8, 8, 12), box(2, 5, 6, 7)
    behind = [(r, 5, 1) for r in range(2, 6)] * 2 + [(r, 6, 2) for r in range(2, 6)] * 2
    things = [(r, c, 1) for r in range(8) for c in range(4)] + [(r, c, 2) for r in range(8) for c in range(8, 12)]
    labels, next_free = labelled([left, right, missing], things + behind)
    assert torch.equal(labels == 5, missing)
    assert next_free == 6


def test_a_part_without_points_belongs_to_its_whole() -> None:
    labels, next_free = labelled([box(1, 1, 7, 9), box(5, 6, 7, 9)], [(r, c, 3) for r in (2, 3) for c in (2, 3, 4)])
    assert next_free == 5
    assert (labels[box(1, 1, 7, 9)] == 3).all()


def test_a_small_mask_gets_the_label_of_its_own_points() -> None:
    small = box(3, 3, 5, 5)
    points = [(3, 3, 1), (3, 4, 1), (4, 4, 1)] + [(r, c, 0) for r in (0, 7) for c in range(12)]
    labels, _ = labelled([small, box(0, 0, 8, 12)], points)
    assert torch.equal(labels == 1, small)


def test_a_few_points_do_not_make_a_mask_a_part() -> None:
    """They may lie behind its object; but if nothing else shows what they belong to, they are believed."""
    large, small = box(1, 1, 6, 6), box(1, 8, 4, 11)
    of_large = [(r, c, 3) for r in (2, 3, 4) for c in (2, 3, 4)]
    points_in_small = [(2, 8, 3), (2, 9, 3), (2, 10, 3)]
    labels, next_free = labelled([large, small], of_large + points_in_small)
    assert torch.equal(labels == 5, small)
    assert next_free == 6
    labels, next_free = labelled([large, small], of_large + [(r, c, 4) for r, c, _ in points_in_small])
    assert (labels[small] == 4).all()
    assert next_free == 5
    enough = [(r, c, 3) for r in (1, 2, 3) for c in (8, 9, 10)]
    labels, _ = labelled([large, small], of_large + enough)
    assert (labels[large | small] == 3).all()


def test_perfect_masks_come_back(scene_of) -> None:
    scene = with_network_masks(scene_of(3).scene, "perfect")
    result = tj.JointSegmenter()(scene)
    assert scene.truth is not None
    for initial, truth in zip(result.initial_images, scene.truth.images, strict=True):
        assert tj.metrics.mean_best_iou(initial, truth) == 1
    scores = [tj.metrics.mean_best_iou(*pair) for pair in zip(result.images, scene.truth.images, strict=True)]
    assert sum(scores) / len(scores) > 0.8
