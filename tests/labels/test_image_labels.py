"""Images labelled from the points they see."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torchjoint_lab.benchmark.paint import paint

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.labels import geodesic
from torchjoint.labels.geodesic import nearest_labels, propagate
from torchjoint.labels.image_labels import label_image
from torchjoint.scene import Scene
from torchjoint.synthetic import make_scene
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

PLAIN = Config().set(["image_graph.smoothing=0"])


def seen_at(pixels: list[tuple[int, int]], image: Tensor, initial: Tensor, depth: list[float] | None = None):
    row, column = torch.tensor(pixels, dtype=torch.int64).reshape(-1, 2).T
    z = torch.tensor(depth or [1.0] * len(pixels))
    visible = Visible(torch.arange(len(pixels)), row, column, column.float(), row.float(), z)
    return Observation("", initial, visible, torch.eye(3), torch.eye(4), image, torch.zeros(image.shape[1:]).byte())


def test_labels_meet_at_the_image_s_edge() -> None:
    image = torch.zeros(3, 6, 10, dtype=torch.uint8)
    image[:, :, 7:] = 255  # nearer to the right point than to the left one
    initial = torch.zeros(6, 10, dtype=torch.int32)
    initial[0] = -1  # stays
    seen = seen_at([(3, 0), (2, 0), (3, 9), (2, 9)], image, initial)
    labels, next_free = propagate(seen, torch.tensor([5, 5, 2, 2]), 6, PLAIN)
    assert labels.dtype == torch.int32
    assert labels.tolist() == [[-1] * 10] + [[5] * 7 + [2] * 3] * 5
    assert next_free == 6


def test_the_nearest_point_of_a_pixel_counts() -> None:
    seen = seen_at([(0, 1), (0, 1), (0, 1), (1, 0)], torch.zeros(3, 2, 2), torch.zeros(2, 2), [3.0, 1.0, 1.0, 2.0])
    assert nearest_labels(seen.visible, torch.tensor([7, 8, 9, 4]), (2, 2)).tolist() == [[-1, 8], [4, -1]]


def test_large_segments_without_a_point_keep_ids_of_their_own(monkeypatch) -> None:
    """Where no point is although many should be; in small ones that is chance."""
    initial = torch.zeros(10, 30, dtype=torch.int32)
    initial[:, 10:20], initial[:, 20:], initial[0, 0] = 2, 1, 3
    pixels = [(row, column) for row in range(10) for column in range(2, 10)]
    seen = seen_at(pixels, torch.zeros(3, 10, 30, dtype=torch.uint8), initial)
    at_point = torch.zeros(80, dtype=torch.int64)
    monkeypatch.setattr(geodesic, "UNSEEN", 20)
    labels, next_free = propagate(seen, at_point, 4, PLAIN)
    assert labels[0].tolist() == [0] * 10 + [4] * 10 + [5] * 10  # 26.7 expected in each
    assert next_free == 6
    monkeypatch.setattr(geodesic, "UNSEEN", 27)
    labels, next_free = propagate(seen, at_point, 4, PLAIN)
    assert not labels.any()
    assert next_free == 4


def test_stray_points_do_not_label_the_sky(monkeypatch) -> None:
    """A segment with points in one place keeps its own id only if these are few, and most of it is far from any."""
    monkeypatch.setattr(geodesic, "UNSEEN", 20)
    initial = torch.zeros(20, 60, dtype=torch.int32)
    initial[:, 20:] = 1
    image = torch.zeros(3, 20, 60, dtype=torch.uint8)
    dense = [(row, column) for row in range(20) for column in range(20)]

    def labels_with(stray: list[tuple[int, int]]) -> Tensor:
        seen = seen_at(dense + stray, image, initial)
        return propagate(seen, torch.tensor([0] * len(dense) + [1] * len(stray)), 2, PLAIN)[0]

    few = [(row, 20 + column) for row in range(4) for column in range(4)]
    sky = labels_with(few)
    assert sky[0, 0] == 0
    assert (sky[:5, 21:25] == 1).all()  # within the mean spacing of points, 1.7 pixels
    assert (sky[5:, 21:] == 2).all()
    assert (sky[:, 25:] == 2).all()
    many = [(row, 20 + column) for row in range(20) for column in range(3)]  # a tree below the sky of its own segment
    assert not (labels_with(many) == 2).any()
    scattered = [
        (row, column) for row in range(1, 20, 6) for column in range(22, 60, 6)
    ]  # a surface with sparse points
    assert not (labels_with(scattered) == 2).any()


def test_specks_of_a_single_point_are_left_to_their_neighbours(monkeypatch) -> None:
    initial = torch.zeros(5, 6, dtype=torch.int32)
    seen = seen_at([(2, 0), (2, 2), (2, 4), (1, 1)], torch.zeros(3, 5, 6, dtype=torch.uint8), initial)
    at_point = torch.tensor([0, 1, 0, 0])
    assert not propagate(seen, at_point, 2, PLAIN)[0].any()
    alone = seen_at([(2, 2)], torch.zeros(3, 5, 6, dtype=torch.uint8), initial)
    assert propagate(alone, torch.tensor([1]), 2, PLAIN)[0].all()  # nothing else to go by
    monkeypatch.setattr(geodesic, "MIN_POINTS", 1)
    assert propagate(seen, at_point, 2, PLAIN)[0].any()


def test_without_points_the_initial_segments_stay() -> None:
    initial = torch.tensor([[1, 1, 0], [-1, 0, 0]], dtype=torch.int32)
    seen = seen_at([], torch.zeros(3, 2, 3, dtype=torch.uint8), initial)
    labels, next_free = propagate(seen, torch.zeros(0, dtype=torch.int64), 0, Config())
    assert labels.tolist() == [[0, 0, 1], [-1, 1, 1]]
    assert next_free == 2


def true_share(images: list[Tensor], truth: tuple[Tensor, ...]) -> float:
    return sum(float((image == true).float().mean()) for image, true in zip(images, truth, strict=True)) / len(truth)


@pytest.mark.slow
def test_better_than_painting_with_the_true_labels() -> None:
    made = make_scene(3, "medium", num_views=4)
    segmenter = JointSegmenter(Config().set(["boundary.detector=gradient"]))
    segmenter.reset(made.scene.points, made.scene.colors)
    segmenter.update(list(made.scene.frames))
    ours, painted = [], []
    for seen in segmenter.state.observations:
        at_point = made.point_labels[seen.visible.point]
        ours.append(propagate(seen, at_point, int(at_point.max()) + 1, segmenter.config)[0])
        painted.append(paint(seen.visible, made.point_labels, seen.labels.shape))
    assert true_share(ours, made.image_labels) > true_share(painted, made.image_labels) + 0.005


def test_the_method_is_chosen_by_the_config(scene_of) -> None:
    scene: Scene = scene_of(3).scene
    segmenter = JointSegmenter(Config().set(["boundary.detector=gradient"]))
    by_paths = segmenter(scene)
    none, paper = torch.bincount(by_paths.points) < 0, segmenter.config.set(["point_segments.method=paper"])
    cuts = [
        label_image(seen, by_paths.points, segmenter.graph, none, paper)[0] for seen in segmenter.state.observations
    ]
    assert any(not torch.equal(one, other) for one, other in zip(by_paths.images, cuts, strict=True))
    other = segmenter.compute(config=segmenter.config.set(["refinement.color_weight=0"]))
    assert any(not torch.equal(one, two) for one, two in zip(by_paths.images, other.images, strict=True))
