"""PLY: what others write is read as they read it; what is cut, too long or no number is an error."""

import warnings

import numpy as np
import pytest
import torch
from damage import CLEAR, damage

from torchjoint.datasets.files.ply import read_ply, read_vertex_property, write_cloud

POINTS = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
COLORS = torch.randint(256, (50, 3), generator=torch.Generator().manual_seed(1)) / 255
FACES = torch.randint(50, (20, 3), generator=torch.Generator().manual_seed(2))


def header(encoding, *lines):
    return "\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header", ""]).encode()


VERTEX = ("element vertex 2", "property float x", "property float y", "property float z")


def written(path, data):
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("ascii_", [True, False])
@pytest.mark.parametrize("compare", ["cloud", "mesh"])
def test_it_reads_what_open3d_writes(tmp_path, ascii_, compare):
    open3d = pytest.importorskip("open3d")
    vector = open3d.utility.Vector3dVector
    if compare == "cloud":
        made = open3d.geometry.PointCloud(vector(POINTS.double().numpy()))
        made.colors, made.normals = vector(COLORS.double().numpy()), vector(POINTS.double().numpy())
        open3d.io.write_point_cloud(str(tmp_path / "a.ply"), made, write_ascii=ascii_)
    else:
        made = open3d.geometry.TriangleMesh(
            vector(POINTS.double().numpy()), open3d.utility.Vector3iVector(FACES.numpy())
        )
        made.vertex_colors = vector(COLORS.double().numpy())
        open3d.io.write_triangle_mesh(str(tmp_path / "a.ply"), made, write_ascii=ascii_)
    read = read_ply(tmp_path / "a.ply")
    torch.testing.assert_close(read.points.double(), POINTS.double(), atol=1e-6, rtol=0)
    torch.testing.assert_close(read.colors, COLORS, atol=1e-6, rtol=0)
    if compare == "mesh":
        assert torch.equal(read.faces, FACES)
    else:
        torch.testing.assert_close(read.normals, POINTS, atol=1e-5, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_open3d_reads_what_it_writes(tmp_path, dtype):
    open3d = pytest.importorskip("open3d")
    points = POINTS.to(dtype) + 500_000 * (dtype == torch.float64)
    write_cloud(tmp_path / "a.ply", points, COLORS, torch.arange(50))
    read = open3d.t.io.read_point_cloud(str(tmp_path / "a.ply")).point
    np.testing.assert_array_equal(read.positions.numpy(), points.numpy())
    np.testing.assert_array_equal(read.colors.numpy(), (COLORS * 255).round().numpy())
    assert read.label.numpy().ravel().tolist() == list(range(50))
    assert torch.equal(read_ply(tmp_path / "a.ply").points, points)


@pytest.mark.parametrize(
    ("comment", "told"),
    [("comment units mm", "units mm"), ("obj_info Unit: Millimeters", "Unit: Millimeters"),
     ("comment lengths are in US survey feet", "lengths are in US survey feet"), ("comment units m", None),
     ("comment VCGLIB generated", None), ("comment made in Cmkin 3", None), ("comment units: metres", None)],
)  # fmt: skip
def test_lengths_that_are_no_metres(tmp_path, comment, told):
    path = written(tmp_path / "a.ply", header("ascii", comment, *VERTEX) + b"1 2 3\n4 5 6\n")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_ply(path)
    assert [str(one.message) for one in caught] == ([f"{path}: {told}: taken as metres"] if told else [])


@pytest.mark.parametrize("order", ["little", "big"])
def test_vertices_after_other_elements(tmp_path, order):
    """Triangles and a quad come first; the vertices have doubles, a list, and colours of 16 bits."""
    sign = "<" if order == "little" else ">"
    lines = ("element face 2", "property list uchar int vertex_indices", "property uchar flag")
    lines += ("element vertex 4", "property double x", "property list uchar short near", "property double y")
    lines += ("property double z", *(f"property ushort {name}" for name in ("red", "green", "blue")))
    body = b"".join(
        np.array([(n, c, 7)], dtype=[("n", "u1"), ("c", f"{sign}i4", (n,)), ("f", "u1")]).tobytes()
        for n, c in ((3, (0, 1, 2)), (4, (3, 2, 1, 0)))
    )
    for i in range(4):
        row = [("x", f"{sign}f8"), ("n", "u1"), ("near", f"{sign}i2", (i,)), ("yz", f"{sign}f8", (2,))]
        body += np.array([(i, i, [9] * i, (0.5, -i), (65535, 0, 0))], [*row, ("c", f"{sign}u2", (3,))]).tobytes()
    data = header(f"binary_{order}_endian", *lines) + body
    with pytest.warns(UserWarning, match=r"a\.ply: near: no position, normal or colour by these names; not used"):
        read = read_ply(written(tmp_path / "a.ply", data))
    assert read.points.tolist() == [[i, 0.5, -i] for i in range(4)]
    assert read.points.dtype == torch.float64
    assert read.colors.tolist() == [[1, 0, 0]] * 4
    assert read.faces.tolist() == [[0, 1, 2], [3, 2, 1], [3, 1, 0]]
    for cut in range(1, len(body)):  # Open3D reads 12 bytes less as a vertex at 1.7e-309
        with pytest.raises(ValueError, match=r"a\.ply: truncated"):
            read_ply(written(tmp_path / "a.ply", data[:-cut]))
    with pytest.raises(ValueError, match="got 3 more bytes"):
        read_ply(written(tmp_path / "a.ply", data + b"abc"))


def test_packed_splats_are_told(tmp_path):
    names = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    lines = ("element vertex 1", *(f"property uint {name}" for name in names))
    with pytest.raises(ValueError, match=r"a\.ply: expected splats with x, y and z, got packed ones of SuperSplat"):
        read_ply(written(tmp_path / "a.ply", header("binary_little_endian", *lines) + bytes(16)))


def test_faces_by_another_name_are_told(tmp_path):
    lines = (*VERTEX, "element face 1", "property list uchar int corners")
    with pytest.warns(UserWarning, match=r"a\.ply: element face: no list vertex_indices; triangles are not read"):
        assert read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + b"1 2 3\n4 5 6\n3 0 1 1\n")).faces is None


