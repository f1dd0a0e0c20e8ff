"""torchjoint superpoints: clouds in every format, results that open elsewhere, nothing overwritten."""

import numpy as np
import pytest
import torch
from PIL import Image

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import read_vertex_property, write_cloud
from torchjoint.results.figures import cloud_figure
from torchjoint.viewer.truth import read_labelled_cloud

POINTS = torch.rand(400, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 1.0, 0.01])
COLORS = torch.rand(400, 3, generator=torch.Generator().manual_seed(1))


def write(path, points=POINTS, colors=COLORS):
    suffix = path.suffix
    if suffix == ".ply":
        write_cloud(path, points, colors)
    elif suffix == ".npy":
        np.save(path, torch.cat([points, colors * 255], 1).numpy())
    elif suffix == ".npz":
        np.savez(path, points=points.numpy(), colors=colors.numpy())
    elif suffix == ".bin":
        np.concatenate([points.numpy(), np.zeros((len(points), 1))], 1).astype("<f4").tofile(path)
    else:
        np.savetxt(path, points.numpy())
    return path


@pytest.mark.parametrize("suffix", [".ply", ".npy", ".npz", ".bin", ".xyz"])
def test_formats(tmp_path, suffix):
    cloud = read_cloud_file(write(tmp_path / f"cloud{suffix}"))
    torch.testing.assert_close(cloud.points.float(), POINTS, atol=1e-6, rtol=0)
    if suffix in (".ply", ".npy", ".npz"):
        torch.testing.assert_close(cloud.colors.float(), COLORS, atol=0.01, rtol=0)
    else:
        assert cloud.colors is None


def test_parameters_that_do_not_count_are_told(tmp_path, run):
    to = write(tmp_path / "cloud.xyz"), "-o", tmp_path / "a.npy", "--no-picture", "--set"
    with pytest.raises(SystemExit, match="colors: color_weight > 0 needs the colours of the points"):
        run("superpoints", *to, "color_weight=0.5")
    with pytest.warns(UserWarning, match="^convex_factor: without effect here"):
        run("superpoints", *to, "convex_factor=0.5")


def test_what_it_writes(tmp_path, run, capsys):
    from open3d import t

    cloud = write(tmp_path / "cloud.npz")
    run("superpoints", cloud, "-o", tmp_path / "a.ply", "--set", "scale=0.3", "min_size=5")
    expected = tj.superpoints(POINTS, COLORS, scale=0.3, min_size=5)
    assert f"400 points in {int(expected.max()) + 1} superpoints" in capsys.readouterr().out
    assert t.io.read_point_cloud(str(tmp_path / "a.ply")).point.superpoint.numpy().ravel().tolist() == expected.tolist()
    assert np.array(Image.open(tmp_path / "a.ply.png")).shape[1] > 1000
    run("superpoints", cloud, "-o", tmp_path / "b.npy", "--no-picture", "--preset", "scan")
    assert np.load(tmp_path / "b.npy").tolist() == tj.superpoints(POINTS, COLORS, preset="scan").tolist()
    run("superpoints", cloud, "-o", tmp_path / "c.npz", "--no-picture", "--viewpoint", 0, 0, 5)
    assert (
        np.load(tmp_path / "c.npz")["labels"].tolist()
        == tj.superpoints(POINTS, COLORS, viewpoint=torch.tensor([0.0, 0, 5])).tolist()
    )
    assert {file.name for file in tmp_path.iterdir()} == {"cloud.npz", "a.ply", "a.ply.png", "b.npy", "c.npz"}


def test_the_picture_of_a_glb_is_upright(tmp_path, run, monkeypatch):
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "a.glb").write_bytes(trimesh.creation.icosphere().export(file_type="glb"))
    drawn = []

    def draw(scene, labels):
        drawn.append(scene)
        return cloud_figure(scene, labels)

    monkeypatch.setattr("torchjoint.cli.superpoints.cloud_figure", draw)
    run("superpoints", tmp_path / "a.glb", "-o", tmp_path / "a.ply")
    assert drawn[0].up.tolist() == [0, 1, 0]


