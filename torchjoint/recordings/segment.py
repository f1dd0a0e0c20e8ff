"""Segments one recording from its files to its result folder; an interrupted run continues where it stopped.

`RecordingOptions` says how it is read.
"""

import logging
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.datasets import find_format, load_scene
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.engine import EngineLike, SharedFile, open_engine
from torchjoint.engine.engine import SHARED
from torchjoint.images.segmenter import ImageSegmenter
from torchjoint.joint import JointSegmenter, observe
from torchjoint.masks import read_folder
from torchjoint.masks.folder import check_files
from torchjoint.results.checkpoint import Checkpoint, model_checksums, run_key
from torchjoint.results.folder import write_result
from torchjoint.results.output_folder import STATE, output_folder, own_files
from torchjoint.runtime.files import file_checksum, write_text
from torchjoint.runtime.foreign_files import damage_is
from torchjoint.runtime.memory import as_bytes
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.outputs import check_no_input
from torchjoint.runtime.threads import on_cpu, one_at_a_time
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.scene.checks import as_direction
from torchjoint.scene.frame import PoseDoubt, PoseWarning
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.scene.scene import voxel_subsample
from torchjoint.views.evidence import Evidence
from torchjoint.views.visibility import in_any_view

logger = logging.getLogger(__name__)

#: Chunks for each worker, so that all workers finish at about the same time; and most frames in a chunk.
CHUNKS, LARGEST = 4, 64

#: Frames that a worker holds at a time.
BATCH = 8


@dataclass(frozen=True)
class RecordingOptions:
    """Options of a recording, as in `torchjoint segment` and `torchjoint batch`.

    Attributes:
        voxel_size: metres, for fusing a cloud from depth if the recording has no cloud.
        max_frames: number of frames to use, evenly spread over the recording, or over its frames with masks; 0: the
            cloud alone; None: all.
        in_view: leave out the points that no frame has in its view (a LiDAR sees all around, a camera does not).
        thin: keep one point per voxel of this size, metres, of clouds that are denser than their noise, or too large;
            None: all points.
        merge_within: metres; all points in a cube with this side are treated as one point and get the same label, but
            for method scan.
        granularity: level of the labels, 0 (coarse) to 1 (fine); None: the default, 0.5. All levels are always saved.
            Only point_segments.method learned has levels; auto chooses it unless the cloud is a scan.
        topics: for a ROS recording: the topic of each role that several topics fit, as a dict or pairs.
        time_limit: for a ROS recording: largest time from an image to its depth image and its pose, seconds.
        ignore_poses: go on if the poses look wrong; else this is an error.
        drop_invalid: leave out the points that are NaN or infinite, and tell their number; else they are an error.
        least_opacity: of Gaussian splats (a .ply), 0 to 1: fainter ones are no part of the cloud. `torchjoint label`
            gives them labels.
        format: of `torchjoint formats`, if the one that is detected is not the right one: cloud_alone.
        up: upward direction x y z in the coordinates of the cloud, for boxes and pictures; None: what the format
            says, +z of a cloud alone, else from the poses and the floor.
    """

    voxel_size: float = 0.02
    max_frames: int | None = None
    in_view: bool = False
    thin: float | None = None
    merge_within: float = 0.0
    granularity: float | None = None
    topics: Mapping[str, str] | tuple[tuple[str, str], ...] = ()
    time_limit: float = 0.02
    ignore_poses: bool = False
    drop_invalid: bool = False
    least_opacity: float = 0.1
    format: str | None = None
    up: tuple[float, float, float] | None = None

    def check(self, config: Config) -> None:
        """Raises an error if an option is out of range, or does not fit the parameters, or these are no Config."""
        if not isinstance(config, Config):
            raise TypeError(f"config: expected a Config, got {type(config).__name__}; Config.from_yaml reads a file")
        if self.max_frames is not None and self.max_frames < 0:
            raise ValueError(f"--max-frames: expected >= 0, got {self.max_frames}")
        if self.thin is not None and not 0 < self.thin < float("inf"):
            raise ValueError(f"--thin: expected more than 0 metres, got {self.thin}")
        if self.up is not None:
            as_direction(torch.tensor(self.up, dtype=torch.float64), "--up")
        if self.granularity is not None:
            check_granularity(self.granularity, "--granularity")
            if (method := config.point_segments.method) in ("scan", "paper"):
                raise ValueError(f"--granularity: expected a method with levels, as in --preset default, got {method}")

    def source(self) -> str:
        """The options that change a fused cloud, or whether the poses of its frames were checked, as text."""
        topics = sorted(dict(self.topics).items())
        return f"{self.voxel_size} {topics} {self.time_limit} {self.format} {self.ignore_poses}"

    def key(self) -> str:
        """The options that change the state of a run, as text."""
        own = self.max_frames, self.in_view, self.thin, self.merge_within, self.drop_invalid, self.least_opacity
        return " ".join(map(str, own))

    def record(self, config: Config) -> dict[str, Any]:
        """On what a result depends beside its recording and its parameters, as it is written to files."""
        models, up = model_checksums(config), None if self.up is None else [*self.up]
        options = vars(self) | {"topics": [*map(list, dict(self.topics).items())], "up": up}
        return {"options": options, **({"models": models} if models else {})}

    def cut_down(self, scene: Scene) -> Scene:
        """Selects the frames and points of a recording that are used; says what is up."""
        if self.up is not None:
            scene = replace(scene, up=torch.tensor(self.up, dtype=torch.float64))
        if self.max_frames is not None:
            scene = scene.sample_frames(self.max_frames)
        if self.in_view:
            scene = scene.select_points(in_any_view(scene.points, scene.frames))
        return scene if self.thin is None else scene.select_points(voxel_subsample(scene.points, self.thin))


