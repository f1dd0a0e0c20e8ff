"""Reads meshes, .obj, .glb, .gltf, .off and .stl, with trimesh."""

import base64
import io
import itertools
import os
import re
import struct
import warnings
from collections.abc import Callable, Sequence
from contextvars import ContextVar, copy_context
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO
from urllib.parse import unquote

import numpy as np
import torch
from PIL import Image
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.datasets.files.columns import Array, CloudFile, colors_of_all, unit_colors
from torchjoint.datasets.files.readers import RASTERS, decode_image
from torchjoint.datasets.files.text import path_inside
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import has_file, parse_json, read_file
from torchjoint.runtime.messages import needed_for

SUFFIXES = (".obj", ".glb", ".gltf", ".off", ".stl")
#: Formats of textures. TGA has no mark at its start, so it is tried last.
TEXTURES = (*RASTERS, "TGA")
#: Extensions of glTF that do not change where points are.
_LOOKS = re.compile("KHR_(materials_.*|texture_.*|lights_punctual|xmp.*|mesh_quantization)|EXT_texture_.*")
_OFF = re.compile(rb"(\s*#.*\n)*\s*(ST)?(CN?|NC?)?OFF(?!\s+BINARY)", re.IGNORECASE)
_NORMALS = re.compile(rb'^[ \t]*vn\s|"NORMAL"|^(ST)?C?NC?OFF', re.MULTILINE)
#: A transform of a texture that does not move it.
_STILL = {"offset": [0, 0], "scale": [1, 1], "rotation": 0, "texCoord": 0}
#: The types of numbers of which trimesh reads these: 8 bits, 16 bits, floating.
_KINDS = {"COLOR_0": (5121, 5123, 5126), "TEXCOORD_0": (5126,)}
#: The parts of our file that is read, if one is: a program's own use of trimesh stays as it is.
_READS = ContextVar[Any]("_READS", default=None)
#: Chunks of a .glb.
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


def read_mesh_file(path: Path) -> CloudFile:
    """Reads all meshes and points of a file as one, in the file's world frame.

    The points of an .obj are its `v` lines, those of others their vertices, in the order of the file. Colours are those
    of vertices, faces or textures; if a part has none, those of the others are not read, which a warning tells. Normals
    are not read: in many files they are those of a smooth picture. Equal vertices of an .stl are one vertex.
    """
    data, suffix, name = read_file(path, "a mesh"), path.suffix.lower(), str(path)
    if suffix in (".obj", ".off"):
        data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\t", b" ").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if suffix == ".obj":
        data = re.sub(rb"(?m)^( *(?:f|v[nt]?) [^#\n]*)#.*", rb"\1", data)  # comments behind values
        data = re.sub(rb"(?m)^ +", b"", data)
    if suffix == ".off" and not _OFF.match(data):
        raise ValueError(f"{path}: expected text that begins with OFF, COFF, NOFF or STOFF, got {data[:20]!r}")
    if suffix == ".stl" and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little") and any(data[133::50]):
        warnings.warn(f"{path}: colours of triangles are not read", stacklevel=4)
    try:
        own = _rows_of_obj(data, name) if suffix == ".obj" else _read_off(data, name) if suffix == ".off" else None
        if own is not None and (suffix == ".off" or not re.search(rb"^[ \t]*f\s", data, re.MULTILINE)):
            mesh = own
        else:
            loaded = scene_of(data, path)
            for geometry in loaded.geometry.values():
                if suffix == ".stl":
                    geometry.merge_vertices()
                _color_twice(geometry)
            mesh = _joined(loaded.dump(), name)
            if own is not None:
                mesh = _in_rows(mesh, own)._replace(faces=_faces_of_obj(data, len(own.points)))
    except MemoryError:
        raise
    except Exception as error:  # trimesh raises errors of many types for damaged files
        raise ValueError(f"{path}: not a whole {path.suffix} mesh: {error!r}"[:300]) from error
    if not len(mesh.points):
        raise ValueError(f"{path}: expected a mesh with vertices, got none")
    if mesh.faces is None and _NORMALS.search(data):
        warnings.warn(f"{path}: normals are not read of {path.suffix} files", stacklevel=4)
    if mesh.colors is None and suffix == ".obj" and b"mtllib" in data and b"usemtl" in data:
        warnings.warn(f"{path}: no colours are read: its materials are not in its first mtllib", stacklevel=4)
    low, high = (0, 0) if mesh.faces is None else map(int, mesh.faces.aminmax())
    if not 0 <= low <= high < len(mesh.points):
        raise ValueError(f"{path}: expected faces of {len(mesh.points)} vertices, got {low} to {high}")
    return mesh


