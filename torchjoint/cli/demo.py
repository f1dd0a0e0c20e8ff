"""torchjoint demo: segments the recording that comes with the package."""

from importlib.resources import files
from pathlib import Path

from torchjoint import metrics
from torchjoint.cli.arguments import DEFAULTS, Flat, Out
from torchjoint.cli.segment import segmented_and_told
from torchjoint.cli.show import live_view, show_result
from torchjoint.recordings import RecordingOptions
from torchjoint.runtime.messages import say

#: The recording: a rendered room, in the format of torchjoint/datasets/formats/folder.py, with its truth.
RECORDING = Path(str(files("torchjoint.models") / "demo"))


def demo(
    out: Out = Path("torchjoint-demo"), parameters: Flat = DEFAULTS, overwrite: bool = False, show: bool = False
) -> None:
    """Segments the package's own recording of a rendered room, and scores the result against its truth.

    Args:
        out: folder for the result.
        parameters: parameters of the method.
        overwrite: replace OUT if it is an earlier result.
        show: show the run, and then the result, in the browser, as `torchjoint segment --show` does.
    """
    view = live_view() if show else None
    say(f"segmenting {RECORDING}", flush=True)
    segmented = segmented_and_told(RECORDING, out, parameters, RecordingOptions(), overwrite=overwrite, view=view)
    if segmented is None:
        return
    result, segmenter, scene = segmented
    if scene.truth is not None and scene.truth.points is not None:
        f = metrics.objects_and_parts(result.points, scene.truth.points).f
        covering = metrics.segmentation_covering(result.points, scene.truth.points).symmetric
        say(f"against the truth, in 3D: covering {covering:.2f}, F for objects and parts {f:.2f}")
    show_result(out, view, segmenter, scene)
