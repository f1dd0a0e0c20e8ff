"""PCD files and the compression they have."""

import struct
import time
import tracemalloc

import numpy as np
import pytest
import torch
from pcd_files import BODIES, compress_lzf, write_pcd

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.pcd import decompress, read_pcd

XYZ = {axis: np.array([1.5, -2.25, 3.0], dtype=np.float32) + place for place, axis in enumerate("xyz")}
HEADER = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA "


class TestLzf:
    @pytest.mark.parametrize(
        ("data", "expected"),
        [
            (b"", b""),
            (b"\x02abc", b"abc"),
            (b"\x00a\x20\x00", b"aaaa"),  # a, then 1 + 2 of it from 1 before the end
            (b"\x02abc\x40\x02", b"abcabca"),  # 2 + 2 from 3 before: it reaches into itself
            (b"\x02abc\xe0\x01\x02", b"abc" + b"abcabcabca"),  # 7 + 1 + 2 from 3 before
            (b"\x1f" + bytes(range(32)) + b"\x20\x1f", bytes(range(32)) + b"\x00\x01\x02"),
        ],
    )
    def test_by_hand(self, data, expected):
        assert decompress(data, len(expected)) == expected

    def test_copies_from_far_back(self):
        data = np.random.default_rng(0).integers(0, 256, 6000, dtype=np.uint8).tobytes() * 2
        packed = compress_lzf(data)
        assert len(packed) < 0.6 * len(data)
        assert decompress(packed, len(data)) == data

    @pytest.mark.parametrize(
        ("data", "size"),
        [
            (b"\x02ab", 3),  # the bytes end
            (b"\x02ab", 2),
            (b"\x20", 3),  # the copy has no place
            (b"\xe0\x01", 10),
            (b"\x00a\x20\x01", 4),  # the copy is from before the start
            (b"\x02abc", 2),
            (b"\x02abc", 4),
        ],
    )
    def test_damaged(self, data, size):
        with pytest.raises(ValueError, match=r"here: damaged: "):
            decompress(data, size, "here")

    def test_a_bomb_ends_where_it_is_known_to_be_one(self):
        bomb = b"\x00a" + b"\xe0\xff\x00" * 1_000_000  # 260 MB
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match="expected 100 bytes"):
                decompress(bomb, 100)
            assert tracemalloc.get_traced_memory()[1] < 10_000_000  # a copy of `bomb`, at the most
        finally:
            tracemalloc.stop()