def scene_of(data: bytes, path: Path) -> Any:
    """The scene that trimesh reads of the bytes of a file, after they are checked."""
    with needed_for(f"{path.suffix} files", "trimesh", "torchjoint[mesh]"):
        import trimesh
    parts, kind = MeshParts(path), path.suffix.lower()[1:]
    bound_textures()
    if kind in ("gltf", "glb"):
        check_gltf(data, parts, str(path))
    (context := copy_context()).run(_READS.set, parts)
    loaded = context.run(trimesh.load_scene, io.BytesIO(data), kind, parts, process=False)  # type: ignore[arg-type]  # it only gets
    if parts.error is not None:
        raise parts.error
    return loaded


def _joined(parts: Sequence[Any], name: str) -> CloudFile:
    """The meshes and clouds of trimesh as one."""
    points, faces, count = [], [], 0
    colors: list[tuple[str, Tensor | None]] = []
    for part in parts:
        has_faces = hasattr(part, "faces")
        if not has_faces and not hasattr(part, "colors"):
            warnings.warn(f"{name}: {part.metadata.get('name')}: lines are not read", stacklevel=5)
            continue
        if has_faces:
            has_colors, is_texture = part.visual.kind is not None, part.visual.kind == "texture"
            of_part = _of_material(part.visual, len(part.vertices)) if is_texture else part.visual.vertex_colors
            faces.append(np.asarray(part.faces, np.int64).reshape(-1, 3) + count)
        else:
            of_part, has_colors = part.colors, part.colors is not None and len(part.colors) > 0
        points.append(np.asarray(part.vertices, np.float64).reshape(-1, 3))
        count += len(points[-1])
        if len(points[-1]):
            own = unit_colors(np.asarray(of_part)[:, :3]) if has_colors and len(of_part) == len(points[-1]) else None
            colors.append((str(part.metadata.get("name")), own))
    vertices = torch.from_numpy(np.concatenate([np.empty((0, 3)), *points]))
    triangles = torch.from_numpy(np.concatenate(faces)) if any(map(len, faces)) else None
    return CloudFile(vertices, colors_of_all(colors, name, "parts"), faces=triangles)


def _color_twice(part: Any) -> None:
    """Gives a part of a .glb with a material and colours of vertices, which trimesh leaves out, their product."""
    own = getattr(part.visual, "vertex_attributes", {}).get("color")
    if own is not None:
        of_material = _of_material(part.visual, len(part.vertices))[:, :3]
        shares = own[:, :3] / (1 if own.dtype.kind == "f" else np.iinfo(own.dtype).max)
        both = (of_material * shares.clip(0, 1)).round().astype(np.uint8)
        part.visual = type(part)(part.vertices, part.faces, vertex_colors=both, process=False).visual


def _of_material(visual: Any, count: int) -> Array:
    """The colours of vertices with a texture, or of one colour, as bytes."""
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    has_texture, factor = image is not None and visual.uv is not None, getattr(material, "baseColorFactor", None)
    if not has_texture and not hasattr(material, "baseColorFactor"):
        return np.tile(material.main_color, (count, 1))
    colors = np.asarray(visual.to_color().vertex_colors) if has_texture else np.full((count, 4), 255, np.uint8)
    linear = np.asarray([255] * 4 if factor is None else factor) / 255  # in glTF only factors are linear
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (colors * curved).round().astype(np.uint8)


def _rows_of_obj(data: bytes, name: str) -> CloudFile:
    """The `v` lines of an .obj: x y z, and r g b of some programs. Seven numbers are x y z w r g b or x y z r g b a."""
    check_obj(data, name)
    rows = [line.split()[1:] for line in data.splitlines() if line.startswith(b"v ")]
    points = np.array([row[:3] for row in rows], np.float64).reshape(-1, 3)
    colors = np.array([row[3:] if len(row) == 6 else [np.nan] * 3 for row in rows], np.float64).reshape(-1, 3)
    if most := max((len(row) for row in rows if len(row) > 6), default=0):
        warnings.warn(f"{name}: {most} numbers in a row: colours are read of x y z r g b only", stacklevel=5)
    return CloudFile(torch.from_numpy(points), unit_colors(colors) if any(len(row) == 6 for row in rows) else None)


