"""The piece in each pixel: by hand, inside the pixel's segment, and the nearest point where paths lead elsewhere."""

import pytest
import torch

import torchjoint as tj
from torchjoint.labels import geodesic
from torchjoint.labels.geodesic import PieceNumbers, propagate, propagate_pieces
from torchjoint.labels.label import piece_image

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


def pieces_of(seen, labels, piece, of_piece):
    numbers = PieceNumbers.of(torch.tensor(piece), torch.tensor(of_piece))
    image = piece_image(seen, torch.tensor([labels]), numbers, tj.Config())
    return image[0].tolist()


class TestByHand:
    """A strip of pixels, a point in each; the image has one colour and no boundaries."""

    def test_each_pixel_takes_its_point_s_piece(self, seen):
        assert pieces_of(seen([0, 1, 2, 3], [0] * 4), [0, 0, 1, 1], [0, 1, 2, 2], [0, 0, 1]) == [0, 1, 2, 2]

    def test_a_pixel_takes_the_nearest_point_of_its_own_segment(self, seen):
        # Pixel 3 holds a point of piece 2 (segment 1), but its label is segment 0, whose nearest point is in pixel 2.
        assert pieces_of(seen([0, 1, 2, 3, 4], [0] * 5), [0, 0, 0, 0, 1], [0, 1, 1, 2, 2], [0, 0, 1]) == [0, 1, 1, 1, 2]

    def test_pixels_without_a_3d_segment_have_no_piece(self, seen):
        assert pieces_of(seen([0, 1, 2], [0] * 3), [-1, 0, 7], [0, 1, 1], [0, 0]) == [-1, 1, -1]

    def test_a_hidden_segment_takes_its_first_piece(self, seen):
        assert pieces_of(seen([0, 1], [0] * 2), [0, 1], [0, 0, 1, 2], [0, 1, 1]) == [0, 1]
        assert pieces_of(seen([], []), [1], [0, 0, 1, 2], [0, 1, 1]) == [1]


@pytest.fixture(scope="module")
def result(scene_of):
    return tj.JointSegmenter(LEARNED)(scene_of(3).scene)


def test_pieces_lie_inside_the_segments_of_the_images(result):
    of_piece = result.hierarchy.segments_of_pieces(result.hierarchy.default)
    for labels, pieces in zip(result.images, result.piece_images, strict=True):
        own = (labels >= 0) & (labels < result.num_point_segments)
        assert torch.equal(pieces >= 0, own)
        assert torch.equal(of_piece[pieces[own]], labels[own])
        assert pieces.dtype == torch.int64
        assert len(pieces[own].unique()) > len(labels[own].unique())


@pytest.mark.parametrize("least", [1, geodesic.MIN_POINTS])
def test_pieces_are_propagated_with_their_labels(scene_of, monkeypatch, least):
    """Also where paths are equally cheap: the labels are those that segments give, without specks the pieces, too."""
    monkeypatch.setattr(geodesic, "MIN_POINTS", least)
    segmenter, scene = tj.JointSegmenter(LEARNED), scene_of(3).scene
    segmenter(scene)
    hierarchy = segmenter.method.segment(segmenter.graph, segmenter.state, segmenter.config)
    of_piece = hierarchy.segments_of_pieces(hierarchy.default)
    of_point, count = of_piece[hierarchy.piece], int(of_piece.max()) + 1
    numbers = PieceNumbers.of(hierarchy.piece, of_piece)
    for seen in segmenter.state.observations[:]:
        there = of_point[seen.visible.point]
        expected, next_free = propagate(seen, there, count, LEARNED)
        labels, free, pieces = propagate_pieces(seen, count, numbers, LEARNED)
        assert torch.equal(labels, expected)
        assert free == next_free
        alone = piece_image(seen, expected.long(), numbers, LEARNED)
        assert float((pieces != alone).float().mean()) < 0.01
        assert least > 1 or torch.equal(pieces, alone)


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
    expected = segmenter.compute().piece_images[:]
    segmenter.update(list(scene.frames[2:]))
    set_threads(3)
    assert len(first.piece_images) == 2
    assert all(torch.equal(a, b) for a, b in zip(first.piece_images, expected, strict=True))


def test_other_methods_have_none(scene_of):
    result = tj.JointSegmenter(tj.Config.from_preset("paper").set(["boundary.detector=gradient"]))(scene_of(3).scene)
    assert result.hierarchy is None
    assert len(result.piece_images) == 0
