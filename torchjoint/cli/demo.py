"""torchjoint demo: segments a generated scene."""

from __future__ import annotations

import sys
from pathlib import Path

from torchjoint import metrics
from torchjoint.cli._demo_scene import SOURCE, demo_scene
from torchjoint.cli._log import printed_log
from torchjoint.cli._summary import summarize
from torchjoint.cli.arguments import DEFAULTS, Flat, Out
from torchjoint.cli.show import live_view, show_result
from torchjoint.joint import JointSegmenter
from torchjoint.results.folder import write_result
from torchjoint.results.output_folder import output_folder
from torchjoint.runtime.messages import say
from torchjoint.runtime.stopwatch import Stopwatch


def demo(
    out: Out = Path("torchjoint-demo"), parameters: Flat = DEFAULTS, overwrite: bool = False, show: bool = False
) -> None:
    """Segments a generated synthetic scene and scores the result against its exact ground truth; needs no data.

    Args:
        out: folder for the result.
        parameters: parameters of the method.
        overwrite: replace OUT if it is an earlier result.
        show: show the run, and then the result, in the browser, as `torchjoint segment --show` does.
    """
    view = live_view(show)
    clock, config = Stopwatch(), parameters.config()
    with output_folder(out, SOURCE, overwrite=overwrite) as partial:
        assert partial is not None  # it is None only if a key is given
        with clock("generate"):
            synthetic = demo_scene()
        with printed_log(), clock("segment"):
            segmenter = JointSegmenter(config, allow_import=True)
            for _ in segmenter.steps(synthetic.scene, progress=sys.stderr.isatty()):
                if view is not None:
                    view(segmenter, synthetic.scene)
            result = segmenter.compute(progress=sys.stderr.isatty())
        write_result(partial, synthetic.scene, result, config, SOURCE, seconds=clock.seconds)
    summarize(result, out)
    in_3d = metrics.objects_and_parts(result.points, synthetic.point_labels)
    covering = metrics.segmentation_covering(result.points, synthetic.point_labels)
    say(f"against the truth, in 3D: covering {covering.symmetric:.2f}, F for objects and parts {in_3d.f:.2f}")
    show_result(out, view, segmenter, synthetic.scene)
