"""Tampered results for benchmarks/fuzz.py: each is read as it was written, or is a clear error.

A case changes the folder of a result once or twice: bytes of a file, its values, files that are lost, exchanged, added
or of another level, or corrections. Whatever comes out without an error must be, to the last bit, what the run wrote;
corrections may join and split it, but not change what lies in one piece. Every third case has no manifest, as a result
of version 0.1.0: then what is read may differ, but must hang together. Each case also makes the name of a file from any
text; it must stay in its folder.
"""

from __future__ import annotations

import io
import json
import shutil
import warnings
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from fuzz_files import CLEAR, FindingError
from torch import Tensor

import torchjoint as tj
from torchjoint.results.folder import write_result
from torchjoint.results.manifest import manifest_checksum
from torchjoint.runtime.files import LONGEST, file_name

#: Parts of names that a stranger may give.
PARTS = (
    "..",
    ".",
    "/",
    "\\",
    "\0",
    "\n",
    "\ud800",
    "a",
    "frame",
    "ü",
    "%2F",
    " ",
    "~",
    "$(x)",
    "n" * 120,
    "-",
    "=",
    "|",
)
#: Numbers and other values for JSON, YAML and arrays.
ODD = (True, None, -1, -5, 1.9, "12", 2**31, 3_000_000_000, 2**62, float("inf"), float("nan"), [], {}, "x" * 300, 0, 1)


class Results:
    """Two levels of a result; the first one is tampered with.

    Args:
        folder: where they are written.
    """

    def __init__(self, folder: Path) -> None:
        scene = tj.synthetic.make_scene(seed=3, num_points=400, num_views=2, height=48, width=64).scene
        segmenter = tj.JointSegmenter(tj.Config().set(["boundary.detector=gradient"]))
        result = segmenter(scene)
        self.root, self.other = folder / "result", folder / "other"
        for place, level in ((self.root, 0.5), (self.other, 0.9)):
            place.mkdir(parents=True)
            write_result(place, scene, result.at(level), segmenter.config, "fuzz", level)
            for name in ("overview.png", "points.ply"):
                (place / name).unlink()
            shutil.rmtree(place / "images_color")
        self.files = {path.relative_to(self.root): path.read_bytes() for path in files_below(self.root)}
        self.intact = read_all(self.root)

    def restore(self) -> None:
        """Writes the first result again."""
        shutil.rmtree(self.root)
        for name, content in self.files.items():
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            (self.root / name).write_bytes(content)


def files_below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def read_all(folder: Path) -> dict[str, Tensor]:
    """Everything that a result has."""
    result = tj.load_result(folder)
    content = {"labels": result.points, "points": result.scene.points}
    if result.hierarchy is not None:
        content |= {"pieces": result.hierarchy.superpoint, "finest": result.at(1.0).points}
    for index, name in enumerate(result.names):
        content[f"labels of {name}"] = result.images[index]
        if len(result.superpoint_images):
            content[f"superpoints of {name}"] = result.superpoint_images[index]
    for frame in result.scene.frames:
        content |= {f"image {frame.name}": frame.image, f"pose {frame.name}": frame.world_to_camera}
    if int(result.points.max()) >= len(result.points) or int(result.points.min()) < 0:
        raise FindingError("labels that cannot be")
    return content


def change_bytes(results: Results, file: Path, rng: np.random.Generator) -> None:
    from damage import damage

    file.write_bytes(damage(file.read_bytes(), rng))


def change_values(results: Results, file: Path, rng: np.random.Generator) -> None:
    """Writes whole files with other values."""
    odd = ODD[rng.integers(len(ODD))]
    if file.suffix == ".npz":
        with np.load(file) as stored:
            arrays = dict(stored)
        name = sorted(arrays)[rng.integers(len(arrays))]
        array = np.array(arrays[name])
        if rng.integers(2) and array.size:
            changed = array.astype([np.float32, np.int64, np.float64][rng.integers(3)])
            value = odd if isinstance(odd, (int, float)) else 7
            with np.errstate(all="ignore"):
                place = rng.integers(changed.size)
                changed.reshape(-1)[place] = np.array(value, dtype=np.float64).astype(changed.dtype)
            array = changed
        else:
            array = [array[:-1] if array.ndim else array, array * 0, array[None], array.astype("U9")][rng.integers(4)]
        np.savez(file, **(arrays | {name: array}))
    elif file.suffix in (".json", ".yaml"):
        text = file.read_text()
        record = json.loads(text) if file.suffix == ".json" else yaml.safe_load(text)
        change_record(record, odd, rng)
        file.write_text(json.dumps(record) if file.suffix == ".json" else yaml.safe_dump(record, sort_keys=False))
    else:
        from PIL import Image

        image = np.array(Image.open(io.BytesIO(file.read_bytes())))
        image = [image[:-1], image[::-1], image * 0, image + 1, np.repeat(image, 2, 0)][rng.integers(5)]
        Image.fromarray(np.ascontiguousarray(image)).save(file)


