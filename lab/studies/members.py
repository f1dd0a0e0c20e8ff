"""How are the members of a model combined best, and what do images give? On all scenes of each kind that was left out.

    python lab/studies/members.py WORK [--write]

WORK is the folder of lab/studies/domains.py after `--part left-out`: its models never saw the kind of data in their
row, so all scenes of this kind serve here, those for training, too. Kinds without models in WORK are left out.
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path

import numpy as np
import report
import torch
from domain_tables import difference
from domains import DOMAINS
from torch import Tensor
from torchjoint_lab.training.boundary_examples import IMAGE_FEATURES, feature_columns
from torchjoint_lab.training.piece_graph_files import load_evidence

from torchjoint.evaluation.scores import score
from torchjoint.runtime.files import write_text
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.segments.learned.agglomeration import build_hierarchy
from torchjoint.segments.learned.boundary_model import BoundaryModel, calibrated
from torchjoint.segments.learned.boundary_model_file import load_boundary_model

#: Kinds of data, and the kind whose left-out models never saw them.
KINDS = {**{kind: kind for kind in DOMAINS}, "mosd": "mosd", "ycb": "desk"}
NAMES = {"mosd": "real table-tops (mOSD)", "ycb": "real desk (YCB-Video)"}
WAYS = ("log odds", "probabilities", "log odds, no images", "probabilities, no images")


class MeanOfLogOdds(BoundaryModel):
    """The other way: the mean of the members' log odds, and the mean of their calibrations for all."""

    def probability(self, number: int, values: Tensor) -> Tensor:
        log_odds = torch.stack([member.rounds[number].score(values) for member in self.members]).mean(0)
        maps = [calibrated(torch.sigmoid(log_odds), member.calibrations[number]) for member in self.members]
        return torch.stack(maps).mean(0)


class WithoutImages:
    """A model that is not told what the images say about a boundary."""

    def __init__(self, model: BoundaryModel) -> None:
        self._model = model
        self.thresholds = model.thresholds

    def probability(self, number: int, values: Tensor) -> Tensor:
        values = values.clone()
        values[:, feature_columns(IMAGE_FEATURES)] = torch.nan
        return self._model.probability(number, values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    report.add_write(parser)
    arguments = parser.parse_args()
    work: Path = arguments.work
    kinds = {
        kind: left_out for kind, left_out in KINDS.items() if evidence_paths(work, kind) and model_paths(work, left_out)
    }
    if not kinds:
        parser.error(
            f"work: {work} has no models with evidence; first run lab/studies/domains.py {work} --part left-out"
        )
    scores = {kind: np.array(scores_of_kind(work, kind, left_out)) for kind, left_out in kinds.items()}
    scores["all"] = np.concatenate(list(scores.values()))
    comparisons = {
        "probabilities - log odds": (1, 0),
        "the same, no images": (3, 2),
        "with - without images": (1, 3),
    }
    rows = [
        [f"{NAMES.get(kind, kind)}, {len(of_kind)}", *(" / ".join(f"{x:.3f}" for x in of_kind[:, 1].mean(0)),)]
        + [difference(of_kind[:, new] - of_kind[:, old]) for new, old in comparisons.values()]
        for kind, of_kind in scores.items()
    ]
    columns = ["kind of data, scenes", "mean of probabilities", *comparisons]
    report.show("members", report.table(columns, rows), arguments.write)


def scores_of_kind(work: Path, kind: str, left_out: str) -> list[list[tuple[float, float]]]:
    """For each scene, F and best IoU of each of the WAYS; kept in WORK."""
    done = work / f"members-{kind}.json"
    if not done.is_file():
        model = left_out_models(work, left_out)
        with one_thread_per_operation():
            rows = parallel_map(partial(scores_of_scene, model=model), evidence_paths(work, kind))
        write_text(done, json.dumps(rows))
        print(kind, len(rows), np.mean(rows, 0).round(3).tolist(), flush=True)
    return json.loads(done.read_text())


def left_out_models(work: Path, left_out: str) -> BoundaryModel:
    """The mean of the models that never saw a kind of data, of all training seeds in WORK."""
    paths = model_paths(work, left_out)
    if not paths:
        raise FileNotFoundError(
            f"{work}: no model-without-{left_out}-SEED.npz; domains.py {work} --part left-out trains it"
        )
    return BoundaryModel.mean_of([load_boundary_model(path) for path in paths])


def model_paths(work: Path, left_out: str) -> list[Path]:
    """The files of these models, one for each training seed."""
    return sorted(work.glob(f"model-without-{left_out}-*.npz"))


def evidence_paths(work: Path, kind: str) -> list[Path]:
    """The files with evidence with images, one for each scene of a kind: the first run, where there are several."""
    paths = sorted((work / "evidence").glob(f"{kind}-*.pt"))
    return [path for path in paths if path.stem.endswith(".0") or "." not in path.stem]


def scores_of_scene(path: Path, model: BoundaryModel) -> list[tuple[float, float]]:
    """F and best IoU of the points of the working cloud, for each of the WAYS."""
    evidence, instance = load_evidence(path)
    other = MeanOfLogOdds(model.members)
    found = []
    for way in (other, model, WithoutImages(other), WithoutImages(model)):
        judged = score(build_hierarchy(evidence, way).at(), instance)
        found.append((judged.f, judged.best_iou))
    return found


if __name__ == "__main__":
    main()
