"""The command line: the commands of torchjoint, listed in `main`."""

from __future__ import annotations

import shutil
import sys
import warnings
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tyro

from torchjoint import metrics
from torchjoint.checkpoint import Checkpoint, run_key
from torchjoint.cli_arguments import DEFAULTS, Flat, Out, check_max_frames
from torchjoint.cli_benchmark import benchmark
from torchjoint.cli_boundaries import evaluate_boundaries
from torchjoint.cli_evaluate import evaluate
from torchjoint.cli_paper_tables import paper_tables
from torchjoint.cli_superpoints import superpoints
from torchjoint.cli_training import train_boundaries
from torchjoint.config import Config, parameter_table
from torchjoint.datasets import load_scene
from torchjoint.datasets.files import fingerprint
from torchjoint.joint import JointSegmenter
from torchjoint.output import output_folder, read_points, write_result
from torchjoint.scene import Scene, Segmentation
from torchjoint.superpoints_config import superpoint_table
from torchjoint.thinning import one_point_a_voxel
from torchjoint.visibility import in_any_view

INTERRUPTED = (
    "torchjoint: interrupted; `segment`, `benchmark --tuning` and `train-boundaries` go on where they were when "
    "started again"
)


def demo(out: Out = Path("torchjoint-demo"), parameters: Flat = DEFAULTS, overwrite: bool = False) -> None:
    """Segments an embedded synthetic scene and scores the result against its exact truth; needs no data.

    Args:
        out: folder for the result.
        parameters: what the method is told.
        overwrite: replace OUT if it is an earlier result.
    """
    from torchjoint.synthetic import make_scene

    print("making a synthetic scene ...")
    synthetic = make_scene(seed=0, size="medium")
    result = _run(synthetic.scene, out, parameters.config(), "synthetic, seed 0, medium", overwrite)
    in_3d = metrics.objects_and_parts(result.points, synthetic.point_labels)
    covering = metrics.segmentation_covering(result.points, synthetic.point_labels)
    print(f"against the truth, in 3D: covering {covering.symmetric:.2f}, F for objects and parts {in_3d.f:.2f}")


def segment(
    scene: tyro.conf.Positional[Path],
    out: Out,
    parameters: Flat = DEFAULTS,
    overwrite: bool = False,
    voxel_size: float = 0.02,
    max_frames: int | None = None,
    in_view: bool = False,
    thin: float | None = None,
) -> None:
    """Segments a recording: a folder of posed frames, with or without a cloud.

    A run that was interrupted goes on where it was when it is started again with the same arguments.

    Args:
        scene: folder of frames; see the README for the layouts that are known.
        out: folder for the result: points.ply, points.npz, images/, overview.png, run.yaml.
        parameters: what the method is told.
        overwrite: replace OUT if it is an earlier result.
        voxel_size: metres, where the cloud must be fused from depth.
        max_frames: use this many frames, evenly spread over the recording.
        thin: keep one point in each voxel of this many metres; for clouds denser than their noise, or too large.
        in_view: leave out the points that are in no frame's view (a LiDAR sees all around, a camera does not).
    """
    config = parameters.config()
    check_max_frames(max_frames)
    if thin is not None and not thin > 0:
        raise ValueError(f"--thin: expected more than 0 metres, got {thin}")
    if out.resolve() in (scene.resolve(), *scene.resolve().parents):
        raise ValueError(f"-o: {out} is, or holds, the recording itself; choose another folder")
    source = f"{fingerprint(scene)} {voxel_size}"
    with output_folder(out, source, overwrite=overwrite) as partial:
        fused = partial / f"cloud-{voxel_size * 1000:g}mm.ply"  # kept there, where the recording brings no cloud
        loaded = load_scene(scene, cloud=fused, voxel_size=voxel_size, progress=True)
        if max_frames is not None:
            loaded = loaded.spread_frames(max_frames)
        if in_view:
            loaded = loaded.select_points(in_any_view(loaded.points, loaded.frames, config.visibility))
        if thin is not None:
            loaded = loaded.select_points(one_point_a_voxel(loaded.points, thin))
        checkpoint = Checkpoint(partial / "state", run_key(f"{source} {max_frames} {in_view} {thin}", config))
        result = JointSegmenter(config)(loaded, progress=True, checkpoint=checkpoint)
        write_result(partial, loaded, result, config, str(scene))
        shutil.rmtree(partial / "state")
    _summarize(result, out)


def show(out: tyro.conf.Positional[Path], open_browser: bool = True) -> None:
    """Makes a page of a result's cloud that any browser shows (viewer.html), and opens it.

    Args:
        out: folder that `torchjoint segment` wrote.
        open_browser: open the page; otherwise only write it.
    """
    from torchjoint.show import write_viewer

    result = read_points(out)
    page = out / "viewer.html"
    write_viewer(page, result.points, result.labels, result.colors)
    print(f"{page}\n{out / 'overview.png'}")
    if open_browser:
        webbrowser.open(page.resolve().as_uri())


def parameters(superpoints: bool = False) -> None:
    """Prints all parameters of the method with default, unit, sensible range and effect (Markdown).

    Args:
        superpoints: those of `torchjoint superpoints`, with their values in each preset.
    """
    print(superpoint_table() if superpoints else parameter_table())


def main() -> None:
    """Entry point; errors of the user's making, and warnings, are one line."""
    warnings.formatwarning = lambda message, *_, **__: f"torchjoint: warning: {message}\n"
    try:
        commands: dict[str, Callable[..., Any]] = {
            "demo": demo,
            "segment": segment,
            "superpoints": superpoints,
            "evaluate": evaluate,
            "benchmark": benchmark,
            "train-boundaries": train_boundaries,
            "evaluate-boundaries": evaluate_boundaries,
            "paper-tables": paper_tables,
            "show": show,
            "parameters": parameters,
        }
        tyro.extras.subcommand_cli_from_dict(commands, prog="torchjoint")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except (ValueError, TypeError, OSError) as error:
        sys.exit(f"torchjoint: error: {error}")


def _run(scene: Scene, out: Path, config: Config, source: str, overwrite: bool) -> Segmentation:
    with output_folder(out, source, overwrite=overwrite) as partial:
        result = JointSegmenter(config)(scene, progress=True)
        write_result(partial, scene, result, config, source)
    _summarize(result, out)
    return result


def _summarize(result: Segmentation, out: Path) -> None:
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in result.seconds.items())
    print(f"{len(result.points)} points in {result.num_point_segments} segments, {len(result.images)} images")
    print(f"seconds by stage (added up over threads): {seconds}")
    print(f"written to {out}: overview.png, points.ply, points.npz, images/, run.yaml")
