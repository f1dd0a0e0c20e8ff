"""torchjoint-lab real: scores the default on real recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from torchjoint.runtime.files import write_text
from torchjoint.runtime.outputs import Output
from torchjoint_lab.benchmark.real import Results, best_rival, measure, report
from torchjoint_lab.benchmark.real_picture import draw_worst
from torchjoint_lab.benchmark.real_scenes import find_real_scenes
from torchjoint_lab.cli.arguments import check_output

TABLE, PICTURE = "table.md", "worst.jpg"


def real(
    data: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("real"),
    sets: tuple[str, ...] = (),
    runs: int = 4,
    rivals: int = 0,
    scan_models: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Scores the default on real recordings, most of them of kinds that no training has seen.

    Each scene is segmented several times, on points that move by 0.1 mm (LiDAR: 1 cm), because the score of one run is
    chance. A run that was killed goes on when the same command is started again; use a new folder after a change of
    the code.

    Args:
        data: folder with real/, ycb/, mosd/, kitti/, semantickitti/, vod/, argo/ and nuscenes/, or some of them.
        out: folder of table.md, which grows scene by scene, of worst.jpg, and of runs/ and rivals/.
        sets: shelf, tote, rio, piles, trees, ycb, mosd, kitti, semantickitti, vod, argo, nuscenes; default: all.
        runs: number of runs of each scene.
        rivals: number of random settings of each simple method, whose best is a column of the table; 0: no such column.
        scan_models: folder of `train-scan-model`: no LiDAR scan is segmented by a model that has seen its sensor.
        overwrite: replace files in OUT that no earlier start has written.
    """
    for name, value, least in (("runs", runs, 1), ("rivals", rivals, 0)):
        if value < least:
            raise ValueError(f"--{name}: expected at least {least}, got {value}")
    scenes = find_real_scenes(data, sets)
    folders = [out / name for name in ("runs", "rivals")]
    files = check_output(out, (TABLE, PICTURE), overwrite or folders[0].is_dir(), (data,))
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    results: Results = {}
    for of_scene in measure(scenes, runs, folders[0], scan_models):
        results |= of_scene
        _write(files[TABLE], report(results, {}))
    found = {}
    for name in dict.fromkeys(one.set for one in scenes if not one.masks) if rivals else ():
        found[name] = best_rival([one for one in scenes if one.set == name], rivals, runs, folders[1])
        _write(files[TABLE], report(results, found))
    with files[PICTURE].written() as path:
        draw_worst(results, folders[0], path)
    print(f"\n{report(results, found)}\n\nwritten to {out}: {TABLE}, {PICTURE}; the next start reads runs/ and rivals/")


def _write(table: Output, text: str) -> None:
    with table.written() as path:
        write_text(path, f"{text}\n")
