"""Step 6, regions: a surface that something in front cuts in two is one again, and nothing else is."""

import dataclasses

import pytest
import torch
from hand_wall import LEFT, RIGHT, STRIP, wall_behind_a_strip
from torchjoint_lab.regions import occlusion_bridging
from torchjoint_lab.regions.config import OcclusionBridgingConfig
from torchjoint_lab.regions.occlusion_bridging import bridge

from torchjoint.segments.planes import Planes
from torchjoint.views.visibility import Visible

CONFIG = OcclusionBridgingConfig(min_votes=3)


@pytest.fixture(autouse=True)
def cells_of_one_pixel(monkeypatch):
    monkeypatch.setattr(occlusion_bridging, "CELL", 1)


def is_bridged(scene, min_votes=3, **constants):
    segment, planes, observations = scene
    with pytest.MonkeyPatch.context() as patch:
        for name, value in constants.items():
            patch.setattr(occlusion_bridging, name.upper(), value)
        joined = bridge(segment, planes, observations, OcclusionBridgingConfig(min_votes))
    of = [joined[segment == part].unique().tolist() for part in (LEFT, STRIP, RIGHT)]
    assert all(len(labels) == 1 for labels in of)
    assert of[1] != of[0], "the strip is no part of the wall"
    assert of in ([[0], [1], [0]], [[0], [1], [2]])
    return of[0] == of[2]


@pytest.mark.parametrize("turned", [False, True])
def test_a_wall_behind_a_strip_is_one(turned):
    assert is_bridged(wall_behind_a_strip(turned=turned))


def test_off():
    segment, planes, observations = wall_behind_a_strip()
    assert bridge(segment, planes, observations, OcclusionBridgingConfig(min_votes=None)) is segment
    assert bridge(segment, planes, [], CONFIG) is segment


@pytest.mark.parametrize(("left", "right"), [(2.0, 2.2), (2.2, 2.0), (2.0, 1.8)])
def test_sides_at_different_depths_are_two(left, right):
    assert not is_bridged(wall_behind_a_strip(left=left, right=right))


def test_flatness_and_a_twentieth_of_the_gap():
    # From the last column on the left to the first one on the right: 5 columns of 0.1 m, so 0.015 + 0.025 are allowed.
    assert is_bridged(wall_behind_a_strip(right=2.036))
    assert not is_bridged(wall_behind_a_strip(right=2.044))
    assert is_bridged(wall_behind_a_strip(right=2.044), flatness=0.02)


@pytest.mark.parametrize("strip", [2.0, 2.5, 1.98])
def test_what_is_behind_or_beside_cuts_nothing_in_two(strip):
    assert not is_bridged(wall_behind_a_strip(strip=strip))


def test_depth_step():
    assert is_bridged(wall_behind_a_strip(strip=1.96))
    assert not is_bridged(wall_behind_a_strip(strip=1.96), depth_step=0.05)


def test_the_strip_must_be_in_front_of_both_sides():
    for left, right in ((2.0, 0.8), (0.8, 2.0)):
        assert not is_bridged(wall_behind_a_strip(left=left, right=right), flatness=10, max_gap=10)


def test_too_wide_a_gap():
    assert is_bridged(wall_behind_a_strip(), max_gap=0.501)
    assert not is_bridged(wall_behind_a_strip(), max_gap=0.499)


def test_a_wall_that_turns_behind_the_strip_is_two():
    # Both parts go through (0, 0, 2), behind the strip: not far off each other's planes, but turned by 31 degrees.
    assert is_bridged(wall_behind_a_strip(slope=0.1), flatness=1)
    assert not is_bridged(wall_behind_a_strip(slope=0.6), flatness=1)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_each_side_must_lie_in_the_other_s_plane(side):
    segment, planes, observations = wall_behind_a_strip()
    normal = planes.normal.clone()
    normal[segment == side] = torch.nn.functional.normalize(torch.tensor([0.36, 0.0, -1.0]), dim=0)
    assert not is_bridged((segment, planes._replace(normal=normal), observations))
    assert is_bridged((segment, planes._replace(normal=normal), observations), flatness=0.2)


def test_the_back_of_a_thing_is_not_its_front():
    assert not is_bridged(wall_behind_a_strip(upside_down=True))


def test_so_many_lines_must_vote():
    """The strip is there in a part of the rows only; elsewhere nothing is seen between the sides."""
    assert is_bridged(wall_behind_a_strip(rows=3))
    assert not is_bridged(wall_behind_a_strip(rows=2))
    assert is_bridged(wall_behind_a_strip(rows=2), min_votes=2)


def test_a_share_of_the_lines_must_vote():
    segment, planes, observations = wall_behind_a_strip()
    row, z = observations[0].visible.row, planes.mean.clone()
    z[(row < 5) & (segment == RIGHT), 2] += 1.0  # in 5 of 8 rows the right side is elsewhere
    scene = segment, Planes(z, planes.normal), observations
    assert is_bridged(scene, agreeing_share=3 / 8)
    assert not is_bridged(scene, agreeing_share=0.4)


@pytest.mark.parametrize("strip_width", [1, 2])
def test_runs_of_one_square_do_not_count(strip_width):
    assert is_bridged(wall_behind_a_strip(strip_width=strip_width)) == (strip_width == 2)


def test_of_a_square_the_nearest_point_counts():
    """What is seen through a gap of the strip does not end it."""
    segment, planes, observations = wall_behind_a_strip()
    visible = observations[0].visible
    behind = (segment == STRIP) & ((visible.row + visible.column) % 2 == 0)
    segment = torch.where(behind, LEFT, segment)
    z = torch.where(behind, 2.0, visible.z)
    scene = segment, planes, [dataclasses.replace(observations[0], visible=visible._replace(z=z))]
    assert is_bridged(scene, cell=2, min_votes=4)  # 4 rows of squares, in each of which the strip is whole
    assert not is_bridged(scene, cell=2, min_votes=5)
    assert not is_bridged(scene, cell=1, min_votes=1)


def test_neither_the_order_of_views_nor_threads_matter(set_threads):
    segment, planes, (seen,) = wall_behind_a_strip()
    views = []
    for rows in (2, 1, 0):
        keep = (segment != STRIP) | (seen.visible.row < rows)
        views.append(dataclasses.replace(seen, visible=Visible(*(values[keep] for values in seen.visible))))
    for count in (1, 2):
        set_threads(count)
        for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
            assert is_bridged((segment, planes, [views[i] for i in order]))  # 2 + 1 votes
            assert not is_bridged((segment, planes, [views[i] for i in order]), min_votes=4)


def test_labels_are_numbered_by_the_lowest_of_those_joined():
    segment, planes, observations = wall_behind_a_strip()
    names = torch.tensor([3, 0, 1])  # the left part, the strip, the right part; nobody sees 2 and 4
    point_labels = torch.cat([names[segment], torch.tensor([2, 4])])
    more = Planes(*(torch.cat([values, torch.zeros(2, 3)]) for values in planes))
    joined = bridge(point_labels, more, observations, CONFIG)
    assert joined[-2:].tolist() == [2, 3]
    assert [joined[:-2][segment == part].unique().tolist() for part in (LEFT, STRIP, RIGHT)] == [[1], [0], [1]]


def test_a_view_of_nothing():
    segment, planes, observations = wall_behind_a_strip()
    nothing = dataclasses.replace(observations[0], visible=Visible(*(values[:0] for values in observations[0].visible)))
    assert torch.equal(bridge(segment, planes, [nothing], CONFIG), segment)
    assert is_bridged((segment, planes, [nothing, *observations]))