def _faces_of_obj(data: bytes, count: int) -> Tensor:
    """The triangles of the `f` lines of an .obj of `count` vertices, [F, 3]; several vertices may be at one place."""
    rows = [line.split()[1:] for line in data.replace(b"\\\n", b" ").splitlines() if line.startswith(b"f ")]
    faces = _fans([[int(corner.partition(b"/")[0]) for corner in row] for row in rows])
    return torch.where(faces < 0, faces + count, faces - 1)  # from 1 on, or back from the last one


def _fans(polygons: Sequence[Sequence[int]]) -> Tensor:
    """The triangles [F, 3] of polygons, from the first corner of each."""
    triangles = [(one[0], *edge) for one in polygons for edge in itertools.pairwise(one[1:])]
    return torch.tensor(triangles, dtype=torch.int64).reshape(-1, 3)


def _in_rows(mesh: CloudFile, own: CloudFile) -> CloudFile:
    """A mesh of an .obj with the file's rows as vertices: trimesh repeats those at seams and drops those of no face."""
    known = own.points.isfinite().all(1).nonzero().squeeze(1)
    rows = known[torch.from_numpy(cKDTree(own.points[known].numpy()).query(mesh.points.numpy())[1])]
    colors = own.colors
    if colors is None and mesh.colors is not None:
        colors = mesh.colors.new_full((len(own.points), 3), torch.nan).index_copy(0, rows, mesh.colors)
        at = cKDTree(mesh.points.numpy()).query(own.points[known].numpy())[1]  # vertices of one place, or of no face
        colors[known] = mesh.colors[torch.from_numpy(at)]
    return own._replace(colors=colors)


def _read_off(data: bytes, name: str) -> CloudFile:
    """An .off: colours stand behind the positions (and normals); those of faces are not read, which a warning tells."""
    lines = [line for line in (line.partition(b"#")[0].split() for line in data.splitlines()) if line]
    head = lines[0][0].upper()
    first = 1 if lines[0][1:] or head[-3:] != b"OFF" else 2  # the counts may stand behind the word OFF
    count, told = map(int, lines[first - 1][-3:-1])
    rows, faces = lines[first : first + count], lines[first + count :]
    if (len(rows), len(faces)) != (count, told):  # edges have no rows
        raise ValueError(f"{name}: expected {told} rows of faces, as its head tells, got {len(faces)}")
    width = min(map(len, rows), default=0)
    if any(len(face) > int(face[0]) + 1 for face in faces) or any(len(row) > width + 1 for row in rows):
        warnings.warn(f"{name}: colours of faces, and of some vertices, are not read; those of all are", stacklevel=4)
    values = np.array([row[:width] for row in rows], np.float64).reshape(len(rows), max(width, 3))
    points, values = torch.from_numpy(values[:, :3]), values[:, 3:]
    is_first = b"NC" in head and width >= 9 and bool(values[:, :3].min() >= 0) and bool(values[:, :3].max() > 1)
    values = values[:, 3 * (b"N" in head[:-3] and not is_first) :][:, :3]  # NC of some programs: colours, then normals
    triangles = _fans([[int(face[1 + at]) for at in range(int(face[0]))] for face in faces])
    colors = unit_colors(values) if values.shape[1] == 3 else None
    return CloudFile(points, colors, faces=triangles if len(triangles) else None)


