"""How sure is a segment? Fits the confidence of segments, and tests it on kinds of data that the fit did not see.

    python lab/studies/confidence.py WORK [--data DATA] [--scenes 4] [--write]

A scene that was measured is not measured again. --write draws docs/confidence.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from sklearn.linear_model import LogisticRegression
from torchjoint_lab.benchmark.real_scenes import LabelledScene, RealScene, all_known, find_real_scenes
from torchjoint_lab.benchmark.robustness_scenes import find_scenes

from torchjoint.joint import JointSegmenter
from torchjoint.scene.hierarchy import OFFSET, PER_IOU, PER_LOG_POINTS

#: Kinds with truth whose scenes method learned segments: generated ones, and real ones of `torchjoint-lab real`.
GENERATED = ("table", "shelf", "bin", "desk", "kitchen", "room", "workshop")
REAL = ("shelf", "tote", "rio", "piles", "trees", "ycb", "mosd")
#: A segment counts if more than this share of its points has a truth.
LEAST_KNOWN = 0.5
#: Edges of the probabilities that the diagram and the table put together.
EDGES = np.linspace(0, 1, 6)
PICTURE = Path(__file__).parents[2] / "docs" / "confidence.png"

Array = npt.NDArray[np.float64]


class Segments(NamedTuple):
    """The segments of some scenes, and a sample of their points."""

    features: Array  #: [S, 2] mean IoU with the judges' segments, log of the points
    is_object: Array  #: [S] whether the IoU with an object is at least .5
    kind: npt.NDArray[np.str_]  #: [S]
    segment: npt.NDArray[np.int64]  #: [N] of each point
    share: Array  #: [N] of the judges
    is_right: Array  #: [N] whether the segment is an object, and the point a part of it


def measure(labelled: LabelledScene) -> dict[str, npt.NDArray[np.generic]]:
    """The arrays of Segments for one scene."""
    result = JointSegmenter()(labelled.scene)
    assert result.hierarchy is not None
    assert result.hierarchy.votes is not None
    superpoint, truth = result.hierarchy.superpoint, labelled.truth.instance
    of_superpoint = superpoint.new_zeros(result.hierarchy.num_superpoints)
    of_superpoint[superpoint] = result.points
    iou, points, share = result.hierarchy.votes.agreement(of_superpoint)
    known, counts = truth >= 0, labelled.truth.counts
    shared = np.zeros((len(points), int(truth.max()) + 1))
    np.add.at(shared, (result.points[known].numpy(), truth[known].numpy()), 1)
    size = np.bincount(result.points[counts].numpy(), minlength=len(points))
    ious = shared / np.maximum(size[:, None] + np.bincount(truth[known].numpy()) - shared, 1)
    counted = size > LEAST_KNOWN * np.bincount(result.points.numpy())
    number = np.cumsum(counted) - 1
    sample = np.flatnonzero(counts.numpy() & counted[result.points.numpy()])[::7]
    label = result.points.numpy()[sample]
    is_object = ious.max(1) >= 0.5
    return {
        "features": np.stack([iou.numpy(), points.log().numpy()], 1)[counted],
        "is_object": is_object[counted],
        "segment": number[label],
        "share": share[superpoint].numpy()[sample],
        "is_right": is_object[label] & (truth.numpy()[sample] == ious.argmax(1)[label]),
    }


def find(data: Path | None, count: int) -> list[RealScene]:
    """At most `count` scenes of each kind; a kind that is generated and real is two."""
    found = [
        RealScene(one.kind, one.name, lambda one=one: all_known(one.load()))  # type: ignore[misc]
        for one in find_scenes(GENERATED, count, None)
    ]
    for kind in REAL if data else ():
        of_kind = [one for one in find_real_scenes(data, (kind,)) if not one.masks]
        found += [one._replace(set=f"real {kind}") for one in of_kind[:count]]
    return found


def collect(scenes: list[RealScene], work: Path) -> Segments:
    """Measures all scenes that have no file in the folder yet."""
    parts: list[Segments] = []
    total = 0
    for one in scenes:
        file = work / f"{one.name}.npz"
        if not file.is_file():
            np.savez_compressed(file, **measure(one.load()))  # type: ignore[arg-type]
            print(one.name, flush=True)
        with np.load(file) as found:
            count = len(found["features"])
            kinds = np.array([one.set] * count)
            parts.append(
                Segments(
                    found["features"], found["is_object"], kinds, found["segment"] + total, found["share"],
                    found["is_right"],
                )
            )  # fmt: skip
        total += count
    return Segments(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def fitted(found: Segments, chosen: npt.NDArray[np.bool_]) -> LogisticRegression:
    """Each kind of data has the same weight."""
    kinds, number = np.unique(found.kind[chosen], return_inverse=True)
    weight = chosen.sum() / len(kinds) / np.bincount(number)[number]
    return LogisticRegression(C=1e3).fit(found.features[chosen], found.is_object[chosen], weight)


def left_out(found: Segments) -> Array:
    """[S] the confidence of each segment, by a fit to the other kinds."""
    sure = np.empty(len(found.kind))
    for kind in np.unique(found.kind):
        own = found.kind == kind
        sure[own] = fitted(found, ~own).predict_proba(found.features[own])[:, 1]
    return sure


def reliability(sure: Array, is_true: Array) -> list[tuple[float, float, int]]:
    """For each range of confidence: its mean, the share that is true, and the number."""
    place = np.digitize(sure, EDGES[1:-1])
    inside = [place == one for one in range(len(EDGES) - 1)]
    return [(float(sure[one].mean()), float(is_true[one].mean()), int(one.sum())) for one in inside if one.any()]


def draw(tables: dict[str, list[tuple[float, float, int]]]) -> None:
    """The reliability diagram."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(4.2, 4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for (name, rows), marker in zip(tables.items(), "os", strict=True):
        axes.plot([row[0] for row in rows], [row[1] for row in rows], marker=marker, label=name)
    axes.set(xlabel="confidence", ylabel="share that is true", xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(PICTURE, dpi=150)


def main() -> None:
    """Measures, fits, prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    found = collect(find(options.data, options.scenes), options.work)
    model = fitted(found, np.ones(len(found.kind), dtype=bool))
    offset, (per_iou, per_log_points) = model.intercept_[0], model.coef_[0]
    print(f"fit to all kinds: offset {offset:.3f}, {per_iou:.3f} per IoU, {per_log_points:.4f} per log of points")
    print(f"in the package:   offset {OFFSET}, {PER_IOU} per IoU, {PER_LOG_POINTS} per log of points")
    sure = left_out(found)
    tables = {
        "segments": reliability(sure, found.is_object),
        "points": reliability(sure[found.segment] * found.share, found.is_right),
    }
    for name, rows in tables.items():
        print(f"\n{name}, kinds left out | confidence | share that is true | number")
        print("\n".join(f"| {mean:.2f} | {share:.2f} | {number} |" for mean, share, number in rows))
    if options.write:
        draw(tables)


if __name__ == "__main__":
    main()
