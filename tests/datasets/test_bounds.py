"""Files of a few bytes that would fill the memory, take a minute or run a program: quick errors, each from a bound."""

import json
import os
import re
import struct
import sys
import tracemalloc
from contextlib import nullcontext, suppress

import bombs
import numpy as np
import pytest
import samples
import torch
import traps

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.meshes import bound_textures
from torchjoint.datasets.files.ply import read_ply
from torchjoint.datasets.files.readers import decode_image
from torchjoint.masks.rle import polygon_pixels
from torchjoint.runtime import bounds
from torchjoint.viewer.truth import read_labelled_cloud

#: What a program would be started with.
PROGRAMS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.startfile", "os.fork", "os.forkpty")
STARTED: list[str] = []
WATCHED = False


def watch(event, _):
    if WATCHED and event in PROGRAMS:
        STARTED.append(event)
        raise AssertionError(f"a program is started: {event}")


@pytest.fixture
def no_program(monkeypatch):
    """Any program that is started is an error."""
    if not hasattr(sys, "_torchjoint_watch"):
        sys.addaudithook(watch)
        sys._torchjoint_watch = True
    STARTED.clear()
    monkeypatch.setattr(sys.modules[__name__], "WATCHED", True)
    yield
    assert STARTED == []


@pytest.mark.parametrize("name", bombs.BOMBS)
def test_the_error_comes_from_a_bound(name, tmp_path, no_program):
    bomb = bombs.BOMBS[name]
    path = tmp_path / f"file{bomb.suffix}"
    path.write_bytes(bomb.content)
    tracemalloc.start()
    try:
        with traps.ends(), pytest.raises((ValueError, TypeError), match=bomb.message) as caught:
            bomb.read(path)
        assert tracemalloc.get_traced_memory()[1] < 700_000_000 + 8 * len(bomb.content)
    finally:
        tracemalloc.stop()
    assert path.name in str(caught.value)


def test_the_table_has_every_kind():
    assert {bomb.kind for bomb in bombs.BOMBS.values()} == {"count", "size", "depth", "sum", "program"}


def test_the_watch_sees_a_program(no_program):
    with pytest.raises(AssertionError, match="a program is started"):
        os.posix_spawn("/bin/true", ["/bin/true"], {})
    assert STARTED.pop() == "os.posix_spawn"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", samples.FORMATS)
def test_eps_in_the_place_of_any_file(name, tmp_path, monkeypatch, no_program):
    monkeypatch.setenv("TORCHJOINT_CACHE", "")
    path = samples.write(name, tmp_path / "sample")
    before = traps.content_of(path)
    for file in sorted(file for file in (tmp_path / "sample").rglob("*") if file.is_file()):
        whole = file.read_bytes()
        file.write_bytes(bombs.EPS)
        with traps.ends(), suppress(ValueError, FileNotFoundError, TypeError):
            assert traps.same(traps.content_of(path), before), file
        file.write_bytes(whole)


def test_the_texture_of_a_mesh(tmp_path, no_program):
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    for texture in ("a.png", "a.mtl"):
        (tmp_path / "a.mtl").write_bytes(bombs.EPS + b"\nnewmtl m\nmap_Kd " + texture.encode() + b"\n")
        (tmp_path / "a.png").write_bytes(bombs.EPS)
        with traps.ends(), pytest.raises(ValueError, match=r"a\.obj: not a whole \.obj mesh"):
            read_cloud_file(tmp_path / "a.obj")
    assert STARTED == []


