"""What kinds of LiDAR see, of a wall ahead."""

from __future__ import annotations

import numpy as np
import pytest
from torchjoint_lab.synthetic import domain_settings, lidar_scan


class Wall:
    """A wall 10 m ahead, in place of a street."""

    def cast(self, rays):
        start, ahead = rays[:, 0], rays[:, 3]
        hit = ahead > 1e-3
        distance = np.where(hit, (10 - start) / np.where(hit, ahead, 1), np.inf)
        return np.where(hit, 0, -1), distance, np.ones(len(rays)), np.zeros(len(rays))


def wall_seen_by(lidar: str) -> np.ndarray:
    settings = domain_settings("street", 0)._replace(depth_noise=0.0, holes=0.0)
    return lidar_scan.scan(np.random.default_rng(0), Wall(), settings, lidar)[0].astype(np.float64)


def test_a_moving_sensor_comes_nearer_while_it_turns() -> None:
    for lidar, speed in (("64", 0.0), ("64, moving", 15.0)):
        seen = wall_seen_by(lidar)
        azimuth = np.arctan2(seen[:, 1], seen[:, 0])
        seen, azimuth = seen[np.abs(azimuth) < 1], azimuth[np.abs(azimuth) < 1]
        come = speed * 0.1 * np.mod(azimuth, 2 * np.pi) / (2 * np.pi)  # a turn takes a tenth of a second
        assert (np.abs(seen[:, 0] - (10 - come)) < 0.02).mean() > 0.98, lidar


def test_sensors_see_what_they_can_reach() -> None:
    for name, lidar in lidar_scan.LIDARS.items():
        seen = wall_seen_by(name)
        assert np.linalg.norm(seen, axis=1).max() < lidar.farthest + 1, name
    ahead = wall_seen_by("solid state")
    assert np.abs(np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))).max() <= 35.1
    assert np.abs(np.degrees(np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1])))).max() <= 12.6
    apart = wall_seen_by("two of 16, apart")
    assert len(apart) == pytest.approx(2 * len(wall_seen_by("16")), rel=0.02)  # two sensors
