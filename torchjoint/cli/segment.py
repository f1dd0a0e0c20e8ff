"""torchjoint segment: segments a recording and writes the result to a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import tyro

from torchjoint.cli._log import printed_log
from torchjoint.cli._summary import summarize
from torchjoint.cli.arguments import DEFAULTS, Flat, Out, check_max_frames
from torchjoint.cli.show import show_result
from torchjoint.datasets import load_scene
from torchjoint.datasets.files import fingerprint
from torchjoint.joint import JointSegmenter
from torchjoint.masks import read_folder
from torchjoint.masks.folder import check_files
from torchjoint.results.checkpoint import Checkpoint, run_key
from torchjoint.results.folder import write_result
from torchjoint.results.output_folder import STATE, output_folder, own_files
from torchjoint.runtime.checked_files import file_checksum
from torchjoint.runtime.files import write_text
from torchjoint.runtime.memory import as_bytes
from torchjoint.scene import Scene
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.scene.thinning import voxel_subsample
from torchjoint.views.projection import in_any_view


def segment(
    scene: tyro.conf.Positional[Path],
    out: Out,
    parameters: Flat = DEFAULTS,
    overwrite: bool = False,
    voxel_size: float = 0.02,
    topics: tuple[str, ...] = (),
    time_limit: float = 0.02,
    max_frames: int | None = None,
    in_view: bool = False,
    thin: float | None = None,
    merge_within: float = 0.0,
    granularity: float | None = None,
    masks: Path | None = None,
    without_masks: Literal["segment", "leave-out"] = "segment",
    memory: str | None = None,
    show: bool = False,
) -> None:
    """Segments a recording: a folder of posed frames, with or without a point cloud.

    An interrupted run continues when it is started again with the same arguments.

    Args:
        scene: folder of frames; docs/your_data.md lists the layouts.
        out: folder for the result: points.ply, points.npz, images/, overview.png, run.yaml; with method learned also
            hierarchy.npz and pieces/.
        parameters: parameters of the method.
        overwrite: replace OUT if it is an earlier result.
        voxel_size: metres, for fusing a cloud from depth if the recording has no cloud.
        topics: of a ROS recording, where several would do: --topics color=/front/image_raw; also info, depth, points,
            odometry.
        time_limit: of a ROS recording: seconds between an image and its depth, and its pose, at most.
        max_frames: number of frames to use, evenly spread over the recording.
        thin: keep one point per voxel of this size, metres; for clouds that are denser than their noise, or too large.
        merge_within: metres; the points in a cube with this side count as one point, and all get its label.
        in_view: leave out the points that no frame has in its view (a LiDAR sees all around, a camera does not).
        granularity: level of the labels, 0 (coarse) to 1 (fine); the default is 0.5. All levels are saved in any case.
            Only point_segments.method learned has levels (auto, if the cloud is no scan).
        masks: masks of a network: a folder with NAME.png (labels, 0 = none), NAME.npz, NAME.json (SAM) or a folder NAME
            of binary PNGs for each frame NAME; or a COCO file. docs/masks.md shows how to make them.
        without_masks: what becomes of frames without masks: they are segmented without masks, or left out.
        memory: how much of the frames stays in memory, such as 2GB; the rest goes to the disk of OUT. It does not
            change the labels. Default: a quarter of the memory of the machine or container.
        show: show the result in the browser, as `torchjoint show` does.
    """
    config = parameters.config()
    check_max_frames(max_frames)
    as_bytes(memory, "--memory")
    if thin is not None and not thin > 0:
        raise ValueError(f"--thin: expected more than 0 metres, got {thin}")
    if granularity is not None:
        check_granularity(granularity, "--granularity")
        if config.point_segments.method not in ("learned", "auto"):
            raise ValueError(
                f"--granularity: method {config.point_segments.method} has one level only; --preset default has all"
            )
    if out.resolve() in (scene.resolve(), *scene.resolve().parents):
        raise ValueError(f"-o: {out} is, or holds, the recording itself; choose another folder")
    if masks is not None and out.resolve() in (masks.resolve(), *masks.resolve().parents):
        raise ValueError(f"-o: {out} is, or holds, the masks; choose another folder")
    for name, path in (("scene", scene), ("--masks", masks)):
        if path is not None and not path.exists():
            raise FileNotFoundError(f"{name}: {path} does not exist")
    chosen = dict(read_topic(topic) for topic in topics)
    source = f"{fingerprint(scene, own_files(out))} {voxel_size}"
    if chosen or time_limit != 0.02:
        source += f" {sorted(chosen.items())} {time_limit}"
    if masks is not None:
        source += f" {fingerprint(masks)} {without_masks}"
    key = run_key(f"{source} {max_frames} {in_view} {thin} {merge_within}", config)
    with output_folder(out, source, key=f"{key} {granularity}", overwrite=overwrite) as partial:
        if partial is None:
            print(f"{out}: an earlier run was killed when all was written; its result is in its place now")
            return
        if masks is not None:
            check_files(masks)  # first, for fusing a cloud takes long
        loaded = _load(scene, partial, voxel_size, chosen, time_limit)
        if masks is not None:
            loaded = read_folder(masks, loaded, "segment" if without_masks == "segment" else "leave out")
        if max_frames is not None:
            loaded = loaded.sample_frames(max_frames)
        if in_view:
            loaded = loaded.select_points(in_any_view(loaded.points, loaded.frames))
        if thin is not None:
            loaded = loaded.select_points(voxel_subsample(loaded.points, thin))
        checkpoint = Checkpoint(partial / STATE / "frames", key)
        with printed_log():
            segmenter = JointSegmenter(config, merge_within=merge_within, memory=memory, spill=partial / STATE)
            result = segmenter(loaded, progress=True, checkpoint=checkpoint)
        if granularity is not None:
            result = result.at(granularity)
        write_result(partial, loaded, result, config, str(scene), 0.5 if granularity is None else granularity)
    summarize(result, out)
    show_result(out, show, segmenter, loaded)


def read_topic(assignment: str) -> tuple[str, str]:
    """Role and topic of ``role=/topic``.

    Raises:
        ValueError: it has another form.
    """
    role, sign, topic = assignment.partition("=")
    if not (role and sign and topic):
        raise ValueError(f"--topics: expected ROLE=TOPIC, such as color=/camera/image_raw, got {assignment!r}")
    return role, topic


def _load(path: Path, partial: Path, voxel_size: float, topics: dict[str, str], time_limit: float) -> Scene:
    """The recording; a fused cloud is kept in the partial result, and stays in the result."""
    fused, checksum = partial / f"cloud-{voxel_size * 1000:g}mm.ply", partial / STATE / "cloud.sha256"
    is_whole = fused.is_file() and checksum.is_file() and checksum.read_bytes().decode() == file_checksum(fused)
    if not is_whole:
        fused.unlink(missing_ok=True)
    scene = load_scene(path, cloud=fused, voxel_size=voxel_size, progress=True, topics=topics, time_limit=time_limit)
    if fused.is_file() and not is_whole:
        checksum.parent.mkdir(exist_ok=True)
        write_text(checksum, file_checksum(fused))
    return scene