@pytest.mark.filterwarnings("ignore:.*are NaN or infinite; they are left out")
@pytest.mark.parametrize("suffix", [".ply", ".npy", ".npz", ".bin", ".xyz"])
def test_points_that_are_nan_or_infinite(tmp_path, run, suffix):
    points = POINTS.clone()
    points[::9] = float("nan")
    cloud, valid = write(tmp_path / f"cloud{suffix}", points), torch.arange(400) % 9 != 0
    with pytest.raises(ValueError, match=rf"cloud{suffix}: 45 of 400 points are NaN or infinite; --drop-invalid"):
        read_cloud_file(cloud)
    run("superpoints", cloud, "-o", tmp_path / "a.npy", "--no-picture", "--drop-invalid")
    labels = torch.from_numpy(np.load(tmp_path / "a.npy"))
    colors = read_cloud_file(cloud, None, "drop").colors
    assert labels[valid].tolist() == tj.superpoints(read_cloud_file(cloud, None, "drop").points, colors).tolist()
    assert (labels[~valid] == -1).all()
    run("superpoints", cloud, "-o", tmp_path / "b.ply", "--no-picture", "--drop-invalid")
    assert len(read_cloud_file(tmp_path / "b.ply", None, "drop").points) == 355
    assert torch.equal(read_labelled_cloud(tmp_path / "b.ply").points, labels[valid])
    assert len(tj.load_scene(cloud, drop_invalid=True).points) == 355


@pytest.mark.filterwarnings("ignore:of 7 columns")
@pytest.mark.parametrize("suffix", [".npy", ".txt", ".bin"])
def test_columns_by_letters(tmp_path, run, suffix):
    cloud, label = tmp_path / f"cloud{suffix}", np.arange(400)[:, None] % 5
    rows = np.concatenate([label, POINTS.numpy(), (COLORS * 255).numpy()], 1).astype("<f4")
    {".npy": lambda: np.save(cloud, rows), ".txt": lambda: np.savetxt(cloud, rows), ".bin": lambda: rows.tofile(cloud)}[
        suffix
    ]()
    read = tj.datasets.load_cloud(cloud, columns="lxyzrgb")
    torch.testing.assert_close(read.points.float(), POINTS)
    torch.testing.assert_close(read.colors, COLORS)
    assert read_cloud_file(cloud, "nnnxyzl").normals.tolist() == rows[:, :3].tolist()
    run("superpoints", cloud, "-o", tmp_path / "a.npy", "--no-picture", "--columns", "lxyzrgb")
    assert np.load(tmp_path / "a.npy").tolist() == tj.superpoints(read.points, read.colors).tolist()
    for wrong, message in (("xyzrgb", "expected rows of"), ("xyzrgll", "expected x, y, z, and r, g, b")):
        with pytest.raises(ValueError, match=message):
            read_cloud_file(cloud, wrong)
    with pytest.raises(ValueError, match=r"for columns 'xyz'"):
        read_cloud_file(write(tmp_path / "b.ply"), "xyz")


