"""Step 6, learned: a cloud without colours gets those of the images."""

from __future__ import annotations

import functools
import warnings

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.scene.frame import PoseWarning
from torchjoint.segments.learned.images import image_colors
from torchjoint.segments.learned.superpoints import build_superpoint_graph
from torchjoint.views.observations import Observation, Observations
from torchjoint.views.visibility import Visible

HEIGHT, WIDTH = 3, 4


def observation(image, points, pixels):
    """A frame that sees points in pixels, numbered row by row."""
    pixel = torch.tensor(pixels, dtype=torch.int64)
    row, column = pixel // WIDTH, pixel % WIDTH
    visible = Visible(
        torch.tensor(points, dtype=torch.int64), row, column, column.float(), row.float(), torch.ones(len(pixel))
    )
    nothing = torch.zeros(HEIGHT, WIDTH)
    return Observation("", nothing.int(), visible, torch.eye(3), torch.eye(4), image, nothing.byte())


def random_image(seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (3, HEIGHT, WIDTH), generator=generator, dtype=torch.uint8)


def by_hand(number, frames):
    """The same, point by point."""
    seen = {}
    for image, of_points, pixels in frames:
        for point, pixel in zip(of_points, pixels, strict=True):
            seen.setdefault(point, []).append(image[:, pixel // WIDTH, pixel % WIDTH].double() / 255)
    colors = torch.full((number, 3), torch.nan)
    for point, values in seen.items():
        colors[point] = torch.stack(values).mean(0)
    return colors if seen else None


@given(st.data())
def test_by_hand(data):
    number = data.draw(st.integers(1, 12), label="points")
    frames = []
    for seed in range(data.draw(st.integers(0, 10), label="frames")):
        of_points = data.draw(st.lists(st.integers(0, number - 1), unique=True))
        pixels = [data.draw(st.integers(0, HEIGHT * WIDTH - 1)) for _ in of_points]
        frames.append((random_image(seed), of_points, pixels))
    observations = [observation(*frame) for frame in frames]
    found, expected = image_colors(number, Observations(observations)), by_hand(number, frames)
    if expected is None:
        assert found is None
        return
    torch.testing.assert_close(found, expected, equal_nan=True)
    backwards = image_colors(number, Observations(observations[::-1]))
    assert torch.equal(found.nan_to_num(-1), backwards.nan_to_num(-1))


room = functools.cache(lambda: tj.synthetic.make_scene(0, num_views=4, num_points=3000, height=90, width=120).scene)


def scene_of(colors):
    """A small room with images, and with colours of the points or without."""
    made = room()
    return tj.Scene(made.points, frames=list(made.frames), colors=made.colors if colors else None)


def test_colors_of_the_images_are_close_to_those_of_the_points():
    scene = scene_of(colors=True)
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points)
    segmenter.update(scene.frames)
    found = image_colors(len(scene.points), segmenter.state.observations)[segmenter.graph.of_given]
    difference = (found - scene.colors).abs().mean(1)
    assert float(difference.nanmedian()) < 0.05
    assert float(difference.isfinite().float().mean()) > 0.8


def test_a_cloud_without_colors_has_those_of_the_images(monkeypatch):
    scene = scene_of(colors=False)
    asked = []

    def spy(num_points, observations):
        asked.append(len(observations))
        return image_colors(num_points, observations)

    monkeypatch.setattr("torchjoint.segments.learned.superpoints.image_colors", spy)
    filled = tj.JointSegmenter()(scene)
    assert asked == [len(scene.frames)]  # all draws have the same colours
    monkeypatch.setattr("torchjoint.segments.learned.superpoints.image_colors", lambda num_points, observations: None)
    assert not torch.equal(filled.points, tj.JointSegmenter()(scene).points)


def test_what_no_image_sees_has_no_colors():
    """A part that one image sees gets its colours; of the rest, all measures of colours are missing."""
    scene = scene_of(colors=False)
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points)
    segmenter.update(scene.frames[0])
    graph, state = segmenter.graph, segmenter.state
    evidence = build_superpoint_graph(graph, graph.scales, state)
    is_seen = image_colors(graph.num_points, state.observations)[:, 0].isfinite()
    assert 0.1 < float(is_seen.float().mean()) < 0.9
    first, second = graph.edge_index
    across = evidence.superpoint[first] != evidence.superpoint[second]
    both = (is_seen[first] & is_seen[second])[across]
    of_steps = evidence.boundaries.binned["color_step"][:, 0]
    assert of_steps.sum() == both.sum() < across.sum()
    colored = torch.zeros(len(evidence.statistics.size)).index_add_(0, evidence.superpoint, is_seen.float())
    assert torch.equal(evidence.statistics.colored.float(), colored)
    assert torch.equal(evidence.statistics.color[:, 0].isfinite(), colored > 0)
    assert torch.equal(evidence.statistics.texture.isfinite(), colored > 0)
    assert len(torch.unique(segmenter.compute(images=False).points)) > 3


def test_given_colors_stay(monkeypatch):
    def fail(num_points, observations):
        raise AssertionError("not asked for")

    monkeypatch.setattr("torchjoint.segments.learned.superpoints.image_colors", fail)
    scene = scene_of(colors=True)
    segmenter = tj.JointSegmenter()
    segmenter(scene)
    assert torch.equal(segmenter.graph.colors[segmenter.graph.of_given], scene.colors)


def test_frames_in_a_file_give_the_same(tmp_path):
    scene = scene_of(colors=False)
    labels = [tj.JointSegmenter(memory=memory)(scene).points for memory in (None, "1kB")]
    assert torch.equal(*labels)


@pytest.mark.parametrize("color", [0.0, 0.7, 1.0])
def test_colors_that_are_all_the_same_are_none(color):
    """Many programs write white or grey for a cloud that has no colours."""
    scene = scene_of(colors=False)
    same = tj.Scene(scene.points, frames=scene.frames, colors=torch.full_like(scene.points, color))
    expected = tj.JointSegmenter()(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error", PoseWarning)  # no colour of an image fits
        found = tj.JointSegmenter()(same)
    assert torch.equal(found.points, expected.points)
    assert all(map(torch.equal, found.images, expected.images))


def test_the_log_says_which_colors_count(caplog):
    scene = scene_of(colors=True)
    lines = []
    for colors in (scene.colors, None, torch.ones_like(scene.points)):
        caplog.clear()
        with caplog.at_level("INFO", logger="torchjoint.joint"):
            tj.JointSegmenter().reset(scene.points, colors)
        lines.append(caplog.messages[0])
    assert "colour" not in lines[0]
    assert "no colours (those of images are used, if any)" in lines[1]
    assert "all of one colour (those of images are used, if any)" in lines[2]


def test_a_weight_of_colors_takes_colors_that_are_all_the_same():
    scene = scene_of(colors=True)
    config = tj.Config.from_preset("paper").set(["paper.color_weight=1"])
    segmenter = tj.JointSegmenter(config)
    segmenter.reset(scene.points, torch.ones_like(scene.points))
    assert segmenter.graph.colors.eq(1).all()
