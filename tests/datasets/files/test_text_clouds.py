"""Clouds as text: what can be read without guessing is read; what cannot, is told with file, line and remedy."""

import numpy as np
import pytest

from torchjoint.datasets.files import text_clouds
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.scene import Scene

RNG = np.random.default_rng(0)
XYZ = RNG.uniform(-1, 1, (30, 3)).round(6)
RGB = RNG.integers(0, 256, (30, 3)).astype(float)
UP = np.tile([0.6, 0.0, 0.8], (30, 1))
HIGH = RNG.integers(-900, 2000, (30, 1)).astype(float)
HIGH[0] = 1000


def text(*columns, by=" "):
    return "\n".join(by.join(f"{value:.6f}" for value in row) for row in np.hstack(columns)) + "\n"


COLORED = text(XYZ, RGB)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.txt", "//X Y Z R G B\n" + COLORED),  # CloudCompare
        ("a.asc", "//X Y Z R G B\n30\n" + COLORED),
        ("a.txt", "# made by hand\n# x y z r g b\n\n" + COLORED),
        ("a.xyz", "x y z red green blue\n" + COLORED),
        ("a.csv", '"x","y","z","r","g","b"\r\n' + text(XYZ, RGB, by=",").replace("\n", "\r\n")),
        ("a.csv", text(XYZ, RGB, by=", ")),
        ("a.csv", "X,Y,Z,Red,Green,Blue,Cloud index\n" + text(XYZ, RGB, RGB[:, :1], by=",")),
        ("a.csv", ",x,y,z,r,g,b\n" + text(RGB[:, :1], XYZ, RGB, by=",")),  # pandas' index
        ("a.csv", '"x","y","z","r","g","b"\n"' + text(XYZ, RGB, by='","').rstrip().replace("\n", '"\n"') + '"\n'),
        ("a.txt", "x y z r g b\n" + text(XYZ, 257 * RGB)),
        ("a.txt", text(XYZ, RGB, by=",").replace("\n", ",\n")),
        ("a.txt", text(XYZ, RGB, by=";")),
        ("a.txt", text(XYZ, RGB, by=";").replace(".", ",")),
        ("a.txt", text(XYZ, RGB, by="\t")),
        ("a.txt", COLORED.replace("\n", "\r")),
        ("a.xyz", "\ufeff" + COLORED),
        ("a.txt", COLORED.encode("utf-16")),
        ("a.pts", "30\n" + text(XYZ, RGB[:, :1], RGB)),
        ("a.txt", "30\n" + text(XYZ, RGB[:, :1], RGB)),
        ("a.txt", text(XYZ, HIGH, RGB)),  # Semantic3D
        ("a.txt", "b g r z y x\n" + text(RGB[:, ::-1], XYZ[:, ::-1])),
        ("a.xyz", text(XYZ, UP, RGB)),
        ("a.xyz", text(XYZ, RGB, UP)),
    ],
)
def test_what_programs_write(tmp_path, name, data):
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    read = read_cloud_file(tmp_path / name)
    np.testing.assert_array_equal(read.points, XYZ)
    np.testing.assert_allclose(read.colors, RGB / 255, atol=1e-6)


@pytest.mark.parametrize("step", [1, 7, -3])
@pytest.mark.parametrize(("first", "more"), [(0, RGB), (1, RGB), (1, RGB[:, :1]), (1, RGB[:, :2])])
def test_a_column_that_counts_the_rows_is_no_coordinate(tmp_path, first, more, step):
    count = first + step * np.arange(30.0)[:, None]
    (tmp_path / "a.txt").write_text(text(count, XYZ, more))
    with pytest.warns(UserWarning, match=r"a\.txt: (of|the first column counts the rows, and is not read; a first)"):
        read = read_cloud_file(tmp_path / "a.txt")
    np.testing.assert_array_equal(read.points, XYZ)
    assert read.colors is None if more is not RGB else np.allclose(read.colors, RGB / 255, atol=1e-6)
    (tmp_path / "a.txt").write_text(text(count, XYZ[:, :2]))
    np.testing.assert_array_equal(read_cloud_file(tmp_path / "a.txt").points[:, :1], count)


def test_degrees_are_told(tmp_path, recwarn):
    path, site = tmp_path / "a.csv", XYZ * [1e-4, 1e-4, 9] + [7.8, 48, 280]
    path.write_text("x,y,z\n" + text(site).replace(" ", ","))
    with pytest.warns(UserWarning, match=r"a\.csv: are x and y in degrees, z in metres\? Project them before"):
        np.testing.assert_allclose(read_cloud_file(path).points, site)
    for other in (XYZ * [0.05, 0.05, 9], XYZ * [1e-4, 1e-4, 9] + 5317000, XYZ * [0, 0, 9], XYZ * [1, 1, 1e4]):
        path.write_text(text(other))
        read_cloud_file(path)
    assert not recwarn.list


