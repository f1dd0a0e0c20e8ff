"""Labels in the files of others: clouds, meshes, Gaussian splats."""

import csv
import json
import re
import resource
import shutil
import warnings
from contextlib import nullcontext
from pathlib import Path

import laspy
import numpy as np
import pytest
import torch
from las_town import WKT, town, write_las
from splat_files import splat_file, splat_rows

import torchjoint as tj
from torchjoint.datasets.files import meshes
from torchjoint.datasets.files.ply import read_ply, read_vertex_property, write_cloud
from torchjoint.datasets.formats import cloud_alone
from torchjoint.results import labelled_file
from torchjoint.results.exports.clouds import export_las
from torchjoint.results.folder import write_result
from torchjoint.results.labelled_file import check_dimension, label_file, nearest_labels, part_files, write_labelled


def result_of(points, labels, colors=None):
    return tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(points, colors=colors))


@pytest.fixture
def splats(tmp_path, scene_of):
    """A room's cloud as splats, and 200 faint ones between them; the rows, and the true labels of the others."""
    made, rng = scene_of(3, num_points=6000), np.random.default_rng(0)
    points = made.scene.points.numpy()
    floaters = rng.uniform(points.min(0), points.max(0), (200, 3))
    opacity = np.concatenate([rng.uniform(0.3, 0.99, len(points)), rng.uniform(0.01, 0.09, 200)])
    colors = np.concatenate([made.scene.colors.numpy(), rng.uniform(0, 1, (200, 3))])
    rows = splat_rows(np.concatenate([points, floaters]), colors, opacity, rng)
    order = rng.permutation(len(rows))
    truth = np.concatenate([made.point_labels.numpy(), np.full(200, -2)])[order]
    return splat_file(tmp_path / "room.ply", rows[order]), rows[order], torch.from_numpy(truth)


def test_faint_splats_are_no_surface(splats):
    path, _, truth = splats
    with pytest.warns(UserWarning, match="200 of 6200 splats are fainter than an opacity of 0.1"):
        scene = tj.load_scene(path)
    assert torch.equal(scene.points, read_ply(path).points[truth > -2])
    assert len(tj.load_scene(path, least_opacity=0).points) == 6200
    with pytest.raises(ValueError, match=r"all 6200 splats are fainter than --least-opacity \(least_opacity\) 1"):
        tj.load_scene(path, least_opacity=1)
    with pytest.raises(ValueError, match=r"least_opacity: expected a number in \[0, 1\], got 2"):
        tj.load_scene(path, least_opacity=2)


@pytest.mark.filterwarnings("ignore:.*fainter")
def test_splats_get_labels_and_keep_every_byte(splats, run, tmp_path):
    path, rows, truth = splats
    scene = tj.load_scene(path)
    labels = truth[truth > -2].clamp(min=0).unique(return_inverse=True)[1]
    (tmp_path / "result").mkdir()
    write_result(tmp_path / "result", scene, tj.Segmentation(labels, ()), tj.Config(), str(path))
    run("label", tmp_path / "result", path, "-o", tmp_path / "out.ply")
    start = (tmp_path / "out.ply").read_bytes().index(b"end_header\n") + len(b"end_header\n")
    written = np.frombuffer((tmp_path / "out.ply").read_bytes(), [*rows.dtype.descr, ("label", "<i4")], offset=start)
    for name in rows.dtype.names:
        np.testing.assert_array_equal(written[name], rows[name])
    np.testing.assert_array_equal(written["label"][truth.numpy() > -2], labels)
    assert written["label"].min() >= 0  # faint ones, too

    run("label", tmp_path / "result", path, "-o", tmp_path / "things")
    files = sorted((tmp_path / "things").glob("*.ply"))
    assert [int(file.stem) for file in files] == labels.unique().tolist()
    parts = [np.frombuffer(file.read_bytes().partition(b"end_header\n")[2], rows.dtype) for file in files]
    for index, part in enumerate(parts):
        assert part.tobytes() == rows[written["label"] == index].tobytes()
    with pytest.raises(SystemExit, match="exists already"):
        run("label", tmp_path / "result", path, "-o", tmp_path / "things")
    with pytest.raises(
        SystemExit, match=r"-o: expected a file that ends in \.ply, \.glb, \.las, .* or a folder, got .*a\.obj"
    ):
        run("label", tmp_path / "result", path, "-o", tmp_path / "a.obj")
    run("label", tmp_path / "result", path, "-o", tmp_path / "things", "--overwrite")
    (tmp_path / "things" / "thesis.tex").write_text("precious")
    with pytest.raises(SystemExit, match=r"holds more than \.ply files"):
        run("label", tmp_path / "result", path, "-o", tmp_path / "things", "--overwrite")


