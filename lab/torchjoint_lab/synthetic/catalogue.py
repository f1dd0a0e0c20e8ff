"""Models of things from a folder: Sweet Home 3D catalogues (``*.sh3f``), or OBJ and GLB files."""

from __future__ import annotations

import hashlib
import re
import tempfile
import zipfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.making import made
from torchjoint_lab.synthetic.models import load_parts

_PROPERTIES = "PluginFurnitureCatalog.properties"
#: Words in the names of models that are several things, no things, or built into a house.
_NO_THINGS = (
    "plate, ", "apples", "with fruits", "with salad", "keys", "servers", "kitchen tools", "living room", "swimming",
    "parking", "crossing", "arrow", "escalator", "staircase", "switch", "plug", "socket", "curtain", "full bookcase",
    "chessboard", "shower", "rails", "tennis", "hanging", "ceiling", "pendant", "chandelier", "hood", "sneakers",
    "slippers", "shoes", "mocassin", "bootie", "wall ", "window", "door", "porch", "sidewalk", "children game",
    "fitness", "sushi", "logs", "bill ", "blind", "thermometer", "intercom", "entry ", "track lights", "sandpit",
    "diving", "jacuzzi", "rail crossing", "spotlight", "detector", "sign", "french fries", "pack", "clothes rack",
)  # fmt: skip
#: The catalogue's categories whose things somebody could put on a table or in a box.
_CARRIED = ("bathroom", "bedroom", "kitchen", "lights", "living room", "miscellaneous", "office", "")
#: Words in the names of hollow objects.
_HOLLOW = frozenset(("bowl", "cup", "mug", "glass", "basket", "pan", "bucket", "potty", "basin", "bin", "trashcan"))


class Model(NamedTuple):
    """One model of a catalogue.

    Attributes:
        name: lower case.
        kind: the last word of its name, without digits: what is held out together.
        category: the catalogue's, lower case; "" for plain files.
        archive: the catalogue, or None for plain files.
        path: of the model's file, within the archive or absolute.
        size: (width, depth, height) metres; None: as the file has it.
        turn: nine numbers, the rotation that makes it y-up; None: none.
    """

    name: str
    kind: str
    category: str
    archive: str | None
    path: str
    size: tuple[float, float, float] | None
    turn: tuple[float, ...] | None


def is_held_out(kind: str) -> bool:
    """Whether a kind of things is kept for checking: a fifth of them are, by a fixed hash of the word."""
    return int.from_bytes(hashlib.sha256(kind.encode()).digest()[:4], "big") % 5 == 0


class Catalogue:
    """The models of a folder that are one thing each.

    Args:
        folder: has ``*.sh3f``, ``*.obj`` or ``*.glb`` files. OBJ and GLB are y-up, in metres; the name of their
            folder is what kind of thing they are, or their own name where they are not in one.
        held_out: keeps only the kinds that :func:`is_held_out`; False keeps only the others.

    Raises:
        ValueError: if the folder has no such file, or none of its models is left.
    """

    def __init__(self, folder: Path | str, held_out: bool = False) -> None:
        found = [model for model in _listed(str(folder)) if is_held_out(model.kind) == held_out]
        self.models = [model for model in found if not any(word in model.name for word in _NO_THINGS)]
        if not self.models:
            raise ValueError(f"models: expected a folder with .sh3f, .obj or .glb files, got none of use in {folder}")

    def draw(
        self, rng: Rng, longest: tuple[float, float], kinds: Sequence[str] = (), carried: bool = False
    ) -> Item | None:
        """A model whose longest side is within ``longest`` metres, or None if there is none.

        Args:
            rng: draws it.
            longest: least and greatest.
            kinds: words of which its name must have one; empty: any name.
            carried: only what somebody could carry.
        """
        fitting = [model for model in self.models if _fits(model, longest, kinds, carried)]
        for index in rng.integers(0, max(len(fitting), 1), 4):
            if not fitting:
                return None
            model = fitting[int(index)]
            parts = _parts(model)
            if parts is None:
                continue
            item = made(model.kind, parts, hollow=not _HOLLOW.isdisjoint(model.name.split()))
            if longest[0] <= max(item.size) <= 1.1 * longest[1]:
                return item
        return None


def _fits(model: Model, longest: tuple[float, float], kinds: Sequence[str], carried: bool) -> bool:
    if model.size is not None and not longest[0] <= max(model.size) <= longest[1]:
        return False
    if carried and model.category not in _CARRIED:
        return False
    return not kinds or any(word in model.name for word in kinds)


@lru_cache(maxsize=8)
def _listed(folder: str) -> tuple[Model, ...]:
    """All models of a folder, in an order that does not depend on the file system."""
    models: list[Model] = []
    for archive in sorted(Path(folder).glob("*.sh3f")):
        models += _of_archive(archive)
    for path in sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in (".obj", ".glb")):
        inside = path.parent.name if path.parent != Path(folder) else path.stem
        models.append(Model(path.stem.lower(), _kind(inside), "", None, str(path), None, None))
    return tuple(models)


def _of_archive(archive: Path) -> list[Model]:
    with zipfile.ZipFile(archive) as file:
        text = file.read(_PROPERTIES).decode("latin-1")
    entries: dict[int, dict[str, str]] = {}
    for key, number, value in re.findall(r"^(\w+)#(\d+)\s*=\s*(.*?)\s*$", text, re.MULTILINE):
        entries.setdefault(int(number), {})[key] = value
    models = []
    for _, entry in sorted(entries.items()):
        if not {"name", "model", "width", "depth", "height"} <= entry.keys():
            continue
        size = (float(entry["width"]) / 100, float(entry["depth"]) / 100, float(entry["height"]) / 100)
        turn = tuple(float(v) for v in entry["modelRotation"].split()) if "modelRotation" in entry else None
        name = entry["name"].lower()
        path = entry["model"].lstrip("/")
        models.append(Model(name, _kind(name), entry.get("category", "").lower(), str(archive), path, size, turn))
    return models


def _kind(name: str) -> str:
    """The last word of a name, in the singular, without digits: "Coffee table 2" is a "table"."""
    words = re.findall(r"[a-z]+", name.lower().split("with")[0]) or ["thing"]
    long = [word for word in words if len(word) > 2] or words
    return long[-1].rstrip("s") or long[-1]


@lru_cache(maxsize=256)
def _parts(model: Model) -> tuple[tuple[Part, Material], ...] | None:
    """The model's triangles and materials, scaled and z-up; None if it cannot be used."""
    if model.archive is None:
        return load_parts(Path(model.path), None, None)
    with zipfile.ZipFile(model.archive) as file, tempfile.TemporaryDirectory() as folder:
        inside = model.path.rpartition("/")[0]
        names = [n for n in file.namelist() if n == model.path or (inside and n.startswith(inside + "/"))]
        file.extractall(folder, [name for name in names if not name.endswith("/")])
        turn = None if model.turn is None else np.array(model.turn).reshape(3, 3)
        return load_parts(Path(folder) / model.path, model.size, turn)
