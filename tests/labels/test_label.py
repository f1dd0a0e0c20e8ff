"""The superpoint in each pixel: by hand, inside its segment, and the nearest point where paths lead elsewhere."""

import pytest
import torch

import torchjoint as tj
from torchjoint.labels import geodesic
from torchjoint.labels.geodesic import SuperpointNumbers, propagate, propagate_superpoints
from torchjoint.labels.label import superpoint_image

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


def superpoints_of(seen, labels, superpoint, of_superpoint):
    numbers = SuperpointNumbers.of(torch.tensor(superpoint), torch.tensor(of_superpoint))
    image = superpoint_image(seen, torch.tensor([labels]), numbers, tj.Config())
    return image[0].tolist()


class TestByHand:
    """A strip of pixels, a point in each; the image has one colour and no boundaries."""

    def test_each_pixel_takes_its_point_s_superpoint(self, seen):
        assert superpoints_of(seen([0, 1, 2, 3], [0] * 4), [0, 0, 1, 1], [0, 1, 2, 2], [0, 0, 1]) == [0, 1, 2, 2]

    def test_a_pixel_takes_the_nearest_point_of_its_own_segment(self, seen):
        # Pixel 3 holds a point of superpoint 2 (segment 1), but its label is segment 0, whose nearest point is in pixel
        # 2.
        assert superpoints_of(seen([0, 1, 2, 3, 4], [0] * 5), [0, 0, 0, 0, 1], [0, 1, 1, 2, 2], [0, 0, 1]) == [
            0,
            1,
            1,
            1,
            2,
        ]

    def test_pixels_without_a_3d_segment_have_no_superpoint(self, seen):
        assert superpoints_of(seen([0, 1, 2], [0] * 3), [-1, 0, 7], [0, 1, 1], [0, 0]) == [-1, 1, -1]

    def test_a_hidden_segment_takes_its_first_superpoint(self, seen):
        assert superpoints_of(seen([0, 1], [0] * 2), [0, 1], [0, 0, 1, 2], [0, 1, 1]) == [0, 1]
        assert superpoints_of(seen([], []), [1], [0, 0, 1, 2], [0, 1, 1]) == [1]


@pytest.fixture(scope="module")
def result(scene_of):
    return tj.JointSegmenter(LEARNED)(scene_of(3).scene)


def test_superpoints_lie_inside_the_segments_of_the_images(result):
    of_superpoint = result.hierarchy.segments_of_superpoints(result.hierarchy.default)
    for labels, superpoints in zip(result.images, result.superpoint_images, strict=True):
        own = (labels >= 0) & (labels < result.num_point_segments)
        assert torch.equal(superpoints >= 0, own)
        assert torch.equal(of_superpoint[superpoints[own]], labels[own])
        assert superpoints.dtype == torch.int64
        assert len(superpoints[own].unique()) > len(labels[own].unique())


@pytest.mark.parametrize("least", [1, geodesic.MIN_POINTS])
def test_superpoints_are_propagated_with_their_labels(scene_of, monkeypatch, least):
    """Also where paths are equally cheap: labels are those that segments give, without specks the superpoints, too."""
    monkeypatch.setattr(geodesic, "MIN_POINTS", least)
    segmenter, scene = tj.JointSegmenter(LEARNED), scene_of(3).scene
    segmenter(scene)
    hierarchy = segmenter.method.segment(segmenter.graph, segmenter.state, segmenter.config)
    of_superpoint = hierarchy.segments_of_superpoints(hierarchy.default)
    of_point, count = of_superpoint[hierarchy.superpoint], int(of_superpoint.max()) + 1
    numbers = SuperpointNumbers.of(hierarchy.superpoint, of_superpoint)
    for seen in segmenter.state.observations[:]:
        there = of_point[seen.visible.point]
        expected, next_free = propagate(seen, there, count, LEARNED)
        labels, free, superpoints = propagate_superpoints(seen, count, numbers, LEARNED)
        assert torch.equal(labels, expected)
        assert free == next_free
        alone = superpoint_image(seen, expected.long(), numbers, LEARNED)
        assert float((superpoints != alone).float().mean()) < 0.01
        assert least > 1 or torch.equal(superpoints, alone)


def test_levels_of_a_scene_are_nested(result):
    before = None
    for granularity in (1.0, 0.8, 0.55, 0.5, 0.45, 0.2, 0.0):
        level = result.at(granularity)
        everywhere = torch.cat([level.points, *(image.flatten() for image in level.images)])
        if before is not None:
            pairs = torch.unique(torch.stack([before, everywhere]), dim=1)
            assert pairs.shape[1] == len(before.unique())
        before = everywhere
    same = result.at(0.5)
    assert torch.equal(same.points, result.points)
    assert all(torch.equal(a, b) for a, b in zip(same.images, result.images, strict=True))


def test_neither_threads_nor_later_frames_matter(scene_of, result, set_threads):
    scene = scene_of(3).scene
    segmenter = tj.JointSegmenter(LEARNED)
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(list(scene.frames[:2]))
    first = segmenter.compute()
    set_threads(1)
    expected = segmenter.compute().superpoint_images[:]
    segmenter.update(list(scene.frames[2:]))
    set_threads(3)
    assert len(first.superpoint_images) == 2
    assert all(torch.equal(a, b) for a, b in zip(first.superpoint_images, expected, strict=True))


def test_other_methods_have_none(scene_of):
    result = tj.JointSegmenter(tj.Config.from_preset("paper").set(["boundary.detector=gradient"]))(scene_of(3).scene)
    assert result.hierarchy is None
    assert len(result.superpoint_images) == 0
