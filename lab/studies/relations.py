"""How well does `result.graph()` find what stands on, hangs on, is in and touches what? In generated rooms.

    python lab/studies/relations.py [--first 10] [--rooms 4]

The labels are the true ones, and the truth comes from the triangles of the room:

- a thing stands on another if one of its lowest corners is within 12 mm of a level surface of the other, the highest;
- two things touch if at least 2 cm² of one are within 12 mm of the other, also where no camera saw it;
- a thing that stands on nothing, 10 cm above the floor or higher (the sofas' feet were not modelled), hangs on the one
  that it touches most, if that is mostly upright there;
- a hollow thing contains what is in its convex hull.

Things that less than 30 points show do not count, and no walls and doors, except as what carries or is touched. What
is found to stand or hang, also touches. Rooms 0 to 3 were looked at while the rules were made.
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import Delaunay, cKDTree
from torchjoint_lab.synthetic import SyntheticScene, make_scene

import torchjoint as tj

#: Metres; and names of what is a part of the room.
NEAR, SHELL = 0.012, ("wall", "floor", "ceiling", "door", "window")
LEAST_POINTS, CORNERS = 30, 40
#: Samples of the surfaces, on a square metre; the least contact, square metres; the part of a thing inside another; the
#: height from which things hang, metres.
DENSITY, CONTACT, INSIDE, ABOVE = 20_000, 2e-4, 0.95, 0.1
UP = torch.tensor([0.0, 0.0, 1.0])
KINDS = ("stands on", "hangs on", "contains", "touches")
Array = npt.NDArray[np.float64]
Pairs = set[tuple[int, int]]


def true_pairs(made: SyntheticScene) -> dict[str, Pairs]:
    """The pairs of each kind, by instance: (what stands, on what), (what hangs, on what), (hollow thing, content)."""
    triangles, labels = made.triangles.double().numpy(), made.triangle_labels.numpy()
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1)
    things = [one for one in np.unique(labels).tolist() if made.instance_names[one] not in SHELL]
    is_level = (np.abs(normals[:, 2]) > 0.9 * length) & (length > 2e-7)
    stands = {pair for one in things for pair in _standing(one, triangles, labels, is_level)}
    chosen = np.random.default_rng(0).choice(len(length), int(DENSITY * length.sum() / 2), p=length / length.sum())
    samples, of = _in_triangles(triangles[chosen]), labels[chosen]
    is_upright = np.abs(normals[chosen, 2]) < 0.35 * length[chosen]
    hulls = {
        one: Delaunay(np.unique(triangles[labels == one].reshape(-1, 3), axis=0))
        for one in things
        if made.instance_kinds[one] == "concave"
    }
    hangs, contains, touches = set(), set(), set()
    for one in things:
        own = samples[of == one]
        contains |= {
            (hull, one)
            for hull, inside in hulls.items()
            if hull != one and (inside.find_simplex(own) >= 0).mean() >= INSIDE
        }
        near = np.nonzero(((samples > own.min(0) - NEAR) & (samples < own.max(0) + NEAR)).all(1) & (of != one))[0]
        near = near[np.isfinite(cKDTree(own).query(samples[near], distance_upper_bound=NEAR)[0])]
        others, counts = np.unique(of[near], return_counts=True)
        others, counts = others[counts >= CONTACT * DENSITY], counts[counts >= CONTACT * DENSITY]
        touches |= {(min(one, other), max(one, other)) for other in others.tolist()}
        if len(others) and own[:, 2].min() > ABOVE and one not in {first for first, _ in stands}:
            most = int(others[counts.argmax()])
            if is_upright[near[of[near] == most]].mean() > 0.5:
                hangs.add((one, most))
    return dict(zip(KINDS, (stands, hangs, contains, touches), strict=True))


def _in_triangles(triangles: Array) -> Array:
    """A random point in each triangle."""
    u, v = np.random.default_rng(1).random((2, len(triangles), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return triangles[:, 0] + u * (triangles[:, 1] - triangles[:, 0]) + v * (triangles[:, 2] - triangles[:, 0])


def _standing(thing: int, triangles: Array, labels: npt.NDArray[np.int64], is_level: npt.NDArray[np.bool_]) -> Pairs:
    corners = triangles[labels == thing].reshape(-1, 3)
    lowest = corners[corners[:, 2] < corners[:, 2].min() + 0.004]
    lowest = lowest[np.random.default_rng(0).permutation(len(lowest))[:CORNERS]]
    others = is_level & (labels != thing)
    below = {carrier(corner, triangles[others], labels[others]) for corner in lowest}
    return {(thing, other) for other in below if other is not None}


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


def found_pairs(made: SyntheticScene) -> tuple[dict[str, Pairs], set[int]]:
    """The pairs of `result.graph()`, and the instances that are seen well enough."""
    ids, labels, counts = made.point_labels.unique(return_inverse=True, return_counts=True)
    result = tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points, up=UP))
    found: dict[str, Pairs] = {kind: set() for kind in KINDS}
    for one in result.graph().relations:
        pair = int(ids[one.first]), int(ids[one.second])
        found[one.kind].add(pair)
        if one.area:
            found["touches"].add((min(pair), max(pair)))
    seen = {one for one, count in zip(ids.tolist(), counts.tolist(), strict=True) if count >= LEAST_POINTS}
    return found, seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=10)
    parser.add_argument("--rooms", type=int, default=4)
    arguments = parser.parse_args()
    total = {kind: np.zeros(3, dtype=int) for kind in KINDS}
    for seed in range(arguments.first, arguments.first + arguments.rooms):
        made = make_scene(seed, size="large")
        (found, seen), true = found_pairs(made), true_pairs(made)
        shell = {one for one in seen if made.instance_names[one] in SHELL}
        for kind, counts in total.items():
            said, real = (
                {pair for pair in pairs[kind] if seen.issuperset(pair) and not _is_of_shell(kind, pair, shell)}
                for pairs in (found, true)
            )
            counts += [len(said & real), len(said), len(real)]
            print(f"room {seed}, {kind}: {len(said & real)} right of {len(said)} found, {len(real)} true", flush=True)
    for kind, (right, said, real) in total.items():
        print(f"{kind}: precision {right / said:.3f} of {said}, recall {right / real:.3f} of {real}")


def _is_of_shell(kind: str, pair: tuple[int, int], shell: set[int]) -> bool:
    """Whether a pair is of the room itself: what stands, hangs or is contained, or both of what touch."""
    return shell.issuperset(pair) if kind == "touches" else pair[kind == "contains"] in shell


if __name__ == "__main__":
    main()