def change_record(record: Any, odd: Any, rng: np.random.Generator) -> None:
    """Replaces one value, at any depth."""
    keys = list(record) if isinstance(record, dict) else list(range(len(record)))
    if not keys:
        return
    key = keys[rng.integers(len(keys))]
    if isinstance(record[key], dict | list) and record[key] and rng.integers(4):
        change_record(record[key], odd, rng)
    elif rng.integers(5):
        record[key] = odd
    else:
        del record[key]


def lose(results: Results, file: Path, rng: np.random.Generator) -> None:
    shutil.rmtree(file.parent) if file.parent != results.root and rng.integers(2) else file.unlink()


def exchange(results: Results, file: Path, rng: np.random.Generator) -> None:
    """Two files of one kind, as if a folder had been sorted wrongly."""
    others = [one for one in files_below(results.root) if one.suffix == file.suffix]
    other = others[rng.integers(len(others))]
    one, two = file.read_bytes(), other.read_bytes()
    file.write_bytes(two)
    other.write_bytes(one)


def take_of_other(results: Results, file: Path, rng: np.random.Generator) -> None:
    shutil.copy(results.other / file.relative_to(results.root), file)


def add(results: Results, file: Path, rng: np.random.Generator) -> None:
    name = file_name("".join(PARTS[place] for place in rng.integers(len(PARTS), size=3)))
    shutil.copy(file, file.with_name(f"{name}{file.suffix}"))


def correct(results: Results, file: Path, rng: np.random.Generator) -> None:
    """Corrections that may be none, of this result, of another one, or of one that they do not name."""
    count = int(results.intact["pieces"].max()) + 1
    steps = []
    for _ in range(rng.integers(4)):
        kind = ("join", "split", "name")[rng.integers(3)] if rng.integers(8) else ODD[rng.integers(len(ODD))]
        superpoints = [int(superpoint) for superpoint in rng.integers(count, size=rng.integers(4))]
        if superpoints and rng.integers(4) == 0:
            superpoints[0] = ODD[rng.integers(len(ODD))]
        steps.append({"kind": kind, "pieces": superpoints} | ({"name": "ü<b>"} if rng.integers(2) else {}))
    record = {"pieces": count, "granularity": [None, 0.3, 1.0, 0][rng.integers(4)], "edits": steps}
    if (of := (None, results.root, results.other)[rng.integers(3)]) is not None:
        record["result"] = manifest_checksum(of)
    if rng.integers(3) == 0:
        change_record(record, ODD[rng.integers(len(ODD))], rng)
    (results.root / "edits.json").write_text(json.dumps(record))


CHANGES: tuple[Callable[[Results, Path, np.random.Generator], None], ...] = (
    change_bytes,
    change_values,
    lose,
    exchange,
    take_of_other,
    add,
    correct,
)


def result_case(index: int, seed: int, results: Results) -> str:
    """One tampered result, and one name; returns how reading it ended."""
    rng = np.random.default_rng([seed, 2, index])
    check_name("".join(PARTS[place] for place in rng.integers(len(PARTS), size=rng.integers(6))))
    is_old = index % 3 == 0
    if is_old:
        (results.root / "manifest.json").unlink()
        run = results.root / "run.yaml"
        run.write_text(run.read_text().replace("manifest: manifest.json\n", ""))
    for _ in range(1 + rng.integers(2)):
        found = files_below(results.root)
        known = [file for file in found if (results.other / file.relative_to(results.root)).is_file()]
        with suppress(
            *CLEAR, OSError, zipfile.BadZipFile, zlib.error, yaml.YAMLError, LookupError, SyntaxError
        ):  # damaged before
            CHANGES[rng.integers(len(CHANGES))](results, known[rng.integers(len(known))], rng)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = read_all(results.root)
    except CLEAR as error:
        if len(str(error)) < 10:
            raise FindingError(f"results: an error without words: {error!r}") from error
        return f"results{' of 0.1.0' * is_old}: error"
    finally:
        edits = results.root / "edits.json"
        is_corrected = edits.is_file()
        is_of_other = is_corrected and str(manifest_checksum(results.other)) in edits.read_text(errors="replace")
        results.restore()
    if is_of_other and not is_old:
        raise FindingError("results: corrections of another result were taken")
    if is_old:
        return "results of 0.1.0: read"
    return judged(results.intact, read, is_corrected)


def judged(intact: dict[str, Tensor], read: dict[str, Tensor], is_corrected: bool) -> str:
    """How a tampered result that loads differs; a finding if it may not."""
    changed = [name for name in intact if name not in read or not torch.equal(read[name], intact[name])]
    if not changed and read.keys() == intact.keys():
        return "results: as the run wrote it"
    if is_corrected and all(name.startswith("labels") for name in changed):
        superpoints = intact["pieces"]
        of_superpoint = torch.zeros(int(superpoints.max()) + 1, dtype=torch.int64)
        of_superpoint[superpoints] = read["labels"]
        if torch.equal(of_superpoint[superpoints], read["labels"]):
            return "results: corrected"
    raise FindingError(f"results: other {', '.join(changed) or 'content'}")


def check_name(name: str) -> None:
    file = file_name(name)
    if not file or Path(file).name != file or len(file.encode()) > LONGEST or file.strip(".") == "":
        raise FindingError(f"names: {name!r} became {file!r}")
    if file != name and file_name(file) != file:
        raise FindingError(f"names: {file!r} is not its own name")