def evidence_of_chunks(
    engine: EngineLike, folder: Path | None = None
) -> Callable[[JointSegmenter, Scene], Iterator[Evidence]]:
    """The evidence of frames, by the workers of an engine: `workers` of :meth:`torchjoint.JointSegmenter.steps`.

    The cloud's graph is written once to a temporary file in `folder`, which workers on other machines must see.
    """
    return partial(_in_order, engine, folder)


def _in_order(engine: EngineLike, folder: Path | None, segmenter: JointSegmenter, scene: Scene) -> Iterator[Evidence]:
    """The evidence of the frames that the segmenter's state lacks, in their order (steps 1, 2, 4 and 5).

    The workers read those frames that are on disk.

    Args:
        engine, folder: the workers, and where they find the graph.
        segmenter: has been reset to the scene's cloud.
        scene: the cloud and its frames.
    """
    frames, done = scene.frames, len(segmenter.state.observations)
    if done == len(frames):
        return
    shared = frames, segmenter.graph, segmenter.config, segmenter.image_segmenter
    with open_engine(engine) as workers, closing(SharedFile(shared, folder)) as file:
        size = min(LARGEST, math.ceil((len(frames) - done) / (CHUNKS * max(1, workers.slots()))))
        chunks = [range(len(frames))[start : start + size] for start in range(done, len(frames), size)]
        for outcome in workers.run(partial(_evidence, file), chunks, in_order=True):
            if outcome.error is not None:
                raise outcome.error
            assert outcome.value is not None
            evidence, seconds = outcome.value
            segmenter.stopwatch.add(seconds)
            yield evidence


def _evidence(
    file: SharedFile[tuple[Sequence[Frame], PointGraph, Config, ImageSegmenter]], chunk: range
) -> tuple[Evidence, dict[str, float]]:
    """The task of a worker: computes the evidence of a chunk, and the seconds by stage."""
    frames, graph, config, images = file.load()
    evidence, stopwatch = Evidence.empty(graph), Stopwatch()
    for start in range(0, len(chunk), BATCH):
        with stopwatch("load frames"):
            batch = [frames[index] for index in chunk[start : start + BATCH]]
        evidence += observe(batch, graph, config, images, stopwatch)
    return evidence, stopwatch.seconds


#: A function (segmenter, scene) that observes a run while its frames are added.
Watch = Callable[[JointSegmenter, Scene], None]


class Segmented(NamedTuple):
    """The output of a run."""

    result: Segmentation
    segmenter: JointSegmenter
    scene: Scene


