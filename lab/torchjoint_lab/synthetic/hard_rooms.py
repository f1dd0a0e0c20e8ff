"""Makes rooms harder: adds flat things on flat surfaces, slender occluders, and hollow things."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from torchjoint.synthetic import SyntheticScene
from torchjoint_lab.synthetic import flats, occluders, vessels
from torchjoint_lab.synthetic.furnished import clutter, furniture
from torchjoint_lab.synthetic.furnished import make_scene as make_furnished_scene
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.layout import Footprints, bounds
from torchjoint_lab.synthetic.furnished.site import Site
from torchjoint_lab.synthetic.furnished.trajectory import WALL_MARGIN
from torchjoint_lab.synthetic.furnished.world import Front, Item, Pose, Surface

#: Names of the items that form the room itself.
_SHELL = ("floor", "wall", "ceiling")
#: Things are laid on surfaces lower than this, metres: the camera sees higher surfaces only from the side.
_HIGHEST = 1.3
#: Distance between tall items and the ring of camera positions, metres.
_CLEARANCE = 0.25
#: Number of positions that are tried for an item.
_TRIES = 80
#: Number of things that are laid per square metre, if there is room.
_DENSITY = 7.0


def make_scene(seed: int = 0, size: str = "small", *, hard: bool = False, **options: Any) -> SyntheticScene:
    """Makes a scene of a room as :func:`~torchjoint_lab.synthetic.furnished.make_scene` does, or a harder room.

    Args:
        seed: as there.
        size: as there.
        hard: adds flat things on flat surfaces, slender occluders that split the object behind them, and hollow things;
            the rest of the room does not change. A large room gets 50 to 75 more instances, about 40 of them flat.
        options: the other arguments of :func:`torchjoint_lab.synthetic.furnished.make_scene`.
    """
    if not hard:
        return make_furnished_scene(seed, size, **options)

    def furnish_more(site: Site, focus: tuple[float, float, float, float]) -> None:
        harden(site, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,))), focus)

    return make_furnished_scene(seed, size, **options, furnish_more=furnish_more)


def harden(site: Site, rng: Rng, focus: tuple[float, float, float, float]) -> None:
    """Adds difficult items to a furnished room; the existing items do not change. ``focus``: see :class:`World`."""
    furnished = list(site.builder.placed)
    taken = Footprints()
    for item, pose in furnished:
        if item.name not in _SHELL:
            taken.boxes.append(_occupied(item, pose))
    _occlude(site, rng, taken, focus)
    fronts = [(pose, front) for item, pose in furnished for front in item.fronts]
    _pull_out_drawers(site, rng, taken, fronts)
    _cover_fronts(site, rng, taken, fronts)
    _hang(site, rng, taken, any(item.name == "door" for item, _ in furnished))
    floor = Surface((-site.size[0] / 2, -site.size[1] / 2), (site.size[0] / 2, site.size[1] / 2), 0.0)
    _stand_vessels(site, rng, taken, floor)
    for item, pose in furnished:
        for surface in item.surfaces:
            if surface.z == item.size[2] and pose.z + surface.z < _HIGHEST:  # the top surface: nothing is above it
                _cover_top(site, rng, taken, pose, surface)
    for _ in range(rng.integers(4, 9)):
        make = flats.doormat if rng.random() < 0.2 else flats.lying
        _lay(site, rng, taken, Pose(), floor, make(rng))


def _occupied(item: Item, pose: Pose) -> tuple[float, float, float, float, float, float]:
    """The box (x0, y0, x1, y1, bottom, top) around the item's triangles, metres; includes brackets and knobs.

    Does not include the handles of an item with fronts: things on fronts keep clear of handles.
    """
    if item.fronts:
        return bounds(item, pose, 0.0)
    corners = np.concatenate([part.moved((pose.x, pose.y, pose.z), pose.yaw).positions for part, _ in item.parts])
    low, high = corners.min(axis=(0, 1)) + 1e-6, corners.max(axis=(0, 1)) - 1e-6
    return low[0], low[1], high[0], high[1], low[2], high[2]


def _occlude(site: Site, rng: Rng, taken: Footprints, focus: tuple[float, float, float, float]) -> None:
    """Adds pipes and rails on walls, and slender items in front of walls and furniture."""
    for _ in range(rng.integers(1, 3)):
        _fix(site, rng, taken, lambda _: occluders.pillar(rng, site.size[2]), (0.0, 0.0), range(4))
    for wall in rng.permutation(4)[: rng.integers(1, 4)]:
        _fix(site, rng, taken, lambda failed: occluders.rail(rng, 2.6 - 1.8 * failed), (0.7, 1.7), [int(wall)])
    cameras = _surroundings(site.size, focus)
    pillar = lambda rng: occluders.pillar(rng, site.size[2])  # noqa: E731
    kinds = (occluders.coat_stand, occluders.plant, occluders.clothes_rail, pillar, furniture.lamp)
    for kind in rng.permutation(len(kinds))[: rng.integers(2, 5)]:
        item = kinds[kind](rng)
        for _ in range(_TRIES):
            wall = int(rng.integers(4))
            along = rng.uniform(-0.5, 0.5) * (site.length(wall) - item.size[0])
            gap = rng.uniform(0.1, 0.9)
            pose = site.at_wall(wall, along, item.size[1] + 2 * gap)
            away = np.hypot(cameras[:, 0] - pose.x, cameras[:, 1] - pose.y).min()
            if away > item.size[0] / 2 + _CLEARANCE and taken.claim(item, pose, 0.02):
                site.builder.place(item, pose)
                break


def _surroundings(room: tuple[float, float, float], focus: tuple[float, float, float, float]) -> Array:
    """Positions [K, 2] that cover the camera positions of `furnished.trajectory.walk`, metres."""
    x, y, half_x, half_y = focus
    angle, away = np.meshgrid(np.arange(0, 2 * np.pi, 0.05), np.linspace(0.5, 0.9, 5))
    reach = np.array(room[:2]) / 2 - WALL_MARGIN
    ring_x = np.clip(x + (half_x + away) * np.cos(angle), -reach[0], reach[0])
    ring_y = np.clip(y + (half_y + away) * np.sin(angle), -reach[1], reach[1])
    return np.stack([ring_x.ravel(), ring_y.ravel()], axis=1)


def _fix(
    site: Site,
    rng: Rng,
    taken: Footprints,
    make: Callable[[float], Item],
    heights: tuple[float, float],
    walls: range | list[int],
) -> bool:
    """Fixes an item flush on one of ``walls``, its lower side within ``heights``; returns whether there was a place.

    ``make`` gets the share of tries that have failed, so that it can make smaller items when space is scarce.
    """
    for failed in range(_TRIES):
        wall = walls[int(rng.integers(len(walls)))]
        item = make(failed / _TRIES)
        along = rng.uniform(-0.5, 0.5) * (site.length(wall) - item.size[0])
        pose = site.at_wall(wall, along, item.size[1], float(rng.uniform(*heights)))
        if pose.z + item.size[2] <= site.size[2] and taken.claim(item, pose, margin=0.03):
            site.builder.place(item, pose)
            return True
    return False


def _hang(site: Site, rng: Rng, taken: Footprints, has_door: bool) -> None:
    """Adds hatches, posters, notices, and a door if the room has none."""
    walls = range(4)
    if not has_door:
        _fix(site, rng, taken, lambda _: furniture.door(rng), (0.0, 0.0), walls)
    tone = paint.pick(rng, paint.WALLS)
    for _ in range(rng.integers(1, 4)):
        _fix(site, rng, taken, lambda _: flats.hatch(rng, tone), (0.3, 1.5), walls)
    for _ in range(rng.integers(3, 7)):
        _fix(site, rng, taken, lambda _: furniture.poster(rng), (0.7, 1.6), walls)
    for _ in range(rng.integers(2, 6)):
        _fix(site, rng, taken, lambda _: flats.notice(rng, 0.3), (0.7, 1.6), walls)


def _pull_out_drawers(site: Site, rng: Rng, taken: Footprints, fronts: list[tuple[Pose, Front]]) -> None:
    """Puts an open drawer with contents in front of up to three low fronts."""
    low = [(pose, front) for pose, front in fronts if front.high[1] < 0.95 and front.high[1] - front.low[1] > 0.19]
    for index in rng.permutation(len(low))[: rng.integers(1, 4)]:
        pose, front = low[index]
        item = vessels.drawer(rng, front.high[0] - front.low[0], float(rng.uniform(0.18, 0.32)), front.material)
        middle = (front.low[0] + front.high[0]) / 2
        at = pose.at(middle, front.y - item.size[1] / 2, front.high[1] - item.size[2])
        if taken.claim(item, at):
            site.builder.place(item, at)
            _fill(site, rng, at, item.surfaces[0])


def _cover_fronts(site: Site, rng: Rng, taken: Footprints, fronts: list[tuple[Pose, Front]]) -> None:
    """Puts notices, and panels of another material, on cupboard fronts."""
    for pose, front in fronts:
        w, h = front.high[0] - front.low[0], front.high[1] - front.low[1]
        kind = rng.random()
        if kind < 0.15:
            item = flats.panel(rng, w, h)
        elif kind < 0.5:
            item = flats.notice(rng, w - 0.04)
        else:
            continue
        slack = np.array([w - item.size[0], h - item.size[2]])
        if (slack < -1e-9).any():
            continue
        x, z = (front.low[0] + w / 2, front.low[1]) + rng.uniform([-0.5, 0], [0.5, 1]) * slack
        at = pose.at(float(x), front.y - item.size[1] / 2, float(z))
        if taken.claim(item, at):
            site.builder.place(item, at)


def _stand_vessels(site: Site, rng: Rng, taken: Footprints, floor: Surface) -> None:
    """Puts crates with contents, and baskets, on the floor."""
    for _ in range(rng.integers(2, 5)):
        item = vessels.crate(rng) if rng.random() < 0.6 else vessels.basket(rng)
        pose = _lay(site, rng, taken, Pose(), floor, item)
        if pose and item.surfaces:
            _fill(site, rng, pose, item.surfaces[0])


def _fill(site: Site, rng: Rng, pose: Pose, inside: Surface) -> None:
    """Puts up to three things into a crate or a drawer."""
    taken = Footprints()
    for _ in range(rng.integers(0, 4)):
        _lay(site, rng, taken, pose, inside, clutter.thing(rng))


def _cover_top(site: Site, rng: Rng, taken: Footprints, pose: Pose, surface: Surface) -> None:
    """Puts mats, overlapping paper, and deep bowls on the free area of a table's, cabinet's or rug's top."""
    width, depth = np.subtract(surface.high, surface.low)
    for _ in range(max(round(_DENSITY * width * depth), 2)):
        kind = rng.random() if pose.z + surface.z > 0.1 else 1.0
        if kind < 0.1:
            _lay(site, rng, taken, pose, surface, vessels.deep_bowl(rng))
        elif kind < 0.25:
            dish = (clutter.mug, clutter.bowl, clutter.plate, clutter.bottle)[rng.integers(4)](rng)
            _lay_two(site, rng, taken, pose, surface, flats.mat(rng), dish, (0.0, 0.03))
        elif rng.random() < 0.35:
            _lay_two(site, rng, taken, pose, surface, flats.lying(rng), flats.lying(rng), (0.03, 0.1))
        else:
            _lay(site, rng, taken, pose, surface, flats.lying(rng))


