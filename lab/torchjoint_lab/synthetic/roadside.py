"""What stands beside streets: poles, signs, trees, hedges, fences, walls, buildings, bins; one instance each."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import prints
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import Part, box, cup, cylinder
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.making import made
from torchjoint_lab.synthetic.solids import blob, random_rotation, rod, rounded_box
from torchjoint_lab.synthetic.style import Style


def pole(rng: Rng, style: Style) -> Item:
    """A lamp post, a sign, a bollard or a traffic light."""
    coat, kind = style.body(0.3), rng.integers(4)
    r = rng.uniform(0.03, 0.12)
    if kind == 0:
        h = rng.uniform(4, 8)
        arm = rod((0, 0, h), (rng.uniform(0.5, 2), 0, h + 0.2), 0.05)
        return made("pole", [(rod((0, 0, 0), (0, 0, h), r, 0.6 * r), coat), (arm, coat)])
    if kind == 1:
        h, size = rng.uniform(2.0, 3.0), rng.uniform(0.4, 0.9)
        face = prints.package(rng, (size, size))
        return made("pole", [(cylinder(0.035, h), coat), (box((0.03, size, size), (0.04, 0, h - size)), face)])
    if kind == 2:
        return made("pole", [(cylinder(r, rng.uniform(0.7, 1.1)), coat)])
    h = rng.uniform(2.4, 3.5)
    return made("pole", [(cylinder(0.06, h), coat), (box((0.25, 0.3, 0.9), (0.1, 0, h - 0.9)), style.body(0.1))])


def tree(rng: Rng, style: Style) -> Item:
    """A tree: a trunk, and a crown of a few lumps with loose leaves around them."""
    h, r = rng.uniform(3.5, 10), rng.uniform(0.08, 0.3)
    bark = prints.rough(rng, np.array([0.35, 0.27, 0.2]), 0.6)
    green = prints.rough(rng, np.array([0.2, 0.33, 0.13]) * rng.uniform(0.7, 1.4), 1.0, 0.4)
    crown = rng.uniform(0.3, 0.55) * h
    parts = [(rod((0, 0, 0), (rng.normal(0, 0.2), rng.normal(0, 0.2), h - 0.6 * crown), r, 0.5 * r), bark)]
    for _ in range(rng.integers(2, 6)):
        size = crown * rng.uniform(0.4, 0.9, 3)
        at = [*(rng.normal(0, 0.2, 2) * crown), h - crown + rng.uniform(0, 0.5) * crown]
        parts.append((blob(rng, size, 0.2, 1.0, at), green))
    return made("tree", [*parts, (leaves(rng, (0, 0, h - 0.5 * crown), (0.5 * crown,) * 3, 260), green)])


def leaves(rng: Rng, middle: tuple[float, float, float], reach: tuple[float, float, float], count: int) -> Part:
    """Loose triangles of leaf clusters, 10 to 40 cm, spread around ``middle``."""
    place = rng.normal(0, 0.42, (count, 1, 3)) * reach + np.asarray(middle)
    shape = rng.normal(0, 1, (count, 3, 3)) * rng.uniform(0.05, 0.2, (count, 1, 1))
    positions: Array = place + shape
    normal = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return Part(positions, np.repeat(normal[:, None], 3, axis=1), rng.uniform(0, 1, (count, 3, 2)))


def hedge(rng: Rng, style: Style) -> Item:
    """A hedge or a bush, along x."""
    length, wide, h = rng.uniform(1.0, 9.0), rng.uniform(0.5, 1.4), rng.uniform(0.6, 2.2)
    green = prints.rough(rng, np.array([0.17, 0.3, 0.12]) * rng.uniform(0.7, 1.5), 0.7, 0.45)
    body = blob(rng, (length, wide, h), 0.08, 0.45)
    return made("hedge", [(body, green), (leaves(rng, (0, 0, h / 2), (0.6 * length, 0.5 * wide, 0.5 * h), 150), green)])


def fence(rng: Rng, style: Style) -> Item:
    """A fence of pickets or rails, along x."""
    length, h, coat = rng.uniform(3, 12), rng.uniform(0.8, 1.8), style.wood() if rng.random() < 0.5 else style.body(0.2)
    parts = [(box((length, 0.04, 0.08), (0, 0, z * h)), coat) for z in (0.25, 0.8)]
    step = rng.uniform(0.12, 0.4) if rng.random() < 0.7 else 2.0
    wide = 0.08 if step < 1 else 0.12
    parts += [(box((wide, 0.03, h), (x, 0.03, 0)), coat) for x in np.arange(-length / 2, length / 2, step)]
    return made("fence", parts)


def wall(rng: Rng, style: Style) -> Item:
    """A garden wall, along x."""
    length, h = rng.uniform(3, 14), rng.uniform(0.5, 2.2)
    stone = prints.joints(
        rng, paint.pick(rng, paint.WOODS + paint.WALLS), (0.25, 0.1), rng.uniform(0.7, 1.3), shift=True
    )
    cap = prints.rough(rng, paint.pick(rng, paint.SOBER[1:3]), 0.5)
    return made("wall", [(box((length, 0.25, h)), stone), (box((length + 0.06, 0.33, 0.06), (0, 0, h)), cap)])


def building(rng: Rng, style: Style) -> Item:
    """A house front along x with windows, doors and a plinth."""
    length, deep, h = rng.uniform(7, 22), rng.uniform(6, 10), rng.uniform(4, 12)
    coat = style.wall()
    glass = paint.plain(rng, np.array([0.1, 0.12, 0.15]), 0.9, 0.6)
    frame = style.body(0.2)
    parts = [(box((length, deep, h)), coat)]
    for z in np.arange(1.0, h - 1.6, 2.9):
        for x in np.arange(-length / 2 + 1.2, length / 2 - 0.8, rng.uniform(1.8, 3.2)):
            for y in (-1, 1):
                parts.append((box((1.1, 0.08, 1.4), (x, y * (deep / 2), z)), glass))
                parts.append((box((1.3, 0.16, 0.08), (x, y * (deep / 2 + 0.02), z - 0.08)), frame))
    return made("building", parts)


def street_bin(rng: Rng, style: Style) -> Item:
    """A bin, a box of the telephone company, a bench, a stone."""
    kind, coat = rng.integers(4), style.body(0.1)
    if kind == 0:
        return made("bin", [(cup(0.25, rng.uniform(0.7, 1.0), 0.02), coat)], hollow=True)
    if kind == 1:
        return made("bin", [(rounded_box((0.58, 0.72, 1.05), 0.05), coat)])
    if kind == 2:
        parts = [
            (box((1.6, 0.45, 0.06), (0, 0, 0.42)), style.wood()),
            (box((1.6, 0.05, 0.4), (0, 0.22, 0.5)), style.wood()),
        ]
        return made("bench", [*parts, *((box((0.08, 0.4, 0.42), (x, 0, 0)), coat) for x in (-0.7, 0.7))])
    stone = blob(rng, rng.uniform(0.4, 1.1, 3), 0.12, 0.8)
    return made("stone", [(turned_anyhow(rng, stone), prints.rough(rng, np.array([0.5, 0.5, 0.48]), 0.5))])


def cafe_table(rng: Rng, style: Style) -> Item:
    """A table in front of a cafe with its chairs."""
    coat, wood = style.body(0.2), style.wood()
    parts = [(cylinder(0.03, 0.72), coat), (box((0.7, 0.7, 0.03), (0, 0, 0.72)), wood)]
    for turn in rng.uniform(-0.3, 0.3) + np.arange(rng.integers(1, 5)) * np.pi / 2:
        x, y = 0.6 * np.cos(turn), 0.6 * np.sin(turn)
        parts += [(box((0.4, 0.4, 0.45), (x, y, 0)), coat), (box((0.3, 0.3, 0.9), (1.3 * x, 1.3 * y, 0)), coat)]
    return made("table", parts)


def turned_anyhow(rng: Rng, part: Part) -> Part:
    """The part in a random orientation, its lowest point at z = 0."""
    rotation = random_rotation(rng)
    positions = part.positions @ rotation.T
    return Part(positions - [0, 0, positions[..., 2].min()], part.normals @ rotation.T, part.uv)