@pytest.mark.filterwarnings("ignore:.*fainter")
def test_splats_of_a_room_are_segmented_and_scored(splats, run, tmp_path):
    """From the file of splats to labels in it: by itself, without cameras, a small room has a best IoU of .31."""
    path, _, truth = splats
    run("segment", path, "-o", tmp_path / "result")
    run("label", tmp_path / "result", path, "-o", tmp_path / "out.ply")
    labels = torch.from_numpy(read_vertex_property(tmp_path / "out.ply", "label"))
    target = truth.where(truth > -2, -1)  # faint splats are void
    assert tj.metrics.mean_best_iou(labels, target) > 0.27
    assert tj.metrics.objects_and_parts(labels, target).f > 0.4


#: Two squares of two triangles beside each other, 10 cm apart.
SQUARES = torch.tensor([[x, y, 0.0] for start in (0.0, 1.1) for x in (start, start + 1) for y in (0.0, 1)])
FACES = torch.tensor([[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]])
HEAD = "ply\nformat {} 1.0\ncomment by hand\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
HEAD += "property uchar quality\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"


def squares(path, encoding):
    quality = [7, 0, 1, 2, 3, 4, 5, 6]
    if encoding == "ascii":
        lines = [f"{x:g} {y:g} {z:g} {q}" for (x, y, z), q in zip(SQUARES.tolist(), quality, strict=True)]
        lines += [f"3 {a} {b} {c}" for a, b, c in FACES.tolist()]
        path.write_text(HEAD.format(encoding) + "\n".join(lines) + "\n")
        return path
    order = "<" if "little" in encoding else ">"
    vertices = np.zeros(8, [("p", f"{order}f4", 3), ("q", "u1")])
    vertices["p"], vertices["q"] = SQUARES, quality
    faces = np.zeros(4, [("n", "u1"), ("i", f"{order}i4", 3)])
    faces["n"], faces["i"] = 3, FACES
    path.write_bytes(HEAD.format(encoding).encode() + vertices.tobytes() + faces.tobytes())
    return path


def of_squares():
    return result_of(SQUARES, (torch.arange(8) > 3).long())


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_mesh_has_labels_of_vertices_and_triangles(tmp_path, encoding):
    path = squares(tmp_path / "a.ply", encoding)
    label_file(path, tmp_path / "b.ply", of_squares(), name="thing")
    assert read_vertex_property(tmp_path / "b.ply", "thing").tolist() == [0] * 4 + [1] * 4
    assert read_vertex_property(tmp_path / "b.ply", "quality").tolist() == [7, 0, 1, 2, 3, 4, 5, 6]
    read = read_ply(tmp_path / "b.ply")
    assert torch.equal(read.points, SQUARES)
    assert torch.equal(read.faces, FACES)
    trimesh = pytest.importorskip("trimesh")
    of_face = trimesh.load(tmp_path / "b.ply", process=False).metadata["_ply_raw"]["face"]["data"]
    assert [int(one) for one in np.ravel(of_face["thing"])] == [0, 0, 1, 1]
    assert b"comment by hand" in (tmp_path / "b.ply").read_bytes()
    with pytest.raises(ValueError, match="element vertex has a property thing already"):
        label_file(tmp_path / "b.ply", tmp_path / "c.ply", of_squares(), name="thing")
    assert not (tmp_path / "c.ply").exists()


def test_faces_of_several_lengths_have_no_labels(tmp_path):
    """An edge and a quad: as many triangles as faces."""
    path = squares(tmp_path / "a.ply", "ascii")
    path.write_text(path.read_text().replace("\n3 0 1 2\n3 1 3 2\n", "\n2 0 1\n4 0 1 3 2\n"))
    label_file(path, tmp_path / "b.ply", of_squares())
    assert (tmp_path / "b.ply").read_text().endswith("\n2 0 1\n4 0 1 3 2\n3 4 5 6\n3 5 7 6\n")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_line_ends_and_comments_stay(tmp_path, encoding):
    """As Windows writes them: without the label, the file is the one before. No warning tells of columns that stay."""
    path = squares(tmp_path / "a.ply", encoding)
    head, end, body = path.read_bytes().replace(b"quality", b"warmth").partition(b"end_header\n")
    body = body.replace(b"\n", b" \r\n") + b"\r\n" if encoding == "ascii" else body
    path.write_bytes(head.replace(b"\n", b" \r\n") + end.replace(b"\n", b"\r\n") + body)
    label_file(path, tmp_path / "b.ply", of_squares(), name="thing")
    head, end, after = (tmp_path / "b.ply").read_bytes().partition(b"end_header\r\n")
    assert head.count(b"property int thing\r\n") == 2
    if encoding == "ascii":
        after = re.sub(rb" [01]\r\n", b"\r\n", after)
    else:
        vertices = np.frombuffer(after, np.uint8, 8 * 17).reshape(8, 17)[:, :13].tobytes()
        after = vertices + np.frombuffer(after, np.uint8, 4 * 17, 8 * 17).reshape(4, 17)[:, :13].tobytes()
        part_files(path, tmp_path / "parts", of_squares())
        of_part = (tmp_path / "parts" / "000000.ply").read_bytes().partition(b"end_header\r\n")[0]
        assert of_part.count(b"\n") == of_part.count(b"\r\n") > 5  # Open3D lost the first sign after two kinds
    assert head.replace(b"property int thing\r\n", b"") + end + after == path.read_bytes()


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian"])
def test_parts_of_a_mesh(tmp_path, encoding):
    part_files(squares(tmp_path / "a.ply", encoding), tmp_path / "parts", of_squares())
    for index in range(2):
        part = read_ply(tmp_path / "parts" / f"{index:06d}.ply")
        assert torch.equal(part.points, SQUARES[4 * index : 4 * index + 4])
        assert torch.equal(part.faces, FACES[:2])
    with pytest.raises(ValueError, match="expected a binary file"):
        part_files(squares(tmp_path / "a.ply", "ascii"), tmp_path / "more", of_squares())


