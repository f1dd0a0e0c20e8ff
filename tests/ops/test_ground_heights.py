"""The ground below points of a scan: against the slow twin, exactly."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.ground_heights import ground_heights_reference

from torchjoint.ops.internal import ground_heights
from torchjoint.segments.scan.recognition import directions


def scene(seed: int, count: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=generator) * torch.tensor([12.0, 12, 0.3]) - torch.tensor([0, 0, 1.5])
    if seed % 2:  # many equal heights, directions and distances
        points = points.round()
    seen = directions(points)
    used = torch.rand(count, generator=generator) < 0.9
    used[seed % count] = True
    values = {"azimuth": seen.azimuth, "elevation": seen.elevation, "distance": seen.distance}
    return values | {"height": points[:, 2].double(), "used": used}


@given(st.integers(0, 2**32 - 1), st.integers(1, 250), st.integers(1, 9))
def test_heights_are_those_of_the_twin(seed: int, count: int, num_columns: int) -> None:
    settings = (num_columns, 0.02, 0.2, 0.1, 0.2, 8.0, 0.75, min(2, num_columns))
    values = scene(seed, count)
    assert torch.equal(
        ground_heights(*values.values(), *settings), ground_heights_reference(*values.values(), *settings)
    )


def settings_by_hand(**changes: float) -> dict[str, float]:
    of_four = {"num_columns": 4, "row_height": 0.01, "slope": 1.0, "step": 0.1, "bump": 9.0, "near": 20.0}
    return of_four | {"blind": 0.0, "sides": 1} | changes


def ground(points: list[list[float]], **changes: float) -> list[float]:
    places = torch.tensor(points, dtype=torch.float64)
    seen = directions(places)
    used = torch.ones(len(places), dtype=torch.bool)
    args = (seen.azimuth, seen.elevation, seen.distance, places[:, 2], used)
    return [round(height, 6) for height in ground_heights(*args, **settings_by_hand(**changes)).tolist()]


def test_the_walk_by_hand() -> None:
    # All are in the middle of one column. (6, 6, -1) is no farther than (6, 6, -2), and (6.2, 6.2, 1) is too steep.
    points = [[4.0, 4, -2], [6, 6, -2], [6, 6, -1], [6.2, 6.2, 1.0], [9, 9, -0.5]]
    found = ground(points)
    assert found[:3] == [-2, -2, -2]
    assert found[4] == -0.5
    assert found[3] == round(-2 + 1.5 * 0.2 / 3, 6)  # between (6, -2) and (9, -.5)
    assert ground(points, slope=0.3)[4] == -2


def test_a_bump_is_left_out() -> None:
    points = [[5.0 * x, 5.0 * y, -2.0 + 0.5 * (x + y == 2)] for x in (-1, 1) for y in (-1, 1)]
    assert max(ground(points)) == -1.5
    assert max(ground(points, bump=0.3)) == -2


def test_points_before_the_blind_distance_are_no_ground() -> None:
    # The lowest beam, of the first point, would meet level ground at 1.5 m.
    points = [[1.0, 1, -1.9], [10, 10, -2], [-10, -10, -2]]
    assert ground(points)[0] == -1.9
    assert ground(points, blind=1.0)[0] == -2


def test_threads_change_nothing(set_threads) -> None:
    values, found = scene(2, 40_000), []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(ground_heights(*values.values(), 180, 0.007, 0.2, 0.1, 0.2, 8.0, 0.75, 4))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])
