"""Meshes of several parts, and rows of their files: no colour, point or row is lost without a word."""

import base64
import json

import numpy as np
import pytest
import torch
from PIL import Image

import torchjoint as tj
from torchjoint.datasets.files import meshes
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import read_ply, read_vertex_property
from torchjoint.results.labelled_file import label_file

trimesh = pytest.importorskip("trimesh")

RED, BLUE = (200, 30, 30), (30, 30, 200)
SIDE = 12
U, V = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE)))
PLANE = np.c_[U, V, 0 * U]
INDEX = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
A, B, C, D = (corner.ravel() for corner in (INDEX[:-1, :-1], INDEX[:-1, 1:], INDEX[1:, 1:], INDEX[1:, :-1]))
FACES = np.r_[np.c_[A, B, C], np.c_[A, C, D]]


def part(kind, color, shift=0.0):
    places, visual = PLANE + np.array([shift, 0, 0]), trimesh.visual
    if kind == "points":
        return trimesh.PointCloud(places, colors=np.tile([*color, 255], (len(places), 1)))
    if kind == "bare":
        return trimesh.Trimesh(places, FACES, process=False)
    if kind == "colored":
        return trimesh.Trimesh(places, FACES, vertex_colors=np.tile([*color, 255], (len(places), 1)), process=False)
    image = Image.new("RGB", (4, 4), color) if kind == "textured" else None
    factor = [*(255 * (np.array(color) / 255) ** 2.2).round().astype(int).tolist(), 255] if kind == "plain" else None
    material = visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=factor, metallicFactor=0.0)
    visuals = visual.TextureVisuals(uv=np.c_[U, V], material=material)
    return trimesh.Trimesh(places, FACES, visual=visuals, process=False)


def glb(path, *parts):
    scene = trimesh.Scene()
    for index, one in enumerate(parts):
        scene.add_geometry(one, node_name=f"n{index}", geom_name=f"g{index}")
    scene.export(path)
    return path


@pytest.mark.parametrize("first", ["textured", "colored", "plain", "points"])
@pytest.mark.parametrize("second", ["textured", "colored", "points"])
def test_parts_of_any_two_kinds(tmp_path, first, second):
    read = read_cloud_file(glb(tmp_path / "a.glb", part(first, RED), part(second, BLUE, 5.0)))
    assert len(read.points) == 2 * SIDE**2
    expected = np.where(read.points[:, :1] > 3, BLUE, RED) / 255
    np.testing.assert_allclose(read.colors, expected, atol=0.04)  # 2.2 is near sRGB's curve


def test_a_part_without_colours_is_told(tmp_path):
    path = glb(tmp_path / "a.glb", part("colored", RED), part("bare", BLUE, 5.0))
    with pytest.warns(
        UserWarning, match=r"a\.glb: 1 of 2 parts have no colours, so those of the others are not read: g1"
    ):
        read = read_cloud_file(path)
    assert read.colors is None
    assert len(read.points) == 2 * SIDE**2


def test_points_beside_large_triangles_are_kept(tmp_path):
    large = trimesh.Trimesh(
        [[0, 0, 5.0], [1, 0, 5], [0, 1, 5]], [[0, 1, 2]], vertex_colors=[[*RED, 255]] * 3, process=False
    )
    path = glb(tmp_path / "a.glb", part("points", BLUE), large)
    with pytest.warns(UserWarning, match="triangles are large"):
        scene = tj.load_scene(path)
    assert int((scene.points[:, 2] == 0).sum()) == SIDE**2
    assert scene.up.tolist() == [0, 1, 0]  # as glTF says


def obj(path, *, colors=None, seams=False, faces=True, more=(), name="a"):
    rows = np.r_[PLANE, np.array(more).reshape(-1, 3)]
    tail = "" if colors is None else " " + " ".join(map(str, colors))
    lines = [f"v {x} {y} {z}{tail}" for x, y, z in rows.tolist()]
    if seams:
        lines = ["mtllib m.mtl", "usemtl a", *lines, *2 * [f"vt {u} {v}" for u, v in zip(U, V, strict=True)]]
    for number, corners in enumerate(FACES.tolist() if faces else []):
        twice = number % 2 * SIDE**2
        lines.append("f " + " ".join(f"{c + 1}/{c + 1 + twice}" if seams else f"{c + 1}" for c in corners))
    (path / "t.png").parent.mkdir(exist_ok=True)
    Image.new("RGB", (4, 4), RED).save(path / "t.png")
    (path / "m.mtl").write_text("newmtl a\nmap_Kd t.png\n")
    (path / f"{name}.obj").write_bytes(b"\xef\xbb\xbf" + "\n".join([*lines, ""]).encode())
    return path / f"{name}.obj"