def _lay_two(
    site: Site,
    rng: Rng,
    taken: Footprints,
    pose: Pose,
    surface: Surface,
    lower: Item,
    upper: Item,
    shift: tuple[float, float],
) -> None:
    """Puts ``upper`` on ``lower``, shifted along both axes by a distance in ``shift`` (metres), if it fits."""
    at = _lay(site, rng, taken, pose, surface, lower)
    if at is None:
        return
    x, y = rng.uniform(*shift, 2) * rng.choice([-1, 1], 2)
    above = at.at(float(x), float(y), lower.size[2], float(rng.normal(0, 0.3)))
    to_corner = np.hypot(upper.size[0], upper.size[1]) / 2
    inside = abs(above.x) + to_corner < site.size[0] / 2 and abs(above.y) + to_corner < site.size[1] / 2
    if inside and lower.size[2] + upper.size[2] < surface.headroom and taken.claim(upper, above):
        site.builder.place(upper, above)


def _lay(site: Site, rng: Rng, taken: Footprints, pose: Pose, surface: Surface, item: Item) -> Pose | None:
    """Puts ``item`` on ``surface`` of the item at ``pose``; returns its pose, or None if no place was found."""
    if item.size[2] > surface.headroom:
        return None
    for _ in range(_TRIES):
        yaw = float(rng.normal(0, 0.2)) + float(rng.choice([0, np.pi / 2]))
        c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
        half: Array = np.array([item.size[0] * c + item.size[1] * s, item.size[0] * s + item.size[1] * c]) / 2
        low, high = np.asarray(surface.low) + half, np.asarray(surface.high) - half
        if (low > high).any():
            continue
        x, y = rng.uniform(low, high)
        at = pose.at(float(x), float(y), surface.z, yaw)
        if taken.claim(item, at, 0.004):
            site.builder.place(item, at)
            return at
    return None