@pytest.mark.parametrize("read", [read_cloud_file, read_labelled_cloud])
def test_a_picture_in_a_chunk_that_the_spec_does_not_know(read, tmp_path, no_program):
    """trimesh counts a second chunk of bytes as a buffer: the last one of them."""
    plain = bombs.png(4, 4, rows=bytes(20))
    size = max(len(plain), len(bombs.EPS))
    tree = json.loads(bombs.gltf(3, 1, bytes(36)))
    tree["buffers"] = [{"byteLength": size + 36}]
    tree["bufferViews"] = [{"buffer": 0, "byteOffset": size, "byteLength": 36}, {"buffer": -1, "byteLength": size}]
    tree["images"] = [{"bufferView": 1, "mimeType": "image/png"}]
    tree |= {"textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    tree["accessors"].append({"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"})
    tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}]
    binary = plain.ljust(size, b"\0") + bytes(36)
    chunks = ((b"JSON", json.dumps(tree).encode()), (b"BIN\0", binary), (b"BIN\0", bombs.EPS.ljust(size)))
    content = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
    (tmp_path / "a.glb").write_bytes(b"glTF" + struct.pack("<2I", 2, 12 + len(content)) + content)
    with traps.ends(), pytest.raises(ValueError, match="expected one of PNG, JPEG"):
        read(tmp_path / "a.glb")
    assert STARTED == []


@pytest.mark.parametrize("trap", traps.TRAPS)
def test_parts_of_a_mesh(trap, tmp_path):
    (tmp_path / "a b.bin").write_bytes(np.eye(3, dtype=np.float32).tobytes())
    tree = json.loads(bombs.gltf(3, 1, bytes(36)))
    tree["buffers"][0]["uri"] = "a%20b.bin"  # as Blender writes it
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    assert len(read_cloud_file(tmp_path / "a.gltf").points) == 3
    with traps.trapped(tmp_path / "a b.bin", trap), traps.ends(), pytest.raises(ValueError, match="cannot be read"):
        read_cloud_file(tmp_path / "a.gltf")