@pytest.mark.parametrize(
    "how",
    [{"colors": RED}, {"colors": tuple(np.array(RED) / 255)}, {"colors": RED, "faces": False}, {"seams": True},
     {"colors": RED, "more": [[9, 9, 9], [0, 0, 0]]}, {"seams": True, "more": [[9, 9, 9]]}],
)  # fmt: skip
def test_rows_of_an_obj(tmp_path, how):
    """One for each `v` line, in their order; and labels of them."""
    path = obj(tmp_path, **how)
    read = read_cloud_file(path)
    rows = np.r_[PLANE, np.array(how.get("more", ())).reshape(-1, 3)]
    np.testing.assert_array_equal(read.points, rows)
    np.testing.assert_allclose(read.colors, np.tile(RED, (len(rows), 1)) / 255, atol=0.01)
    if how.get("faces", True):
        corners = [sorted(map(tuple, read.points[face].tolist())) for face in read.faces]
        assert sorted(corners) == sorted(sorted(map(tuple, PLANE[face].tolist())) for face in FACES)
    scene = tj.Scene(read.points)
    result = tj.Result.of(tj.Segmentation((scene.points[:, 0] > 0.5).long(), ()), scene)
    label_file(path, tmp_path / "out.ply", result)
    assert read_vertex_property(tmp_path / "out.ply", "label").tolist() == (rows[:, 0] > 0.5).astype(int).tolist()


@pytest.mark.parametrize(
    ("head", "before", "counts"),
    [("COFF", "", "\n"), ("CNOFF", "0 0 1 ", "\n"), ("NCOFF", "0 0 1 ", "\n"), ("COFF", "", " "), ("OFF", "", "\n")],
)
def test_colours_of_an_off(tmp_path, head, before, counts):
    lines = [f"{x} {y} {z} {before}200 30 30 255" for x, y, z in PLANE.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in FACES.tolist()]
    path = tmp_path / "a.off"
    path.write_text(f"{head}{counts}{len(PLANE)} {len(FACES)} 0\n" + "\n".join(lines) + "\n")
    red = np.tile(RED, (len(PLANE), 1)) / 255
    read = read_cloud_file(path)
    np.testing.assert_array_equal(read.points, PLANE)
    np.testing.assert_allclose(read.colors, red, atol=1e-6)
    if head == "NCOFF":  # MeshLab has the colours first
        path.write_text(path.read_text().replace("0 0 1 200 30 30 255", "200 30 30 255 0 0 1"))
        np.testing.assert_allclose(read_cloud_file(path).colors, red, atol=1e-6)
    path.write_text(path.read_text().rstrip() + " 255 0 0\n")
    with pytest.warns(UserWarning, match=r"a\.off: colours of faces, and of some vertices"):
        read_cloud_file(path)
    path.write_text("OFF\n3 0 0\n0 0 0 255 0 0\n1 0 0\n0 1 0 0 255 0\n")
    with pytest.warns(UserWarning, match=r"a\.off: colours of faces, and of some vertices"):
        assert read_cloud_file(path).colors is None


@pytest.mark.parametrize("head", [b"4OFF", b"OFF BINARY", b"3 1 0"])
def test_other_kinds_of_off(tmp_path, head):
    (tmp_path / "a.off").write_bytes(head + b"\n3 0 0\n0 0 0 2\n1 0 0 2\n0 1 0 2\n")
    with pytest.raises(ValueError, match=r"a\.off: expected text that begins with OFF, COFF, NOFF or STOFF, got"):
        read_cloud_file(tmp_path / "a.off")


def test_tabs_of_an_obj(tmp_path):
    path = obj(tmp_path)
    path.write_text(path.read_text().replace(" ", "\t"))
    assert len(read_cloud_file(path).faces) == len(FACES)