@pytest.mark.parametrize("suffix", [".xyz", ".npy"])
def test_normals_without_a_negative_one_are_no_colours(tmp_path, suffix):
    normals = UP.copy()
    normals[3] = 0
    path = tmp_path / f"a{suffix}"
    np.save(path, np.hstack([XYZ, normals])) if suffix == ".npy" else path.write_text(text(XYZ, normals))
    with pytest.warns(UserWarning, match="1 of 30 normals are NaN or of length 0"):
        read = read_cloud_file(path)
    assert read.colors is None
    np.testing.assert_allclose(read.normals, UP, atol=1e-6)
    assert Scene(read.points, normals=read.normals).normals is not None


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (COLORED + "1 2 x 4 5 6\n", r"line 31: .* 6 numbers, got '1 2 x 4 5 6'; correct or remove the line, or text"),
        ("# x\n" + COLORED + "1 2 3\n", r"line 32: expected 6 numbers, got '1 2 3'"),
        (
            "Point cloud of a room\n" + COLORED,
            r"line 1: expected numbers, or names of columns with x, y and z, got 'Poin.* or remove the text",
        ),
        ("31\n" + COLORED, r"line 1: 31 points are counted, got 30: is it truncated\?"),
        ("1,5 2,5 3,5\n", r"line 1: expected decimal points, got commas in '1,5 2,5 3,5'; replace them"),
        ("1,5, 2,5, 3\n", r"line 1: expected decimal points, got commas in '1,5, 2,5, 3'; replace them"),
        ("x y z r g b\n" + text(RGB[:, :1], XYZ, RGB), "6 names of columns, x, y, z, r, g, b, but 7 numbers a row"),
        ("# nothing\n", "expected a row of x y z for each point, got no rows"),
        ("x,y,z,x\n1,2,3,4\n", "column 'x' is there twice"),
        ("# by hand\nid x y z\n" + "1 0 0 0 9\n" * 9, "4 names of columns, id, x, y, z, but 5 numbers a row"),
        ("z,y,x,label\n1,2,3\n", "4 names of columns, z, y, x, label, but 3 numbers a row"),
        ("1 2\n3 4\n", r"expected a row of x y z for each point, got shape \[2, 2\]"),
    ],
)
def test_what_cannot_be_read(tmp_path, data, message):
    (tmp_path / "a.txt").write_text(data)
    with pytest.raises(ValueError, match=rf"a\.txt: .*{message}"):
        read_cloud_file(tmp_path / "a.txt")


@pytest.mark.parametrize(
    "head",
    [
        "z [m];y (m);x (m)",
        "# z y x",
        "// by a program of x, y, z\n//z,y,x",
        "Height Northing Easting",
        "H;N;E",
    ],
)
def test_names_with_units(tmp_path, head):
    (tmp_path / "a.csv").write_text(f"{head}\n1,2,3\n")
    assert read_cloud_file(tmp_path / "a.csv").points.tolist() == [[3, 2, 1]]


@pytest.mark.parametrize(
    "head",
    [
        "x [mm],y [mm],z [mm]",
        "# X(ft) Y(ft) Z(ft)",
        "# X Y Z\n// units: mm",
        "x (deg);y (deg);z (m)",
        "x [usft],y [usft],z [usft]",
        "e (US survey feet),n (US survey feet),h (m)",
    ],
)
def test_units_that_are_no_metres(tmp_path, head):
    (tmp_path / "a.csv").write_text(f"{head}\n1,2,3\n")
    with pytest.warns(UserWarning, match=r"(?i)a\.csv: (// units: |[xe] ?.)(mm|ft|deg|usft|us survey feet).?: taken"):
        assert read_cloud_file(tmp_path / "a.csv").points.tolist() == [[1, 2, 3]]