@pytest.mark.parametrize("write", [label_file, part_files])
def test_a_file_that_changes_after_it_was_read(tmp_path, monkeypatch, write):
    """Its vertices would get the labels of those that it had before."""
    path, read = squares(tmp_path / "a.ply", "binary_little_endian"), labelled_file._read
    later = squares(tmp_path / "b.ply", "ascii")
    monkeypatch.setattr(labelled_file, "_read", lambda source: (read(source), later.replace(source))[0])
    with pytest.raises(ValueError, match=r"a\.ply: changed while it was read; start again"):
        write(path, tmp_path / "out.ply", of_squares())


@pytest.mark.parametrize("suffix", meshes.SUFFIXES)
def test_meshes_of_other_formats(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    colors = np.array([[255, 0, 0, 255]] * 4 + [[0, 0, 255, 255]] * 4, np.uint8)
    mesh = trimesh.Trimesh(SQUARES.numpy(), FACES.numpy(), vertex_colors=colors, process=False)
    path = tmp_path / f"a{suffix}"
    exported = mesh.export(file_type=suffix[1:])
    if isinstance(exported, dict):  # gltf: several files
        for name, content in exported.items():
            (tmp_path / name).write_bytes(content)
        path = next(tmp_path.glob("*.gltf"))
    else:
        path.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
    read = meshes.read_mesh_file(path)
    assert sorted(read.points.float().tolist()) == sorted(SQUARES.tolist())
    assert len(read.faces) == 4
    if suffix in (".obj", ".glb", ".gltf"):
        assert torch.equal(read.colors[:, 0] == 1, read.points[:, 0] <= 1)
    with pytest.warns(UserWarning, match="triangles are large, so 200000 points are drawn"):
        scene = tj.load_scene(path)
    assert bool(((scene.points[:, 0] <= 1) | (scene.points[:, 0] >= 1.1)).all())
    drawn = result_of(scene.points, (scene.points[:, 0] > 1.05).long())
    label_file(path, tmp_path / "b.ply", drawn)
    again = read_ply(tmp_path / "b.ply")
    assert read_vertex_property(tmp_path / "b.ply", "label").tolist() == (again.points[:, 0] > 1.05).long().tolist()
    part_files(path, tmp_path / "parts", drawn)
    assert [len(read_ply(file).faces) for file in sorted((tmp_path / "parts").iterdir())] == [2, 2]
    label_file(path, tmp_path / "b.glb", drawn)
    scene = trimesh.load_scene(tmp_path / "b.glb")
    assert sorted(scene.geometry) == ["000000", "000001"]
    assert all(len(part.faces) == 2 for part in scene.geometry.values())


def test_a_mesh_of_a_survey_is_as_exact_in_a_glb(tmp_path):
    """Its vertices are float32 there, and stood in steps of a quarter of a metre."""
    places = SQUARES.double() + torch.tensor([500_000.0, 4_000_000.0, 100.0])
    rows = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in places.tolist()]
    faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES.tolist()]
    (tmp_path / "a.obj").write_text("\n".join([*rows, *faces]))
    label_file(tmp_path / "a.obj", tmp_path / "b.GLB", result_of(places, torch.zeros(len(places), dtype=torch.int64)))
    assert (torch.cdist(places, meshes.read_mesh_file(tmp_path / "b.GLB").points.double()).amin(1) < 1e-3).all()


