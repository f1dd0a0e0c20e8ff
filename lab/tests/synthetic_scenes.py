"""Options of furnished rooms, and their surface to measure distances to."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchjoint.synthetic import SyntheticScene

o3d = pytest.importorskip("open3d", reason="Open3D measures distances to a surface")

CLEAN = {
    "pose_error": 0.0,
    "depth_noise": 0.0,
    "depth_holes": 0.0,
    "image_noise": 0.0,
    "motion_blur": 0.0,
    "exposure": 0.0,
}
TINY = {"num_views": 2, "height": 48, "width": 64, "num_points": 300}


def surface_of(truth: SyntheticScene) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    vertices = truth.triangles.reshape(-1, 3)
    faces = torch.arange(len(vertices), dtype=torch.int64).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(vertices.numpy()), o3d.core.Tensor(faces.numpy().astype(np.uint32)))
    return scene