def test_ascii_with_lists(tmp_path):
    lines = (*VERTEX, "element face 2", "property list uchar int vertex_index")
    data = header("ascii", *lines) + b"1 2 3\n4 5 6\n3 0 1 1\n4 0 1 0 1\n"
    read = read_ply(written(tmp_path / "a.ply", data))
    assert read.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read.faces.tolist() == [[0, 1, 1], [0, 1, 0], [0, 0, 1]]


def test_ascii_vertices_after_lists_of_any_length(tmp_path):
    """Lists of one length are read by columns, others line by line; what comes behind is where they end."""
    vertex = (*VERTEX[:1], *(line.replace("float", "double") for line in VERTEX[1:]))
    for lists in (b"3 0 1 1 7\n3 1 1 0 8\n", b"3 0 1 1 7\n 2\t1 0 8 \n"):
        lines = ("element face 2", "property list uchar int vertex_index", "property short flag", *vertex)
        read = read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + lists + b"1 2 3.1\n4 5 6e-3\n \n"))
        assert read.points.tolist() == [[1, 2, 3.1], [4, 5, 6e-3]]
        assert read.faces[0].tolist() == [0, 1, 1]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"3 0 1 1\n3 0 1\n", "element face: expected 3 numbers of vertex_index in b'3 0 1'"),
        (b"3 0 1 1\n2 0 1 1\n", "element face: expected 3 numbers in b'2 0 1 1'"),
        (b"3 0 1 1\n3 0 x 1\n", "could not convert string to float: b'x'"),
        (b"3 0 1 1\n3 0 1.5 1\n", "property vertex_index: expected integers of 32 bits"),
        (b"3 0 1 1\n300 0 1 1\n", "property vertex_index: expected integers of 8 bits"),
        (b"3 0 1 1\n3 0 1e99 1\n", "property vertex_index: expected integers of 32 bits"),
        (b"3 0 1 1\n3 0 nan 1\n", "property vertex_index: expected integers of 32 bits"),
        (b"3 0 1 1\n", "expected 4 lines"),
    ],
)
def test_ascii_lists_that_are_damaged(tmp_path, body, message):
    lines = (*VERTEX, "element face 2", "property list uchar int vertex_index")
    with pytest.raises(ValueError, match=message):
        read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + b"1 2 3\n4 5 6\n" + body))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"1 2 3\n4 5 6", "expected a line break after the last number"),  # perhaps 6.25, cut
        (b"1 2 3\n\n4 5 6\n", "expected 2 lines"),
        (b"\n1 2 3\n", "expected 3 numbers in row 0, got 0 words"),
        (b"1 2 3\n4 5\n", "expected 3 numbers in row 1, got 2 words"),
        (b"1 2 3 4\n5 6\n", "expected 3 numbers in row 0, got 4 words"),
        (b"1 2 3\n4 5 x\n", "a word is no number"),
        (b"1 2 3\n4 5 6-7\n", "a word is no number|7 numbers in 6 words"),
        (b"1 2 3\n4_0 5 6\n", "a word is no number"),
        (b"1 2 3\n", "truncated"),
    ],
)
def test_ascii_that_is_damaged(tmp_path, body, message):
    with pytest.raises(ValueError, match=message):
        read_ply(written(tmp_path / "a.ply", header("ascii", *VERTEX) + body))