def test_points_on_a_mesh_are_even_and_in_its_colours():
    corners = torch.tensor([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [5, 0, 0], [5, 3, 0], [5, 0, 2]])
    with pytest.warns(UserWarning, match="are drawn on them"):
        points, colors = cloud_alone.points_on(corners, torch.tensor([[0, 1, 2], [3, 4, 5]]), corners / 5, "a")
    of_first = points[:, 0] < 3
    assert float(of_first.double().mean()) == pytest.approx(1 / 4, abs=0.01)  # the areas are 1 and 3
    assert torch.allclose(points[of_first].mean(0), torch.tensor([2 / 3, 1 / 3, 0]).double(), atol=0.01)
    assert torch.allclose(colors, points.float() / 5, atol=1e-5)
    assert bool((points[of_first, 0] / 2 + points[of_first, 1] <= 1 + 1e-9).all())


def test_triangles_give_a_mesh_its_normals(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=5)
    points = torch.from_numpy(np.concatenate([ball.vertices, [[0, 0, 1.1]]]))  # the last has no triangle
    faces, outwards = torch.from_numpy(ball.faces).long(), torch.nn.functional.normalize(points, dim=1)
    normals = cloud_alone.agreed_normals(points, faces)
    assert (normals - outwards).norm(dim=1).max() < 0.05
    assert torch.allclose(cloud_alone.agreed_normals(points, faces.flip(1)), -normals)
    torn = faces.clone()
    torn[::3] = torn[::3].flip(1)
    assert cloud_alone.agreed_normals(points, torn) is None  # no common side
    # A .glb has each vertex at a seam of its texture several times; labels must be those of the same mesh without.
    alone, corners = torch.arange(faces.numel()).view(-1, 3), points[faces].reshape(-1, 3)
    assert torch.allclose(cloud_alone.agreed_normals(corners, alone), normals[faces].reshape(-1, 3), atol=1e-6)
    assert cloud_alone.agreed_normals(corners + (alone // 3).repeat_interleave(3, 0)[:, :1], alone) is None  # loose
    both = torch.cat([faces, faces.flip(1)])  # two sides: what is left of their sum has no direction
    assert cloud_alone.agreed_normals(points, both) is None
    assert cloud_alone.agreed_normals(torch.zeros(3, 3), torch.tensor([[0, 1, 2], [0, 2, 1]])) is None
    mesh = trimesh.Trimesh(points.numpy(), faces.numpy(), process=False)
    (tmp_path / "ball.ply").write_bytes(mesh.export(file_type="ply", vertex_normal=False))
    assert torch.allclose(tj.load_scene(tmp_path / "ball.ply").normals, normals, atol=1e-4)


def test_a_fine_mesh_has_its_vertices():
    line = torch.linspace(0, 1, 60)
    points = torch.stack([*torch.meshgrid(line, line, indexing="ij"), torch.zeros(60, 60)], -1).reshape(-1, 3)
    a = (torch.arange(59)[:, None] * 60 + torch.arange(59)).flatten()
    faces = torch.cat([torch.stack([a, a + 1, a + 60], 1), torch.stack([a + 1, a + 61, a + 60], 1)])
    assert not cloud_alone.has_large_triangles(points, faces)
    assert cloud_alone.has_large_triangles(SQUARES, FACES)


def test_the_nearest_point_decides():
    result = result_of(torch.tensor([[0.0, 0, 0], [1, 0, 0], [5, 0, 0]]), torch.tensor([0, 1, 2]))
    asked = torch.tensor([[0.4, 0, 0], [0.6, 0, 0], [float("nan"), 0, 0], [4.9, 0, 0]])
    assert nearest_labels(result, asked).tolist() == [0, 1, -1, 2]
    with pytest.raises(ValueError, match="is the file of another place"):
        nearest_labels(result, asked + 100)


def test_a_file_that_was_moved_is_told():
    points = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1))
    result = result_of(points, torch.arange(400))
    order = torch.randperm(400)
    assert torch.equal(nearest_labels(result, points[order] + 0.25), order)
    turned = points @ torch.tensor([[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]])
    for moved in (points + torch.tensor([0.0, 0, 2]), turned, turned[1:]):
        with pytest.warns(UserWarning, match="whose points are 1 m apart; was it moved"):
            nearest_labels(result, moved)


def test_a_file_with_nothing_within_reach_is_an_error():
    points = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1))
    for away in (5, torch.nan):
        with pytest.raises(ValueError, match=r"farther than (5|inf) m; is the file of another place"):
            nearest_labels(result_of(points, torch.arange(400)), points + torch.tensor([0.0, 0, away]))


