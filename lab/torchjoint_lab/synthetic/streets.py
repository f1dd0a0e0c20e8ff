"""Streets around a turning LiDAR at the origin: one ground with slopes and pavements, and what stands on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from torchjoint_lab.synthetic import prints, roadside, vehicles
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import Part
from torchjoint_lab.synthetic.furnished.world import Item, Light
from torchjoint_lab.synthetic.rigs import Mount
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.solids import euler, sheet_of
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.tabletop import Layout

#: What the truth of a scan knows, as SemanticKITTI's does; vegetation, buildings and fences are void there.
KNOWN = ("ground", "car", "van", "person", "bicycle", "cyclist", "moped", "pole")
#: The ground reaches so far, metres.
_REACH = 85.0
#: Words in the names of catalogue models that make them a vehicle or somebody of the street.
_CARS = ("car", "sedan", "focus", "suv", "leon", "peugeot", "scenic", "beetle", "chevrolet")
_PEOPLE = ("male", "boy", "girl")


class Ground:
    """A street along x: carriageway, kerb or ramp, pavement, verge; slopes and bumps over all.

    Args:
        rng: draws it.
        below: metres that it lies below the sensor.
    """

    def __init__(self, rng: Rng, below: float) -> None:
        self._offset = float(rng.uniform(-2, 2))
        self.half = float(rng.uniform(3.0, 7.0))  # of the carriageway
        self.pavement = float(rng.uniform(1.2, 4.0))
        self._kerb = float(rng.uniform(0.02, 0.16))
        self._ramp = float(rng.choice([0.02, rng.uniform(0.1, 2.0)]))  # metres over which the kerb rises
        self._rise = float(rng.choice([0.02, rng.uniform(0.0, 0.1)]))  # of the pavement
        self._bank = rng.uniform(-0.04, 0.15, 2)  # slope of the verges
        self._slope = rng.normal(0, 0.02, 2)
        self._waves = rng.normal(0, [0.15, 0.15, 0.04], (3,)), rng.uniform(0.02, 0.2, (3, 2)), rng.uniform(0, 6.3, 3)
        self._rough = rng.standard_normal((64, 64)) * rng.uniform(0.01, 0.08)
        self._level = 0.0
        self._level = float(self(np.zeros(1), np.zeros(1))[0]) + below

    def lateral(self, y: Array) -> Array:
        """Metres off the middle of the carriageway; the sensor's place is y = 0."""
        return np.asarray(y - self._offset)

    def y(self, lateral: float) -> float:
        """The inverse of :meth:`lateral`."""
        return lateral + self._offset

    def __call__(self, x: Array, y: Array) -> Array:
        """Height [...] of the ground."""
        side = self.lateral(y)
        away = np.abs(side) - self.half
        height = -0.015 * np.minimum(np.abs(side), self.half)
        height = height + self._kerb * np.clip(away / self._ramp, 0, 1)
        height = height + self._rise * np.clip(away, 0, self.pavement)
        beyond = np.maximum(away - self.pavement, 0)
        height = height + np.where(side > 0, self._bank[0], self._bank[1]) * np.minimum(beyond, 25)
        height = height + self._slope[0] * x + self._slope[1] * y
        size, wave, phase = self._waves
        for k in range(3):
            height = height + size[k] * np.sin(wave[k, 0] * x + wave[k, 1] * y + phase[k])
        soft = np.clip(beyond / 2, 0, 1)  # only the verge is rough
        cell = self._rough[np.floor(x / 0.7).astype(int) % 64, np.floor(y / 0.7).astype(int) % 64]
        return np.asarray(height + soft * cell - self._level)

    def tilt(self, x: float, y: float) -> Array:
        """[3, 3] rotation that lets a car stand on the ground."""
        step = 0.8
        at = self(np.array([x - step, x + step, x, x]), np.array([y, y, y - step, y + step]))
        return euler(0, np.arctan2(at[3] - at[2], 2 * step), -np.arctan2(at[1] - at[0], 2 * step))

    def item(self, rng: Rng) -> Item:
        """The ground as one instance, its strips of different materials."""
        asphalt = prints.rough(rng, np.array([0.33, 0.33, 0.34]) * rng.uniform(0.6, 1.3), 3.0, 0.2)
        slabs = prints.joints(rng, paint.pick(rng, paint.SOBER[1:3] + paint.WALLS), (0.5, 0.5), rng.uniform(0.6, 1.1))
        lawn = prints.rough(rng, np.array([0.25, 0.34, 0.15]) * rng.uniform(0.7, 1.4), 1.5, 0.4)
        soil = prints.rough(rng, np.array([0.45, 0.38, 0.3]), 2.0, 0.3)
        edge = self.half + self._ramp
        verge = lawn if rng.random() < 0.6 else soil if rng.random() < 0.5 else slabs
        strips: list[tuple[float, float, float, Material]] = [(-self.half, self.half, 1.0, asphalt)]
        for side in (-1, 1):
            for low, high, step, coat in (
                (self.half, edge, max(self._ramp / 3, 0.02), slabs),
                (edge, edge + self.pavement, 0.6, slabs if rng.random() < 0.8 else asphalt),
                (edge + self.pavement, 50.0, 1.4, verge),
            ):
                ends = sorted((side * low, side * high))
                strips.append((ends[0], ends[1], step, coat))
        parts = [(self._strip(low, high, step), coat) for low, high, step, coat in strips]
        return Item("ground", (100, 100, 1), parts)

    def _strip(self, low: float, high: float, step: float) -> Part:
        x = np.arange(-_REACH, _REACH + 1, 1.4)
        y = np.linspace(self.y(low), self.y(high), max(int(np.ceil((high - low) / step)), 1) + 1)
        x, y = np.meshgrid(x, y, indexing="ij")
        z = self(x, y)
        normal = np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3))
        return sheet_of(np.stack([x, y, z], axis=-1), normal, np.stack([x, y], axis=-1))


