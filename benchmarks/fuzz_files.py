"""Damaged files for benchmarks/fuzz.py: how reading each of them ends, and whether its values can be right.

What a damaged file may change is known in part:

* Where a file has checksums (PNG, .npz, saved states) either an error comes, or the values of the intact file.
* A JPEG changes one image, and the colours that a cloud has from it.
* In a cloud without checksums, b bytes that are replaced behind the header change at most b points.

All else (a digit of a pose) is counted by what changed.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchjoint as tj
from torchjoint.results.exports import FORMATS as EXPORTS
from torchjoint.results.exports import SUFFIXES

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

#: What a reader may raise.
CLEAR = (ValueError, TypeError, FileNotFoundError)
#: Files whose formats have checksums of all values.
GUARDED = (".png", ".npz", ".pt")
#: What precedes the values in clouds without checksums.
HEADER_ENDS = {".ply": b"end_header\n", ".npy": b"\n", ".xyz": b""}

#: Everything that is read, by name; what belongs to a frame ends with its number.
Content = dict[str, Tensor]


class FindingError(Exception):
    """A case that should not be."""


class Sample:
    """A file or folder that is read as a whole.

    Args:
        name: for counts.
        root: folder of its files.
        read: reads everything.
    """

    def __init__(self, name: str, root: Path, read: Callable[[], Content]) -> None:
        self.name, self.read = name, read
        self.files = {path: path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}
        self.intact = read()

    def restore(self) -> None:
        """Writes what is missing or damaged again."""
        for path, content in self.files.items():
            if not path.is_file() or path.read_bytes() != content:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)


def read_scene(path: Path) -> Content:
    scene = tj.load_scene(path)
    if not torch.isfinite(scene.points).all():
        raise FindingError("points that are not finite")
    content = {"points": scene.points} | ({} if scene.colors is None else {"colors": scene.colors})
    for index, frame in enumerate(scene.frames):
        content |= {f"image {index}": frame.image, f"pose {index}": frame.world_to_camera}
        content |= {f"intrinsics {index}": frame.intrinsics}
        content |= {} if frame.depth is None else {f"depth {index}": frame.depth}
    if scene.truth is not None:
        content |= {} if scene.truth.points is None else {"truth": scene.truth.points}
        content |= {f"truth {index}": labels for index, labels in enumerate(scene.truth.images)}
    return content


def make_samples(folder: Path) -> list[Sample]:
    """Writes all samples; tests/samples has the data sets."""
    import samples

    made = []
    for name in samples.FORMATS:
        path = samples.write(name, folder / name)
        made.append(Sample(name, folder / name, lambda path=path: read_scene(path)))
    return [
        *made,
        *make_clouds(folder),
        *make_meshes(folder),
        *make_instances(folder),
        *make_boxes(folder),
        *make_run(folder),
    ]


def make_clouds(folder: Path) -> list[Sample]:
    from torchjoint.datasets.files.clouds import read_cloud_file
    from torchjoint.datasets.files.ply import write_cloud

    def read(path: Path) -> Content:
        cloud = read_cloud_file(path)
        return {"points": cloud.points} | ({} if cloud.colors is None else {"colors": cloud.colors})

    made = []
    points = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    for suffix in ("ply", "npz", "npy", "xyz"):
        path = folder / suffix / f"cloud.{suffix}"
        path.parent.mkdir()
        if suffix == "ply":
            write_cloud(path, points, points, torch.arange(60))
        elif suffix == "npz":
            np.savez_compressed(path, points=points.numpy(), colors=points.numpy())
        else:
            np.save(path, points.numpy()) if suffix == "npy" else np.savetxt(path, points.numpy())
        made.append(Sample(f".{suffix}", path.parent, lambda path=path: read(path)))
    return made


def make_meshes(folder: Path) -> list[Sample]:
    """Meshes of other formats; and a .ply whose records get labels."""
    import trimesh

    from torchjoint.datasets.files.meshes import SUFFIXES, read_mesh_file
    from torchjoint.datasets.files.ply import read_records, read_vertex_property, write_bytes

    def read(path: Path) -> Content:
        mesh = read_mesh_file(path)
        content = {"points": mesh.points} | ({} if mesh.faces is None else {"faces": mesh.faces})
        return content | ({} if mesh.colors is None else {"colors": mesh.colors})

    def labelled(path: Path) -> Content:
        records = read_records(path)
        count = records.header.elements[0].rows
        out = folder / "labelled.ply"
        write_bytes(out, records.with_labels("label", {"vertex": np.arange(count)}))
        labels = read_vertex_property(out, "label")
        if labels is None or not np.array_equal(labels, np.arange(count)):
            raise FindingError(f"{path.name}: other labels than were written")
        return {"labels": torch.from_numpy(labels)}

    made, mesh = [], trimesh.creation.icosphere(subdivisions=1)
    mesh.visual.vertex_colors = np.arange(3 * len(mesh.vertices), dtype=np.uint8).reshape(-1, 3)
    for suffix in (one for one in SUFFIXES if one != ".gltf"):
        path = folder / f"mesh{suffix}" / f"mesh{suffix}"
        path.parent.mkdir()
        mesh.export(path)
        made.append(Sample(f"mesh {suffix}", path.parent, lambda path=path: read(path)))
    for encoding in ("ascii", "binary"):
        path = folder / f"records_{encoding}" / "mesh.ply"
        path.parent.mkdir()
        mesh.export(path, encoding=encoding)
        made.append(Sample(f"records {encoding}", path.parent, lambda path=path: labelled(path)))
    return made


def make_instances(folder: Path) -> list[Sample]:
    """Predicted instances as in ScanNet's benchmark, in both layouts."""
    from torchjoint_lab.evaluation.instances import read_instances

    labels = torch.arange(60) // 20
    scene = tj.Scene(torch.rand(60, 3, generator=torch.Generator().manual_seed(0)), name="scene0000_00")
    result = tj.Result.of(tj.Segmentation(labels, ()), scene)

    def read(path: Path) -> Content:
        found = read_instances(path, 60)
        masks = torch.zeros(len(found.points), 60)
        for mask, points in zip(masks, found.points, strict=True):
            mask[points] = 1
        return {"masks": masks, "scores": found.scores}

    made = []
    for name, path in (("scannet", "instances/scene0000_00.txt"), ("masks", "archive/a.npz")):
        root = (folder / path).parent
        if name == "masks":
            root.mkdir()
        EXPORTS[name](root if name == "scannet" else folder / path, result)
        made.append(Sample(f"instances {name}", root, lambda path=path: read(folder / path)))
    return made