@pytest.mark.parametrize(
    ("text", "labelled"),
    [
        ("x;y;z;n\r\n0,5;0;0;7\r\n1;0;0;\r\n\r\n2;0;0;8\r\n", "x;y;z;n;thing\n0,5;0;0;7;0\n1;0;0;;1\n\n2;0;0;8;2\n"),
        ("# by hand\n0.5\t0\t0\n1\t0\t0 # edge\nnan\t0\t0\n", "# by hand\n0.5\t0\t0\t0\n1\t0\t0\t1\nnan\t0\t0\t-1\n"),
        ("x,y,z\n# lazy xyz\n1,0,0\n2,0,0\n", "x,y,z,thing\n# lazy xyz\n1,0,0,1\n2,0,0,2\n"),
        ("2\n1 0 0 5 9 9 9\n2 0 0 5 9 9 9", "2\n1 0 0 5 9 9 9 1\n2 0 0 5 9 9 9 2\n"),
    ],
)
def test_text_has_one_more_column(tmp_path, text, labelled):
    file, out = tmp_path / "a.csv", tmp_path / "b.csv"
    file.write_bytes(text.encode())
    result = result_of(torch.tensor([[0.5, 0, 0], [1, 0, 0], [2, 0, 0]]), torch.arange(3))
    label_file(file, out, result, name="thing")
    assert out.read_text() == labelled
    with pytest.raises(ValueError, match=r"b\.ply: expected \.xyz or .* for a\.csv"):
        label_file(file, tmp_path / "b.ply", result)
    if "thing" in labelled:
        with pytest.raises(ValueError, match="expected no column thing, got one; choose another --name"):
            label_file(out, file, result, name="thing")


def test_the_command_labels_text(run, tmp_path):
    (tmp_path / "result").mkdir()
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
    segmentation = tj.Segmentation(torch.arange(2), ())
    write_result(tmp_path / "result", tj.Scene(points), segmentation, tj.Config(), "test")
    (tmp_path / "a.xyz").write_text("1 0 0\n0 0 0\n")
    run("label", tmp_path / "result", tmp_path / "a.xyz", "-o", tmp_path / "b.txt")
    assert (tmp_path / "b.txt").read_text() == "1 0 0 1\n0 0 0 0\n"
    with pytest.raises(SystemExit, match=r"a\.xyz: expected a mesh .* give -o parts\.xyz"):
        run("label", tmp_path / "result", tmp_path / "a.xyz", "-o", tmp_path / "parts")


def test_a_cloud_that_was_mirrored_is_told(scene_of):
    """In a room with walls all around, half of its points are within four spacings of others."""
    scene = scene_of(3).scene
    result = result_of(scene.points, torch.zeros(len(scene.points), dtype=torch.int64))
    axis, box = torch.tensor([1.0, 0, 0]), scene.points.amin(0) + scene.points.amax(0)
    with pytest.warns(UserWarning, match="was it moved"):
        nearest_labels(result, scene.points * (1 - 2 * axis) + axis * box)
    nearest_labels(result, scene.points.flip(0) + 1e-4)  # without a warning


def test_a_file_of_more_than_was_segmented_is_told():
    points = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1))
    more = torch.cat([points, points[:300] + 500])
    with pytest.warns(UserWarning, match="300 of 700 vertices are farther than 4 m from the result, whose"):
        found = nearest_labels(result_of(points, torch.arange(400)), more)
    assert torch.equal(found[:400], torch.arange(400))


@pytest.mark.parametrize("suffix", [".glb", ".ply"])
def test_a_mesh_that_was_moved_is_told_once(tmp_path, suffix):
    points = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1))
    write_cloud(tmp_path / "a.ply", points + torch.tensor([0.0, 0, 2]), faces=torch.tensor([[0, 1, 20], [1, 20, 21]]))
    with pytest.warns(UserWarning, match="was it moved") as told:
        label_file(tmp_path / "a.ply", tmp_path / f"b{suffix}", result_of(points, torch.arange(400)))
    assert len(told) == 1


def test_the_property_comes_last_in_any_header(tmp_path):
    """Its values stand at the end of each row."""
    file, out = tmp_path / "a.ply", tmp_path / "b.ply"
    lines = "element vertex 2", "property float x", "obj_info of a scanner", "property float y", " property float z"
    file.write_text("\n".join(["ply", "format ascii 1.0", *lines, "end_header", "0 0 1", "2 3 4", ""]))
    label_file(file, out, result_of(read_ply(file).points, torch.tensor([0, 1])))
    assert torch.equal(read_ply(out).points, read_ply(file).points)
    assert read_vertex_property(out, "label").tolist() == [0, 1]


def test_files_that_cannot_be_labelled(tmp_path, run):
    for name, out in (("a.pcd", "b.ply"), ("a.e57", "b.las"), ("", "b.ply"), ("a.bin", "b")):
        write = label_file if "." in out else part_files
        with pytest.raises(ValueError, match=r"expected a file .*\.ply, \.las, \.laz, .* one by one; .* --format las"):
            write(tmp_path / name, tmp_path / out, of_squares())
    (tmp_path / "a.glb").write_bytes(b"glTF no")
    with pytest.raises(ValueError, match=r"a\.glb: not a whole \.glb mesh"):
        label_file(tmp_path / "a.glb", tmp_path / "b.ply", of_squares())
    path = squares(tmp_path / "a.ply", "ascii")
    path.write_text(path.read_text().replace("\n3 0 1 2", " 3 0 1 2"))
    with pytest.raises(ValueError, match=r"a\.ply"):
        label_file(path, tmp_path / "b.ply", of_squares())
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.glb", "a.ply"]


