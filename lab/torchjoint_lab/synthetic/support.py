"""Putting things on a support by contact: standing, stacked, lying, leaning, piled, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.solids import euler, rotated, rotation_about
from torchjoint_lab.synthetic.stage import Body, Heights, Stage

#: Contacts count as such within this many metres.
_TOUCH = 0.004
_TRIES = 24
#: Eight directions in which a standing thing must not topple.
_AROUND = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)


class Support:
    """A level rectangle of a stage, and the things that were put on it.

    Args:
        rng: draws places.
        stage: gets the things.
        low, high: least and greatest (x, y), metres.
        z: height of the support.
        cell: resolution of contacts, metres.
        walls: whether things must stay within the rectangle (they may hang over its edge otherwise).
        headroom: free height above.
    """

    def __init__(
        self,
        rng: Rng,
        stage: Stage,
        low: Sequence[float],
        high: Sequence[float],
        z: float = 0.0,
        *,
        cell: float = 0.004,
        walls: bool = True,
        headroom: float = 9.0,
    ) -> None:
        self._rng, self._stage = rng, stage
        self.heights = Heights(low, high, z, cell, walls)
        self.headroom = headroom

    def fixed(self, item: Item, x: float, y: float, yaw: float = 0.0, rotation: Array | None = None) -> bool:
        """Puts a thing down exactly there, on the highest surface at this place."""
        body = self._body(item)
        turn = euler(yaw) if rotation is None else rotation
        return self.lay(body, turn, np.array([x, y]) + rotated(body.centre, turn)[:2])

    def stand(self, item: Item, stacked: float = 0.0, spread: float = 0.9, yaw: float | None = None) -> bool:
        """Stands a thing somewhere stable, on others with probability ``stacked``; False if there is no place."""
        body, rng = self._body(item), self._rng
        points = body.coarse()
        on_top = rng.random() < stacked
        for _ in range(_TRIES):
            turn = euler(rng.uniform(-np.pi, np.pi) if yaw is None else yaw + rng.normal(0, 0.05))
            spot = self._spot(spread)
            moved = rotated(points - body.centre, turn) + np.append(spot, 0)
            lift = float(self.heights.contact(moved))
            raised = lift + moved[:, 2].min() - self.heights.base > _TOUCH
            if lift > 500 or lift < -500 or raised != on_top:
                continue
            if self._is_stable(moved, lift, spot):
                return self.lay(body, turn, spot)
        return False

    def beside(self, item: Item, yaw: float | None = None) -> bool:
        """Pushes a standing thing along a random line until it touches another."""
        body, rng = self._body(item), self._rng
        turn = euler(rng.uniform(-np.pi, np.pi) if yaw is None else yaw)
        for _ in range(_TRIES):
            start, angle = self._spot(0.95), rng.uniform(-np.pi, np.pi)
            spot = self.pushed(body, turn, start, np.array([np.cos(angle), np.sin(angle)]))
            if spot is not None and self.lay(body, turn, spot):
                return True
        return False

    def pushed(
        self, body: Body, turn: Array, start: Array, way: Array, far: float = 0.6, to_edge: bool = False
    ) -> Array | None:
        """Where a thing that stands at ``start`` ends if it is pushed along ``way`` till it meets something.

        None if it meets nothing within ``far`` metres (only the rectangle's edge, unless ``to_edge``) or has no room at
        the start.
        """
        step = self.heights.cell / 2
        places = start + np.arange(0, far, step)[:, None] * way
        points = rotated(body.coarse() - body.centre, turn)
        lift = self.heights.contact(
            points[None] + np.concatenate([places, np.zeros((len(places), 1))], axis=1)[:, None]
        )
        bottom = lift + points[:, 2].min() - self.heights.base
        if bottom[0] > _TOUCH or bottom[0] < -500:
            return None
        stop = np.flatnonzero(bottom > _TOUCH)
        if len(stop) == 0 or (bottom[stop[0]] > 500 and not to_edge):
            return None
        return np.asarray(places[stop[0] - 1])

    def lean(self, item: Item, tilt: float) -> bool:
        """Leans a thing, tilted by ``tilt`` radians, against the thing that stands there."""
        body, rng = self._body(item), self._rng
        for _ in range(_TRIES):
            yaw = rng.uniform(-np.pi, np.pi)
            turn = euler(yaw) @ euler(0, -tilt)  # its head towards its +y
            way = np.array([-np.sin(yaw), np.cos(yaw)])
            spot = self.pushed(body, turn, self._spot(0.95), way)
            if spot is None:
                continue
            found = self._settle(body.coarse() - body.centre, turn, spot, 12, 0.08)
            if found is not None and found[0][2, 2] < 0.998 and self.lay(body, *found):
                return True
        return False

    def lean_on_edge(self, item: Item, turn: Array, x: float, y: float) -> bool:
        """Leans a thing, turned so that its head is towards +y, against a wall at ``y``."""
        body = self._body(item)
        reach = rotated(body.points - body.centre, turn)[:, 1].max()
        return self.lay(body, turn, np.array([x, y - reach - self.heights.cell]))

    def drop(self, item: Item, turn: Array | None = None, spread: float = 0.9, rounds: int = 30) -> bool:
        """Lets a thing fall from anyhow (or from ``turn``) and roll until its centre cannot sink any further."""
        body, rng = self._body(item), self._rng
        points = body.coarse() - body.centre
        for _ in range(6):
            start = rotation_about(rng.normal(0, 1.8, 3)) if turn is None else turn @ euler(rng.uniform(-3, 3))
            spot = self._spot(spread)
            found = self._settle(points, start, spot, rounds)
            if found is not None and self.lay(body, *found):
                return True
        return False

    def _settle(
        self, points: Array, turn: Array, spot: Array, rounds: int, reach: float = 0.6
    ) -> tuple[Array, Array] | None:
        """Random turns by some ``reach`` radians at first, and small pushes, that let the centre sink."""
        rng = self._rng
        height = float(self.heights.contact(rotated(points, turn) + np.append(spot, 0)))
        for i in range(rounds):
            size = reach * (0.02 ** (i / rounds))
            turns = [rotation_about(v) @ turn for v in rng.normal(0, size, (10, 3))]
            spots = spot + rng.normal(0, 0.03 * size, (10, 2))
            moved = np.stack([rotated(points, r) + np.append(s, 0) for r, s in zip(turns, spots, strict=True)])
            lift = self.heights.contact(moved)
            lift[lift < -500] = 1e3
            best = int(lift.argmin())
            if lift[best] < height or not -500 < height < 500:
                turn, spot, height = turns[best], spots[best], float(lift[best])
        return (turn, spot) if -500 < height < 500 else None

    def _body(self, item: Item) -> Body:
        return Body.of(self._rng, item, self.heights.cell)

    def _spot(self, spread: float) -> Array:
        middle, half = (self.heights.low + self.heights.high) / 2, (self.heights.high - self.heights.low) / 2
        return np.asarray(middle + self._rng.uniform(-spread, spread, 2) * half)

    def _is_stable(self, points: Array, lift: float, spot: Array) -> bool:
        row, column = self.heights.cells(points)
        touching = self.heights.grid[row, column] - points[:, 2] - lift > -_TOUCH
        arms = points[touching, :2] - spot
        if len(arms) < 3:
            return False
        reach = arms[:, :1] * _AROUND[:, 0] + arms[:, 1:] * _AROUND[:, 1]
        return bool((reach.max(axis=0) > 0.002).all())

    def lay(self, body: Body, turn: Array, spot: Array) -> bool:
        """Puts a turned thing down with its centre over ``spot``; False if it finds no support or is too high."""
        points = rotated(body.points - body.centre, turn) + np.append(spot, 0)
        lift = float(self.heights.contact(points))
        top = lift + points[:, 2].max() - self.heights.base
        if not -500 < lift < 500 or top > self.headroom:
            return False
        points[:, 2] += lift
        self.heights.put(points)
        offset = np.array([*spot, lift]) - rotated(body.centre, turn)
        self._stage.add(body.item, turn, offset)
        return True