def test_decimal_commas_in_quotes(tmp_path):
    """They were taken for twice as many columns: three places became x y z r g b."""
    (tmp_path / "a.csv").write_text('"1,5","2,5","3,5"\n')
    with pytest.raises(ValueError, match=r"a\.csv: expected decimal points, got commas inside of quotes"):
        read_cloud_file(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text('1;2;3\n"1,5";"2,5";"3,5"\n')
    assert read_cloud_file(tmp_path / "a.csv").points.tolist() == [[1, 2, 3], [1.5, 2.5, 3.5]]
    (tmp_path / "a.csv").write_text('"1.5","2.5","3.5"\n')
    assert read_cloud_file(tmp_path / "a.csv").points.tolist() == [[1.5, 2.5, 3.5]]
    (tmp_path / "a.csv").write_text("x, y, z,label\n1, 2, 3,7\n")  # as `torchjoint label` adds a column
    assert read_cloud_file(tmp_path / "a.csv").points.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("by", [" ", ","])
def test_single_unknown_values(tmp_path, by):
    """They are NaN, or empty as pandas writes them."""
    rows = text(XYZ, np.where(np.arange(30)[:, None] == 3, np.nan, RGB), by=by)
    (tmp_path / "a.csv").write_text(rows if by == " " else rows.replace("nan", ""))
    with pytest.warns(
        UserWarning, match="1 of 30 colors are NaN or out of range; they are taken from the nearest points"
    ):
        colors = read_cloud_file(tmp_path / "a.csv").colors
    np.testing.assert_allclose(np.delete(colors.numpy(), 3, 0), np.delete(RGB, 3, 0) / 255, atol=1e-6)
    (tmp_path / "a.xyz").write_text(text(XYZ, np.where(np.arange(30)[:, None] == 3, np.nan, UP)))
    with pytest.warns(UserWarning, match="1 of 30 normals are NaN"):
        np.testing.assert_allclose(read_cloud_file(tmp_path / "a.xyz").normals, UP, atol=1e-6)
    (tmp_path / "a.csv").write_text("x,y,z\n0,1,2\n,,\n,1,2\n")
    with pytest.raises(ValueError, match="2 of 3 points are NaN"):
        read_cloud_file(tmp_path / "a.csv")


@pytest.mark.parametrize("values", [[1], [1, 2, 3]])
def test_a_column_of_another_length_is_an_error(tmp_path, values):
    (tmp_path / "a.csv").write_text("x,y,z\n0,0,0\n\n# a comment\n1,1,1\n")
    with pytest.raises(ValueError, match=r"argument 2 is (shorter|longer)"):
        text_clouds.with_column(tmp_path / "a.csv", "label", values)
    lines = text_clouds.with_column(tmp_path / "a.csv", "label", [5, 6]).splitlines()
    assert lines[:2] == [b"x,y,z,label", b"0,0,0,5"]
    assert lines[-1] == b"1,1,1,6"


@pytest.mark.parametrize("names", ["x;y;z\n", "x;y;z;\n", "# X;Y;Z\n", "x;y;Höhe;z\n", ""])
def test_rows_that_end_with_a_semicolon_get_no_empty_column(tmp_path, names):
    """Labels stood one column behind their name."""
    (tmp_path / "a.csv").write_text(f"{names}0;0,5;0;\n1;1,5;1;\n", "cp1252")
    *titles, first, second = text_clouds.with_column(tmp_path / "a.csv", "label", [5, 6]).splitlines()
    assert titles == [f"{line.strip(';')};label".encode("cp1252") for line in names.splitlines()]
    assert (first, second) == (b"0;0,5;0;5", b"1;1,5;1;6")
    (tmp_path / "b.csv").write_bytes(b"0;0;0;1\n1;1;1;\n")  # an empty field
    assert text_clouds.with_column(tmp_path / "b.csv", "label", [5, 6]) == b"0;0;0;1;5\n1;1;1;;6\n"


@pytest.mark.parametrize(
    ("file", "out", "then"),
    [
        ("a.pts", "a.pts", "intensity r g b"),
        ("counted.xyz", "b.xyz", "intensity r g b"),
        ("two_more.xyz", "b.txt", "r g b"),
        ("steps.xyz", "b.xyz", None),
    ],
)
def test_a_label_that_gives_other_columns_a_meaning(file, out, then, tmp_path):
    """Behind six columns of a .pts it makes an intensity of red; with two that are not read it makes colours."""
    colored = "".join(f"{i}.5 {i} .5 10 {20 + i} 30\n" for i in range(12))
    two_more = "".join(f"{i}.5 {i} .5 10 {i}\n" for i in range(12))
    steps = "".join(f"{i} {i}.5 .5\n" for i in range(12))
    texts = {"a.pts": colored, "counted.xyz": f"12\n{colored}", "two_more.xyz": two_more, "steps.xyz": steps}
    (tmp_path / file).write_text(texts[file])
    then = f"x y z {then}" if then else "number x y z"
    with pytest.raises(ValueError, match=rf"with label, x y z.* would be read as {then}; name all columns in a first"):
        text_clouds.with_column(tmp_path / file, "label", range(12), tmp_path / out)
    names = " ".join(["x", "y", "z", "red", "green", "blue"][: len(texts[file].splitlines()[-1].split())])
    (tmp_path / file).write_text(f"{names}\n{texts[file]}")
    assert text_clouds.with_column(tmp_path / file, "label", range(12), tmp_path / out).endswith(b" 11\n")
    (tmp_path / "b.xyz").write_text(colored)
    assert text_clouds.with_column(tmp_path / "b.xyz", "label", range(12)).endswith(b"11.5 11 .5 10 31 30 11\n")


def test_decimal_commas_between_commas(tmp_path):
    rows = np.random.default_rng(0).integers(0, 999, (20, 6))
    text = "\n".join("{},{:03},{},{:03},{},{:03}".format(*row) for row in rows)
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(ValueError, match=r"a\.txt: line 1: expected decimal points, got commas in '849,636,"):
        read_cloud_file(tmp_path / "a.txt")
