"""The piece in each pixel: by hand, inside the pixel's segment, and the nearest point where paths lead elsewhere."""

import pytest
import torch

import torchjoint as tj
from torchjoint.labels import geodesic, piece_images
from torchjoint.labels.piece_images import piece_image

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


def pieces_of(seen, labels, piece, of_piece):
    image = piece_image(seen, torch.tensor([labels]), torch.tensor(piece), torch.tensor(of_piece), tj.Config())
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
    of_piece = result.hierarchy.segments_of_pieces(0.5)
    for labels, pieces in zip(result.images, result.piece_images, strict=True):
        own = (labels >= 0) & (labels < result.num_point_segments)
        assert torch.equal(pieces >= 0, own)
        assert torch.equal(of_piece[pieces[own]], labels[own])
        assert pieces.dtype == torch.int64
        assert len(pieces[own].unique()) > len(labels[own].unique())


def test_paths_lead_to_pieces_as_to_labels(scene_of, monkeypatch):
    """Also where paths are equally cheap: only pixels of removed specks need the nearest point of their segment."""
    corrected = []

    def nearest(seen, pieces_there, of_piece, row, column, segment):
        corrected.append(len(row))
        return segment

    monkeypatch.setattr(piece_images, "_nearest_of_segment", nearest)
    monkeypatch.setattr(geodesic, "MIN_POINTS", 1)
    result = tj.JointSegmenter(LEARNED)(scene_of(3).scene)
    assert len(result.piece_images[:]) == 6
    assert corrected == [0] * 6


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