def make_boxes(folder: Path) -> list[Sample]:
    """Boxes and labels of programs of annotation."""
    from torchjoint.results.boxes import read_boxes
    from torchjoint.results.shared_edits import read_point_labels

    labels = torch.arange(60) // 20
    scene = tj.Scene(torch.rand(60, 3, generator=torch.Generator().manual_seed(0)))
    result = tj.Result.of(tj.Segmentation(labels, ()), scene)

    def read(path: Path) -> Content:
        labels = read_point_labels(path, 60)
        if labels is not None:
            return {"labels": torch.from_numpy(labels.of_point), "named": torch.tensor([*labels.names])}
        boxes = read_boxes(path)
        return {"boxes": torch.tensor([[*box.center, *box.size, box.yaw] for box in boxes])}

    made = []
    for name in ("openpcdet", "labelcloud", "segmentsai", "segmentsai-cuboids"):
        path = folder / f"boxes_{name}" / f"boxes{SUFFIXES[name]}"
        path.parent.mkdir()
        EXPORTS[name](path, result)
        made.append(Sample(f"boxes {name}", path.parent, lambda path=path: read(path)))
    return made


def make_run(folder: Path) -> list[Sample]:
    """The saved state of a run, and its result."""
    from torchjoint.results.checkpoint import Checkpoint
    from torchjoint.results.folder import read_result, write_result

    scene = tj.synthetic.make_scene(seed=3, num_points=400, num_views=2, height=48, width=64).scene
    segmenter = tj.JointSegmenter(tj.Config().set(["boundary.detector=gradient"]))
    result = segmenter(scene)
    Checkpoint(folder / "state", "key").save(segmenter.state, now=True)

    def state() -> Content:
        loaded = Checkpoint(folder / "state", "key").load()
        if loaded is None:
            raise ValueError("damaged, starting over")
        return {name: value for name, value in vars(loaded).items() if isinstance(value, Tensor)}

    made = [Sample("state of a run", folder / "state", state)]
    (folder / "result").mkdir()
    write_result(folder / "result", scene, result, segmenter.config, "fuzz")
    (folder / "result" / "overview.png").unlink()

    def whole() -> Content:
        read = read_result(folder / "result")
        superpoints = {
            f"superpoints {index}": read.superpoint_images[index] for index in range(len(read.superpoint_images))
        }
        return {"points": read.points} | {f"image {i}": image for i, image in enumerate(read.images)} | superpoints

    return [*made, Sample("result", folder / "result", whole)]


