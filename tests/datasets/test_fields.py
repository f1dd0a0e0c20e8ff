"""A walk over all readers of clouds: each optional field goes where the table says, or a warning tells of it.

Each field is present, absent, of another type, NaN, or in one of two parts: nothing is lost in silence.
"""

import base64
import json
import warnings

import numpy as np
import pytest
import torch
from pcd_files import write_pcd
from samples import ros, ros_points

from torchjoint.datasets.files import columns
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ros_messages import cloud_points

RNG = np.random.default_rng(0)
COUNT = 30
XYZ = RNG.uniform(1, 2, (COUNT, 3)).astype("<f4")
RGB = RNG.integers(0, 256, (COUNT, 3)).astype("u1")
RGB[0] = 255
UP = np.tile(np.float32([0, 0.6, 0.8]), (COUNT, 1))
WORDS = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}

#: Where each field goes: the names of each group of the table, its values, and the types that they may have.
FIELDS = [
    *((names, "colors", RGB, ("u1", "u2", "i4", "f4", "f8")) for names in columns.COLORS),
    *((names, "normals", UP, ("f4", "f8")) for names in columns.NORMALS),
]


def ply(path, fields):
    rows = np.rec.fromarrays(list(fields.values()), names=list(fields))
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {COUNT}"]
    lines += [f"property {WORDS[rows.dtype[name].str[1:]]} {name}" for name in fields]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + rows.tobytes())
    return read_cloud_file(path)


def pcd(path, fields):
    return read_cloud_file(write_pcd(path, fields, data="binary"))


def text(path, fields):
    rows = "\n".join(" ".join(map(repr, row)) for row in zip(*(one.tolist() for one in fields.values()), strict=True))
    path.write_text(f"{' '.join(fields)}\n{rows}\n")
    return read_cloud_file(path)


def message(path, fields):
    kinds = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    rows = np.rec.fromarrays(list(fields.values()), names=list(fields))
    made = ros_points.cloud(0.0, np.zeros((COUNT, 3)))
    field, offsets = ros.TYPES["sensor_msgs/msg/PointField"], [rows.dtype.fields[name][1] for name in fields]
    made.fields = [
        field(name, offset, kinds[rows.dtype[name].str[1:]], 1) for name, offset in zip(fields, offsets, strict=True)
    ]
    made.point_step = rows.dtype.itemsize
    made.row_step, made.data = made.point_step * COUNT, np.frombuffer(rows.tobytes(), np.uint8)
    return cloud_points(made, path.name)[0]


READERS = {"a.ply": ply, "a.pcd": pcd, "a.txt": text, "message": message}


