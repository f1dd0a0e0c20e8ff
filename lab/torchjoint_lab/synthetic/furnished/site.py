"""A room while it is furnished: size, walls and occupied places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.layout import Footprints
from torchjoint_lab.synthetic.furnished.world import Pose, WorldBuilder

#: Yaw at which an item's back (+y) is against the wall: north (+y), east (+x), south, west.
_WALL_YAW = (0.0, -np.pi / 2, np.pi, np.pi / 2)


@dataclass
class Site:
    """A room while it is furnished: ``size`` (x, y, z) metres; ``clutter`` scales the number of small things."""

    size: tuple[float, float, float]
    clutter: float
    builder: WorldBuilder
    taken: Footprints

    def length(self, wall: int) -> float:
        """Returns the length of a wall, metres."""
        return self.size[0] if wall % 2 == 0 else self.size[1]

    def at_wall(self, wall: int, along: float, depth: float, z: float = 0.0) -> Pose:
        """Returns the pose of an item ``depth`` deep, its back on a wall, ``along`` metres from the wall's middle."""
        reach = (self.size[1] if wall % 2 == 0 else self.size[0]) / 2 - depth / 2
        return Pose(yaw=_WALL_YAW[wall]).at(along, reach, z)
