"""Places items on level surfaces without intersections."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from torchjoint_lab.synthetic.furnished import clutter
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.world import Item, Pose, Surface, WorldBuilder


@dataclass
class Footprints:
    """Occupied axis-aligned boxes (x0, y0, x1, y1, bottom, top), metres."""

    boxes: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)

    def claim(self, item: Item, pose: Pose, margin: float = 0.0) -> bool:
        """Occupies the item's bounding box, grown sideways by ``margin``, metres; False (no change) if not free."""
        new = bounds(item, pose, margin)
        for old in self.boxes:
            if (
                new[0] < old[2]
                and old[0] < new[2]
                and new[1] < old[3]
                and old[1] < new[3]
                and new[4] < old[5]
                and old[4] < new[5]
            ):
                return False
        self.boxes.append(new)
        return True


def bounds(item: Item, pose: Pose, margin: float) -> tuple[float, float, float, float, float, float]:
    """The item's bounding box (x0, y0, x1, y1, bottom, top), grown sideways by ``margin``, metres."""
    c, s = abs(np.cos(pose.yaw)), abs(np.sin(pose.yaw))
    hx = (item.size[0] * c + item.size[1] * s) / 2 + margin - 1e-6
    hy = (item.size[0] * s + item.size[1] * c) / 2 + margin - 1e-6
    return pose.x - hx, pose.y - hy, pose.x + hx, pose.y + hy, pose.z, pose.z + item.size[2]


def furnish(
    builder: WorldBuilder, rng: Rng, pose: Pose, surface: Surface, count: int, material: Material | None = None
) -> None:
    """Puts up to ``count`` things on a surface; ``material`` is the surface's material, for camouflaged boxes."""
    taken = Footprints()
    for _ in range(count):
        kind = rng.random()
        if kind < 0.12:
            tone = material if material and rng.random() < 0.5 else paint.plain(rng, paint.pick(rng, paint.VIVID))
            one, two = clutter.twins(rng, tone)
            both = Item("", (one.size[0] + two.size[0], one.size[1], one.size[2]), [])
            spot = _free_spot(rng, taken, surface, both)
            if spot:
                builder.place(one, pose.at(spot.x, spot.y, spot.z, spot.yaw).at(-two.size[0] / 2, 0))
                builder.place(two, pose.at(spot.x, spot.y, spot.z, spot.yaw).at(one.size[0] / 2, 0))
            continue
        item = clutter.thing(rng)
        spot = _free_spot(rng, taken, surface, item)
        if spot is None:
            continue
        at = builder.place(item, pose.at(spot.x, spot.y, spot.z, spot.yaw))
        if item.name in ("book", "magazine", "paper", "box") and rng.random() < 0.35:
            _stack(builder, rng, at, item, surface.headroom)


def _stack(builder: WorldBuilder, rng: Rng, pose: Pose, below: Item, headroom: float) -> None:
    """Puts one more thing on top of ``below``, if a random thing fits."""
    for _ in range(4):
        item = clutter.thing(rng)
        fits = item.size[0] < below.size[0] + 0.03 and item.size[1] < below.size[1] + 0.03
        if fits and below.size[2] + item.size[2] < headroom:
            shift = rng.normal(0, 0.012, 2)
            builder.place(item, pose.at(shift[0], shift[1], below.size[2], rng.normal(0, 0.2)))
            return


def _free_spot(rng: Rng, taken: Footprints, surface: Surface, item: Item) -> Pose | None:
    """A pose on ``surface``, in the frame of its item, where ``item`` fits; it may touch another item."""
    if item.size[2] > surface.headroom:
        return None
    for _ in range(12):
        yaw = float(rng.normal(0, 0.35)) if rng.random() < 0.7 else float(rng.uniform(-np.pi, np.pi))
        c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
        half = np.array([item.size[0] * c + item.size[1] * s, item.size[0] * s + item.size[1] * c]) / 2
        low, high = np.asarray(surface.low) + half, np.asarray(surface.high) - half
        if (low > high).any():
            continue
        x, y = rng.uniform(low, high)
        pose = Pose(float(x), float(y), surface.z, yaw)
        if taken.claim(item, pose, margin=-0.004):
            return pose
    return None


def fill_shelf(builder: WorldBuilder, rng: Rng, pose: Pose, surface: Surface, factor: float) -> None:
    """Fills a shelf with a row of standing, touching books, or with a few things."""
    if rng.random() < 0.45 or surface.headroom < 0.2 or surface.headroom > 0.45:
        furnish(builder, rng, pose, surface, int(rng.poisson(2 * factor)))
        return
    along, depth = surface.low[0], surface.high[1] - surface.low[1]
    end = surface.low[0] + rng.uniform(0.4, 1.0) * (surface.high[0] - surface.low[0])
    while True:
        book = clutter.standing_book(rng, rng.uniform(0.6, 0.95) * surface.headroom, depth * rng.uniform(0.55, 0.85))
        if along + book.size[0] > end:
            return
        builder.place(book, pose.at(along + book.size[0] / 2, surface.low[1] + 0.02 + book.size[1] / 2, surface.z))
        along += book.size[0] if rng.random() < 0.9 else rng.uniform(0.05, 0.15)
