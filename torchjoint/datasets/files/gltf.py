"""What a mesh of .gltf, .glb or .obj may have: trimesh trusts its sizes, and lets Pillow choose the decoder."""

from __future__ import annotations

import base64
import os
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from torchjoint.datasets.files.rasters import RASTERS, decode_image
from torchjoint.datasets.paths import path_inside
from torchjoint.runtime import foreign_files as bounds
from torchjoint.runtime.foreign_files import has_file, parse_json, read_file

#: Formats of textures. TGA has no mark at its start, so it is tried last.
TEXTURES = (*RASTERS, "TGA")
#: Chunks of a .glb.
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


class Parts:
    """The other files that a mesh names: trimesh's resolver. Files outside of the mesh's folder are not there.

    Args:
        path: of the mesh.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        #: The first file that is there and cannot be read: trimesh goes on without colours.
        self.error: ValueError | None = None
        self._pixels = 0
        self._names: set[str] = set()

    def get(self, name: str) -> bytes:
        """The bytes of a file.

        Raises:
            FileNotFoundError: there is no such file inside the folder.
            ValueError: it cannot be read, or is a texture of no known format.
        """
        try:
            data = self._read(name)
            # A library of materials is read once; the second time it is named as a texture.
            is_library = name.strip().lower().endswith(".mtl") and name not in self._names
            self._names.add(name)
            if self._path.suffix.lower() == ".obj" and not is_library:
                self.check_texture(data, str(self._path.parent / name))
        except ValueError as error:
            self.error = self.error or error
            raise
        return data

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def check_texture(self, data: bytes, name: str) -> None:
        """Checks a texture, and the sum of all of them; errors as of :func:`decode_image`."""
        image = decode_image(data, name, formats=TEXTURES)
        self._pixels += image.width * image.height
        bounds.check(self._pixels, bounds.TEXTURES, "pixels in all textures", name)

    def _read(self, name: str) -> bytes:
        for candidate in (name.strip(), name.strip().lstrip("/"), os.path.split(name)[-1]):
            try:
                path = path_inside(self._path.parent, candidate, str(self._path))
            except ValueError:  # it leads out of the folder
                continue
            if has_file(path):
                return read_file(path, "a part of a mesh")
        raise FileNotFoundError(f"{self._path}: {name}: missing in its folder")


def bound_textures() -> None:
    """Makes trimesh decode the textures of .obj files with our decoder; those of .gltf are checked before."""
    from trimesh.exchange import obj

    decoder = SimpleNamespace(open=lambda stream: decode_image(stream.read(), "texture", formats=TEXTURES))
    vars(obj)["Image"] = decoder


def check_obj(data: bytes, name: str) -> None:
    """Checks how long trimesh takes for the materials of an .obj; errors as of :func:`bounds.check`."""
    steps = data.count(b"usemtl") * data.count(b"\nv")
    bounds.check(steps, bounds.MATERIAL_STEPS, "vertices times materials", name)


def check_gltf(data: bytes, parts: Parts, name: str) -> None:
    """Checks the images of a .gltf or .glb, and that its numbers lie in its buffers.

    Raises:
        FileNotFoundError, ValueError: as of :meth:`Parts.get`, or there are too many numbers.
        LookupError, TypeError, struct.error: the file is damaged.
    """
    chunks = _chunks(data) if data[:4] == b"glTF" else [(_JSON, data)]
    tree = parse_json(next(chunk for kind, chunk in chunks if kind == _JSON), name)
    binary = iter([chunk for kind, chunk in chunks if kind == _BINARY])
    buffers = [_content(one, parts) if "uri" in one else next(binary, b"") for one in tree.get("buffers", ())]
    _check_numbers(tree, sum(map(len, buffers)) + len(data))
    for index, image in enumerate(tree.get("images", ())):
        if "bufferView" in image:
            view = tree["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            content = buffers[view["buffer"]][start : start + view["byteLength"]]
        else:
            content = _content(image, parts)
        parts.check_texture(content, f"{name}: image {index}")


def _check_numbers(tree: dict[str, Any], size: int) -> None:
    """Checks how many values the accessors have, and how many all meshes have together, each as often as it stands."""
    counts = [int(one["count"]) for one in tree.get("accessors", ())]
    for count in counts:
        bounds.check(count, size, "values in an accessor")
    bounds.check(sum(counts), size, "values in all accessors")
    sizes = [
        sum(counts[one] for primitive in mesh["primitives"] for one in _accessors(primitive))
        for mesh in tree.get("meshes", ())
    ]
    placed = sum(sizes[node["mesh"]] for node in tree.get("nodes", ()) if "mesh" in node)
    most = bounds.POINTS_PER_BYTE * size + bounds.INSTANCED
    bounds.check(sum(sizes), most, "values in all meshes")
    bounds.check(placed, most, "values in all places of meshes")


def _accessors(primitive: dict[str, Any]) -> list[int]:
    return [*primitive.get("attributes", {}).values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _content(one: dict[str, Any], parts: Parts) -> bytes:
    """The bytes of a buffer or an image: of a file, or of the text itself."""
    uri = one["uri"]
    place = uri.find("base64,")
    return parts.get(uri) if place < 0 else base64.b64decode(uri[place + 7 :])


def _chunks(data: bytes) -> list[tuple[int, bytes]]:
    """The chunks of a .glb: kind and bytes."""
    found, place = [], 12
    while place + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, place)
        found.append((kind, data[place + 8 : place + 8 + size]))
        place += 8 + size
    return found
