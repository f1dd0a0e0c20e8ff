"""VGGT's predictions: lengths in metres, depth of little confidence, names, and errors."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import samples
import torch

import torchjoint as tj


def changed(path, **arrays):
    file = path / "predictions.npz"
    with np.load(file) as before:
        kept = dict(before)
    np.savez(file, **{name: value for name, value in (kept | arrays).items() if value is not None})
    return path


def test_lengths_are_those_of_a_median_depth_of_two_metres(tmp_path, caplog):
    path = samples.write("vggt", tmp_path / "a")
    scene = tj.load_scene(path)
    assert "has no metres; its lengths times 4," in caplog.text
    for index, frame in enumerate(scene.frames):
        center = -frame.world_to_camera[:3, :3].T @ frame.world_to_camera[:3, 3]
        torch.testing.assert_close(center, torch.tensor([0.1 * index, 0, 0]).double(), atol=1e-6, rtol=0)
        assert not frame.depth[:3].any()  # of little confidence
        assert frame.depth[3:].unique().tolist() == [2.0]
        assert frame.name == f"frame-{index:06d}"
    assert float((scene.points[:, 1] - 2).abs().max()) < 0.05
    intrinsics = np.tile(frame.intrinsics.numpy().astype(">f4"), (2, 1, 1))  # the bytes of another machine
    assert len(tj.load_scene(changed(path, intrinsic=intrinsics) / "predictions.npz").points) == len(scene.points)


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (("left.jpg", "right.png"), ["left", "right"]),
        (("a (1).jpg", "a.jpg", ".DS_Store"), ["a (1)", "a"]),  # as the demo sorts them
        (("a.jpg", "a.png", "b.jpg"), ["frame-000000", "frame-000001"]),
    ],
)
def test_names_are_those_of_the_same_images(tmp_path, files, names):
    path = samples.write("vggt", tmp_path / "a")
    (path / "images").mkdir()
    for file in files:
        (path / "images" / file).touch()
    assert [frame.name for frame in tj.load_scene(path).frames] == names


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"depth": None}, r"expected an array 'depth', \[S H W 1\], got none"),
        ({"depth": np.ones((2, 12, 15, 1))}, r"depth: expected \[S H W 1\] floats \(S = 2, H = 12, W = 16\), got"),
        ({"images": np.ones((2, 3, 12, 16), int)}, r"images: expected \[S 3 H W\] floats"),
        ({"depth": np.full((2, 12, 16, 1), np.nan)}, "depth: expected numbers > 0, got none"),
        ({"extrinsic": np.ones((2, 3, 4))}, "extrinsic 0"),
        ({"extrinsic": np.ones((2, 3, 4), np.float16)}, "extrinsic: expected a floating dtype, got torch.float16"),
    ],
)
def test_errors(tmp_path, arrays, message):
    with pytest.raises((TypeError, ValueError), match=message):
        list(tj.load_scene(changed(samples.write("vggt", tmp_path / "a"), **arrays)).frames)


@pytest.mark.parametrize("network", ["dust3r", "mast3r"])
def test_the_example_writes_it_from_the_scenes_of_other_networks(tmp_path, network):
    path = samples.write("vggt", tmp_path / "a")
    expected, file = tj.load_scene(path), path / "predictions.npz"
    with np.load(file) as stored:
        arrays = {name: torch.from_numpy(values) for name, values in stored.items()}
    world_to_camera = torch.eye(4).repeat(len(arrays["depth"]), 1, 1)
    world_to_camera[:, :3] = arrays["extrinsic"]
    depth, sure = [*arrays["depth"][..., 0]], [*arrays["depth_conf"]]
    scene = SimpleNamespace(
        imgs=[*arrays["images"].permute(0, 2, 3, 1).numpy()],
        get_focals=lambda: torch.nn.Parameter(arrays["intrinsic"][:, :1, 0]),
        get_principal_points=lambda: arrays["intrinsic"][:, :2, 2],
        get_im_poses=lambda: world_to_camera.inverse(),
    )
    if network == "dust3r":
        scene.get_depthmaps, scene.im_conf = lambda: depth, sure
    else:
        scene.get_dense_pts3d = lambda: (None, [one.flatten() for one in depth], sure)
    file.unlink()
    example = Path(__file__).parents[3] / "examples" / "save_dust3r.py"
    spec = importlib.util.spec_from_file_location("example", example)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.save(scene, path)
    found = tj.load_scene(path)
    torch.testing.assert_close(found.points, expected.points, atol=1e-5, rtol=0)
    for one, other in zip(found.frames, expected.frames, strict=True):
        torch.testing.assert_close(one.world_to_camera, other.world_to_camera, atol=1e-5, rtol=0)
        assert torch.equal(one.image, other.image)
