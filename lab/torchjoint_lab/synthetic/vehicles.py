"""Cars, vans and people of a street; each function draws one as one instance, its front towards +x."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchjoint_lab.synthetic import prints
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part, box, cylinder
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.making import made
from torchjoint_lab.synthetic.solids import blob, euler, ring, rod, rounded_box, sheet_of, turned
from torchjoint_lab.synthetic.style import Style


def car(rng: Rng, style: Style) -> Item:
    """A car of any shape: hatchback, saloon, estate, sports car."""
    length, width, height = rng.uniform(3.4, 4.9), rng.uniform(1.6, 1.9), rng.uniform(1.3, 1.75)
    bonnet, boot = rng.uniform(0.22, 0.32), rng.uniform(0.0, 0.2)
    belt = rng.uniform(0.52, 0.62) * height
    nose, clear = rng.uniform(0.4, 0.5) * height, rng.uniform(0.16, 0.24)
    half = length / 2
    lower = [(-half, clear), (half, clear), (half, nose), (half - bonnet * length, belt), (-half, belt)]
    front, rear = half - bonnet * length, -half + boot * length
    slant = rng.uniform(0.4, 0.7)
    cabin = [(rear, belt), (front, belt), (front - slant, height), (rear + rng.uniform(0.1, 0.5), height)]
    coat = paint.plain(rng, _lacquer(rng), 0.8, rng.uniform(0, 0.15))
    glass = paint.plain(rng, np.array([0.08, 0.1, 0.12]), 0.9, rng.uniform(0.3, 0.8))
    parts = [(_hull(lower, width, 0.0), coat), (_hull(cabin, 0.94 * width, 0.16), glass)]
    roof = [(cabin[3][0], height - 0.01), (cabin[2][0], height - 0.01), (cabin[2][0] - 0.06, height + 0.03)]
    parts.append((_hull([*roof, (cabin[3][0] + 0.06, height + 0.03)], 0.78 * width, 0.03), coat))
    for x in (cabin[3][0] + 0.05, (cabin[2][0] + cabin[3][0]) / 2, cabin[2][0] - 0.05):  # pillars
        parts.append(_pillar(x, width, belt, height, coat))
    return made("car", [*parts, *_wheels(rng, half * 0.62, width, rng.uniform(0.28, 0.36))])


def van(rng: Rng, style: Style) -> Item:
    """A van, bus or lorry: a high box, printed now and then, and a slanting front."""
    length, width, height = rng.uniform(4.6, 8.0), rng.uniform(1.9, 2.4), rng.uniform(2.0, 3.2)
    half, cab = length / 2, rng.uniform(0.9, 1.6)
    coat = paint.plain(rng, _lacquer(rng), 0.6)
    sides = prints.package(rng, (length, height)) if rng.random() < 0.4 else coat
    glass = paint.plain(rng, np.array([0.08, 0.1, 0.12]), 0.9, rng.uniform(0.3, 0.8))
    nose = [
        (half - cab, 0.3),
        (half, 0.3),
        (half, 0.45 * height),
        (half - 0.55 * cab, 0.75 * height),
        (half - cab, 0.8 * height),
    ]
    parts = [
        (box((length - cab, width, height - 0.35), (-cab / 2, 0, 0.35)), sides),
        (_hull(nose, 0.96 * width, 0.04), coat),
    ]
    screen = [(half - 0.03, 0.47 * height), (half + 0.01, 0.47 * height), (half - 0.52 * cab, 0.74 * height)]
    parts.append((_hull([*screen, (half - 0.55 * cab, 0.72 * height)], 0.85 * width, 0.02), glass))
    return made("van", [*parts, *_wheels(rng, half * 0.65, width, rng.uniform(0.33, 0.45))])


def person(rng: Rng, style: Style) -> Item:
    """Somebody who stands or walks, with a bag now and then."""
    height = rng.uniform(1.1, 1.3) if rng.random() < 0.1 else rng.uniform(1.5, 1.95)
    s, stride = height / 1.75, rng.uniform(-0.35, 0.35)
    top, legs, skin = (
        style.cloth(),
        style.body(0.0),
        paint.plain(rng, np.array([0.75, 0.55, 0.42]) * rng.uniform(0.4, 1.15)),
    )
    hip, neck = 0.85 * s, 1.45 * s
    parts: list[tuple[Part, Material]] = []
    for side in (-1, 1):
        foot = (side * stride * s, side * 0.1 * s, 0.05)
        parts.append((rod(foot, (0, side * 0.08 * s, hip), 0.06 * s, 0.09 * s), legs))
        parts.append((rounded_box((0.26 * s, 0.1, 0.09), 0.03, (foot[0] + 0.05, foot[1], 0)), style.body(0.1)))
        hand = (-side * 0.7 * stride * s, side * 0.27 * s, 0.8 * s)
        parts.append((rod((0, side * 0.2 * s, 1.38 * s), hand, 0.055 * s, 0.04 * s), top))
    parts.append((blob(rng, (0.26 * s, 0.44 * s, neck - hip + 0.12), 0.03, 0.8, (0, 0, hip - 0.06)), top))
    parts.append((blob(rng, (0.19 * s, 0.17 * s, 0.26 * s), 0.02, 1.0, (0, 0, neck)), skin))
    hair = paint.plain(rng, np.array([0.25, 0.17, 0.1]) * rng.uniform(0.3, 2.5))
    parts.append((blob(rng, (0.2 * s, 0.19 * s, 0.14 * s), 0.04, 1.0, (-0.02, 0, neck + 0.14 * s)), hair))
    if rng.random() < 0.4:
        parts.append((blob(rng, (0.18, 0.3, 0.4), 0.05, 0.7, (-0.2 * s, 0, 1.0 * s)), style.body()))
    return made("person", parts)


def bicycle(rng: Rng, style: Style) -> Item:
    """A bicycle."""
    r, coat, dark = rng.uniform(0.3, 0.35), style.body(0.4), paint.plain(rng, np.array([0.1, 0.1, 0.1]))
    wheels = [(turned(ring(r, 0.02), euler(0, np.pi / 2), (x, 0, r + 0.02)), dark) for x in (-0.52, 0.52)]
    nodes = np.array([[-0.52, 0, r], [-0.12, 0, 0.8], [0.36, 0, 0.85], [0.52, 0, r], [0.0, 0, r - 0.05]])
    bars = [(0, 1), (1, 2), (2, 3), (2, 4), (1, 4), (0, 4)]
    parts = [(rod(nodes[a], nodes[b], 0.018), coat) for a, b in bars]
    parts.append((rod((0.36, -0.28, 1.0), (0.36, 0.28, 1.0), 0.015), dark))
    parts += [
        (rod(nodes[2], (0.36, 0, 1.0), 0.015), coat),
        (blob(rng, (0.25, 0.14, 0.07), 0, 1, (-0.14, 0, 0.88)), dark),
    ]
    return made("bicycle", [*wheels, *parts])


def cyclist(rng: Rng, style: Style) -> Item:
    """Somebody on a bicycle: one instance."""
    rider = _rider(rng, style)
    return made("cyclist", [*bicycle(rng, style).parts, *rider])


def _rider(rng: Rng, style: Style) -> list[tuple[Part, Material]]:
    parts = person(rng, style).parts
    return [(Part(part.positions + np.array([-0.1, 0, 0.25]), part.normals, part.uv), coat) for part, coat in parts]


def moped(rng: Rng, style: Style) -> Item:
    """A moped or motorcycle, some with somebody on it."""
    coat, dark = style.body(0.3), paint.plain(rng, np.array([0.1, 0.1, 0.1]))
    wheels = [(turned(cylinder(0.25, 0.1), euler(0, np.pi / 2), (x, -0.05, 0.25)), dark) for x in (-0.6, 0.6)]
    body = [
        (rounded_box((0.9, rng.uniform(0.25, 0.4), 0.45), 0.05, (-0.2, 0, 0.3)), coat),
        (rod((0.55, 0, 0.3), (0.4, 0, 1.0), 0.06), coat),
        (rod((0.4, -0.35, 1.0), (0.4, 0.35, 1.0), 0.02), dark),
    ]
    rider = _rider(rng, style) if rng.random() < 0.4 else []
    return made("moped", [*wheels, *body, *rider])


def pram(rng: Rng, style: Style) -> Item:
    """A pram, or now and then a dog: what walks beside people."""
    coat = style.cloth()
    if rng.random() < 0.5:
        legs = [(rod((x, y, 0), (x, y, 0.35), 0.03), coat) for x in (-0.22, 0.22) for y in (-0.08, 0.08)]
        body = (blob(rng, (0.7, 0.24, 0.28), 0.03, 0.9, (0, 0, 0.3)), coat)
        return made("dog", [body, (blob(rng, (0.28, 0.16, 0.2), 0.02, 1.0, (0.4, 0, 0.5)), coat), *legs])
    wheels = [(turned(cylinder(0.12, 0.05), euler(0, np.pi / 2), (x, y, 0.12)), coat) for x in (-0.3, 0.3)
              for y in (-0.25, 0.25)]  # fmt: skip
    handle = (rod((-0.35, -0.2, 0.6), (-0.55, 0.2, 1.0), 0.02), coat)
    return made("pram", [(blob(rng, (0.75, 0.4, 0.6), 0.04, 0.7, (0, 0, 0.35)), coat), handle, *wheels])


def _lacquer(rng: Rng) -> Array:
    return paint.pick(rng, paint.SOBER + paint.SOBER + paint.VIVID)


def _hull(profile: Sequence[tuple[float, float]], width: float, taper: float) -> Part:
    """A profile (x, z), counter-clockwise and convex, swept across ``width``; its top narrower by ``taper`` a side."""
    line = np.asarray(profile, dtype=np.float64)
    low, high = line[:, 1].min(), line[:, 1].max()
    inset = taper * (line[:, 1] - low) / max(high - low, 1e-9)
    sides = [np.stack([line[:, 0], side * (width / 2 - inset), line[:, 1]], axis=1) for side in (-1, 1)]
    closed = [np.concatenate([side, side[:1]]) for side in sides]
    skin = np.stack(closed, axis=1)
    step = np.roll(line, -1, axis=0) - line
    out = np.stack([step[:, 1], 0 * step[:, 0], -step[:, 0]], axis=1)
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    normals = np.concatenate([out, out[:1]])[:, None].repeat(2, axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step, axis=1))])
    uv = np.stack(np.broadcast_arrays(along[:, None], np.array([0.0, width])[None]), axis=-1)
    body = sheet_of(skin, normals, uv)
    caps = []
    for side, points in zip((-1.0, 1.0), sides, strict=True):
        fan = np.stack(
            [np.broadcast_to(points.mean(axis=0), points.shape), points, np.roll(points, -1, axis=0)], axis=1
        )
        caps.append(Part(fan, np.broadcast_to([0.0, side, 0.0], fan.shape), fan[..., [0, 2]] - line.min(axis=0)))
    return Part(
        np.concatenate([body.positions, *(cap.positions for cap in caps)]),
        np.concatenate([body.normals, *(cap.normals for cap in caps)]),
        np.concatenate([body.uv, *(cap.uv for cap in caps)]),
    )


def _pillar(x: float, width: float, belt: float, height: float, coat: Material) -> tuple[Part, Material]:
    """A hoop of body colour over the cabin."""
    hoop = [(x - 0.04, belt), (x + 0.04, belt), (x + 0.02, height + 0.005), (x - 0.02, height + 0.005)]
    return _hull(hoop, 0.955 * width, 0.16), coat


def _wheels(rng: Rng, x: float, width: float, r: float) -> list[tuple[Part, Material]]:
    tyre = paint.plain(rng, np.array([0.08, 0.08, 0.08]), 0.05, 0.3)
    rim = paint.plain(rng, paint.pick(rng, paint.SOBER[1:4]), 0.7)
    parts = []
    for along in (-x, x):
        for side in (-1, 1):
            at = (along, side * (width / 2 - 0.1) - 0.1, r)
            parts.append((turned(cylinder(r, 0.2), euler(0, -np.pi / 2), at), tyre))
            parts.append((turned(cylinder(0.6 * r, 0.21), euler(0, -np.pi / 2), (at[0], at[1] - 0.005, r)), rim))
    return parts