def test_an_obj_of_an_old_mac(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\r")
    assert read_cloud_file(tmp_path / "a.obj").faces.tolist() == [[0, 1, 2]]


def test_more_numbers_than_a_colour_has(tmp_path):
    """Those of `x y z w r g b` were the colours w r g."""
    (tmp_path / "a.obj").write_text("".join(f"v {at} 0 0 1 .2 .4 .6\n" for at in range(3)))
    with pytest.warns(UserWarning, match=r"a\.obj: 7 numbers in a row: colours are read of x y z r g b only"):
        cloud = read_cloud_file(tmp_path / "a.obj")
    assert (cloud.points[:, 0].tolist(), cloud.colors) == ([0, 1, 2], None)


@pytest.mark.parametrize("face", ["0 1 2", "1 2 0", "1/1 0/1 2/1"])
def test_faces_that_count_from_0(tmp_path, face):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1 2 3\nf {face}\n")
    with pytest.raises(
        ValueError, match=r"a\.obj: not a whole \.obj mesh: .*expected faces of vertices from 1 on, got 0"
    ):
        read_cloud_file(tmp_path / "a.obj")


def test_places_in_a_texture_are_no_colours(tmp_path):
    """Without a material there is none; trimesh has a grey one for it."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    assert read_cloud_file(tmp_path / "a.obj").colors is None


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n"
QUAD = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n"


@pytest.mark.parametrize(
    ("text", "faces"),
    [
        (f"{QUAD}f -4 -3 -2\n", [[0, 1, 2]]),
        (f"{QUAD}f 1 2 3\n  f 2 4 3\n", [[0, 1, 2], [1, 3, 2]]),  # it was left out
        (f"{QUAD}f 1 2 \\\n 3\n", [[0, 1, 2]]),
        (f"{QUAD}vn 0 0 1 # up\nf 1 2 3 # first\n", [[0, 1, 2]]),
        (f"{QUAD}f -4 -3 -2\n{QUAD}f -4 -3 -2\n", "behind all vertices, where they count back"),
        (f"{QUAD}f 1 2 3\nf 2 4\n", "at least three vertices, got 'f 2 4'"),
        (f"{OFF}5 0 1 2 3 0\n3 1 2 3", [[0, 1, 2], [0, 2, 3], [0, 3, 0], [1, 2, 3]]),
        (f"{OFF}2 0 1\n4 0 1 2 3", [[0, 1, 2], [0, 2, 3]]),
        (f"{OFF}3 0 1 2\n4 0 1 2", "not a whole .off mesh"),
        (f"{OFF}3 0 1 2\n3 1 2 3\n3 0 1 2", "expected 2 rows of faces, as its head tells, got 3"),
        (f"{OFF}3 0 1 2", "expected 2 rows of faces, as its head tells, got 1"),
        (f"{OFF[:-6]}3 0 1 2\n3 1 2 0", "expected 2 rows of faces, as its head tells, got 1"),
    ],
)
def test_faces_of_obj_and_off(tmp_path, text, faces):
    path = tmp_path / f"a.{'off' if text.startswith('OFF') else 'obj'}"
    path.write_text(text)
    if isinstance(faces, str):
        with pytest.raises(ValueError, match=faces):
            read_cloud_file(path)
    else:
        assert read_cloud_file(path).faces.tolist() == faces


@pytest.mark.parametrize("kind", ["white", "plain", "textured"])
def test_vertices_and_a_material_have_colours(tmp_path, kind):
    """As Blender writes them: the colour is the product."""
    one = part("textured" if kind == "textured" else "plain", (255, 255, 255) if kind == "white" else (255, 255, 0))
    one.visual.vertex_attributes["color"] = np.tile(np.uint8([*RED, 255]), (len(PLANE), 1))
    read = read_cloud_file(glb(tmp_path / "a.glb", one))
    product = np.array(RED) / 255 * (1, 1, kind == "white")
    np.testing.assert_allclose(read.colors, np.tile(product, (len(PLANE), 1)), atol=1e-2)


def test_lines_of_a_glb_are_told(tmp_path):
    test_kinds_that_are_not_read(lambda tree: tree["meshes"][0]["primitives"][0].update(mode=6), "fans", tmp_path)
    path = tmp_path / "a.gltf"
    tree = json.loads(path.read_text())
    tree["scenes"].pop()
    tree["meshes"][0]["primitives"][0]["mode"] = 3
    tree["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}})
    path.write_text(json.dumps(tree))
    with pytest.warns(UserWarning, match=r"a\.gltf: lines are not read"):
        assert len(read_cloud_file(path).points) == 9


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_strips_of_a_ply(tmp_path, encoding):
    """Each corner of a strip turns the last two; -1 begins a new one."""
    strips = [np.c_[INDEX[row], INDEX[row + 1]].ravel() for row in range(SIDE - 1)]
    corners = np.concatenate([np.r_[strip, -1] for strip in strips]).astype("<i4")
    lines = ["ply", f"format {encoding} 1.0", f"element vertex {len(PLANE)}", *(f"property double {a}" for a in "xyz")]
    lines += ["element tristrips 1", "property list int int vertex_indices", "end_header", ""]
    if encoding == "ascii":
        body = "\n".join(" ".join(map(repr, row)) for row in PLANE.tolist())
        body = f"{body}\n{len(corners)} {' '.join(map(str, corners))}\n".encode()
    else:
        body = PLANE.astype("<f8").tobytes() + np.array([len(corners)], "<i4").tobytes() + corners.tobytes()
    (tmp_path / "a.ply").write_bytes("\n".join(lines).encode() + body)
    read = read_ply(tmp_path / "a.ply")
    assert len(read.faces) == 2 * (SIDE - 1) ** 2
    first, second, third = read.points[read.faces].unbind(1)
    normals = torch.linalg.cross(second - first, third - first)
    assert bool((normals[:, 2] < 0).all()) or bool((normals[:, 2] > 0).all())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "extension KHR_draco"),
        (lambda tree: tree.update(extensionsRequired=["EXT_meshopt_compression"]), "extension EXT_meshopt"),
        (lambda tree: tree["accessors"][0].update(sparse={"count": 1}), "sparse accessors"),
        (lambda tree: tree["accessors"][0].pop("bufferView"), "accessors without data"),
        (lambda tree: tree["accessors"][0].update(type="VEC4", count=6), "positions that are no triples"),
        (lambda tree: tree["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}), "many instances of a node"),
        (lambda tree: tree["accessors"][0].update(normalized=True), "normalized positions"),
        (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=6), "fans of triangles"),
        (lambda tree: tree["nodes"][0].update(skin=0), "skins"),
        (lambda tree: tree["meshes"][0].update(weights=[0, 0.5]), "weights of morph targets"),
    ],
)
def test_kinds_that_are_not_read(change, told, tmp_path):
    """The library would leave them out, or take them for zeros, in silence."""
    points = base64.b64encode(np.random.default_rng(0).random((9, 3), np.float32).tobytes()).decode()
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}, {"nodes": []}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 9, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 108}],
        "buffers": [{"byteLength": 108, "uri": f"data:application/octet-stream;base64,{points}"}],
        "extensionsRequired": ["KHR_materials_unlit"],
    }  # fmt: skip
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(tree))
    with pytest.warns(UserWarning, match=r"a\.gltf: of 2 scenes only one is read"):
        assert len(meshes.read_mesh_file(path).points) == 9
    change(tree)
    path.write_text(json.dumps(tree))
    with pytest.raises(ValueError, match=f"expected a plain mesh, got {told}"):
        meshes.read_mesh_file(path)


def colored_gltf(path, colors, kind, *, has_faces, material=None):
    """A triangle or three points, two at one place; `kind` is glTF's number of the colours' type."""
    raw = PLANE[[0, 1, 1]].astype("<f4").tobytes() + colors.tobytes()
    views = [{"buffer": 0, "byteOffset": start, "byteLength": size} for start, size in ((0, 36), (36, colors.nbytes))]
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": 4 * has_faces}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                      {"bufferView": 1, "componentType": kind, "count": 3, "type": "VEC4", "normalized": True}],
        "bufferViews": views,
        "buffers": [{"byteLength": len(raw), "uri": f"data:;base64,{base64.b64encode(raw).decode()}"}],
    }  # fmt: skip
    if material is not None:
        tree["materials"], tree["meshes"][0]["primitives"][0]["material"] = [{"pbrMetallicRoughness": material}], 0
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.parametrize(
    "how",
    [{"has_faces": False}, {"has_faces": True}, {"has_faces": True, "material": {"baseColorFactor": [1, 1, 1, 1]}}],
)
@pytest.mark.parametrize("color", [(40000, 20000, 600), (250, 130, 0)])
def test_colours_of_16_bits_in_a_gltf(how, color, tmp_path):
    """As Blender writes them; the library keeps the low bytes. Those of a dark part are no 8 bits."""
    colors = np.tile(np.array([*color, 65535], "<u2"), (3, 1))
    read = read_cloud_file(colored_gltf(tmp_path / "a.gltf", colors, 5123, **how))
    np.testing.assert_allclose(read.colors, np.tile(np.array(color) / 65535, (3, 1)), atol=3e-3)


def test_colours_that_the_library_reads_wrongly(tmp_path):
    signed = colored_gltf(tmp_path / "a.gltf", np.full((3, 4), 100, "i1"), 5120, has_faces=False)
    with pytest.raises(ValueError, match="got odd integers as colours"):
        read_cloud_file(signed)
    bright = colored_gltf(
        tmp_path / "b.gltf", np.full((3, 4), 1.5, "<f4"), 5126, has_faces=True, material={"baseColorFactor": [1] * 4}
    )
    assert bool((read_cloud_file(bright).colors == 1).all())  # it was taken modulo 256
    still, turned = ({"KHR_texture_transform": {"scale": [1, up], "offset": [0, 0]}} for up in (1, -1))
    texture = {"index": 0, "texCoord": 0}
    for change, is_moved in (({"texCoord": 1}, True), ({"extensions": turned}, True), ({"extensions": still}, False)):
        assert meshes._is_moved({"pbrMetallicRoughness": {"baseColorTexture": texture | change}}) == is_moved
    moved = {"baseColorTexture": {"index": 0, "texCoord": 1}}
    with pytest.raises(ValueError, match="got textures that are moved"):
        read_cloud_file(colored_gltf(tmp_path / "c.gltf", np.ones((3, 4), "<f4"), 5126, has_faces=True, material=moved))


def test_a_texture_and_a_factor_of_a_glb(tmp_path):
    """The colour is the product of both."""
    one = part("textured", (255, 100, 255))
    one.visual.material.baseColorFactor = [0, 255, 255, 255]
    read = read_cloud_file(glb(tmp_path / "a.glb", one))
    np.testing.assert_allclose(read.colors, np.tile([0, 100 / 255, 1], (len(PLANE), 1)), atol=1e-6)


def test_vertices_of_an_obj_at_one_place(tmp_path):
    """Two walls that touch, each with corners of its own: a triangle has those of its own wall."""
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    (tmp_path / "a.obj").write_text(f"{square}{square}f 1 2 3 4\nf 5/1 6/2 7/3 \\\n 8/4\nf -4 -3 -2\n")
    faces = read_cloud_file(tmp_path / "a.obj").faces
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [4, 5, 6]]


def test_materials_of_a_second_library_are_told(tmp_path):
    path = obj(tmp_path, seams=True)
    path.write_bytes(path.read_bytes().replace(b"mtllib m.mtl", b"mtllib other.mtl\nmtllib m.mtl"))
    (tmp_path / "other.mtl").write_text("newmtl other\nKd 1 0 0\n")
    with pytest.warns(UserWarning, match="no colours are read: its materials are not in its first mtllib"):
        assert read_cloud_file(path).colors is None


def test_a_programs_own_use_of_the_library_stays(tmp_path):
    Image.new("RGB", (4, 4), RED).save(tmp_path / "a.gif")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.gif\n")
    bare = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    (tmp_path / "bare.obj").write_text(bare)
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{bare.replace('f ', 'usemtl a' + chr(10) + 'f ')}")
    read_cloud_file(tmp_path / "bare.obj")
    assert trimesh.load(tmp_path / "a.obj").visual.material.image.size == (4, 4)
    assert trimesh.load(tmp_path / "bare.obj").visual.kind == "texture"
    assert trimesh.visual.color.to_rgba(np.array([[255, 0, 0]], np.uint16)).tolist() == [[255, 0, 0, 255]]
