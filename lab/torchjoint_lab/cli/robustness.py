"""torchjoint-lab robustness: scores the default on disturbed scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from torchjoint.runtime.files import write_text
from torchjoint_lab.benchmark.disturbances import DISTURBANCES
from torchjoint_lab.benchmark.robustness import Record, Run, measure, report
from torchjoint_lab.benchmark.robustness_scenes import find_scenes
from torchjoint_lab.cli.arguments import check_output

TABLE = "table.md"


def robustness(
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("robustness"),
    data: Path | None = None,
    kinds: tuple[str, ...] = (),
    disturbances: tuple[str, ...] = (),
    scenes: int = 2,
    runs: int = 4,
    overwrite: bool = False,
) -> None:
    """Measures how much the default's labels and scores change with noise, light, density, frames and poses.

    Every run also moves the points by .1 mm, so that "nothing" shows how much scores jump by themselves. A run that was
    killed goes on when the same command is started again; use a new folder after a change of the code.

    Args:
        out: folder of table.md, which grows scene by scene, and of runs/.
        data: folder with ycb/, mosd/, kitchen/, semantickitti/, vod/ and argo/, or some of them.
        kinds: kinds of scenes: table, shelf, bin, desk, kitchen, room, workshop (generated), ycb, mosd,
            recorded-kitchen, semantickitti, vod, argo; default: those that are generated, and those that DATA has.
        disturbances: names, such as half-points light-0.25; default: all. A wrong name lists them.
        scenes: at most so many scenes of each kind.
        runs: number of runs of each scene and disturbance.
        overwrite: replace files in OUT that no earlier start has written.
    """
    if runs < 1:
        raise ValueError(f"--runs: expected at least 1, got {runs}")
    if unknown := [name for name in disturbances if name not in DISTURBANCES]:
        raise ValueError(f"--disturbances: expected some of {', '.join(DISTURBANCES)}, got {unknown[0]!r}")
    chosen = find_scenes(kinds, scenes, data)
    folder = out / "runs"
    table = check_output(out, (TABLE,), overwrite or folder.is_dir(), (data,))[TABLE]
    folder.mkdir(parents=True, exist_ok=True)
    names = [name for name in DISTURBANCES if not disturbances or name in disturbances]
    results: dict[Run, Record] = {}
    for of_scene in measure(chosen, names, runs, folder):
        results |= of_scene
        text = report(results)
        with table.written() as path:
            write_text(path, f"{text}\n")
    print(f"\n{text}\n\nwritten to {out}: {TABLE}; runs/ has the scores of each run; the next start reads them")