class TestFields:
    @pytest.mark.parametrize("data", BODIES)
    def test_all_types_in_all_encodings(self, tmp_path, data):
        fields = XYZ | {
            "label": np.array([0, 7, 2**32 - 1], dtype=np.uint32),
            "small": np.array([-128, 0, 127], dtype=np.int8),
            "time": np.array([0.1, 1e9, -1e-9]),
            "histogram": np.arange(12, dtype=np.uint16).reshape(3, 4),
            "large": np.array([-(2**40), 0, 2**40]),
        }
        cloud = read_pcd(write_pcd(tmp_path / "c.pcd", fields, data=data))
        assert (cloud.width, cloud.height) == (3, 1)
        assert list(cloud.fields) == list(fields)
        for name, values in fields.items():
            assert cloud.fields[name].dtype == values.dtype
            np.testing.assert_array_equal(cloud.fields[name], values)

    @pytest.mark.parametrize("data", BODIES)
    @pytest.mark.parametrize("name", ["rgb", "rgba"])
    @pytest.mark.parametrize("kind", [np.uint32, np.int32, np.float32])
    def test_colours_are_packed(self, tmp_path, data, name, kind):
        packed = np.array([0x00FF8001, 0x00010203, 0x00000000], dtype=np.uint32).view(kind)
        points, colors, normals = read_cloud_file(write_pcd(tmp_path / "c.pcd", XYZ | {name: packed}, data=data))[:3]
        expected = torch.tensor([[255, 128, 1], [1, 2, 3], [0, 0, 0]]) / 255
        torch.testing.assert_close(colors, expected)
        assert points.tolist() == np.stack(list(XYZ.values()), axis=1).tolist()
        assert normals is None

    def test_packed_colours_may_be_numbers_of_floats(self, tmp_path):
        """As in the file that explains the format: 4.2108e+06."""
        packed = np.array([0x404040, 0x00FF80, 0], dtype=np.float32)
        colors = read_cloud_file(write_pcd(tmp_path / "c.pcd", XYZ | {"rgb": packed}, data="ascii")).colors
        torch.testing.assert_close(colors, torch.tensor([[64, 64, 64], [0, 255, 128], [0, 0, 0]]) / 255)

    def test_floats_of_pcl_are_32_bits_in_text(self, tmp_path):
        """PCL writes rgb of TYPE F as the whole number of its bits, whose upper eight are 255."""
        path = write_pcd(tmp_path / "c.pcd", XYZ | {"rgb": np.array([1, 2, 3], dtype=np.float32)}, data="ascii")
        head, rows = path.read_text().split("ascii\n")
        opaque = (0xFFFF8001, 0xFF010203, 0xFF000000)
        rows = [f"{row.rpartition(' ')[0]} {packed}\n" for row, packed in zip(rows.splitlines(), opaque, strict=True)]
        path.write_text(f"{head}ascii\n{''.join(rows)}")
        colors = read_cloud_file(path).colors
        torch.testing.assert_close(colors, torch.tensor([[255, 128, 1], [1, 2, 3], [0, 0, 0]]) / 255)

    def test_places_in_a_survey_keep_their_digits_in_text(self, tmp_path):
        """Open3D writes ten of them, though TYPE and SIZE say float32, whose steps are 0.5 m there."""
        path = write_pcd(tmp_path / "c.pcd", XYZ | {"fpfh": np.zeros((3, 33), np.float32)}, data="ascii")
        head, rows = path.read_text().split("ascii\n")
        rows = [f"500000.25 5600000.125 {row.split(' ', 2)[2]}\n" for row in rows.splitlines()]
        path.write_text(f"{head}ascii\n{''.join(rows)}")
        with pytest.warns(UserWarning, match="fpfh: no position"):
            points = read_cloud_file(path).points
        assert points[:, :2].tolist() == [[500000.25, 5600000.125]] * 3

    def test_normals(self, tmp_path):
        fields = XYZ | {f"normal_{axis}": np.full(3, axis == "y", dtype=np.float32) for axis in "xyz"}
        cloud = read_cloud_file(write_pcd(tmp_path / "c.pcd", fields))
        assert cloud.normals.tolist() == [[0, 1, 0]] * 3
        assert cloud.colors is None

    def test_padding_is_passed_over(self, tmp_path):
        gap = np.arange(3, dtype=np.uint8)
        path = write_pcd(tmp_path / "c.pcd", {"x": XYZ["x"], "gap1": gap, "y": XYZ["y"], "gap2": gap, "z": XYZ["z"]})
        path.write_bytes(path.read_bytes().replace(b"x gap1 y gap2 z", b"x _ y _ z"))
        cloud = read_pcd(path)
        assert list(cloud.fields) == ["x", "y", "z"]
        np.testing.assert_array_equal(cloud.fields["z"], XYZ["z"])

    def test_open3d_s_own_files(self, tmp_path):
        from open3d import core, t

        generator = torch.Generator().manual_seed(0)
        positions = (torch.rand(500, 3, generator=generator) * 4).round() / 4  # repetitive, to be compressed
        colors = torch.randint(0, 256, (500, 3), dtype=torch.uint8, generator=generator)
        cloud = t.geometry.PointCloud(core.Tensor(positions.numpy()))
        cloud.point.colors = core.Tensor(colors.numpy())
        for ascii_, compressed in ((True, False), (False, False), (False, True)):
            path = tmp_path / f"{ascii_}{compressed}.pcd"
            t.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
            points, read_colors, _ = read_cloud_file(path)[:3]
            torch.testing.assert_close(points.float(), positions)
            torch.testing.assert_close(read_colors, colors.float() / 255)

    def test_nan_is_kept_here_and_refused_for_a_cloud(self, tmp_path):
        x = XYZ["x"].copy()
        x[1] = np.nan
        path = write_pcd(tmp_path / "c.pcd", XYZ | {"x": x}, data="ascii")
        assert read_pcd(path).cloud("c").points.isnan().sum() == 1
        with pytest.raises(ValueError, match=r"c\.pcd: 1 of 3 points are NaN"):
            read_cloud_file(path)

    def test_unorganised_files_of_old_without_points_and_count(self, tmp_path):
        path = tmp_path / "c.pcd"
        path.write_text("# comment\n\nFIELDS x y z\r\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 2 nan\n")
        assert read_pcd(path).cloud("c").points[0, :2].tolist() == [1, 2]


