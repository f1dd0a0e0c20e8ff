"""How well does `result.graph()` find what stands on what? In generated rooms with their true labels.

    python lab/studies/relations.py [--first 10] [--rooms 4]

The truth comes from the triangles of the room: a thing stands on another if one of its lowest corners is within 12 mm
of a level surface of the other, the highest there. Things that less than 30 points show do not count, and no walls and
doors. Rooms 0 to 3 were looked at while the rules were made.
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt
import torch

import torchjoint as tj
from torchjoint.synthetic import SyntheticScene, make_scene

#: Metres; and names of what is a part of the room.
NEAR, SHELL = 0.012, ("wall", "floor", "ceiling", "door", "window")
LEAST_POINTS, CORNERS = 30, 40
Array = npt.NDArray[np.float64]
Pairs = set[tuple[int, int]]


def true_pairs(made: SyntheticScene) -> Pairs:
    """(what stands, on what), by instance."""
    triangles, labels = made.triangles.double().numpy(), made.triangle_labels.numpy()
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1)
    is_level = (np.abs(normals[:, 2]) > 0.9 * length) & (length > 2e-7)
    found: Pairs = set()
    for instance in np.unique(labels).tolist():
        if made.instance_names[instance] in SHELL:
            continue
        corners = triangles[labels == instance].reshape(-1, 3)
        lowest = corners[corners[:, 2] < corners[:, 2].min() + 0.004]
        lowest = lowest[np.random.default_rng(0).permutation(len(lowest))[:CORNERS]]
        others = is_level & (labels != instance)
        for corner in lowest:
            below = carrier(corner, triangles[others], labels[others])
            if below is not None:
                found.add((instance, below))
    return found


def carrier(corner: Array, triangles: Array, labels: npt.NDArray[np.int64]) -> int | None:
    """The instance of the highest triangle within NEAR above or below a corner."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    way = corner - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    s = (way[:, 0] * v[:, 1] - way[:, 1] * v[:, 0]) / area
    t = (u[:, 0] * way[:, 1] - u[:, 1] * way[:, 0]) / area
    height = a[:, 2] + s * u[:, 2] + t * v[:, 2]
    inside = (s >= -1e-3) & (t >= -1e-3) & (s + t <= 1.001) & (np.abs(height - corner[2]) < NEAR)
    return int(labels[inside][np.argmax(height[inside])]) if inside.any() else None


def found_pairs(made: SyntheticScene) -> tuple[Pairs, set[int]]:
    """The pairs of `result.graph()`, and the instances that are seen well enough."""
    ids, labels, counts = made.point_labels.unique(return_inverse=True, return_counts=True)
    result = tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points))
    relations = result.graph(torch.tensor([0.0, 0.0, 1.0])).relations
    pairs = {(int(ids[one.first]), int(ids[one.second])) for one in relations if one.kind == "stands on"}
    seen = {one for one, count in zip(ids.tolist(), counts.tolist(), strict=True) if count >= LEAST_POINTS}
    return {pair for pair in pairs if made.instance_names[pair[0]] not in SHELL}, seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=10)
    parser.add_argument("--rooms", type=int, default=4)
    arguments = parser.parse_args()
    total = np.zeros(3, dtype=int)
    for seed in range(arguments.first, arguments.first + arguments.rooms):
        made = make_scene(seed, size="large")
        found, seen = found_pairs(made)
        found, true = ({pair for pair in pairs if seen.issuperset(pair)} for pairs in (found, true_pairs(made)))
        total += [len(found & true), len(found), len(true)]
        print(f"room {seed}: {len(found & true)} right of {len(found)} found and {len(true)} true", flush=True)
    print(f"precision {total[0] / total[1]:.3f} of {total[1]}, recall {total[0] / total[2]:.3f} of {total[2]}")


if __name__ == "__main__":
    main()
