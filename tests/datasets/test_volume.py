"""Depth images are fused into a volume: by hand, against Open3D, in any order."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from torchjoint.datasets.volume import BLOCK, MOST_BLOCKS, Volume

CAMERA = torch.tensor([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]], dtype=torch.float64)
EYE = torch.eye(4, dtype=torch.float64)
GREY = torch.full((60, 80, 3), 90, dtype=torch.uint8)


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(1)


def fused(images, voxel_size=0.04, memory=None):
    volume = Volume(voxel_size, 5.0, memory)
    for image in images:
        volume.integrate(*image)
    return volume


def arguments(scene):
    return [
        (f.depth, (f.image * 255).round().to(torch.uint8).permute(1, 2, 0), f.intrinsics.double(), f.world_to_camera)
        for f in scene.frames
    ]


def test_a_wall_by_hand():
    color = GREY.clone()
    color[:, :, 0] = 200
    points, colors = fused([(torch.full((60, 80), 2.013), color, CAMERA, EYE)]).surface()
    # One voxel before and one behind the wall, whose distances are along the same rays nearly.
    assert (points[:, 2] - 2.013).abs().max() < 1e-3
    assert (colors == torch.tensor([200.0, 90.0, 90.0])).all()
    # The camera sees 80/60 * 2 by 60/60 * 2 metres of it, in voxels of 4 cm.
    assert len(points) == pytest.approx(80 / 60 * 2.013 / 0.04 * 2.013 / 0.04, rel=0.05)
    assert ((points[:, :2] / 0.04 - 0.5) - (points[:, :2] / 0.04 - 0.5).round()).abs().max() < 1e-9


def test_a_second_image_is_averaged():
    images = [(torch.full((60, 80), z), torch.full_like(GREY, c), CAMERA, EYE) for z, c in ((2.0, 100), (2.01, 200))]
    points, colors = fused(images).surface()
    assert (points[:, 2] - 2.005).abs().max() < 1e-3
    assert (colors == 150).all()


def test_the_order_of_images_changes_nothing(synthetic):
    images = arguments(synthetic.scene)
    one, other = fused(images).surface(), fused(images[::-1]).surface()
    assert len(one[0]) > 1000
    assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("memory", [0, 1 << 21])
def test_a_volume_on_the_disk_is_the_same(synthetic, memory, tmp_path, monkeypatch):
    images = arguments(synthetic.scene)
    whole = fused(images)
    assert len(whole._key) * BLOCK > 2 * memory
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    volume = fused(images[:-1], memory=memory)
    assert volume._map is not None
    again = Volume(0.04, 5.0, memory)
    again.restore(volume.state())
    for one in (volume, again):
        one.integrate(*images[-1])
        assert all(torch.equal(a, b) for a, b in zip(whole.surface(), one.surface(), strict=True))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="Linux tells which pages are in memory")
def test_blocks_on_the_disk_leave_the_memory(synthetic):
    def resident(volume):
        start = volume._sums.data_ptr()
        lines = Path("/proc/self/smaps").read_text().splitlines()
        found = next(index for index, line in enumerate(lines) if line.startswith(f"{start:08x}-"))
        return next(int(line.split()[1]) for line in lines[found:] if line.startswith("Rss:")) * 1024

    volume = fused(arguments(synthetic.scene), memory=0)
    assert resident(volume) == 0
    volume._sums.sum()
    assert resident(volume) >= len(volume._key) * BLOCK
    volume.surface()
    assert resident(volume) == 0


def test_missing_depth_measures_nothing():
    for value in (0.0, -1.0, float("nan"), float("inf"), 6.0):
        assert len(fused([(torch.full((60, 80), value), GREY, CAMERA, EYE)]).surface()[0]) == 0
    assert len(fused([]).surface()[0]) == 0


@pytest.mark.parametrize("scale", [0.02, 0.5])
def test_small_and_large_voxels(scale):
    points, _ = fused([(torch.full((60, 80), 2.0), GREY, CAMERA, EYE)], scale).surface()
    assert (points[:, 2] - 2.0).abs().max() < 0.05 * scale
    assert points[:, 0].max() - points[:, 0].min() == pytest.approx(80 / 60 * (2 - scale), abs=2 * scale)


def test_what_is_too_large_is_told(monkeypatch):
    pose = EYE.clone()
    pose[0, 3] = 1e6
    with pytest.raises(ValueError, match=r"world_to_camera: expected points at most 3.355e\+05 m from"):
        fused([(torch.full((60, 80), 2.0), GREY, CAMERA, pose)])
    assert MOST_BLOCKS * 512 * 5 * 4 < 6e9
    monkeypatch.setattr("torchjoint.datasets.volume.MOST_BLOCKS", 8)
    with pytest.raises(ValueError, match="voxel_size: the surface needs more than 8 blocks"):
        fused([(torch.full((60, 80), 2.0), GREY, CAMERA, EYE)])


@pytest.mark.slow  # Open3D takes seconds to import
def test_the_surface_is_that_of_open3d(synthetic):
    pytest.importorskip("open3d")
    from open3d import camera, geometry, pipelines

    images, size = arguments(synthetic.scene), synthetic.scene.frames[0].size
    volume = pipelines.integration.ScalableTSDFVolume(0.04, 0.16, pipelines.integration.TSDFVolumeColorType.RGB8)
    for depth, color, k, pose in images:
        both = geometry.RGBDImage.create_from_color_and_depth(
            geometry.Image(color.contiguous().numpy()), geometry.Image(depth.numpy()), 1.0, 5.0, False
        )
        pinhole = camera.PinholeCameraIntrinsic(
            size[1], size[0], *(float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        )
        volume.integrate(both, pinhole, pose.numpy())
    theirs = torch.from_numpy(np.asarray(volume.extract_point_cloud().points))
    ours = fused(images).surface()[0]
    assert len(ours) == pytest.approx(len(theirs), rel=0.02)
    for one, other in ((ours, theirs), (theirs, ours)):
        assert torch.cdist(one, other).amin(1).quantile(0.95) < 1e-3
