"""torchjoint-lab train-scan-model: trains the model of step 6, method scan, on generated streets and real scans."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from torchjoint_lab.cli.arguments import check_output


def train_scan_model(
    data: Path | None = None,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("scan"),
    seeds: tuple[int, int] = (2000, 2090),
    overwrite: bool = False,
) -> None:
    """Trains the model that says which parts of a scan's tree are things.

    OUT/scan.npz learns from everything; OUT/without-NAME.npz from all but one sensor, on which it can be judged.

    Args:
        data: folder with kitti/, semantickitti/, vod/, argo/ and nuscenes/, or some of them; default: only streets.
        out: folder of the models.
        seeds: first seed of the generated streets, and the seed after the last one.
        overwrite: replace the models in OUT.
    """
    from tqdm import tqdm

    from torchjoint_lab.benchmark.real_scenes import model_without
    from torchjoint_lab.training.boundary_model_file import save_boundary_model
    from torchjoint_lab.training.scan_model import fit_scan_model, real_examples, street_examples

    if not 0 <= seeds[0] < seeds[1]:
        raise ValueError(f"--seeds: expected 0 <= first < end, got {seeds[0]} {seeds[1]}")
    examples = list(real_examples(data)) if data is not None else []
    sensors = sorted({one.sensor for one in examples})
    names = {"": "scan.npz", **{sensor: model_without(sensor) for sensor in sensors}}
    files = check_output(out, tuple(names.values()), overwrite, () if data is None else (data,))
    out.mkdir(parents=True, exist_ok=True)
    for seed in tqdm(range(*seeds), unit="street"):
        examples += street_examples([seed])
    for sensor, name in names.items():
        with files[name].written() as path:
            save_boundary_model(path, fit_scan_model(examples, sensor))
    print(f"{len(names)} models of {len(examples)} scans: {out}")