class MeshParts:
    """The other files that a mesh names: trimesh's resolver. Files outside of the mesh's folder are not there.

    Args:
        path: of the mesh.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        #: The first file that is there and cannot be read: trimesh goes on without colours.
        self.error: ValueError | None = None
        self._pixels = 0
        #: For names that trimesh makes.
        self.numbers = itertools.count(1)

    def __getitem__(self, name: str) -> bytes:
        """The bytes of a file."""
        try:
            return self._read(name)
        except FileNotFoundError:
            warnings.warn(f"{self._path}: {name}: missing in its folder; colours of it are not read", stacklevel=2)
            raise
        except ValueError as error:
            self.error = self.error or error
            raise

    get = __getitem__

    def texture(self, file: BinaryIO, what: str = "texture") -> Image.Image:
        """Decodes a texture, and bounds the sum of all of them; errors as of :func:`decode_image`."""
        try:
            image = decode_image(file.read(), f"{self._path}: {what}", kinds=TEXTURES)
            self._pixels += image.width * image.height
            bounds.check(self._pixels, bounds.TEXTURES, "pixels in all textures", str(self._path))
        except ValueError as error:
            self.error = self.error or error
            raise
        return image

    def images(self, tree: dict[str, Any], views: Sequence[bytes]) -> list[Image.Image]:
        """The images of a .gltf or .glb, of the bytes that trimesh has found for them."""
        images = tree.get("images", ())
        found = [views[one["bufferView"]] if "bufferView" in one else _content(one, self) for one in images]
        return [self.texture(io.BytesIO(data), f"image {index}") for index, data in enumerate(found)]

    def _read(self, name: str) -> bytes:
        for candidate in (name.strip(), unquote(name.strip()), name.strip().lstrip("/"), os.path.split(name)[-1]):
            try:
                path = path_inside(self._path.parent, candidate, str(self._path))
            except ValueError:  # it leads out of the folder
                continue
            if has_file(path):
                return read_file(path, "a part of a mesh")
        raise FileNotFoundError(f"{self._path}: {name}: missing in its folder")


def bound_textures() -> None:
    """Makes trimesh read our files otherwise. It decodes textures with our decoder: Pillow would go by their content.

    And it divides colours of 16 bits, of which it takes the low byte. It tries all numbers for each name that is taken.
    """
    from trimesh import scene, util
    from trimesh.exchange import gltf, obj
    from trimesh.visual import color

    def in_ours(module: Any, name: str, ours: Callable[..., Any]) -> None:
        theirs = vars(module).setdefault(f"{name}_of_trimesh", vars(module)[name])
        vars(module)[name] = lambda *one, **two: (partial(ours, theirs) if _READS.get() else theirs)(*one, **two)

    def to_rgba(theirs: Callable[..., Any], colors: Any, dtype: Any = np.uint8) -> Any:
        return theirs(colors / 65535 if getattr(colors, "dtype", None) == np.uint16 else colors, dtype)

    def unique_name(theirs: Callable[..., str], start: str | None, contains: Any, counts: Any = None) -> str:
        free = (f"{start or 'geometry'}_{at}" for at in _READS.get().numbers)
        return start if start and start not in contains else next(name for name in free if name not in contains)

    in_ours(color, "to_rgba", to_rgba)
    in_ours(util, "unique_name", unique_name)
    in_ours(scene.scene, "unique_name", unique_name)
    in_ours(gltf, "_parse_textures", lambda _, tree, views, parts: parts.images(tree, views))
    vars(obj)["Image"] = SimpleNamespace(open=lambda file: getattr(_READS.get(), "texture", Image.open)(file))
    # A part with places in a texture, but without a material, has no colour; trimesh would make it grey.
    in_ours(obj, "TextureVisuals", lambda theirs, uv, material=None: material and theirs(uv, material))


def check_obj(data: bytes, name: str) -> None:
    """Checks how long trimesh takes for the materials of an .obj, and that it reads its faces as they are meant."""
    if re.search(rb"^f (?:.* )?0+(?:[/ ]|$)", data, re.MULTILINE):
        raise ValueError("expected faces of vertices from 1 on, got 0")
    if short := re.search(rb"^f(?: +[^\s\\]+){0,2} *$", data, re.MULTILINE):
        raise ValueError(f"expected faces of at least three vertices, got {short[0].decode(errors='replace')!r}")
    # trimesh counts back from the end of the file.
    if (back := re.search(rb"^f .*-", data, re.MULTILINE)) and data.rfind(b"\nv ") > back.start():
        raise ValueError("expected faces behind all vertices, where they count back (f -3 -2 -1)")
    bounds.check(data.count(b"usemtl") * data.count(b"\nv"), bounds.MATERIAL_STEPS, "vertices times materials", name)


def check_gltf(data: bytes, parts: MeshParts, name: str) -> None:
    """Checks that the numbers of a .gltf or .glb lie in its buffers, and that trimesh reads what it has."""
    chunks = _chunks(data) if data[:4] == b"glTF" else [(_JSON, data)]
    tree = parse_json(next(chunk for kind, chunk in chunks if kind == _JSON), name)
    given = tree.get("buffers", ())
    # Of other files trimesh would take other bytes for a buffer than those that are checked here.
    if sum("uri" not in one for one in given) > [kind for kind, _ in chunks[1:2]].count(_BINARY):
        raise ValueError("expected at most one buffer without uri, whose bytes are the second chunk of the file")
    buffers = [_content(one, parts) if "uri" in one else chunks[1][1] for one in given]
    _check_numbers(tree, sum(map(len, buffers)) + len(data))
    _check_ways(tree.get("nodes", ()))
    _check_kinds(tree, name)


def _check_kinds(tree: dict[str, Any], name: str) -> None:
    """Checks that trimesh reads all points as they are meant: what it does not know it leaves out, or takes for 0."""
    unknown = {f"extension {one}" for one in tree.get("extensionsRequired", ()) if not _LOOKS.fullmatch(one)}
    primitives, nodes = [one for mesh in tree.get("meshes", ()) for one in mesh["primitives"]], tree.get("nodes", ())
    used = [[tree["accessors"][at] for at in _accessors(one)] for one in primitives]
    named = [{key: tree["accessors"][at] for key, at in one["attributes"].items()} for one in primitives]
    kinds = [(key, one[key]["componentType"]) for one in named for key in _KINDS.keys() & one.keys()]
    found = {
        "skins": any("skin" in node for node in nodes),
        "many instances of a node": any("EXT_mesh_gpu_instancing" in node.get("extensions", ()) for node in nodes),
        "weights of morph targets": any(any(one.get("weights", ())) for one in (*tree.get("meshes", ()), *nodes)),
        "textures that are moved": any(map(_is_moved, tree.get("materials", ()))),
        "sparse accessors": any("sparse" in one for of_one in used for one in of_one),
        "accessors without data": any("bufferView" not in one for of_one in used for one in of_one),
        "attributes of several lengths": any(len({one["count"] for one in of_one.values()}) > 1 for of_one in named),
        "odd integers as colours or places in textures": any(kind not in _KINDS[key] for key, kind in kinds),
        "fans of triangles": any(one.get("mode") == 6 for one in primitives),
        "normalized positions": any(one["POSITION"].get("normalized") for one in named),
        "positions that are no triples": any(one["POSITION"]["type"] != "VEC3" for one in named),
    }
    unknown |= {what for what, is_there in found.items() if is_there}
    for _ in (one for one in primitives if one.get("mode") in (2, 3)):
        warnings.warn(f"{name}: lines are not read", stacklevel=5)
    if unknown:
        raise ValueError(f"expected a plain mesh, got {', '.join(sorted(unknown))}; save it without")
    if len(tree.get("scenes", ())) > 1:
        warnings.warn(f"{name}: of {len(tree['scenes'])} scenes only one is read", stacklevel=5)


def _is_moved(material: dict[str, Any]) -> bool:
    """Whether a texture is not where TEXCOORD_0 has it."""
    texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
    given = texture | texture.get("extensions", {}).get("KHR_texture_transform", {})
    return any(given.get(key, still) != still for key, still in _STILL.items())


def _check_numbers(tree: dict[str, Any], size: int) -> None:
    """Checks how many values the accessors have, and how many all meshes have together, each as often as it stands."""
    counts = [int(one["count"]) for one in tree.get("accessors", ())]
    bounds.check(max(counts, default=0), size, "values in an accessor")
    bounds.check(sum(counts), size, "values in all accessors")
    sizes = [sum(counts[at] for one in mesh["primitives"] for at in _accessors(one)) for mesh in tree.get("meshes", ())]
    placed = sum(sizes[node["mesh"]] for node in tree.get("nodes", ()) if "mesh" in node)
    most = bounds.POINTS_PER_BYTE * size + bounds.INSTANCED
    bounds.check(sum(sizes), most, "values in all meshes")
    bounds.check(placed, most, "values in all places of meshes")


def _check_ways(nodes: Sequence[dict[str, Any]]) -> None:
    """Checks how many nodes stand above meshes, each as often as trimesh walks by it."""
    parent = {child: at for at, node in enumerate(nodes) for child in node.get("children", ())}
    below, steps = [at for at, node in enumerate(nodes) if "mesh" in node], 0
    while below:
        steps += len(below)
        bounds.check(steps, bounds.NODE_STEPS, "nodes above meshes")
        below = [parent[at] for at in below if at in parent]


def _accessors(primitive: dict[str, Any]) -> list[int]:
    return [*primitive.get("attributes", {}).values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _content(one: dict[str, Any], parts: MeshParts) -> bytes:
    """The bytes of a buffer or an image: of a file, or of the text itself."""
    _, mark, text = one["uri"].partition("base64,")
    return base64.b64decode(text) if mark else parts.get(one["uri"])


def _chunks(data: bytes) -> list[tuple[int, bytes]]:
    """The chunks of a .glb: kind and bytes."""
    found, place = [], 12
    while place + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, place)
        found.append((kind, data[place + 8 : place + 8 + size]))
        place += 8 + size
    return found
