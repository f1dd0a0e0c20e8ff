"""Files of a few bytes that declare, or unpack to, gigabytes, or take a minute: formats x what is too much.

Each entry of `BOMBS` writes a file below a folder and reads it; the error must come from a bound. benchmarks/fuzz.py
reads them, too.
"""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.mat_files import read_matrices
from torchjoint.datasets.files.readers import read_array, read_depth, read_image, read_label_image

#: What an EPS file has in it: Ghostscript would run it.
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n(run) print\n{} loop\n%%EOF\n"
SIDE = 8000  # 64 megapixels
Write = Callable[[Path], object]


class Bomb(NamedTuple):
    """A file, what reads it, and what the error says."""

    kind: str  #: count, size, depth, sum or program
    suffix: str
    content: bytes
    read: Callable[[Path], Any]
    message: str


def npy(shape: tuple[int, ...], dtype: str, data: bytes = b"") -> bytes:
    """The bytes of a .npy file whose header says anything."""
    header = repr({"descr": dtype, "fortran_order": False, "shape": shape}).encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def npz(**arrays: bytes) -> bytes:
    """The bytes of an archive of .npy files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def saved(**arrays: np.ndarray) -> bytes:
    return npz(**{name: npy(array.shape, array.dtype.str, array.tobytes()) for name, array in arrays.items()})


def rle(count: int, side: int, inside: bool) -> bytes:
    counts = [0, side * side] if inside else [side * side]
    return json.dumps([{"segmentation": {"size": [side, side], "counts": counts}}] * count).encode()


def gltf(count: int, places: int = 0, data: bytes | None = None, **more: Any) -> bytes:
    """A mesh whose accessor has `count` values, at so many places."""
    accessor: dict[str, Any] = {"componentType": 5126, "count": count, "type": "VEC3"}
    tree: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [accessor], "bufferViews": []}
    if data is not None:
        accessor["bufferView"] = 0
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        tree |= {"buffers": [{"byteLength": len(data), "uri": uri}]}
        tree["bufferViews"] = [{"buffer": 0, "byteLength": len(data)}]
    nodes = [{"mesh": 0}] * max(places, 1)
    tree |= {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": nodes}
    return json.dumps(tree | {"scenes": [{"nodes": list(range(len(nodes)))}], "scene": 0} | more).encode()


def jpeg_of_scans(count: int, side: int) -> bytes:
    """A progressive JPEG, whose last scan stands there so often."""
    stream = io.BytesIO()
    Image.new("L", (8, 8)).save(stream, "JPEG", progressive=True)
    data = stream.getvalue()
    size, last = data.index(b"\xff\xc2") + 5, data.rindex(b"\xff\xda")
    head = data[:size] + struct.pack(">2H", side, side) + data[size + 4 : last]
    return head + data[last:-2] * count + data[-2:]


def glb_of_two() -> bytes:
    """A mesh with a picture in its second buffer, for which trimesh takes the last chunk: EPS."""
    triangle, plain = bytes(60), png(4, 4, rows=bytes(20))
    size = 60 + max(len(plain), len(EPS))
    link = "base64," + base64.b64encode((triangle + plain).ljust(size, b"\0")).decode()
    places = ((0, 0, 36), (0, 36, 24), (1, 60, size - 60))
    tree = json.loads(gltf(3, 1, triangle)) | {
        "buffers": [{"byteLength": size}, {"byteLength": size, "uri": link}],
        "bufferViews": [{"buffer": one, "byteOffset": at, "byteLength": long} for one, at, long in places],
        "images": [{"bufferView": 2, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }
    tree["accessors"].append({"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"})
    tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}]
    chunks = ((b"JSON", json.dumps(tree).encode()), (b"mine", b""), (b"BIN\0", (triangle + EPS).ljust(size)))
    content = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
    return b"glTF" + struct.pack("<2I", 2, 12 + len(content)) + content


def ply(*lines: str, body: bytes = b"", encoding: str = "binary_little_endian") -> bytes:
    return "\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header", ""]).encode() + body


def mat(count: int) -> bytes:
    """So many packed matrices of zeros of 16 megapixels."""
    shape = (4096, 4096)
    name = b"abcdefgh"
    parts = struct.pack("<4I", 6, 8, 6, 0) + struct.pack("<2I2i", 5, 8, *shape) + struct.pack("<2I", 1, 8) + name
    numbers = struct.pack("<2I", 9, 8 * shape[0] * shape[1])
    packer = zlib.compressobj(1)
    packed = packer.compress(struct.pack("<2I", 14, 0) + parts + numbers)
    for _ in range(128):
        packed += packer.compress(bytes(1 << 20))
    packed += packer.flush()
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + (struct.pack("<2I", 15, len(packed)) + packed) * count


def picture() -> str:
    """An image of 64 megapixels in a link."""
    stream = io.BytesIO()
    Image.new("1", (SIDE, SIDE)).save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def png(width: int, height: int, bits: int = 8, rows: bytes = b"") -> bytes:
    """A grey image of any size in its header."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">2I5B", width, height, bits, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def tiff() -> bytes:
    stream = io.BytesIO()
    Image.new("L", (4, 4)).save(stream, "TIFF")
    return stream.getvalue()


