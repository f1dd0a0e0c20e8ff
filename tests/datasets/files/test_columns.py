"""Columns of clouds: known names are read, in every format; one scale of colours; single bad values are estimated."""

import warnings
from contextlib import nullcontext

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.columns import cloud_of, repaired, unit_colors
from torchjoint.tiles.plan import survey

RNG = np.random.default_rng(0)
XYZ = RNG.uniform(0, 1, (40, 3)).astype(np.float32)
BYTES = RNG.integers(0, 256, (40, 3), np.uint8)
BYTES[0] = 255
UNIT = BYTES / 255
NORMALS = np.tile(np.float32([0, 0, 1]), (40, 1))
WORDS = {"f4": "float", "f8": "double", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
PLACES = dict(zip("xyz", XYZ.T, strict=True))


def named(names, values, kind=None):
    return {name: column if kind is None else column.astype(kind) for name, column in zip(names, values.T, strict=True)}


def write(path, columns):
    """A .ply, .pcd or .txt with these columns."""
    rows = np.rec.fromarrays(list(columns.values()), names=list(columns))
    kinds = [rows.dtype[name].str[1:] for name in columns]
    if path.suffix == ".txt":
        path.write_text(" ".join(columns) + "\n" + "\n".join(" ".join(map(repr, row)) for row in rows.tolist()) + "\n")
        return path
    if path.suffix == ".ply":
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
        lines += [f"property {WORDS[kind]} {name}" for kind, name in zip(kinds, columns, strict=True)] + ["end_header"]
    else:
        lines = ["VERSION .7", f"FIELDS {' '.join(columns)}", f"SIZE {' '.join(kind[1] for kind in kinds)}"]
        lines += [
            f"TYPE {' '.join(kind[0].upper() for kind in kinds)}",
            f"WIDTH {len(rows)}",
            "HEIGHT 1",
            "DATA binary",
        ]
    path.write_bytes("\n".join([*lines, ""]).encode() + rows.tobytes())
    return path


FILES = pytest.mark.parametrize("suffix", [".ply", ".pcd", ".txt"])


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_integers_of_0_and_1_are_nearly_black(tmp_path, suffix):
    path = write(tmp_path / f"a{suffix}", PLACES | named(["red", "green", "blue"], BYTES > 99, "u1"))
    with pytest.warns(UserWarning, match=rf"a\{suffix}: colours are only 0 and 1 of 255, and are read as black"):
        assert read_cloud_file(path).colors.max() < 0.01


@FILES
@pytest.mark.parametrize(
    "names",
    ["red green blue", "r g b", "Red Green Blue", "R G B", "diffuse_red diffuse_green diffuse_blue",
     "scalar_R scalar_G scalar_B", "scalar_red scalar_green scalar_blue", "color_r color_g color_b"],
)  # fmt: skip
def test_colours_by_any_known_name(tmp_path, suffix, names):
    read = read_cloud_file(write(tmp_path / f"a{suffix}", PLACES | named(names.split(), BYTES)))
    np.testing.assert_allclose(read.colors, UNIT, atol=1e-7)


@FILES
@pytest.mark.parametrize("names", ["nx ny nz", "normal_x normal_y normal_z", "normalx normaly normalz", "Nx Ny Nz",
                                   "scalar_Nx scalar_Ny scalar_Nz"])  # fmt: skip
def test_normals_and_places_by_any_known_name(tmp_path, suffix, names):
    read = read_cloud_file(write(tmp_path / f"a{suffix}", named("XYZ", XYZ) | named(names.split(), NORMALS)))
    np.testing.assert_array_equal(read.points, XYZ)
    np.testing.assert_array_equal(read.normals, NORMALS)
    assert read.colors is None


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("kind", ["i2", "u2", "i4", "u4", "f4", "f8"])
def test_colours_of_8_bits_in_any_type(tmp_path, suffix, kind):
    """PDAL and pyntcloud write them so; wider colours are what they were."""
    rgb = ("red", "green", "blue")
    read = read_cloud_file(write(tmp_path / f"a{suffix}", PLACES | named(rgb, BYTES, kind)))
    np.testing.assert_allclose(read.colors, UNIT, atol=1e-7)
    if kind in ("u2", "i4", "u4"):
        wide = BYTES.astype(kind) * 257
        read = read_cloud_file(write(tmp_path / f"a{suffix}", PLACES | named(rgb, wide)))
        np.testing.assert_allclose(read.colors, UNIT, atol=1e-7)
    if kind[0] == "f":
        read = read_cloud_file(write(tmp_path / f"a{suffix}", PLACES | named(rgb, UNIT, kind)))
        np.testing.assert_allclose(read.colors, UNIT, atol=1e-7)


@pytest.mark.parametrize("kind", [torch.int16, torch.int32, torch.int64, torch.uint16])
def test_tensors_have_the_same_scale(kind):
    colors = torch.from_numpy(BYTES.astype(np.int32)).to(kind)
    expected = torch.from_numpy(UNIT.astype(np.float32))
    assert torch.equal(tj.Scene(torch.from_numpy(XYZ), colors=colors).colors, expected)
    if kind != torch.int16:
        wide = (torch.from_numpy(BYTES.astype(np.int32)) * 257).to(kind)
        assert torch.equal(tj.Scene(torch.from_numpy(XYZ), colors=wide).colors, expected)
    with pytest.raises(ValueError, match=r"colors: expected values in \[0, 1\]"):
        tj.Scene(torch.from_numpy(XYZ), colors=-torch.from_numpy(BYTES.astype(np.int32)))


def test_each_file_of_a_folder_has_its_own_scale(tmp_path):
    """Of two .las one has 8 bits, the other 16; of three, one has no colours."""
    laspy = pytest.importorskip("laspy")
    for name, factor in (("a", 1), ("b", 257), ("c", 0)):
        las = laspy.create(point_format=2, file_version="1.2")
        las.header.scales = [1e-3] * 3
        las.x, las.y, las.z = (XYZ.astype(float) + factor).T  # each file is another part of a cloud
        las.red, las.green, las.blue = (BYTES.astype(np.uint16) * factor).T
        las.write(tmp_path / f"{name}.las")
        colors = read_cloud_file(tmp_path / f"{name}.las").colors
        assert colors is None if factor == 0 else np.abs(colors.numpy() - UNIT).max() < 1e-7
    files = sorted(tmp_path.glob("*.las"))
    assert survey(files[:2]).whites == (255, 65535)
    with pytest.warns(
        UserWarning, match=r"1 of 3 files have no colours, so those of the others are not read: .*c\.las"
    ):
        assert survey(files).whites is None


@pytest.mark.parametrize("alpha", [0, 100])
@pytest.mark.parametrize("kind", ["f4", "u4", "f8", "i4"])
def test_packed_colours_of_any_type(kind, alpha):
    packed = (BYTES.astype(np.uint32) << [16, 8, 0]).sum(1, dtype=np.uint32) + np.uint32(alpha << 24)
    column = packed.view("f4").astype("f8") if kind == "f8" else packed.view(kind)
    np.testing.assert_allclose(cloud_of(PLACES | {"rgb": column}, "a").colors, UNIT, atol=1e-7)
    np.testing.assert_allclose(cloud_of(PLACES | {"rgb": BYTES}, "a").colors, UNIT, atol=1e-7)


def test_what_is_unknown_is_told_and_what_is_known_is_not():
    with pytest.warns(UserWarning, match=r"^a\.ply: red, foo, nx: no position, normal or colour by these names; not u"):
        cloud_of(PLACES | dict.fromkeys(["red", "foo", "nx"], XYZ[:, 0]), "a.ply")
    with pytest.warns(UserWarning, match=r"f6, f7, f8 and 2 more: no position"):
        cloud_of(PLACES | {f"f{number}": XYZ[:, 0] for number in range(1, 11)}, "a.ply")
    known = ("Intensity", "label", "scale_0", "rot_3", "f_rest_44", "alpha", "scalar_Classification", "ring",
             "timestamp", "gps_time", "curvature", "_3", "quality", "scalar_Original_cloud_index")  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cloud_of(PLACES | dict.fromkeys(known, XYZ[:, 0]), "a.ply")
    with pytest.raises(ValueError, match="expected x, y and z, got x, y: z missing"):
        cloud_of({"x": XYZ[:, 0], "y": XYZ[:, 1]}, "a.ply")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz", ".txt"])
def test_a_few_bad_normals_are_estimated(tmp_path, suffix, bad):
    normals = NORMALS.copy()
    normals[[3, 17]] = bad
    path = tmp_path / f"a{suffix}"
    if suffix == ".npz":
        np.savez(path, points=XYZ, normals=normals)
    else:
        write(path, PLACES | named(("nx", "ny", "nz"), normals))
    with pytest.warns(
        UserWarning, match=r"a\.\w+: 2 of 40 normals are NaN or of length 0; they are taken from the nea"
    ):
        read = read_cloud_file(path)
    np.testing.assert_array_equal(read.normals, NORMALS)


def test_bad_colours_and_opacities_are_estimated():
    cloud = cloud_of(PLACES | named(("red", "green", "blue"), UNIT, "f4"), "a")._replace(opacities=torch.ones(40))
    cloud.colors[5], cloud.opacities[7] = torch.nan, torch.nan
    place = np.linalg.norm(XYZ - XYZ[5], axis=1)
    place[5] = np.inf
    with pytest.warns(UserWarning, match="they are taken from the nearest points") as told:
        read = repaired(cloud, "a.ply")
    assert [str(one.message)[:29] for one in told] == ["a.ply: 1 of 40 colors are NaN", "a.ply: 1 of 40 opacities are "]
    assert torch.equal(read.colors[5], cloud.colors[int(place.argmin())])
    assert bool((read.opacities == 1).all())
    with pytest.warns(UserWarning, match=r"a\.ply: 40 of 40 normals are NaN or of length 0; the normals are not read"):
        assert repaired(cloud_of(PLACES, "a")._replace(normals=torch.full((40, 3), torch.nan)), "a.ply").normals is None


@pytest.mark.parametrize("low", [0, -0.01])
def test_opacities_that_had_their_sigmoid(low):
    """Another would make all of them .5 to .73, so that no splat is faint."""
    values = np.linspace(low, 1, 40, dtype=np.float32)
    splats = PLACES | named(("f_dc_0", "f_dc_1", "f_dc_2"), XYZ) | {"opacity": values}
    with nullcontext() if low else pytest.warns(UserWarning, match="a: opacities of 0 to 1 are read as they are, with"):
        read = cloud_of(splats, "a").opacities
    torch.testing.assert_close(read, torch.from_numpy(values).sigmoid() if low else torch.from_numpy(values))


@pytest.mark.parametrize("head", ["x y z r g b\n", ""])
def test_a_colour_of_256_darkens_no_other(tmp_path, head):
    (tmp_path / "a.txt").write_text(f"{head}0.5 1 2 256 0 51\n0.25 3 4 204 102 255\n")
    with pytest.warns(UserWarning, match="256 is taken as 255, full brightness"):
        colors = read_cloud_file(tmp_path / "a.txt").colors
    assert (255 * colors).round().tolist() == [[255, 0, 51], [204, 102, 255]]


def test_colours_of_12_bits_are_told():
    with pytest.warns(UserWarning, match=r"colours are at most 4095 of 65535, and .*: are they of 12 bits\?"):
        unit_colors(np.array([[0, 300, 4095]], np.uint16))


def test_signed_bytes_are_bytes():
    np.testing.assert_allclose(unit_colors(BYTES.view(np.int8)), UNIT, atol=1e-7)


def test_colors_of_few_bits(recwarn):
    """65535 is beyond float16."""
    np.testing.assert_allclose(unit_colors(BYTES.astype(np.float16)), UNIT, atol=1e-3)
    with pytest.raises(ValueError, match="colors: expected numbers, got bool"):
        unit_colors(BYTES > 0)
    assert not len(recwarn)