def test_what_is_written_is_read(tmp_path):
    """And of an error the row is told."""
    for count in (1, 3, 7, 9):
        lines = (
            f"element vertex {count}",
            *VERTEX[1:],
            *(f"property uchar {name}" for name in ("red", "green", "blue")),
        )
        body = b"".join(b"%d 0.5 -1e-3 255 %d 0\n" % (i, i) for i in range(count))
        read = read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + body))
        write_cloud(tmp_path / "b.ply", read.points, read.colors)
        again = read_ply(tmp_path / "b.ply")
        assert torch.equal(read.points, torch.tensor([[i, 0.5, -1e-3] for i in range(count)]))
        assert torch.equal(read.colors, torch.tensor([[1, i / 255, 0] for i in range(count)]))
        assert torch.equal(again.points, read.points)
        assert torch.equal(again.colors, read.colors)
    assert read_vertex_property(tmp_path / "b.ply", "green").tolist() == list(range(9))
    with pytest.raises(ValueError, match="element vertex: expected 6 numbers in row 7, got 1 words"):
        read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + body.replace(b"7 0.5 -1e-3 255 7 0", b"7")))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((*VERTEX[:3], "property real z"), "header: 'property real z' is not understood"),
        ((*VERTEX, "property float x"), "property x of element vertex is there twice"),
        ((*VERTEX[:3], "property float w"), "z missing"),
        (("element vertex 999999999999", *VERTEX[1:]), "truncated"),
        ((*VERTEX, "format ascii 1.0"), "'format ascii 1.0' is not understood"),
        ((*VERTEX, "element face -1", "property list int int vertex_index"), "expected a count"),
    ],
)
def test_headers_that_are_wrong(tmp_path, lines, message):
    with pytest.raises(ValueError, match=message):
        read_ply(written(tmp_path / "a.ply", header("binary_little_endian", *lines) + bytes(24)))


def test_faces_of_vertices_that_are_not_there(tmp_path):
    lines = (*VERTEX, "element face 1", "property list uchar int vertex_index")
    with pytest.raises(ValueError, match=r"expected vertices in \[0, 2\), got 0 to 2"):
        read_ply(written(tmp_path / "a.ply", header("ascii", *lines) + b"1 2 3\n4 5 6\n3 0 1 2\n"))


@pytest.mark.filterwarnings("ignore:.*no position, normal or colour")
def test_damage_is_an_error_or_leaves_the_size(tmp_path):
    """A flipped bit of a coordinate cannot be told; a wrong number of points can."""
    write_cloud(tmp_path / "a.ply", POINTS, COLORS, torch.arange(50))
    whole, rng = (tmp_path / "a.ply").read_bytes(), np.random.default_rng(0)
    for _ in range(300):
        spoiled = damage(whole, rng)
        try:
            read = read_ply(written(tmp_path / "b.ply", spoiled))
        except CLEAR as error:
            assert "b.ply" in str(error)  # noqa: PT017
        else:
            assert len(spoiled) == len(whole)
            assert len(read.points) == 50


def test_gaussian_splats_have_colours_and_no_normals(tmp_path):
    names = ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0", "opacity", "scale_0", "rot_0")
    rows = np.zeros((3, len(names)), dtype="<f4")
    rows[:, :3] = np.arange(9).reshape(3, 3)
    rows[:, 6:9] = [[0, 1, -1], [10, -10, 0], [0.5, 0.5, 0.5]]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 3",
        *(f"property float {name}" for name in names),
    ]
    path = tmp_path / "splats.ply"
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + rows.tobytes())
    found = read_ply(path)
    assert found.normals is None
    # RGB = 1/2 + Y_0 f, with the constant spherical harmonic Y_0 = 1 / (2 sqrt(pi)) = 0.28209479.
    expected = torch.tensor([[0.5, 0.78209479, 0.21790521], [1, 0, 0.5], [0.641047395] * 3])
    assert torch.allclose(found.colors, expected, atol=1e-6)
    rows[1, 5] = 1
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + rows.tobytes())
    assert torch.equal(read_ply(path).normals, torch.from_numpy(rows[:, 3:6]))