class TestLittleMemory:
    def test_lists_of_unequal_length(self, tmp_path):
        count = 50_000
        body = np.zeros((3, 3), "<f4").tobytes() + b"\x00\x01\x00" * (count // 2)
        lines = (*bombs.VERTEX, "element face " + str(count), "property list uchar uchar vertex_indices")
        lines = ("element vertex 3", *lines[1:])
        (tmp_path / "a.ply").write_bytes(bombs.ply(*lines, body=body))
        tracemalloc.start()
        try:
            assert read_ply(tmp_path / "a.ply").faces is None
            assert tracemalloc.get_traced_memory()[1] < 100 * len(body)
        finally:
            tracemalloc.stop()

    @pytest.mark.parametrize("encoding", ["ascii", "binary_big_endian"])
    def test_polygons_of_several_lengths(self, tmp_path, encoding):
        lines = ("element vertex 5", *bombs.VERTEX[1:], "element face 3", "property list uchar int vertex_indices")
        order = ">" if "big" in encoding else "<"
        points = np.arange(15).reshape(5, 3)
        faces = [[0, 1, 2], [1, 2, 3, 4], [0, 2]]
        if encoding == "ascii":
            rows = [*points.tolist(), *([len(face), *face] for face in faces)]
            body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
        else:
            body = points.astype(f"{order}f4").tobytes()
            body += b"".join(bytes([len(face)]) + np.array(face, f"{order}i4").tobytes() for face in faces)
        (tmp_path / "a.ply").write_bytes(bombs.ply(*lines, body=body, encoding=encoding))
        assert read_ply(tmp_path / "a.ply").faces.tolist() == [[0, 1, 2], [1, 2, 3], [1, 3, 4]]

    @pytest.mark.parametrize(
        ("suffix", "content"),
        [(".ply", bombs.ply(f"comment {'in ' * 50_000}", "element vertex 1", *bombs.VERTEX[1:], body=b"\0" * 12)),
         (".xyz", b"#" + b"(" * 300_000 + b"\n1 2 3\n"), (".obj", b"\n" * 300_000 + b"v 1 2 3\n"),
         (".pcd", "\n".join(f"{number:x}" for number in range(13_000)).encode())],
    )  # fmt: skip
    def test_many_lines_and_long_ones(self, suffix, content, tmp_path):
        """Each took minutes: a search went through the rest of the file from each place."""
        (tmp_path / f"a{suffix}").write_bytes(content)
        with traps.ends(5), nullcontext() if suffix != ".pcd" else pytest.raises(ValueError, match="not a PCD file"):
            assert len(read_cloud_file(tmp_path / f"a{suffix}").points) == 1

    def test_keys_for_all_frames(self, tmp_path):
        keys = dict.fromkeys(map(str, range(3000)), 0)
        (tmp_path / "transforms.json").write_text(json.dumps(keys | {"frames": [{}] * 3000}))
        with pytest.raises(ValueError, match=r"transforms\.json: expected at most \d+ values of all frames"):
            tj.load_scene(tmp_path)

    def test_many_parts_of_one_name(self, tmp_path, monkeypatch):
        """trimesh tries all numbers for each name that is taken: 18,000 took a minute."""
        from trimesh import util
        from trimesh.scene import scene

        bound_textures()
        for module in (util, scene):
            monkeypatch.setattr(module, "unique_name", pytest.fail)
        solid = "solid\n{}endsolid\n"
        solids = (solid.format("".join(f"vertex {x} {y} {at}\n" for x, y in ("00", "10", "01"))) for at in range(9))
        (tmp_path / "a.stl").write_text("".join(solids))
        assert read_cloud_file(tmp_path / "a.stl").points[::3, 2].tolist() == list(range(9))

    def test_a_mask_of_many_large_polygons(self, tmp_path):
        """Their pixels together would take a gigabyte, and be sorted; a kilobyte of text became 16 GB."""
        corners = [[0, 0, 1500, 0, 1500, 1500, 0, 1500]] * 60
        (tmp_path / "a.json").write_bytes(bombs.coco(1500, 1600, corners))
        tracemalloc.start()
        try:
            assert bombs.read_coco(tmp_path / "a.json").areas().tolist() == [1500 * 1500]
            assert tracemalloc.get_traced_memory()[1] < 500_000_000
        finally:
            tracemalloc.stop()

    def test_masks_of_a_large_image(self, tmp_path):
        """60 small masks of 64 megapixels: a stack would take 4 GB."""
        side = bombs.SIDE
        counts = [[10 * index, 7, side * side - 10 * index - 7] for index in range(60)]
        records = [{"segmentation": {"size": [side, side], "counts": one}} for one in counts]
        (tmp_path / "a.json").write_text(json.dumps(records))
        assert tj.masks.read_masks(tmp_path / "a.json").areas().tolist() == [7] * 60

    def test_a_million_characters_of_run_lengths(self):
        text = "1" * 1_000_000  # differences of 1 to the count two places before
        with traps.ends(), pytest.raises(ValueError, match=r"expected at most \d+ pixels in all masks"):
            tj.masks.from_sam([{"segmentation": {"size": [9, 9], "counts": text}}])

    def test_a_polygon_of_many_corners(self):
        angle = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
        corners = np.stack([50 + 40 * np.cos(angle), 50 + 40 * np.sin(angle)], axis=1)
        with traps.ends():
            assert abs(len(polygon_pixels(corners, (100, 100))) - np.pi * 1600) < 50

    def test_masks_that_nest(self, monkeypatch):
        monkeypatch.setattr(bounds, "PAIRS", 1000)
        stack = torch.ones(60, 60, dtype=torch.bool).tril()[:, None]
        with pytest.raises(ValueError, match="expected at most 1000 parts of masks that lie in several masks"):
            tj.masks.from_stack(stack)

    def test_exif(self):
        data = bombs.Image.new("RGB", (4, 4))
        stream = bombs.io.BytesIO()
        data.save(stream, "PNG", exif=b"Exif\0\0MM\0*\0\0\0\x08\0\0" + bytes(1 << 17))
        with pytest.raises(ValueError, match="bytes of EXIF"):
            decode_image(stream.getvalue(), "a.png")


class TestPackedPoints:
    def test_points_in_few_bytes(self, tmp_path, monkeypatch):
        path = samples.write("cloud_alone_laz", tmp_path / "sample")
        monkeypatch.setattr(bounds, "POINTS_PER_BYTE", 0)
        monkeypatch.setattr(bounds, "FREE_POINTS", 5)
        with pytest.raises(ValueError, match=r"expected at most 5 points in \d+ bytes, got"):
            tj.load_scene(path)

    @pytest.mark.parametrize(
        "xml",
        [
            b'<!DOCTYPE e57Root SYSTEM "http://a/b">',  # the library asks the network
            b'<!ENTITY a SYSTEM "/dev/zero">        ',
            b'<e57Root xsi:schemaLocation="a http://a/b">',  # it validates, too
            b'<e57Root x:noNamespaceSchemaLocation = "b">',
            b'<?xml version="1" encoding="IBM1047"?>',
            "<?xml".encode("utf-16"),
        ],
    )
    def test_xml_of_e57(self, xml, tmp_path, monkeypatch):
        path = samples.write("cloud_alone_e57", tmp_path / "sample")
        content = path.read_bytes()
        at = content.index(b"<?xml")
        assert at % 1024 < 900
        path.write_bytes(content[:at] + xml + content[at + len(xml) :])
        monkeypatch.delattr("pye57.E57")
        with pytest.raises(ValueError, match=r"cloud\.e57: not a whole E57 file: expected XML in UTF-8 without a"):
            tj.load_scene(path)

    @pytest.mark.parametrize("number", [b"NaN", b"-INF", b"five"])
    def test_poses_of_e57_that_are_no_numbers(self, number, tmp_path):
        """The library reads them as 0: the scan came to lie elsewhere."""
        path = samples.write("cloud_alone_e57", tmp_path / "sample")
        given = re.search(rb'<x type="Float">5</x>\s*', path.read_bytes())
        changed = (b'<x type="Float">' + number + b"</x>").ljust(len(given[0]))
        path.write_bytes(given.string.replace(given[0], changed))
        with pytest.raises(ValueError, match=r"cloud\.e57: not a whole E57 file: expected poses of numbers"):
            tj.load_scene(path)

    def test_e57(self, tmp_path, monkeypatch):
        path = samples.write("cloud_alone_e57", tmp_path / "sample")
        monkeypatch.setattr(bounds, "POINTS_PER_BYTE", 0)
        monkeypatch.setattr(bounds, "FREE_POINTS", 5)
        with pytest.raises(ValueError, match=r"expected at most 5 points in \d+ bytes, got"):
            tj.load_scene(path)
        monkeypatch.setattr(bounds, "NESTED", 3)
        with pytest.raises(ValueError, match="expected at most 3 XML elements in each other, got 4"):
            tj.load_scene(path)


def test_channels_of_exr_that_nobody_wants(tmp_path, monkeypatch):
    OpenEXR = pytest.importorskip("OpenEXR")
    from torchjoint.datasets.formats.record3d import read_exr

    channels = {f"c{index:02}": np.zeros((10, 10), np.float16) for index in range(24)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
    monkeypatch.setattr(bounds, "PIXELS", 2399)
    with pytest.raises(ValueError, match="expected at most 2399 numbers in all channels, got 2400"):
        read_exr(tmp_path / "a.exr", "c00")


def test_all_readers_open_paths_in_one_way():
    """Only foreign_files.py opens a path that data may name; what is here opens what torchjoint itself wrote."""
    from pathlib import Path

    root = Path(tj.__file__).parent
    own = re.compile(r"\.(read_bytes|read_text)\(|(?<!\w)(np\.load|np\.memmap|torch\.load|json\.load)\(|Image\.open\(")
    found = {
        file.relative_to(root).as_posix()
        for folder in ("datasets", "masks", "evaluation", "live", "results", "config", "viewer")
        for file in (root / folder).rglob("*.py")
        if own.search(file.read_text())
    }
    allowed = {
        "config/config.py",  # the package's own presets
        "datasets/files/readers.py",  # with the formats that it may have
        "results/output_folder.py",  # markers of a run
        "viewer/shared_page.py",  # the package's own script
        "viewer/html.py",  # the package's own style and script
        "viewer/model.py",  # a file that it has just written
    }
    assert found <= allowed