def test_a_ply_that_changes_meanwhile(tmp_path, run, monkeypatch):
    """It is read once for its points, and once for its other bytes."""
    write_cloud(tmp_path / "a.ply", POINTS)

    def read(path, *given):
        cloud = read_cloud_file(path, *given)
        write_cloud(path, cloud.points.flip(0))
        return cloud

    monkeypatch.setattr("torchjoint.cli.superpoints.read_cloud_file", read)
    with pytest.raises(SystemExit, match=r"a\.ply: changed while it was read; start again"):
        run("superpoints", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--no-picture")
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.parametrize("encoding", ["ascii", "binary_big_endian"])
def test_a_ply_keeps_all_that_it_has(tmp_path, run, encoding):
    """The source's bytes stay, and get a column; a second time is an error before the work."""
    columns = [("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("alpha", ">u1"), ("intensity", ">f8")]
    rows = np.zeros(400, columns)
    for axis in range(3):
        rows["xyz"[axis]] = POINTS[:, axis]
    rows["alpha"], rows["intensity"] = np.arange(400) % 256, np.arange(400) / 8
    kinds = ["float"] * 3 + ["uchar", "double"]
    lines = ["ply", f"format {encoding} 1.0", "comment mine", "element vertex 400"]
    lines += [f"property {kind} {name}" for kind, (name, _) in zip(kinds, columns, strict=True)]
    head = "\n".join(lines).encode()
    body = b"".join(b"%s\n" % " ".join(map(str, row)).encode() for row in rows.tolist())
    (tmp_path / "a.ply").write_bytes(head + b"\nend_header\n" + (body if encoding == "ascii" else rows.tobytes()))
    run("superpoints", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--no-picture")
    expected, written = tj.superpoints(POINTS).numpy(), (tmp_path / "b.ply").read_bytes()
    start = head + b"\nproperty int superpoint\nend_header\n"
    assert written.startswith(start)
    if encoding == "ascii":
        assert written[len(start) :] == b"".join(
            b"%s %d\n" % (line, label) for line, label in zip(body.splitlines(), expected.tolist(), strict=True)
        )
    else:
        found = np.frombuffer(written[len(start) :], [*columns, ("superpoint", ">i4")])
        assert found[[name for name, _ in columns]].tolist() == rows.tolist()
        assert found["superpoint"].tolist() == expected.tolist()
    assert torch.equal(read_labelled_cloud(tmp_path / "b.ply").points, torch.from_numpy(expected))
    with pytest.raises(SystemExit, match=r"b\.ply: element vertex has a property superpoint already; choose another"):
        run("superpoints", tmp_path / "b.ply", "-o", tmp_path / "c.ply")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_a_ply_of_any_order_of_elements(tmp_path, run, encoding):
    """Faces of several lengths, and elements without properties, may stand before the vertices."""
    faces = [[3, 0, 1, 2], [4, 0, 1, 2, 3]]
    head = f"ply\nformat {encoding} 1.0\nelement face 2\nproperty list uchar int vertex_indices\nelement empty 3\n"
    head += (
        "element vertex 400\nproperty float x\nproperty float y\nproperty float z\nelement old 1\nproperty uchar a\n"
    )
    if encoding == "ascii":
        rows = [*faces, *POINTS.tolist(), [7]]
        body = [" ".join(map(str, row)).encode() + b"\n" for row in rows]
    else:
        body = [bytes(row[:1]) + np.array(row[1:], "<i4").tobytes() for row in faces]
        body += [row.tobytes() for row in POINTS.numpy()] + [b"\7"]
    (tmp_path / "a.ply").write_bytes(head.encode() + b"end_header\n" + b"".join(body))
    run("superpoints", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--no-picture")
    before, after = (read_cloud_file(tmp_path / name) for name in ("a.ply", "b.ply"))
    assert torch.equal(before.points, after.points)
    assert torch.equal(before.faces, after.faces)
    found = read_vertex_property(tmp_path / "b.ply", "superpoint")
    assert found.tolist() == tj.superpoints(POINTS).tolist()


def test_the_newest_labels_are_shown(tmp_path, run):
    write_cloud(tmp_path / "a.ply", POINTS, labels=torch.arange(400))
    run("superpoints", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--no-picture")
    assert torch.equal(read_labelled_cloud(tmp_path / "a.ply").points, torch.arange(400))
    assert torch.equal(read_labelled_cloud(tmp_path / "b.ply").points, tj.superpoints(POINTS))


def test_a_mesh(tmp_path, run):
    import open3d

    mesh = open3d.geometry.TriangleMesh.create_sphere(1.0, 20)
    open3d.io.write_triangle_mesh(str(tmp_path / "mesh.ply"), mesh)
    run("superpoints", tmp_path / "mesh.ply", "-o", tmp_path / "out.npy", "--preset", "segmentator", "--no-picture")
    read = read_cloud_file(tmp_path / "mesh.ply")
    assert read.faces.tolist() == np.asarray(mesh.triangles).tolist()
    expected = tj.superpoints(read.points, faces=read.faces, preset="segmentator")
    assert np.load(tmp_path / "out.npy").tolist() == expected.tolist()


@pytest.mark.filterwarnings("ignore:.*are NaN or infinite; they are left out")
def test_a_mesh_keeps_its_triangles(tmp_path, run):
    grid = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1)) / 10
    corner = torch.cartesian_prod(torch.arange(19), torch.arange(19)) @ torch.tensor([20, 1])
    faces = torch.cat([torch.stack([corner, corner + 20, corner + one], 1) for one in (1, 21)])
    write_cloud(tmp_path / "mesh.ply", grid, faces=faces)
    for name in ("a.ply", "a.npz"):
        run("superpoints", tmp_path / "mesh.ply", "-o", tmp_path / name, "--no-picture")
        read = tj.datasets.load_cloud(tmp_path / name)
        assert torch.equal(read.points, grid)
        assert torch.equal(read.faces, faces)
    broken = grid.clone()
    broken[[0, 57]] = float("nan")
    write_cloud(tmp_path / "broken.ply", broken, faces=faces)
    whole = faces[~torch.isin(faces, torch.tensor([0, 57])).any(1)]
    left = tj.datasets.load_cloud(tmp_path / "broken.ply", drop_invalid=True)
    with pytest.raises(ValueError, match=r"broken\.ply: 2 of 400 points are NaN or infinite"):
        tj.datasets.load_cloud(tmp_path / "broken.ply")
    run("superpoints", tmp_path / "broken.ply", "-o", tmp_path / "b.ply", "--no-picture", "--drop-invalid")
    for read in (left, tj.datasets.load_cloud(tmp_path / "b.ply", drop_invalid=True)):
        assert torch.equal(read.points[read.faces], grid[whole])
    labels = tj.superpoints(left.points, faces=left.faces, preset="segmentator")
    given = tj.superpoints(broken, faces=faces, preset="segmentator", drop_invalid=True)
    assert torch.equal(labels, given[given >= 0])


def test_nothing_is_overwritten(tmp_path, run):
    cloud = write(tmp_path / "cloud.npz")
    (tmp_path / "out.ply.png").write_text("precious")
    with pytest.raises(SystemExit, match=r"out\.ply\.png: exists already; choose another name with -o, or --overwrite"):
        run("superpoints", cloud, "-o", tmp_path / "out.ply")
    assert {file.name for file in tmp_path.iterdir()} == {"cloud.npz", "out.ply.png"}
    run("superpoints", cloud, "-o", tmp_path / "out.ply", "--overwrite")
    with pytest.raises(SystemExit, match=r"out\.ply: exists already"):
        run("superpoints", cloud, "-o", tmp_path / "out.ply")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.ply"], r"nowhere\.ply: missing; expected a point cloud"),
        (["nowhere", "-o", "e"], r"nowhere: missing; expected a point cloud"),
        (["cloud.doc", "-o", "e.ply"], r"cloud\.doc: expected a file that ends in \.ply, \.pcd"),
        (["cloud.npz", "-o", "out.txt"], r"-o: expected a file that ends in \.ply, \.npy or \.npz, got out\.txt"),
        (["site.laz", "-o", "out"], r"-o: expected a file that ends in \.ply, \.las, \.laz, \.npy or \.npz, got out"),
        (["tiles", "-o", "out.laz"], r"out: a folder of clouds gives a folder: expected its name, got .*out\.laz"),
        (["tiles", "-o", "out.PLY"], r"out: a folder of clouds gives a folder"),
        (["cloud.npz", "-o", "no/out.ply"], r"-o: no is no folder"),
        (["cloud.npz", "--preset", "nope"], r"preset: expected one of default, scan, segmentator"),
        (["cloud.npz", "--set", "sclae=1"], r"superpoints\.sclae: unknown parameter"),
        (["cloud.npz", "--set", "scale"], r"--set: expected parameter=value, got 'scale'"),
        (["cloud.npz", "--set", "scale=["], r"scale: expected a value, got '\['"),
        (["odd.bin"], r"odd\.bin: expected rows of 4 float32, 16 bytes each, got 6 bytes"),
        (["odd.npy"], r"odd\.npy: not a whole \.npy cloud: expected a row of x y z for each point, got shape \[3\]"),
        (["odd.npz"], r"odd\.npz: not a whole \.npz cloud: expected an array `points`, got xyz"),
        (["odd.xyz"], r"odd\.xyz: not a whole \.xyz cloud"),
    ],
)
def test_errors_are_one_line(tmp_path, monkeypatch, arguments, message, run):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "cloud.npz")
    (tmp_path / "tiles").mkdir()
    for name in ("site.laz", "tiles/a.laz", "cloud.doc"):
        (tmp_path / name).touch()
    (tmp_path / "odd.bin").write_bytes(b"123456")
    np.save(tmp_path / "odd.npy", np.zeros(3))
    np.savez(tmp_path / "odd.npz", xyz=np.zeros((3, 3)))
    (tmp_path / "odd.xyz").write_text("one two three")
    before = set(tmp_path.iterdir())
    with pytest.raises(SystemExit, match="torchjoint: error: " + message):
        run("superpoints", *arguments)
    assert set(tmp_path.iterdir()) == before


def turning(count=2000):
    """Rows x y z intensity ring of a LiDAR that turns."""
    angle = torch.arange(count) / count * 6.28
    radius = 10 + torch.sin(5 * angle)
    rows = [radius * angle.cos(), radius * angle.sin(), torch.zeros(count), 60 + 50 * angle.cos(), torch.zeros(count)]
    return torch.stack(rows, 1).numpy().astype("<f4")


class TestScans:
    def test_those_of_nuscenes_have_five_columns(self, tmp_path):
        turning().tofile(tmp_path / "LIDAR_TOP.pcd.bin")
        np.testing.assert_array_equal(read_cloud_file(tmp_path / "LIDAR_TOP.pcd.bin").points, turning()[:, :3])

    def test_columns_that_are_not_plausible(self, tmp_path, run):
        turning().tofile(tmp_path / "scan.bin")  # would be 2500 points of KITTI
        with pytest.raises(
            SystemExit, match=r"scan\.bin: expected rows of 4 float32, but rows of 5 are more plausible.*--columns 5"
        ):
            run("superpoints", tmp_path / "scan.bin", "-o", tmp_path / "a.npy", "--no-picture")
        run("superpoints", tmp_path / "scan.bin", "-o", tmp_path / "a.npy", "--no-picture", "--columns", 5)
        assert len(np.load(tmp_path / "a.npy")) == 2000
        assert len(read_cloud_file(tmp_path / "scan.bin", 4).points) == 2500  # who insists gets it

    def test_a_project_of_cloudcompare(self, tmp_path):
        (tmp_path / "a.bin").write_bytes(b"CCB2" + turning().tobytes()[4:])
        with pytest.raises(ValueError, match=r"a\.bin: expected rows of float32, got a project of CloudCompare"):
            read_cloud_file(tmp_path / "a.bin", 5)

    @pytest.mark.parametrize("suffix", [".npy", ".ply"])
    def test_columns_of_another_format(self, tmp_path, suffix):
        with pytest.raises(ValueError, match="expected at least 3 columns, and a file that ends"):
            read_cloud_file(write(tmp_path / f"cloud{suffix}"), 5)

    def test_transposed_arrays(self, tmp_path):
        np.save(tmp_path / "cloud.npy", POINTS.T.numpy())
        with pytest.raises(ValueError, match=r"cloud\.npy.*got shape \[3, 400\]: transpose the array"):
            read_cloud_file(tmp_path / "cloud.npy")
