"""What the process has set as torch's default dtype and device does not matter."""

import dataclasses

import pytest
import torch

import torchjoint as tj


@pytest.fixture(params=["float64", "meta"])
def other_default(request):
    dtype = torch.get_default_dtype()
    if request.param == "meta":
        torch.set_default_device("meta")
    else:
        torch.set_default_dtype(getattr(torch, request.param))
    yield
    torch.set_default_device(None)
    torch.set_default_dtype(dtype)


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


METHODS = ["learned", "regions", "edges", "scan"]


def segmented(scene, method):
    """Scene and frames are made anew, too."""
    frames = [dataclasses.replace(frame) for frame in scene.frames]
    made = tj.Scene(scene.points, frames, colors=scene.colors)
    options = [f"point_segments.method={method}", "point_segments.min_size=20"]
    result = tj.JointSegmenter(tj.Config().set(options))(made)
    return [result.points, *result.images]


@pytest.fixture(scope="module")
def expected(scene):
    known = {method: segmented(scene, method) for method in METHODS}
    return known | {"superpoints": [tj.superpoints(scene.points, scene.colors)]}


@pytest.mark.parametrize("method", METHODS)
def test_segmentation(scene, expected, method, other_default):
    result = segmented(scene, method)
    torch.set_default_device(None)
    assert all(torch.equal(*pair) for pair in zip(result, expected[method], strict=True))


def test_superpoints(scene, expected, other_default):
    labels = tj.superpoints(scene.points, scene.colors)
    torch.set_default_device(None)
    assert torch.equal(labels, expected["superpoints"][0])