class TestErrors:
    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("HEIGHT 1\n", "HEIGHT 1\nHEIGHT 2\n", "line 'HEIGHT' is there twice"),
            ("VERSION 0.7\nFIELDS x y z\n", "", "not a PCD file"),
            ("DATA ", "DATA xml", "expected DATA ascii, binary or binary_compressed, got 'xmlascii'"),
            ("WIDTH 2", "WIDTH 3", "expected POINTS = WIDTH x HEIGHT > 0"),
            ("WIDTH 2", "WIDTH two", "WIDTH: expected an integer, got 'two'"),
            ("HEIGHT 1", "HEIGHT 0", "expected POINTS = WIDTH x HEIGHT > 0"),
            ("HEIGHT 1", "", "not a PCD file, or its header is damaged: .*'HEIGHT'"),
            ("SIZE 4 4 4", "SIZE 4 4", "do not agree in number"),
            ("SIZE 4 4 4", "SIZE 4 4 3", "field 'z' of TYPE F, SIZE 3, COUNT 1 is not known"),
            ("COUNT 1 1 1", "COUNT 1 1 0", "field 'z' of TYPE F, SIZE 4, COUNT 0"),
            ("COUNT 1 1 1", "COUNT 1 1 3", "expected fields x, y and z of TYPE F"),
            ("COUNT 1 1 1", "COUNT 1 1 5000", "COUNT 5000"),
            ("x y z", "x y y", "field 'y'.* twice"),
            ("x y z", "a b c", "expected fields x, y and z of TYPE F, got a b c"),
            ("TYPE F F F", "TYPE F F I", "expected fields x, y and z of TYPE F"),
            ("WIDTH 2\nHEIGHT 1\nPOINTS 2", "WIDTH 1\nHEIGHT 1\nPOINTS 1", "expected 1 points of 3 numbers, got 2"),
            ("WIDTH 2\nHEIGHT 1\nPOINTS 2", f"WIDTH {9**17}\nHEIGHT 1\nPOINTS {9**17}", "points of 3 numbers, got 2"),
            ("1 2 3\n", "", "truncated, or too long: expected 2 points of 3 numbers, got 1 of 3"),
            ("1 2 3\n4 5 6", "", "truncated, or too long: expected 2 points of 3 numbers, got 0 of 3"),
            ("1 2 3", "1 2", "expected lines of 3 numbers"),
            ("1 2 3", "1 2 abc", "expected lines of 3 numbers"),
        ],
    )
    def test_a_header_or_text_that_is_wrong(self, tmp_path, old, new, message):
        path, whole = tmp_path / "c.pcd", HEADER + "ascii\n1 2 3\n4 5 6\n"
        assert old in whole
        path.write_text(whole.replace(old, new))
        with pytest.raises(ValueError, match=f"c\\.pcd: .*{message}"):
            read_pcd(path)

    @pytest.mark.parametrize("value", ["-1", "256", "1.5", "nan", "1e30"])
    def test_integers_that_do_not_fit(self, tmp_path, value):
        path = tmp_path / "c.pcd"
        header = HEADER.replace("x y z", "x y z a").replace("4 4 4", "4 4 4 1").replace("F F F", "F F F U")
        path.write_text(header.replace("COUNT 1 1 1", "COUNT 1 1 1 1") + f"ascii\n1 2 3 0\n4 5 6 {value}\n")
        with pytest.raises(ValueError, match=r"c\.pcd: expected integers of 8 bits in field 'a'"):
            read_pcd(path)

    @pytest.mark.parametrize("points", [2, 10**15])
    def test_binary_that_is_too_short(self, tmp_path, points):
        path, header = (
            tmp_path / "c.pcd",
            HEADER.replace("WIDTH 2", f"WIDTH {points}").replace("POINTS 2", f"POINTS {points}"),
        )
        path.write_bytes(header.encode() + b"binary\n" + bytes(23))
        with pytest.raises(ValueError, match=f"c\\.pcd: truncated: {points} points take {12 * points} bytes, got 23"):
            read_pcd(path)

    @pytest.mark.parametrize(
        ("sizes", "message"),
        [
            ((4, 25), "expected 24 bytes of 2 points, got 25"),
            ((40, 24), "truncated: 2 points take 40 bytes, got 26"),
            ((26, 24), "damaged: expected 24 bytes of LZF data, got 24"),
            ((24, 24), "damaged: expected 24 bytes of LZF data, got 23"),
        ],
    )
    def test_compressed_sizes_that_are_wrong(self, tmp_path, sizes, message):
        path = tmp_path / "c.pcd"
        path.write_bytes(HEADER.encode() + b"binary_compressed\n" + struct.pack("<II", *sizes) + b"\x17" + bytes(25))
        with pytest.raises(ValueError, match=f"c\\.pcd: {message}"):
            read_pcd(path)

    def test_other_files(self, tmp_path):
        for content in (b"", b"ply\n", bytes(100_000), b"DATA ascii\n"):
            (tmp_path / "c.pcd").write_bytes(content)
            with pytest.raises(ValueError, match=r"c\.pcd: not a PCD file"):
                read_pcd(tmp_path / "c.pcd")
        with pytest.raises(FileNotFoundError, match=r"d\.pcd: missing"):
            read_pcd(tmp_path / "d.pcd")


def test_a_real_file_is_read_quickly(shared):
    start = time.perf_counter()
    cloud = read_pcd(shared / "data" / "mosd" / "learn10.pcd")
    assert time.perf_counter() - start < 60  # 0.3 s where nothing else runs; one value at a time takes minutes
    assert list(cloud.fields) == ["label", "x", "y", "z", "rgba"]
    assert (cloud.width, cloud.height) == (640, 480)