@pytest.fixture(scope="module")
def survey(tmp_path_factory, run):
    """A survey and its result."""
    folder = tmp_path_factory.mktemp("survey")
    file = write_las(folder / "site.laz", town(3_000, 12))
    run("segment", file, "-o", folder / "result")
    return file, folder / "result"


class TestSurvey:
    """LAS and LAZ keep all that they have: coordinate system, dimensions, records, the order of points."""

    def check(self, source, out, result, name="label"):
        before, after = laspy.read(source), laspy.read(out)
        for dimension in before.point_format.dimension_names:
            assert np.array_equal(before[dimension], after[dimension]), dimension
        assert [one.string for one in after.vlrs.get("WktCoordinateSystemVlr")] == [WKT]
        loaded = tj.load_result(result)
        assert np.array_equal(after[name], loaded.points.numpy())
        sure = "confidence" if name == "label" else f"{name}_confidence"
        assert np.allclose(after[sure], loaded.point_confidence.numpy())

    @pytest.mark.parametrize("suffix", [".las", ".laz"])
    def test_label(self, survey, run, tmp_path, suffix):
        run("label", survey[1], survey[0], "-o", tmp_path / f"out{suffix}", "--name", "thing")
        self.check(survey[0], tmp_path / f"out{suffix}", survey[1], "thing")

    def test_dimensions_that_stay_are_not_told(self, survey, tmp_path):
        write_labelled(survey[0], tmp_path / "own.laz", {"Deviation": np.ones(len(laspy.read(survey[0])), np.float32)})
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            label_file(tmp_path / "own.laz", tmp_path / "out.laz", tj.load_result(survey[1]))
        assert laspy.read(tmp_path / "out.laz")["Deviation"].all()

    @pytest.mark.parametrize("suffix", [".las", ".laz"])
    def test_waveforms_are_found(self, tmp_path, suffix):
        """Their record lies behind the points, and the header tells at which byte."""
        cloud, one = (
            laspy.LasData(laspy.LasHeader(point_format=9, version="1.4")),
            laspy.VLR("LASF_Spec", 65535, "", b"w"),
        )
        cloud.x = cloud.y = cloud.z = np.arange(50.0)
        cloud.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("other", 7, "", bytes(9)), one])
        cloud.write(tmp_path / "a.las")
        data = bytearray((tmp_path / "a.las").read_bytes())
        data[227:235] = (data.rindex(b"LASF_Spec") - 2).to_bytes(8, "little")
        (tmp_path / "a.las").write_bytes(data)
        write_labelled(tmp_path / "a.las", tmp_path / f"b{suffix}", {"label": np.arange(50)})
        made = (tmp_path / f"b{suffix}").read_bytes()
        assert made[int.from_bytes(made[227:235], "little") + 2 :].startswith(b"LASF_Spec")
        cloud.scanner_channel = np.arange(50) % 2  # lazrs packs them wrongly
        cloud.write(tmp_path / "c.las")
        with pytest.raises(ValueError, match="waveforms") if suffix == ".laz" else nullcontext():
            write_labelled(tmp_path / "c.las", tmp_path / f"d{suffix}", {"label": np.arange(50)})

    def test_a_confidence_of_the_survey_stays(self, survey, tmp_path):
        own = np.arange(len(laspy.read(survey[0])), dtype=np.float32)
        write_labelled(survey[0], tmp_path / "own.laz", {"confidence": own})
        label_file(tmp_path / "own.laz", tmp_path / "out.laz", loaded := tj.load_result(survey[1]))
        made = laspy.read(tmp_path / "out.laz")
        assert np.array_equal(made["confidence"], own)
        assert np.allclose(made["label_confidence"], loaded.point_confidence.numpy())

    @pytest.mark.parametrize("suffix", [".las", ".laz"])
    def test_what_a_survey_says_of_its_dimensions_stays(self, tmp_path, suffix):
        """Its values for "none" and its ranges; of new dimensions, whose range laspy tells wrongly, there is none."""
        cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        cloud.xyz = np.eye(3)
        cloud.add_extra_dim(laspy.ExtraBytesParams("height", "f8", "of ground", no_data=[-9999.0]))
        cloud["height"] = [1.5, -9999, 3]
        cloud.write(tmp_path / "a.las")
        write_labelled(tmp_path / "a.las", tmp_path / f"b{suffix}", {"label": np.int32([5, 7, 2])})
        before, after = (
            laspy.read(one).vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs
            for one in (tmp_path / "a.las", tmp_path / f"b{suffix}")
        )
        assert before[0].no_data == -9999
        assert bytes(after[0]) == bytes(before[0])
        assert (after[1].min, after[1].max, after[1].no_data) == (None, None, None)
        assert laspy.read(tmp_path / f"b{suffix}")["label"].tolist() == [5, 7, 2]

    def test_early_versions_and_undocumented_bytes(self, tmp_path):
        """laspy writes no LAS 1.0, and cannot read again what it writes for 8 bytes and more."""
        cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
        cloud.xyz = np.eye(3)
        cloud.write(tmp_path / "a.las")
        data = bytearray((tmp_path / "a.las").read_bytes())
        data[25] = 0
        (tmp_path / "a.las").write_bytes(data)
        write_labelled(tmp_path / "a.las", tmp_path / "b.las", {"label": np.arange(3)})
        assert laspy.read(tmp_path / "b.las")["label"].tolist() == [0, 1, 2]
        data[104] = 0  # the other 14 of 34 bytes have no meaning then
        (tmp_path / "a.las").write_bytes(data)
        with pytest.raises(ValueError, match=r"a\.las: expected at most 7 undocumented bytes .*, got 14"):
            check_dimension(tmp_path / "a.las", "label")

    def test_a_wrong_name_leads_to_the_cloud(self, survey, run, tmp_path):
        with pytest.raises(SystemExit, match=r"sit\.laz does not exist; the cloud of this result is .*points\.ply"):
            run("label", survey[1], "sit.laz", "-o", tmp_path / "out.laz")
        with pytest.raises(SystemExit, match=r"no-result/points\.npz: missing"):
            run("label", tmp_path / "no-result", "sit.laz")

    def test_export(self, survey, run, tmp_path):
        run("export", survey[1], "--format", "las", "-o", tmp_path / "out.laz")
        self.check(survey[0], tmp_path / "out.laz", survey[1])

    def test_of_a_laz_comes_a_laz(self, survey, run, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        run("export", survey[1], "--format", "las")
        self.check(survey[0], tmp_path / "result-las.laz", survey[1])
        with laspy.open(tmp_path / "result-las.laz") as file:
            assert file.header.are_points_compressed

    def test_table(self, survey, run, tmp_path):
        """A line for each segment, with its place in the coordinates of the survey."""
        run("export", survey[1], "--format", "csv", "-o", tmp_path / "out.csv")
        rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
        result = tj.load_result(survey[1])
        assert [int(row["id"]) for row in rows] == list(range(result.num_point_segments))
        for row in rows:
            points = result.scene.points[result.points == int(row["id"])].double()
            low, high = points.amin(0), points.amax(0)
            assert int(row["points"]) == len(points)
            assert float(row["z"]) == pytest.approx(float(low[2] + high[2]) / 2, abs=0.01)
            assert all(low[axis] - 1 < float(row["xyz"[axis]]) < high[axis] + 1 for axis in range(3))
            assert float(row["size_z"]) == pytest.approx(float(high[2] - low[2]), abs=0.01)
            assert float(row["confidence"]) == pytest.approx(float(result.confidence[int(row["id"])]), abs=1e-4)

    def test_footprints(self, survey, run, tmp_path):
        run("export", survey[1], "--format", "geojson", "-o", tmp_path / "out.geojson")
        found = json.loads((tmp_path / "out.geojson").read_text())
        assert found["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::32632"
        result = tj.load_result(survey[1])
        assert [one["properties"]["id"] for one in found["features"]] == list(range(result.num_point_segments))
        for one in found["features"]:
            points = result.scene.points[result.points == one["id"], :2].double()
            assert one["geometry"]["type"] == "Polygon"
            corners = torch.tensor(one["geometry"]["coordinates"], dtype=torch.float64)[0]
            assert torch.equal(corners[0], corners[-1])
            for corner in corners:
                assert (points - corner).norm(dim=1).min() < 0.5
            torch.testing.assert_close(corners.amin(0), points.amin(0), rtol=0, atol=0.5)
            torch.testing.assert_close(corners.amax(0), points.amax(0), rtol=0, atol=0.5)

    def test_the_file_is_gone(self, survey, run, tmp_path):
        moved = survey[0].rename(tmp_path / "moved.laz")
        try:
            with pytest.warns(UserWarning, match=r"site\.laz: not there any more, or changed since; OUT has neither"):
                run("export", survey[1], "--format", "las", "-o", tmp_path / "out.las")
            run("label", survey[1], moved, "-o", tmp_path / "again.laz")
        finally:
            moved.rename(survey[0])
        self.check(survey[0], tmp_path / "again.laz", survey[1])
        assert set(laspy.read(tmp_path / "out.las").point_format.dimension_names) >= {"label", "confidence", "red"}

    def test_another_file_of_its_name(self, survey, run, tmp_path):
        """Labels of a survey do not go into another one, which a record of others may name, too."""
        moved = survey[0].rename(tmp_path / "moved.laz")
        try:
            write_las(survey[0], town(3_000, 13))
            with pytest.warns(UserWarning, match=r"site\.laz: not there any more, or changed since"):
                run("export", survey[1], "--format", "las", "-o", tmp_path / "out.las")
        finally:
            moved.rename(survey[0])
        cloud, result = laspy.read(tmp_path / "out.las"), tj.load_result(survey[1])
        assert "quality" not in set(cloud.point_format.dimension_names)
        assert np.allclose(cloud.xyz, result.scene.points.numpy(), atol=1e-3)

    def test_labels_of_several_names(self, survey, run, tmp_path):
        run("label", survey[1], survey[0], "-o", tmp_path / "once.laz")
        run("label", survey[1], tmp_path / "once.laz", "-o", tmp_path / "twice.laz", "--name", "thing")
        for name in ("label", "thing"):
            self.check(survey[0], tmp_path / "twice.laz", survey[1], name)
        with pytest.raises(SystemExit, match=r"dimension label, got one; .* `torchjoint label \.\.\. --name NAME`"):
            run("label", survey[1], tmp_path / "once.laz", "-o", tmp_path / "third.laz")

    def test_the_survey_stays(self, survey, run):
        before = survey[0].read_bytes()
        for command in (["export", survey[1], "--format", "las", "--overwrite", "-o"], ["show", survey[1], "--static"]):
            with pytest.raises(SystemExit, match=r"expected another path than the input's, .*site\.laz"):
                run(*command, survey[0])
        assert survey[0].read_bytes() == before

    def test_a_survey_that_was_given_by_a_relative_path(self, survey, run, tmp_path, monkeypatch):
        """It was known only in the folder where `segment` had been called, and was replaced from another one."""
        file = Path(shutil.copy(survey[0], tmp_path))
        before = file.read_bytes()
        monkeypatch.chdir(tmp_path)
        run("segment", file.name, "-o", "result")
        monkeypatch.chdir(tmp_path.parent)
        with pytest.raises(SystemExit, match=r"expected another path than the input's, .*site\.laz"):
            run("export", tmp_path / "result", "--format", "las", "--overwrite", "-o", file)
        assert file.read_bytes() == before
        run("export", tmp_path / "result", "--format", "las", "-o", tmp_path / "out.laz")
        self.check(file, tmp_path / "out.laz", tmp_path / "result")

    def test_copc_is_not_written(self, survey, run, tmp_path):
        out, told = tmp_path / "out.copc.laz", rf"got {tmp_path}/out\.copc\.laz: COPC is read but not written"
        for command in (["label", survey[1], survey[0]], ["export", survey[1], "--format", "las"]):
            with pytest.raises(SystemExit, match=told):
                run(*command, "-o", out)
        with pytest.raises(ValueError, match="COPC is read but not written"):
            export_las(out, tj.load_result(survey[1]))
        assert list(tmp_path.iterdir()) == []

    def test_what_cannot_be(self, survey, run, tmp_path):
        with pytest.raises(SystemExit, match=rf"{tmp_path}/out\.ply: expected \.las or \.laz for site\.laz"):
            run("label", survey[1], survey[0], "-o", tmp_path / "out.ply")
        with pytest.raises(SystemExit, match=rf"-o: expected .* \.las or \.laz, got {tmp_path}/out"):
            run("export", survey[1], "--format", "las", "-o", tmp_path / "out")
        with pytest.raises(SystemExit, match=r"site\.laz: expected a mesh .* give -o lab\.laz, or write parts with"):
            run("label", survey[1], survey[0], "-o", tmp_path / "lab")
        with pytest.raises(SystemExit, match="expected no dimension quality, got one; remove it first"):
            run("label", survey[1], survey[0], "-o", tmp_path / "out.laz", "--name", "quality")
        for name in ("x" * 33, "x" * 22):  # the second with _confidence
            with pytest.raises(
                SystemExit, match=r"--name: expected at most 32 bytes for a dimension of site\.laz, got x"
            ):
                run("label", survey[1], survey[0], "-o", tmp_path / "out.laz", "--name", name)
        with pytest.raises(SystemExit, match="expected no dimension x, got one"):
            run("label", survey[1], survey[0], "-o", tmp_path / "out.laz", "--name", "x")
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # laspy's file, as it is deleted
    def test_a_full_disk_is_one_line(self, survey, run, tmp_path):
        """lazrs does not say why it cannot write; files of at most 8 kB stand for the disk."""
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, limits[1]))
        try:
            with pytest.raises(SystemExit, match=r"out\.laz: cannot be written .* is the disk full\?"):
                run("label", survey[1], survey[0], "-o", tmp_path / "out.laz")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert list(tmp_path.iterdir()) == []