def file_case(index: int, seed: int, samples: list[Sample]) -> str:
    """One damaged file; returns how reading it ended."""
    from damage import damage

    rng = np.random.default_rng([seed, 1, index])
    sample = samples[rng.integers(len(samples))]
    file, intact = list(sample.files.items())[rng.integers(len(sample.files))]
    spoiled = damage(intact, rng)
    if spoiled == intact:
        return "files: not damaged"
    file.write_bytes(spoiled)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = sample.read()
    except CLEAR as error:
        if len(str(error)) < 10:
            raise FindingError(f"{sample.name}: an error without words: {error!r}") from error
        return "files: error"
    finally:
        sample.restore()
    return judged(sample, file, intact, spoiled, read)


def judged(sample: Sample, file: Path, intact: bytes, spoiled: bytes, read: Content) -> str:
    """How a damaged file that loads differs; a finding if it cannot be right."""
    sizes = [{name: tuple(value.shape) for name, value in content.items()} for content in (sample.intact, read)]
    where = f"{sample.name}/{file.name}"
    if sizes[0] != sizes[1]:
        if file.suffix in GUARDED:
            raise FindingError(f"{where}: other sizes in spite of checksums")
        return f"files: other sizes, {where}"
    changed = [name for name, value in read.items() if not torch.equal(value, sample.intact[name])]
    if not changed:
        return "files: values of the intact file"
    if file.suffix in GUARDED:
        raise FindingError(f"{where}: other {', '.join(changed)} in spite of checksums")
    kinds = sorted({name.split()[0] for name in changed})
    images = sum(name.startswith("image") for name in changed)
    if file.suffix in (".jpg", ".jpeg") and (images > 1 or {*kinds} - {"image", "colors"}):
        raise FindingError(f"{where}: a JPEG changes {', '.join(changed)}")
    check_rows(sample, file, intact, spoiled, read)
    return f"files: other values: {', '.join(kinds)}"


def check_rows(sample: Sample, file: Path, intact: bytes, spoiled: bytes, read: Content) -> None:
    """In a cloud without checksums so many bytes change at most so many points."""
    if file.suffix not in HEADER_ENDS or file.suffix != sample.name or len(intact) != len(spoiled):
        return
    end = HEADER_ENDS[file.suffix]
    start = intact.index(end) + len(end)
    replaced = [place for place, (a, b) in enumerate(zip(intact, spoiled, strict=True)) if a != b]
    if replaced[0] < start:
        return
    rows = max(int((read[name] != sample.intact[name]).any(1).sum()) for name in read)
    if rows > len(replaced):
        raise FindingError(f"{file.name}: {rows} rows changed by {len(replaced)} bytes")
