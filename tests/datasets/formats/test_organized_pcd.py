"""Organised PCD files, such as mOSD's."""

import numpy as np
import pytest
import torch
from pcd_files import write_pcd

import torchjoint as tj

HEIGHT, WIDTH = 6, 8


def view(rng, *, focal=(10.0, 12.0), center=(3.2, 2.9)):
    """Columns of a random view, some pixels of it without depth."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    z = rng.uniform(1, 3, (HEIGHT, WIDTH))
    fields = {"x": (column - center[0]) * z / focal[0], "y": (row - center[1]) * z / focal[1], "z": z}
    fields = {name: values.astype(np.float32).ravel() for name, values in fields.items()}
    for values in fields.values():
        values[[3, 20, 21]] = np.nan
    fields["rgba"] = rng.integers(0, 1 << 24, HEIGHT * WIDTH, dtype=np.uint32)
    return fields


def write(path, fields, **how):
    return write_pcd(path, fields, width=WIDTH, height=HEIGHT, **how)


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_a_view_comes_back(tmp_path, data):
    fields = view(np.random.default_rng(0))
    scene = tj.load_scene(write(tmp_path / "view.pcd", fields, data=data))
    frame, known = scene.frames[0], ~np.isnan(fields["z"])
    np.testing.assert_array_equal(scene.points.numpy(), np.stack([fields[a] for a in "xyz"], axis=1)[known])
    assert frame.size == (HEIGHT, WIDTH)
    assert frame.world_to_camera.tolist() == np.eye(4).tolist()
    expected = torch.tensor([[10, 0, 3.2], [0, 12, 2.9], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(frame.intrinsics, expected, atol=1e-5, rtol=0)
    np.testing.assert_array_equal(frame.depth.numpy().ravel(), np.where(known, fields["z"], 0))
    red, green, blue = (fields["rgba"] >> shift & 255 for shift in (16, 8, 0))
    colors = np.stack([red, green, blue]) / np.float32(255)  # those of pixels without depth, too
    np.testing.assert_allclose(frame.image.numpy().reshape(3, -1), colors, atol=1e-6)
    np.testing.assert_allclose(scene.colors.numpy(), colors.T[known], atol=1e-6)
    assert scene.truth is None
    assert scene.name == frame.name == "view"


def test_labels_of_mosd_become_instances(tmp_path):
    fields = view(np.random.default_rng(0))
    labels = np.repeat(np.array([1, 2, 20, 21, 30, 0, 100, 9], dtype=np.uint32), HEIGHT)
    labels[3] = 1  # where there is no depth: the table, it says, but nobody can know
    scene = tj.load_scene(write(tmp_path / "view.pcd", fields | {"label": labels}))
    expected = np.repeat([0, 0, 2, 2, 3, -1, 10, 0], HEIGHT)
    expected[[3, 20, 21]] = -1
    assert scene.truth.images[0].shape == (HEIGHT, WIDTH)
    assert scene.truth.images[0].ravel().tolist() == expected.tolist()
    assert scene.truth.points.tolist() == expected[~np.isnan(fields["z"])].tolist()


def test_zero_depth_is_none(tmp_path):
    fields = view(np.random.default_rng(0))
    for axis in "xyz":
        fields[axis][10] = 0
    scene = tj.load_scene(write(tmp_path / "view.pcd", fields))
    assert len(scene.points) == HEIGHT * WIDTH - 4
    assert scene.frames[0].depth.ravel()[10] == 0


def test_scenes_of_a_folder(tmp_path):
    for name in ("b", "a"):
        write(tmp_path / f"{name}.pcd", view(np.random.default_rng(0)))
    plain = view(np.random.default_rng(0))
    write_pcd(tmp_path / "not organised.pcd", plain)
    del plain["rgba"]
    write(tmp_path / "no colours.pcd", plain)
    (tmp_path / "damaged.pcd").write_bytes(b"HEIGHT 3\nDATA ascii\n")
    assert tj.datasets.list_scenes(tmp_path) == {name: tmp_path / f"{name}.pcd" for name in "ab"}
    for name in ("not organised", "no colours"):  # clouds alone, which have no pixels without a point
        with pytest.raises(ValueError, match=r"\.pcd: 3 of 48 points are NaN or infinite"):
            tj.load_scene(tmp_path / f"{name}.pcd")
    with pytest.raises(ValueError, match=r"damaged\.pcd"):
        tj.load_scene(tmp_path / "damaged.pcd")


def test_points_that_are_on_no_pixel_s_ray(tmp_path):
    fields = view(np.random.default_rng(0))
    fields["x"][30] += 0.2
    for factor in (1, -1):  # one point; all points, mirrored
        fields["x"] *= factor
        path = write(tmp_path / "view.pcd", fields)
        with (
            pytest.warns(UserWarning, match=r"view\.pcd: 3 of 48 points are NaN or infinite; they are left out"),
            pytest.warns(
                UserWarning, match=r"view\.pcd: expected points on the rays .* px off its ray: read as a cloud"
            ),
        ):
            scene = tj.load_scene(path)
        assert len(scene.points) == len(scene.colors) == 45
        assert len(scene.frames) == 0


def test_a_view_may_be_read_as_a_cloud(tmp_path):
    path = write(tmp_path / "view.pcd", view(np.random.default_rng(0)))
    with pytest.warns(UserWarning, match="3 of 48 points are NaN"):
        scene = tj.load_scene(path, format="cloud_alone", drop_invalid=True)
    assert len(scene.frames) == 0
    with pytest.raises(ValueError, match=r"format: expected one of folder, .*, got 'cloud'"):
        tj.load_scene(path, format="cloud")
    with pytest.raises(ValueError, match=r"view\.pcd is not of format ros, which needs a ROS recording"):
        tj.load_scene(path, format="ros")


def test_a_view_along_the_other_axis_is_a_cloud_alone(tmp_path):
    fields = view(np.random.default_rng(0))
    fields["z"] = -fields["z"]
    fields = {name: np.nan_to_num(values, nan=-1) for name, values in fields.items()}
    with pytest.warns(UserWarning, match=r"view\.pcd: 0 points with depth are too few, .*: read as a cloud alone"):
        scene = tj.load_scene(write(tmp_path / "view.pcd", fields))
    assert (len(scene.points), len(scene.frames)) == (HEIGHT * WIDTH, 0)


@pytest.mark.parametrize("left", [[], [5], [5, 6]])
def test_too_few_points_to_find_intrinsics(tmp_path, left):
    fields = view(np.random.default_rng(0))
    fields["z"][[i for i in range(HEIGHT * WIDTH) if i not in left]] = np.nan
    with pytest.raises(ValueError, match=r"view\.pcd: .* points with depth are too few, or too close"):
        tj.load_scene(write(tmp_path / "view.pcd", fields))


def test_labels_that_are_none(tmp_path):
    fields = view(np.random.default_rng(0))
    count = HEIGHT * WIDTH
    with pytest.raises(ValueError, match="expected one integer per point in the field label, got float32"):
        tj.load_scene(write(tmp_path / "view.pcd", fields | {"label": np.ones(count, dtype=np.float32)}))
    with pytest.raises(ValueError, match="label: expected labels >= -1"):
        tj.load_scene(write(tmp_path / "view.pcd", fields | {"label": np.full(count, -50, dtype=np.int32)}))


def test_colours_of_another_size_are_none(tmp_path):
    fields = view(np.random.default_rng(0))
    path = write(tmp_path / "view.pcd", fields | {"rgba": fields["rgba"].astype(np.uint16)})
    with (
        pytest.warns(UserWarning, match="rgba: no position, normal or colour by these names"),
        pytest.raises(ValueError, match="expected a field rgb or rgba of 4 bytes"),
    ):
        tj.load_scene(path)


@pytest.mark.slow
def test_the_real_table_tops(shared):
    scenes = tj.datasets.list_scenes(shared / "data" / "mosd")
    assert len(scenes) == 23
    for name in ("learn0", "learn28", "learn38"):
        scene = tj.load_scene(scenes[name])
        frame, truth = scene.frames[0], scene.truth
        expected = torch.tensor([[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]], dtype=torch.float64)
        torch.testing.assert_close(frame.intrinsics, expected, atol=1e-3, rtol=0)
        ids = truth.points.unique().tolist()
        assert ids == [0, *range(2, len(ids) + 1)]  # the table, and the objects without a gap
        assert truth.images[0].unique().tolist() == [-1, *ids]
        # Every point falls on its own pixel, where depth, colour and instance are its own.
        row, column = torch.nonzero(frame.depth).T
        pixel = scene.points.double() @ frame.intrinsics.T
        assert (pixel[:, 0] / pixel[:, 2] - column).abs().max() < 0.01
        assert (pixel[:, 1] / pixel[:, 2] - row).abs().max() < 0.01
        assert torch.equal(frame.image[:, row, column].T, scene.colors)
        assert torch.equal(truth.images[0][row, column], truth.points)
        assert (truth.images[0][frame.depth == 0] == -1).all()


def test_labels_are_those_open3d_reads(shared):
    from open3d import t

    path = shared / "data" / "mosd" / "learn44.pcd"
    labels = t.io.read_point_cloud(str(path)).point.label.numpy().ravel().astype(int)
    expected = np.select([labels == 0, labels < 10], [-1, 0], labels // 10)
    truth = tj.load_scene(path).truth
    assert truth.images[0].ravel().tolist() == expected.tolist()
    assert truth.points.tolist() == expected[expected >= 0].tolist()
