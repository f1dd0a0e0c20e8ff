"""A walk over all readers of clouds: each optional field goes where the table says, or a warning tells of it.

Each field is present, absent, of another type, NaN, or in one of two parts: nothing is lost in silence.
"""

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
    if (file, goes) == ("message", "normals"):
        pytest.skip("scans are merged without normals")
    path, reader = tmp_path / file, READERS[file]
    made, told = read(path, reader, {})
    assert getattr(made, goes) is None  # absent
    assert not told
    for kind in kinds:  # present, in any type
        fields = {name: column.astype(f"{kind}") for name, column in zip(names, values.T, strict=True)}
        made, told = read(path, reader, fields)
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


def test_arrays_of_an_archive(tmp_path):
    arrays = {"points": XYZ, "colors": RGB, "normals": UP, "labels": np.arange(COUNT)}
    np.savez(tmp_path / "a.npz", **arrays)
    made = read_cloud_file(tmp_path / "a.npz")
    torch.testing.assert_close(made.colors, expected("colors", RGB))
    torch.testing.assert_close(made.normals, torch.from_numpy(UP))
    np.savez(tmp_path / "a.npz", **arrays, heat=XYZ)
    with pytest.warns(UserWarning, match=r"a\.npz: heat: no position, normal or colour by these names; not read"):
        read_cloud_file(tmp_path / "a.npz")


def test_dimensions_of_a_las(tmp_path):
    laspy = pytest.importorskip("laspy")
    for kind in (0, 2):
        las = laspy.create(point_format=kind, file_version="1.2")
        las.header.scales = [1e-6] * 3
        las.x, las.y, las.z = XYZ.astype(float).T
        las.intensity = np.arange(COUNT)
        if kind == 2:
            las.red, las.green, las.blue = RGB.astype("u2").T
            las.add_extra_dim(laspy.ExtraBytesParams("heat", "float32"))
        las.write(tmp_path / "a.las")
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            made = read_cloud_file(tmp_path / "a.las")
        assert (made.colors is None) == (kind == 0)
        assert ["heat: no position" in str(one.message) for one in told] == [True] * (kind == 2)


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
    assert ["1 of 2 scans have no colours (1), so" in str(one.message) for one in told] == [True] * (len(bare) == 1)


def test_scans_of_a_recording_of_which_one_has_no_colours(tmp_path):
    import torchjoint as tj

    messages = list(ros_points.messages())
    last = [one for topic, _, one in messages if topic.endswith("points")][-1]
    last.fields = last.fields[:3]
    with pytest.warns(UserWarning, match="1 of 2 scans have no colours, so those of the others; they are left out"):
        assert tj.load_scene(ros.record(tmp_path / "bag", messages), voxel_size=1e-4).colors is None