@on_cpu()
def segment_recording(
    path: Path,
    out: Path,
    config: Config,
    options: RecordingOptions,
    *,
    masks: Path | None = None,
    without_masks: Literal["segment", "leave-out"] = "segment",
    overwrite: bool = False,
    memory: int | str | None = None,
    engine: EngineLike | None = None,
    progress: bool = False,
    begin: Callable[[], object] = str,
    watch: Watch | None = None,
    allow_import: bool = False,
) -> Segmented | None:
    """Segments a recording and writes its result folder, completely or not at all.

    Args:
        path: of the recording.
        out: folder for the result.
        config: parameters of the method.
        options: how the recording is read.
        masks: masks of a network, see :func:`torchjoint.masks.read_folder`.
        without_masks: whether frames without masks are segmented without masks, or left out.
        overwrite: replace an earlier result.
        memory: memory for the data of the frames, see :class:`~torchjoint.JointSegmenter`; the rest goes to the disk of
            `out`.
        engine: workers for the frames: any executor, or a name; None: this process. The labels are the same.
        progress: show progress bars.
        begin: is called when all but the files' contents is checked, before they are read.
        watch: is called before the first frame and after each batch; it must not change its arguments.
        allow_import: import the code that the config names, see :class:`torchjoint.JointSegmenter`.

    Returns:
        the result; None if an earlier run was killed after its last file: its result is now in `out`.

    Raises:
        ValueError, TypeError, OSError: an invalid option or file, which the message names; `out` exists or is in use;
            the poses look wrong.
    """
    options.check(config)
    as_bytes(memory, "--memory")
    check_no_input(out, (path, masks, *map(Path, model_checksums(config))))  # before their files are looked at
    for name, needed in (("scene", path), ("--masks", masks)):
        if needed is not None and not needed.exists():
            raise FileNotFoundError(f"{name}: {needed} does not exist")
    find_format(path, options.format)  # raises at once
    before = fingerprints(path, masks, out)
    source = f"{' '.join(fingerprints(path, masks, out, changed=True))} {options.source()}"
    source += f" {without_masks}" * (masks is not None)
    key = run_key(f"{source} {options.key()}", config)
    level = options.granularity
    with output_folder(out, source, key=f"{key} {level} {options.up}", overwrite=overwrite) as partial:
        if partial is None:
            return None
        begin()
        clock = Stopwatch()
        with clock("read"):
            if masks is not None:
                check_files(masks)  # first, because fusing a cloud takes long
            with nullcontext() if options.ignore_poses else _poses_must_fit():
                scene = _load(path, partial, options, progress)
            if masks is not None:
                without: Literal["segment", "leave out"] = "segment" if without_masks == "segment" else "leave out"
                scene = read_folder(masks, scene, without, options.max_frames)
            scene = options.cut_down(scene)
        checkpoint = Checkpoint(partial / STATE / "frames", key)
        segmenter = JointSegmenter(
            config, merge_within=options.merge_within, memory=memory, offload=partial / STATE, allow_import=allow_import
        )
        with clock("segment"), nullcontext() if options.ignore_poses else _poses_must_fit():
            result = run(segmenter, scene, checkpoint, engine=engine, watch=watch, progress=progress)
        level, result = (0.5, result) if level is None else (level, result.at(level))
        made = {"fingerprint": before[0], **options.record(config)}
        made |= {} if masks is None else {"masks": [str(masks.absolute()), without_masks]}
        logger.info("writing %s", out)
        parts = clock.seconds
        write_result(partial, scene, result, config, str(path), level, made=made, seconds=parts, progress=progress)
        tell_if_changed(path, masks, out, before)  # writing reads the frames once more
    return Segmented(result, segmenter, scene)


def fingerprints(path: Path, masks: Path | None, out: Path, *, changed: bool = False) -> tuple[str, str]:
    """Of a recording and its masks; a result tells their paths."""
    with damage_is("expected a recording and masks with paths in UTF-8"):
        f"{path.absolute()} {masks and masks.absolute()}".encode()
    of = partial(fingerprint, without=own_files(out), changed=changed)
    return of(path), "" if masks is None else of(masks, alone=True)


def tell_if_changed(path: Path, masks: Path | None, out: Path, before: tuple[str, str]) -> None:
    """Warns if a recording or its masks are not what they were before its run."""
    with suppress(FileNotFoundError):
        if fingerprints(path, masks, out) == before:
            return
    warnings.warn(f"{path}: it or its masks changed meanwhile; the result may be of both states", stacklevel=3)


def run(
    segmenter: JointSegmenter,
    scene: Scene,
    checkpoint: Checkpoint,
    *,
    engine: EngineLike | None = None,
    watch: Watch | None = None,
    progress: bool = False,
    batch_size: int = 8,
) -> Segmentation:
    """``segmenter(scene)`` that saves its state from time to time, and goes on from a saved one; arguments as above."""
    for left in checkpoint.directory.glob(f"{SHARED}*"):
        left.unlink()  # by a run that was killed
    workers = None if engine is None else evidence_of_chunks(engine, checkpoint.directory)
    steps = segmenter.steps(scene, progress=progress, batch_size=batch_size, resume=checkpoint.load, workers=workers)
    for number, _ in enumerate(steps):
        if number:  # before the first frame there is nothing to save
            checkpoint.save(segmenter.state)
        if watch is not None:
            watch(segmenter, scene)
    if scene.frames:
        checkpoint.save(segmenter.state, now=True)
    return segmenter.compute(progress=progress)


@contextmanager
def _poses_must_fit() -> Iterator[None]:
    """Poses that look wrong end the run: its labels would look right, and be wrong."""
    try:
        with one_at_a_time, warnings.catch_warnings():
            warnings.simplefilter("error", PoseWarning)
            warnings.simplefilter("default", PoseDoubt)
            yield
    except PoseWarning as warning:
        raise ValueError(f"{warning}; --ignore-poses segments it all the same") from warning


def _load(path: Path, partial: Path, options: RecordingOptions, progress: bool) -> Scene:
    """Loads the recording; a fused cloud is written to the partial result, and becomes part of the result."""
    fused, checksum = partial / f"cloud-{options.voxel_size * 1000:g}mm.ply", partial / STATE / "cloud.sha256"
    is_whole = fused.is_file() and checksum.is_file() and checksum.read_bytes().decode() == file_checksum(fused)
    if not is_whole:
        fused.unlink(missing_ok=True)
    scene = load_scene(
        path,
        cloud=fused,
        voxel_size=options.voxel_size,
        progress=progress,
        topics=dict(options.topics),
        time_limit=options.time_limit,
        drop_invalid=options.drop_invalid,
        least_opacity=options.least_opacity,
        format=options.format,
    )
    if fused.is_file() and not is_whole:
        checksum.parent.mkdir(exist_ok=True)
        write_text(checksum, file_checksum(fused))
    return scene
