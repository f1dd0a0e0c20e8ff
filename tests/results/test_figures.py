"""Pictures of clouds."""

import matplotlib
import pytest
import torch

import torchjoint as tj
from torchjoint.results.figures import cloud_figure, overview
from torchjoint.scene import Segmentation


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("with_colors", [True, False])
def test_any_cloud_is_drawn(dtype, with_colors):
    random = torch.Generator().manual_seed(0)
    points = torch.rand(200, 3, generator=random, dtype=dtype)
    points += 0 if dtype == torch.float32 else 1e5  # far from the origin: float32 would round it
    scene = tj.Scene(points, colors=torch.rand(200, 3, generator=random, dtype=dtype) if with_colors else None)
    assert scene.points.dtype == dtype
    labels = torch.arange(200) % 3
    for figure in (cloud_figure(scene, labels), overview(scene, Segmentation(labels, ()))):
        figure.canvas.draw()
        assert len(figure.get_axes() or figure.subfigs) > 0


def test_the_frames_of_some_names_are_drawn(scene_of):
    scene = scene_of(3).scene
    images = [torch.zeros(frame.size, dtype=torch.int64) for frame in scene.frames]
    names = tuple(f"f{index}" for index in range(len(images)))
    result = Segmentation(torch.zeros(len(scene.points), dtype=torch.int64), images, initial_images=images, names=names)
    for given, drawn in ((("f1", "f3", "g"), ["f1", "f3"]), ((), [names[0], names[-1]])):
        figure = overview(scene, result, 2, given)
        assert [axis.get_title() for axis in figure.subfigs[0].axes if axis.get_title()] == drawn


def test_no_program_draws_text(scene_of, tmp_path, monkeypatch):
    """A file matplotlibrc in the current folder, such as a stranger's recording, can ask for LaTeX."""
    monkeypatch.setenv("PATH", str(tmp_path))
    scene = scene_of(1).scene
    labels = torch.zeros(len(scene.points), dtype=torch.int64)
    images = [torch.zeros(scene.frames[0].image.shape[1:], dtype=torch.int64)]
    with matplotlib.rc_context({"text.usetex": True}):
        for result in (Segmentation(labels, ()), Segmentation(labels, images, initial_images=images, names=("a",))):
            overview(scene, result).savefig(tmp_path / "a.png")
        cloud_figure(scene, labels).savefig(tmp_path / "a.png")