def build(source: Source, settings: DomainSettings) -> Layout:
    """A street with parked and driving cars, people, poles, trees, hedges, walls, houses."""
    rng, stage = source.rng, Stage()
    below = source.between(1.5, 2.1)
    ground = Ground(rng, below)
    stage.add(ground.item(rng))
    street = _Street(source, stage, ground)
    for side in (-1, 1):
        street.parked(side)
        street.racks(side)
        street.groups(side)
        street.fronts(side)
        street.furniture(side)
        street.people(side)
    street.driving()
    sun = np.array([*(rng.uniform(-1, 1, 2)), rng.uniform(0.4, 1.5)])
    sun = 150 * sun / np.linalg.norm(sun)
    power = np.array([1.05, 1.0, 0.9]) * rng.uniform(0.3, 1.6) * 150**2
    world = stage.build((Light(sun, 0.7, power),), float(rng.uniform(0.4, 0.9)))
    return Layout(world, Mount(source.between(0.05, 0.4)), (np.full(3, -1e3), np.full(3, 1e3)))


class _Street:
    """Puts things on a ground, none on another."""

    def __init__(self, source: Source, stage: Stage, ground: Ground) -> None:
        self._source, self._stage, self._ground = source, stage, ground
        self._hedges: list[tuple[float, float]] = []
        self._taken: list[tuple[float, float, float, float]] = [(-3.0, -1.3, 3.0, 1.3)]  # the car with the sensor

    def parked(self, side: int) -> None:
        """A row of cars along the kerb, or side by side across it, some of them at 25 cm; a hedge or wall beside it."""
        rng, source = self._source.rng, self._source
        if source.chance(0.2):
            return
        x, dense, across = float(rng.uniform(-45, -25)), source.between(0.3, 1.0), source.chance(0.25)
        least = source.between(0.25, 0.8)
        while x < 45:
            item = self._vehicle()
            long, wide = (float(item.size[1]), float(item.size[0])) if across else map(float, item.size[:2])
            x += long / 2
            out = self._ground.half - wide / 2 - rng.uniform(-0.4, 0.3)
            if source.chance(dense):
                yaw = float(rng.choice([0, np.pi]) + rng.normal(0, 0.03)) + across * np.pi / 2
                self.put(item, x, self._ground.y(side * out), yaw, margin=0.0)
            x += long / 2 + rng.uniform(least, 2.0)
        for make in (roadside.hedge, roadside.wall):
            self._row(make, side, (0.45, 1.1), (2, 20), 0.3)

    def racks(self, side: int) -> None:
        """Rows of bicycles or mopeds, handlebar at handlebar, most of them at a wall."""
        rng = self._source.rng
        for _ in range(int(rng.integers(0, 4))):
            x, out = float(rng.uniform(-35, 35)), self._ground.half + float(rng.uniform(0.4, 1)) * self._ground.pavement
            make = vehicles.moped if self._source.chance(0.25) else vehicles.bicycle
            step, lean = rng.uniform(0.32, 0.8), float(rng.normal(np.pi / 2, 0.15))
            if self._source.chance(0.5):
                self.put(roadside.wall(rng, self._source.style), x + 2, self._ground.y(side * (out + 1.2)), 0.0, True)
            for k in range(int(rng.integers(2, 16))):
                turn = lean + float(rng.normal(0, 0.06)) + np.pi * int(rng.random() < 0.3)
                y = self._ground.y(side * (out + float(rng.normal(0, 0.08))))
                if self._source.chance(0.85):
                    self.put(make(rng, self._source.style), x + k * float(step), y, turn, True, margin=-0.2)

    def groups(self, side: int) -> None:
        """People who stand together or wait in a queue, with prams, dogs and bicycles; at tables; riders abreast."""
        rng, style = self._source.rng, self._source.style
        for _ in range(int(rng.integers(0, 6))):
            x, out = (
                float(rng.uniform(-30, 30)),
                self._ground.half + float(rng.uniform(-1.5, 1) * self._ground.pavement),
            )
            rows, step = int(rng.choice([1, 1, 2, 3])), float(rng.uniform(0.5, 0.95))
            makers = [vehicles.person] * 8 + [vehicles.pram, vehicles.bicycle]
            if self._source.chance(0.2):
                makers, step = [vehicles.cyclist, vehicles.moped], step + 0.4
            elif self._source.chance(0.2):
                makers = [roadside.cafe_table, vehicles.person, vehicles.person]
            yaw = float(rng.uniform(-np.pi, np.pi))
            for k in range(rows * int(rng.integers(1, 5))):
                at = np.array([k // rows, k % rows]) * step + rng.normal(0, 0.08, 2)
                item = makers[int(rng.integers(len(makers)))](rng, style)
                turn = float(rng.choice([0, np.pi])) + yaw + float(rng.normal(0, 0.4))
                self.put(item, x + float(at[0]), self._ground.y(side * (out + float(at[1]))), turn, True, margin=-0.1)

    def driving(self) -> None:
        """Cars and cyclists on the carriageway."""
        rng = self._source.rng
        for _ in range(self._source.count(1, 5)):
            item = self._vehicle() if rng.random() < 0.8 else vehicles.cyclist(rng, self._source.style)
            lane = rng.uniform(0.25, 0.5) * self._ground.half * rng.choice([-1, 1])
            self.put(item, float(rng.uniform(-45, 45)), self._ground.y(float(lane)), float(rng.choice([0, np.pi])))

    def people(self, side: int) -> None:
        """People alone, and two to four side by side."""
        rng = self._source.rng
        for _ in range(self._source.count(0, 5)):
            x, out = rng.uniform(-30, 30), self._ground.half + rng.uniform(0.1, 1) * self._ground.pavement
            yaw, y = float(rng.choice([0, np.pi]) + rng.normal(0, 0.3)), self._ground.y(float(side * out))
            for k in range(int(rng.choice([1, 1, 2, 3, 4]))):
                item = self._source.model(_PEOPLE, 1.0, 2.1) or vehicles.person(rng, self._source.style)
                gap = k * float(rng.uniform(0.52, 0.8))
                turn = yaw + float(rng.normal(0, 0.2))
                self.put(
                    item, float(x + rng.normal(0, 0.1)), y + float(gap * side), float(turn), flat=True, margin=-0.08
                )

    def furniture(self, side: int) -> None:
        """Poles, bins, bicycles and trees along the pavement."""
        self._row(roadside.pole, side, (0.2, 0.6), (4, 18), 0.8)
        self._row(roadside.tree, side, (0.7, 2.5), (5, 16), 0.6)
        self._row(roadside.street_bin, side, (0.4, 2.0), (6, 40), 0.7)
        self._row(vehicles.bicycle, side, (0.5, 1.5), (2, 40), 0.4)
        for x, y in [place for place in self._hedges if self._source.chance(0.15)]:  # poles in bushes
            height = float(self._ground(np.array([x]), np.array([y]))[0])
            self._stage.add(roadside.pole(self._source.rng, self._source.style), euler(0.0), (x, y, height))

    def fronts(self, side: int) -> None:
        """Hedges, fences and walls behind the pavement, houses and trees behind those."""
        behind = self._ground.pavement
        makers = (roadside.hedge, roadside.fence, roadside.wall)
        rng = self._source.rng
        for make in (makers[int(k)] for k in rng.choice(3, rng.integers(1, 3), replace=False)):
            self._row(make, side, (behind + 0.4, behind + 1.4), (2, 14), 0.9)
        self._row(roadside.building, side, (behind + 6, behind + 12), (8, 25), 0.7)
        self._row(roadside.tree, side, (behind + 2, behind + 9), (3, 12), 0.7)

    def _row(
        self,
        make: Callable[..., Item],
        side: int,
        beyond: tuple[float, float],
        every: tuple[float, float],
        probability: float,
    ) -> None:
        rng = self._source.rng
        if not self._source.chance(probability):
            return
        x, out = -50.0 + rng.uniform(0, every[1]), self._ground.half + rng.uniform(*beyond)
        while x < 50:
            item = make(rng, self._source.style)
            x += item.size[0] / 2
            yaw = float(rng.normal(0, 0.02)) if item.size[0] > 3 else float(rng.uniform(-np.pi, np.pi))
            sway = rng.normal(0, 0.05) if item.size[0] > 3 else rng.normal(0, 0.3)
            depth = item.size[1] / 2 if item.name == "building" else 0.0
            self.put(item, float(x), self._ground.y(float(side * (out + sway + depth))), yaw, flat=True)
            x += item.size[0] / 2 + rng.uniform(*every)

    def _vehicle(self) -> Item:
        rng, source = self._source.rng, self._source
        if source.chance(0.15):
            return vehicles.van(rng, source.style)
        model = source.model(_CARS, 2.3, 5.5)
        return model if model is not None else vehicles.car(rng, source.style)

    def put(self, item: Item, x: float, y: float, yaw: float, flat: bool = False, margin: float = 0.05) -> None:
        """Stands a thing on the ground (upright if ``flat``), unless the place is taken."""
        c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
        half_x = (item.size[0] * c + item.size[1] * s) / 2 + margin
        half_y = (item.size[0] * s + item.size[1] * c) / 2 + margin
        if item.name in ("tree", "pole"):  # crowns and arms are above the others
            half_x = half_y = 0.4
        new = (x - half_x, y - half_y, x + half_x, y + half_y)
        for old in self._taken:
            if new[0] < old[2] and old[0] < new[2] and new[1] < old[3] and old[1] < new[3]:
                return
        self._taken.append(new)
        if item.name == "hedge":
            self._hedges.append((x, y))
        z = float(self._ground(np.array([x]), np.array([y]))[0])
        if flat and item.size[0] > 1.5:
            ends = np.array([x - half_x, x, x + half_x])
            z = float(self._ground(ends, np.full(3, y)).min())
        turn = euler(yaw) if flat else self._ground.tilt(x, y) @ euler(yaw)
        self._stage.add(item, turn, (x, y, z))