def read(path, reader, fields):
    """What a reader makes of x, y, z and these fields, and its warnings."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = reader(path, dict(zip("xyz", XYZ.T, strict=True)) | fields)
    np.testing.assert_array_equal(made.points.float(), XYZ)
    return made, [str(one.message) for one in told]


def expected(goes, values):
    return torch.from_numpy(values / (255 if goes == "colors" else 1)).float()


@pytest.mark.parametrize("file", READERS)
@pytest.mark.parametrize(("names", "goes", "values", "kinds"), FIELDS, ids=["-".join(one[0]) for one in FIELDS])
def test_each_field(tmp_path, file, names, goes, values, kinds):
    path, reader = tmp_path / file, READERS[file]
    made, told = read(path, reader, {})
    assert getattr(made, goes) is None  # absent
    assert not told
    for kind in kinds:  # present, in any type
        fields = {name: column.astype(f"{kind}") for name, column in zip(names, values.T, strict=True)}
        made, told = read(path, reader, fields)
        if (file, goes) == ("message", "normals"):
            assert made.normals is None
            assert told == ["message: normals of scans are not read"]
            continue
        torch.testing.assert_close(getattr(made, goes), expected(goes, values), atol=1e-6, rtol=0)
        assert not told
        if kind[0] == "f":  # NaN at one point
            fields[names[1]][4] = np.nan
            made, told = read(path, reader, fields)
            assert bool(getattr(made, goes).isfinite().all())
            assert f"1 of {COUNT} {goes} are NaN" in told[0]
            for column in fields.values():  # NaN at all points
                column[:] = np.nan
            made, told = read(path, reader, fields)
            assert getattr(made, goes) is None
            assert f"the {goes} are not read" in told[0]
    fields.pop(names[2])  # in part
    made, told = read(path, reader, fields)
    assert getattr(made, goes) is None
    assert f"{names[0]}, {names[1]}: no position, normal or colour" in told[0]


@pytest.mark.parametrize("file", READERS)
def test_other_fields_are_told_or_known(tmp_path, file):
    _, told = read(tmp_path / file, READERS[file], dict.fromkeys(["blue", "temperature", "intensity"], XYZ[:, 0]))
    assert ["blue, temperature: no position, normal or colour" in one for one in told] == [True]


def npz(path, colors, normals):
    np.savez(path, points=XYZ, **({} if colors is None else {"colors": colors}), **normals_as("normals", normals))


def normals_as(name, normals):
    return {} if normals is None else {name: normals}


def las(path, colors, normals):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6 if colors is None else 7, file_version="1.4")
    las.header.scales = [1e-6] * 3
    las.x, las.y, las.z = XYZ.astype(float).T
    las.intensity = np.arange(COUNT)
    if colors is not None:
        las.red, las.green, las.blue = colors.T
    if normals is not None:  # as CloudCompare and PDAL write them
        for name, column in zip(("NormalX", "NormalY", "NormalZ"), normals.T, strict=True):
            las.add_extra_dim(laspy.ExtraBytesParams(name, normals.dtype))
            las[name] = column
    las.write(path)


def e57(path, colors, normals):
    pye57 = pytest.importorskip("pye57")
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), XYZ.astype(float).T, strict=True))
    data["intensity"] = np.linspace(0, 1, COUNT)
    if colors is not None:
        data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), colors.T.copy(), strict=True))
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(data)


def rows_of(*parts):
    return [" ".join(map(repr, row)) for row in np.hstack([one for one in parts if one is not None]).tolist()]


def obj(path, colors, normals):
    pytest.importorskip("trimesh")
    lines = [f"v {row}" for row in rows_of(XYZ, colors)]
    path.write_text("\n".join(lines + ([] if normals is None else [f"vn {row}" for row in rows_of(normals)])) + "\n")


def off(path, colors, normals):
    pytest.importorskip("trimesh")
    head = f"{'' if colors is None else 'C'}{'' if normals is None else 'N'}OFF"
    path.write_text("\n".join([head, f"{COUNT} 0 0", *rows_of(XYZ, normals, colors), ""]))


def gltf(path, colors, normals):
    pytest.importorskip("trimesh")
    given = {"POSITION": XYZ, "COLOR_0": colors, "NORMAL": normals}
    given = {name: values for name, values in given.items() if values is not None}
    types = {"f4": 5126, "u1": 5121, "u2": 5123}
    sizes = [len(values.tobytes()) for values in given.values()]
    data = base64.b64encode(b"".join(values.tobytes() for values in given.values())).decode()
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"mode": 0, "attributes": dict(zip(given, range(3), strict=False))}]}],
        "accessors": [
            {"bufferView": place, "componentType": types[one.dtype.str[1:]], "count": COUNT, "type": "VEC3"}
            for place, one in enumerate(given.values())
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": sum(sizes[:place]), "byteLength": size} for place, size in enumerate(sizes)
        ],
        "buffers": [{"byteLength": sum(sizes), "uri": f"data:application/octet-stream;base64,{data}"}],
    }  # fmt: skip
    path.write_text(json.dumps(tree))


def typed(kind):
    """The colours of a type; "u2 full" has 16 bits, "f8 unit" goes to 1."""
    kind, _, scale = kind.partition(" ")
    return (RGB * {"": 1.0, "full": 257.0, "unit": 1 / 255}[scale]).astype(kind)


#: How a file is written, the types of its colours; those of its normals, if they are read.
FILES = {
    "a.npz": (npz, ("u1", "u2", "u2 full", ">u2", "i8", "f4 unit", "f8", "f4 full"), ("f4", "f8", ">f8")),
    "a.las": (las, ("u2", "u2 full"), ("f4", "f8")),
    "a.laz": (las, ("u2", "u2 full"), ("f4", "f8")),
    "a.e57": (e57, ("u1",), ()),
    "a.obj": (obj, ("f8", "f8 unit", "f8 full"), None),
    "a.off": (off, ("f8", "f8 unit", "f8 full"), None),
    "a.gltf": (gltf, ("u1", "u2 full", "f4 unit"), None),
}


def read_written(path, write, colors=None, normals=None):
    write(path, colors, normals)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = read_cloud_file(path)
    np.testing.assert_allclose(made.points, XYZ, atol=1e-6)
    return made, [str(one.message) for one in told]


@pytest.mark.parametrize("file", FILES)
def test_each_group_of_other_files(tmp_path, file):
    write, colors, normals = FILES[file]
    made, told = read_written(tmp_path / file, write)
    assert (made.colors, made.normals, told) == (None, None, [])
    for kind in colors:
        made, told = read_written(tmp_path / file, write, typed(kind))
        torch.testing.assert_close(made.colors, expected("colors", RGB), atol=1e-6, rtol=0)
        assert made.normals is None
        assert not told
    for kind in normals or ():
        made, told = read_written(tmp_path / file, write, None, UP.astype(kind))
        torch.testing.assert_close(made.normals, expected("normals", UP), atol=1e-6, rtol=0)
        assert made.colors is None
        assert not told
    if normals is None:
        made, told = read_written(tmp_path / file, write, None, UP)
        assert made.normals is None
        assert "normals are not read" in told[0]


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("goes", ["colors", "normals"])
def test_groups_with_nan(tmp_path, file, goes):
    write, colors, normals = FILES[file]
    kinds = [kind for kind in (colors if goes == "colors" else normals or ()) if kind.startswith("f")]
    if not kinds or file == "a.gltf":
        pytest.skip("has no NaN there")
    values = np.array(RGB / 255 if goes == "colors" else UP, kinds[0].split()[0])
    for which, message in (([4], f"1 of {COUNT} {goes} are NaN"), (slice(None), f"the {goes} are not read")):
        values[which] = np.nan
        made, told = read_written(tmp_path / file, write, **{goes: values})
        if which == [4]:
            assert bool(getattr(made, goes).isfinite().all())
        else:
            assert getattr(made, goes) is None
        assert message in told[0]


def test_other_arrays_of_an_archive(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, points=XYZ, labels=np.arange(COUNT), heat=XYZ)
    with pytest.warns(UserWarning, match=r"a\.npz: heat: no position, normal or colour by these names; not used"):
        read_cloud_file(path)
    np.savez(path, points=(1000 * XYZ).astype(int), faces=np.array([[0, 1, 2]], "i4"))
    made = read_cloud_file(path)
    assert (made.points.dtype, made.faces.dtype) == (torch.float64, torch.int64)
    for faces in ([[0, 1, COUNT]], [[0, 1, 2, 3]], [[0.0, 1.0, 2.0]]):
        np.savez(path, points=XYZ, faces=np.array(faces))
        with pytest.raises(ValueError, match=r"a\.npz: .*faces: expected rows of three of the 30 points"):
            read_cloud_file(path)


def test_other_dimensions_of_a_las(tmp_path):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=2, file_version="1.2")
    las.x, las.y, las.z = XYZ.astype(float).T
    las.add_extra_dim(laspy.ExtraBytesParams("heat", "float32"))
    las.write(tmp_path / "a.las")
    with pytest.warns(UserWarning, match="heat: no position"):
        assert read_cloud_file(tmp_path / "a.las").colors is None  # all are 0


def test_images_of_an_e57(tmp_path):
    pye57 = pytest.importorskip("pye57")
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        file.write_scan_raw(dict.fromkeys(("cartesianX", "cartesianY", "cartesianZ"), np.arange(9.0)))
        file.root["images2D"].append(pye57.libe57.StructureNode(file.image_file))
    with pytest.warns(UserWarning, match=r"a\.e57: its 1 images are not read, the points are"):
        read_cloud_file(tmp_path / "a.e57")


def test_other_fields_of_an_e57(tmp_path, monkeypatch):
    e57(tmp_path / "a.e57", None, None)
    kind = pytest.importorskip("pye57").E57
    get_header = kind.get_header

    def with_normals(file, index):
        header = get_header(file, index)
        header.point_fields = [*header.point_fields, "nor:normalX"]
        return header

    monkeypatch.setattr(kind, "get_header", with_normals)
    with pytest.warns(UserWarning, match=r"a\.e57: scan 0: nor:normalX: no position"):
        read_cloud_file(tmp_path / "a.e57")


def test_colours_of_triangles_and_textures_are_told(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 1", "property list uchar int vertex_indices"]
    body = ["0 0 1", "1 0 1", "0 1 1"]
    for more, value in (
        (["uchar red", "uchar green", "uchar blue"], "9 9 9"),
        (["list uchar float texcoord"], "2 0 0"),
    ):
        whole = [*lines, *(f"property {one}" for one in more), "end_header", *body, f"3 0 1 2 {value}", ""]
        (tmp_path / "a.ply").write_text("\n".join(whole))
        with pytest.warns(UserWarning, match=r"a\.ply: .*colours of faces and textures are not read"):
            read_cloud_file(tmp_path / "a.ply")
    stl = bytearray(trimesh.Trimesh(XYZ, [[0, 1, 2]], process=False).export(file_type="stl"))
    stl[-1] = 0x80  # VisCAM
    (tmp_path / "a.stl").write_bytes(stl)
    with pytest.warns(UserWarning, match=r"a\.stl: colours of triangles are not read"):
        read_cloud_file(tmp_path / "a.stl")


@pytest.mark.parametrize(("bad", "share"), [(np.inf, 1), (-np.inf, 1), (1e30, 1), (-9, 1), (-9, 20), (2.5, 1)])
def test_colours_out_of_range(tmp_path, bad, share):
    """They do not change the scale of the others."""
    values = RGB / np.float32(255 if bad == 2.5 else 1)
    values[4 : 4 + share] = bad
    fields = dict(zip("xyz", XYZ.T, strict=True)) | dict(zip(("red", "green", "blue"), values.T, strict=True))
    rest = "they are taken from the nearest points" if share == 1 else "the colors are not read"
    with pytest.warns(UserWarning, match=rf"a\.ply: {share} of 30 colors are NaN or out of range; {rest}"):
        colors = ply(tmp_path / "a.ply", fields).colors
    assert (colors is None) == (share > 1)
    if colors is not None:
        torch.testing.assert_close(colors[5:], expected("colors", RGB)[5:])


def test_splats_in_part(tmp_path):
    dc = {f"f_dc_{place}": XYZ[:, 0] for place in range(3)}
    with pytest.warns(UserWarning, match="f_dc_0, f_dc_1: no position"):
        ply(tmp_path / "a.ply", dict(zip("xyz", XYZ.T, strict=True)) | {name: dc[name] for name in list(dc)[:2]})
    with pytest.warns(UserWarning, match="opacity: no position"):
        ply(tmp_path / "a.ply", dict(zip("xyz", XYZ.T, strict=True)) | {"opacity": XYZ[:, 0]})


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_packed_colours_with_nan(tmp_path, kind):
    """Text has no bits of NaN, so a colour is lost there; it is no dark red."""
    packed = (RGB.astype("u4") << np.array([16, 8, 0], "u4")).sum(1, dtype="u4")
    values = packed.view("f4") if kind == "f4" else packed.astype("f8")
    values[4] = np.nan
    fields = dict(zip("xyz", XYZ.T, strict=True)) | {"rgb": values}
    with pytest.warns(
        UserWarning, match="1 of 30 colors are NaN or out of range; they are taken from the nearest points"
    ):
        read = read_cloud_file(write_pcd(tmp_path / "a.pcd", fields, data="ascii"))
    rest = np.arange(COUNT) != 4
    torch.testing.assert_close(read.colors[rest], expected("colors", RGB)[rest])


@pytest.mark.parametrize("bare", [(), (1,), (0, 1)])
def test_scans_of_an_e57(tmp_path, bare):
    pye57 = pytest.importorskip("pye57")
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        for index in range(2):
            data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), XYZ.astype(float).T, strict=True))
            if index not in bare:
                data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), RGB.T.copy(), strict=True))
            file.write_scan_raw(data)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = read_cloud_file(tmp_path / "a.e57")
    assert len(made.points) == 2 * COUNT
    assert (made.colors is None) == bool(bare)
    assert [
        "1 of 2 scans have no colours, so those of the others are not read: 1" in str(one.message) for one in told
    ] == [True] * (len(bare) == 1)


def e57_of(path, scans):
    """Writes scans, each of fields, and the numbers of its pose and limits, in any order, as other programs do."""
    pye57 = pytest.importorskip("pye57")
    kind = pye57.libe57
    with pye57.E57(str(path), mode="w") as file:
        image = file.image_file
        for fields, pose in scans:
            scan, columns, buffers = kind.StructureNode(image), kind.StructureNode(image), kind.VectorSourceDestBuffer()
            poses = kind.StructureNode(image)
            for part, numbers in pose.items():
                node = kind.StructureNode(image)
                for axis, number in numbers:
                    node.set(axis, kind.FloatNode(image, number))
                (scan if part == "colorLimits" else poses).set(part, node)
            scan.set("pose", poses)
            for name, values in fields.items():
                columns.set(name, kind.FloatNode(image, 0.0, kind.E57_DOUBLE, -1e9, 1e9))
                buffers.append(kind.SourceDestBuffer(image, name, values, COUNT, True, True))
            points = kind.CompressedVectorNode(image, columns, kind.VectorNode(image, True))
            scan.set("points", points)
            file.data3d.append(scan)
            if len(values):
                writer = points.writer(buffers)
                writer.write(COUNT)
                writer.close()
    return path


def e57_fields(values, names):
    return dict(zip(names, np.asarray(values, np.float64).T.copy(), strict=True))


E57_XYZ, E57_RGB = ("cartesianX", "cartesianY", "cartesianZ"), ("colorRed", "colorGreen", "colorBlue")


@pytest.mark.parametrize("full", [1, 255, 65535])
def test_wide_colours_of_an_e57(tmp_path, full):
    fields = e57_fields(XYZ, E57_XYZ) | e57_fields(RGB / 255 * full, E57_RGB)
    none = {name: values[:0] for name, values in fields.items()}
    made = read_cloud_file(e57_of(tmp_path / "a.e57", [(none, {}), (fields, {})]))
    np.testing.assert_allclose(made.colors, RGB / 255, atol=1e-6)


@pytest.mark.parametrize(("full", "limit"), [(65535, 255), (1, 255), (1, 65535)])
def test_an_e57_whose_colours_have_limits_of_another_type(tmp_path, full, limit):
    fields = e57_fields(XYZ, E57_XYZ) | e57_fields(RGB / 255 * full, E57_RGB)
    limits = [(f"{name}{end}", value) for name in E57_RGB for end, value in (("Minimum", 0.0), ("Maximum", limit))]
    made = read_cloud_file(e57_of(tmp_path / "a.e57", [(fields, {"colorLimits": limits})]))
    assert np.abs(made.colors.numpy() - RGB / 255).max() < 1e-3


def test_invalid_colours_of_an_e57(tmp_path):
    fields = e57_fields(XYZ, E57_XYZ) | e57_fields(np.where(np.arange(COUNT)[:, None], RGB, 0), E57_RGB)
    fields["isColorInvalid"] = (np.arange(COUNT) == 0).astype(np.float64)
    with pytest.warns(UserWarning, match=f"1 of {COUNT} colors are NaN"):
        made = read_cloud_file(e57_of(tmp_path / "a.e57", [(fields, {})]))
    assert (made.colors[1:] == made.colors[0]).all(1).any()


def test_poses_of_an_e57_with_numbers_in_another_order(tmp_path):
    pose = {"rotation": [("x", 0.0), ("y", 0.0), ("z", 1.0), ("w", 0.0)]}
    pose["translation"] = [("z", 3.0), ("y", 2.0), ("x", 1.0)]
    made = read_cloud_file(e57_of(tmp_path / "a.e57", [(e57_fields(XYZ, E57_XYZ), pose)]))
    np.testing.assert_allclose(made.points, XYZ * (-1, -1, 1) + (1, 2, 3), atol=1e-6)
    pose["rotation"] = [(axis, 0.0) for axis in "wxyz"]
    with pytest.raises(ValueError, match=r"b\.e57: .*expected unit quaternions"):
        read_cloud_file(e57_of(tmp_path / "b.e57", [(e57_fields(XYZ, E57_XYZ), pose)]))


def test_an_e57_with_fewer_points_than_it_declares(tmp_path, monkeypatch):
    """The rest would be what the memory held before."""
    file = e57_of(tmp_path / "a.e57", [(e57_fields(XYZ, E57_XYZ), {})])
    monkeypatch.setattr("pye57.scan_header.ScanHeader.point_count", COUNT + 1)
    with pytest.raises(ValueError, match=rf"a\.e57: .*expected {COUNT + 1} points, got {COUNT}"):
        read_cloud_file(file)


def test_scans_of_a_recording_of_which_one_has_no_colours(tmp_path):
    import torchjoint as tj

    messages = list(ros_points.messages())
    last = [one for topic, _, one in messages if topic.endswith("points")][-1]
    last.fields = last.fields[:3]
    with pytest.warns(UserWarning, match="1 of 2 scans have no colours, so those of the others; they are left out"):
        assert tj.load_scene(ros.record(tmp_path / "bag", messages), voxel_size=1e-4).colors is None


def test_padding_fields_of_a_message_may_have_one_name():
    field = type("Field", (), {})
    fields = []
    for name, offset, kind in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("_", 12, 2), ("_", 13, 2)):
        fields.append(field())
        vars(fields[-1]).update(name=name, offset=offset, datatype=kind, count=1)
    data = np.zeros((COUNT, 14), np.uint8)
    data[:, :12] = XYZ.view(np.uint8).reshape(COUNT, 12)
    made = type("Message", (), {"fields": fields, "width": COUNT, "height": 1, "point_step": 14})()
    made.row_step, made.is_bigendian, made.data = 14 * COUNT, False, data.reshape(-1)
    np.testing.assert_array_equal(cloud_points(made, "scan")[0].points.float(), XYZ)
    fields[-1].name = "x"
    with pytest.raises(ValueError, match="scan: field 'x' is there twice"):
        cloud_points(made, "scan")
