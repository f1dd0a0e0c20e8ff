"""Clouds of Open3D become scenes, and results clouds of Open3D."""

import sys

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.results.render import label_colors

o3d = pytest.importorskip("open3d", reason="needs Open3D: pip install 'torchjoint[open3d]'")


@pytest.fixture
def mesh():
    mesh = o3d.geometry.TriangleMesh.create_box(1.0, 2.0, 3.0)
    mesh.compute_vertex_normals()
    mesh.paint_uniform_color([0.25, 0.5, 0.75])
    return mesh


@pytest.mark.parametrize("is_tensor", [False, True])
def test_a_mesh_and_a_cloud_become_the_same_scene(mesh, is_tensor):
    cloud = o3d.geometry.PointCloud(mesh.vertices)
    cloud.colors, cloud.normals = mesh.vertex_colors, mesh.vertex_normals
    if is_tensor:
        mesh, cloud = o3d.t.geometry.TriangleMesh.from_legacy(mesh), o3d.t.geometry.PointCloud.from_legacy(cloud)
    for given in (mesh, cloud):
        scene = tj.Scene.from_open3d(given)
        assert scene.points.amax(0).tolist() == [1, 2, 3]
        assert torch.equal(scene.colors, torch.tensor([[0.25, 0.5, 0.75]]).expand(8, 3))
        assert torch.allclose(scene.normals.norm(dim=1), torch.ones(8, dtype=scene.normals.dtype))


def test_what_is_absent_stays_absent():
    scene = tj.Scene.from_open3d(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.eye(3))))
    assert (scene.colors, scene.normals, len(scene.frames)) == (None, None, 0)


@pytest.mark.parametrize("given", [np.eye(3), None])
def test_something_else_is_an_error(given):
    with pytest.raises(TypeError, match="cloud: expected a PointCloud or TriangleMesh of Open3D, got "):
        tj.Scene.from_open3d(given)


def test_a_result_becomes_a_cloud_with_labels():
    labels = torch.tensor([0, 1, 1, -1])
    scene = tj.Scene(torch.rand(4, 3))
    cloud = tj.Result.of(tj.Segmentation(labels, ()), scene).to_open3d()
    assert np.array_equal(cloud.point.positions.numpy(), scene.points.numpy())
    assert cloud.point.labels.numpy().ravel().tolist() == labels.tolist()
    assert np.array_equal(np.asarray(cloud.to_legacy().colors, np.float32), label_colors(labels).numpy())
    cloud.translate(np.ones(3, np.float32))
    assert np.allclose(cloud.point.positions.numpy(), scene.points + 1)


def test_a_missing_open3d_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    result = tj.Result.of(tj.Segmentation(torch.zeros(1, dtype=torch.long), ()), tj.Scene(torch.zeros(1, 3)))
    with pytest.raises(ModuleNotFoundError, match=r"torchjoint\[open3d\]"):
        result.to_open3d()