def coco(height: int, width: int, segmentation: Any, count: int = 1) -> bytes:
    image = {"id": 1, "file_name": "a.jpg", "height": height, "width": width}
    annotations = [{"image_id": 1, "segmentation": segmentation}] * count
    return json.dumps({"images": [image], "annotations": annotations}).encode()


def read_coco(path: Path) -> Any:
    from torchjoint.masks.coco import CocoFile

    return CocoFile(path).read("a")


def read_yaml(path: Path) -> Any:
    return tj.Config.from_preset(str(path))


VERTEX = ("element vertex 1", "property float x", "property float y", "property float z")
MASKS = tj.masks.read_masks
PICTURE = picture()
NESTED = [[0] * index + [1] * (3000 - index) for index in range(3000)]

BOMBS: dict[str, Bomb] = {
    "texts of no length": Bomb("count", ".npy", npy((10**9,), "<U0"), read_array, "expected numbers, or texts"),
    "bytes of no length": Bomb("count", ".npy", npy((10**9,), "|S0"), read_array, "expected numbers, or texts"),
    "records of no length": Bomb("count", ".npy", npy((10**9,), "|V0"), read_array, "expected numbers, or texts"),
    "array": Bomb("size", ".npy", npy((10**9, 3), "<f8"), read_array, "a shape that fits"),
    "array of negative size": Bomb("size", ".npy", npy((-1, -(10**9)), "<f8"), read_array, "a shape that fits"),
    "cloud of no length": Bomb("count", ".npz", npz(points=npy((10**9, 3), "<U0")), read_cloud_file, "or texts"),
    "points that are packed": Bomb(
        "count", ".npz", saved(points=np.zeros((10**7, 3), np.uint8)), read_cloud_file, "points in .* bytes"
    ),
    "triangles that are packed": Bomb(
        "count",
        ".npz",
        saved(points=np.zeros((3, 3)), faces=np.zeros((10**7, 3), np.uint8)),
        read_cloud_file,
        "points in .* bytes",
    ),
    "names of no length": Bomb(
        "count",
        ".npz",
        npz(
            atom=npy((1, 1), "<i4", bytes(4)),
            pairs=npy((2, 0), "<i8"),
            mask_scores=npy((0,), "<f4"),
            names=npy((10**9,), "<U0"),
        ),
        MASKS,
        "expected numbers, or texts",
    ),
    "names of masks": Bomb(
        "count",
        ".npz",
        saved(
            atom=np.zeros((1, 1), np.int32),
            pairs=np.zeros((2, 0), np.int64),
            mask_scores=np.zeros(0, np.float32),
            names=np.zeros(10**6, "U1"),
        ),
        MASKS,
        "expected at most 65536 names",
    ),
    "atoms": Bomb(
        "count",
        ".npz",
        saved(
            atom=np.full((1, 1), 2**31 - 1, np.int32),
            pairs=np.zeros((2, 0), np.int64),
            mask_scores=np.zeros(0, np.float32),
        ),
        MASKS,
        "atom: expected numbers from 0, at most one for each pixel",
    ),
    "label map": Bomb("size", ".npz", saved(masks=np.zeros((30000, 3000), np.uint8)), MASKS, "are too many"),
    "unsigned labels": Bomb(
        "size", ".npz", saved(masks=np.full((2, 2), 2**63, np.uint64)), MASKS, "expected integers below 2"
    ),
    "unsigned array": Bomb(
        "size", ".npy", npy((1,), "<u8", struct.pack("<Q", 2**63)), read_array, "expected integers below 2"
    ),
    "run lengths, sum": Bomb("sum", ".json", rle(60, SIDE, True), MASKS, "pixels in all masks"),
    "run lengths, size": Bomb("size", ".json", rle(1, 60000, False), MASKS, "are too many"),
    "size of SAM": Bomb(
        "size", ".json", b'{"image":{"height":60000,"width":60000},"annotations":[]}', MASKS, "are too many"
    ),
    "size of COCO": Bomb("size", ".json", coco(60000, 60000, [[0, 0, 9, 0, 9, 9]]), read_coco, "are too many"),
    "negative size": Bomb("size", ".json", coco(-6, -6, [[0, 0, 9, 0, 9, 9]]), read_coco, "are too many"),
    "polygons around much": Bomb(
        "sum", ".json", coco(SIDE, SIDE, [[0, 0, SIDE, 0, SIDE, SIDE]] * 40), read_coco, "pixels around polygons"
    ),
    "edges over many rows": Bomb(
        "sum", ".json", coco(SIDE, 9, [[0, 0, 8, SIDE] * 5000]), read_coco, "rows of all edges"
    ),
    "masks around much": Bomb(
        "sum", ".json", coco(SIDE, SIDE, [[0, 0, SIDE, SIDE, 0, 0]], 40), read_coco, "pixels around polygons"
    ),
    "edges in several masks": Bomb(
        "sum", ".json", coco(SIDE, SIDE, [[0, 0, 8, SIDE] * 500], 20), read_coco, "rows of all edges"
    ),
    "far corners": Bomb("size", ".json", coco(9, 9, [[0, 0, 1e300, 0, 9, -1e300]]), read_coco, "finite corners"),
    "deep JSON": Bomb("depth", ".json", b"[" * 100_000 + b"]" * 100_000, MASKS, "not a whole JSON file"),
    "many values": Bomb("count", ".json", b"[" + b"[]," * (1 << 23) + b"[]]", MASKS, "values"),
    "ids beyond 64 bits": Bomb(
        "size",
        ".json",
        coco(2, 2, [[0, 0, 2, 0, 2, 2]]).replace(b'"image_id": 1', b'"image_id": 1, "id": %d' % 2**70),
        read_coco,
        "ids: expected integers of 64 bits",
    ),
    "accessor without data": Bomb("count", ".gltf", gltf(10**9), read_cloud_file, "values in an accessor"),
    "negative accessor": Bomb("count", ".gltf", gltf(-5), read_cloud_file, "values in an accessor"),
    "mesh at many places": Bomb(
        "sum", ".gltf", gltf(3000, 20000, bytes(36000)), read_cloud_file, "values in all places of meshes"
    ),
    "nodes in each other": Bomb(
        "depth",
        ".gltf",
        gltf(3, 1, bytes(36), nodes=[{"mesh": 0, "children": [at]} for at in range(1, 3000)] + [{"mesh": 0}]),
        read_cloud_file,
        "nodes above meshes",
    ),
    "image of a mesh": Bomb(
        "program",
        ".gltf",
        gltf(3, 1, bytes(36), images=[{"uri": "data:image/png;base64,JSFQUw=="}]),
        read_cloud_file,
        "expected one of PNG, JPEG",
    ),
    "image that trimesh finds elsewhere": Bomb(
        "program", ".glb", glb_of_two(), read_cloud_file, "at most one buffer without uri"
    ),
    "textures of a mesh": Bomb(
        "sum", ".gltf", gltf(3, 1, bytes(36), images=[{"uri": PICTURE}] * 20), read_cloud_file, "pixels in all textures"
    ),
    "materials": Bomb(
        "sum",
        ".obj",
        b"\nv 0 0 0" * 200_000 + b"".join(b"\nusemtl m%d\nf 1 2 3" % i for i in range(20_000)),
        read_cloud_file,
        "vertices times materials",
    ),
    "elements": Bomb(
        "count", ".ply", ply(*VERTEX, *(f"element e{i} 0" for i in range(40_000))), read_cloud_file, "at most 256 elem"
    ),
    "properties": Bomb(
        "count",
        ".ply",
        ply("element vertex 1", *(f"property float p{i}" for i in range(40_000))),
        read_cloud_file,
        "at most 4096 properties",
    ),
    "rows": Bomb("count", ".ply", ply("element vertex 999999999999", *VERTEX[1:]), read_cloud_file, "truncated"),
    "matrices": Bomb("sum", ".mat", mat(5), lambda path: read_matrices(path, 64_000_000), "more than expected"),
    "image": Bomb("size", ".png", png(60000, 60000), read_image, "are too many|exceeds limit"),
    "image that is EPS": Bomb("program", ".png", EPS, read_image, "expected one of PNG, JPEG"),
    "depth that is EPS": Bomb("program", ".png", EPS, read_depth, "expected one of PNG, JPEG"),
    "labels that are EPS": Bomb("program", ".png", EPS, read_label_image, "expected one of PNG, JPEG"),
    "masks that are EPS": Bomb("program", ".png", EPS, MASKS, "expected one of PNG, JPEG"),
    "JPEG of many scans": Bomb("sum", ".jpg", jpeg_of_scans(300, 8000), read_image, "pixels in all scans"),
    "image that is TIFF": Bomb("program", ".jpg", tiff(), read_image, "expected one of PNG, JPEG"),
    "YAML of one hash": Bomb(
        "count", ".yaml", b"".join(b"%d: 1\n" % (i * (2**61 - 1)) for i in range(999)), read_yaml, "at most 19 digits"
    ),
    "YAML": Bomb("size", ".yaml", b"#" * (1 << 22) + b"\n{}", read_yaml, "bytes of"),
}
