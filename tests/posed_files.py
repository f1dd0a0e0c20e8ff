"""What tests of posed image collections share: a scene to write, and comparisons with what was read."""

from dataclasses import replace

import numpy as np
import torch
from PIL import Image

import torchjoint as tj


def eight_bits(synthetic):
    """The scene as 8-bit files can hold it."""
    frames = [replace(frame, image=(frame.image * 255).round() / 255) for frame in synthetic.scene.frames]
    return replace(synthetic.scene, frames=frames, colors=(synthetic.scene.colors * 255).round() / 255)


def save_image(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((image * 255).round().byte().permute(1, 2, 0).numpy()).save(path)


def save_depth(path, depth, units):
    """16 bits, `units` a metre."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((depth * units).round().numpy().astype(np.uint16)).save(path)


def quaternion_of(rotation):
    """w x y z of a rotation matrix: the eigenvector of Bar-Itzhack's matrix (2000) of the largest eigenvalue."""
    r = np.asarray(rotation, dtype=np.float64)
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def assert_same_frames(got, expected):
    assert len(got) == len(expected)
    for one, other in zip(got, expected, strict=True):
        torch.testing.assert_close(one.world_to_camera, other.world_to_camera, atol=1e-6, rtol=0)
        torch.testing.assert_close(one.intrinsics, other.intrinsics, atol=1e-6, rtol=0)
        torch.testing.assert_close(one.image, other.image, atol=1e-6, rtol=0)


def assert_same_segmentation(got, expected):
    one, other = tj.JointSegmenter()(got), tj.JointSegmenter()(expected)
    assert one.num_point_segments > 3
    assert torch.equal(one.points, other.points)
    for labels, right in zip(one.images, other.images, strict=True):
        assert torch.equal(labels, right)
