"""Step 6, learned: regions of one surface behind an occluder are joined, other regions are not."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.scene import Frame, Scene
from torchjoint.segments.learned.occluded_surfaces import Occlusions, _is_seen_through, continued_surfaces
from torchjoint.segments.learned.region_statistics import RegionStatistics
from torchjoint.views import occluders
from torchjoint.views.observations import Observation
from torchjoint.views.occluders import lines_across
from torchjoint.views.visibility import Visible

DEPTHS = [None, 1.0, 1.5, 1.6, 2.0, 2.01, 3.0]


@pytest.fixture(autouse=True)
def cells_of_one_pixel(monkeypatch):
    monkeypatch.setattr(occluders, "CELL", 0.1)


def visible_of(rows):
    """The visible points of rows of depths, None = no point; the number of a point is 10 times its place."""
    seen = [(row, column, z) for row, depths in enumerate(rows) for column, z in enumerate(depths) if z is not None]
    row, column, z = zip(*seen, strict=True) if seen else ((), (), ())
    point = 10 * torch.arange(len(seen))
    row, column = torch.tensor(row, dtype=torch.int64), torch.tensor(column, dtype=torch.int64)
    return Visible(point, row, column, column.float(), row.float(), torch.tensor(z, dtype=torch.float32))


def lines_of(rows, noise=0.0):
    visible = visible_of(rows)
    return sorted(lines_across(visible, torch.full((10 * len(visible.point) + 1,), noise)).T.tolist())


def lines_by_hand(depths, noise):
    """The same for one row, cell by cell, in numbers of its points."""
    place = [i for i, z in enumerate(depths) if z is not None]
    cells = [(number, float(torch.tensor(depths[i]))) for number, i in enumerate(place)]

    def threshold(z):
        return max(occluders.DEPTH_STEP * z, occluders.STEP_IN_NOISE * noise)

    def step(i):  # -1 falls, 1 rises, 0 neither, from cell i to the next one
        one, other = cells[i][1], cells[i + 1][1]
        return 0 if abs(one - other) <= threshold(max(one, other)) else (1 if other > one else -1)

    mixed = [0 < i < len(cells) - 1 and step(i - 1) == step(i) != 0 for i in range(len(cells))]
    cells = [cell for cell, is_mixed in zip(cells, mixed, strict=True) if not is_mixed]
    stack, found = [], []
    for i in range(len(cells) - 1):
        if step(i) == -1:
            stack.append(i)
        elif step(i) == 1 and stack:
            fall = stack.pop()
            long = fall > 0 and step(fall - 1) == 0 and i + 2 < len(cells) and step(i + 1) == 0 and i > fall + 1
            behind = min(cells[fall][1], cells[i + 1][1]) - max(threshold(cells[fall][1]), threshold(cells[i + 1][1]))
            if long and max(cells[fall + 1][1], cells[i][1]) < behind:
                found.append([10 * cells[fall][0], 10 * cells[i + 1][0]])
    return sorted(found)


def test_one_row():
    assert lines_of([[2, 2, 1, 1, 2, 2]]) == [[10, 40]]
    assert lines_of([[2, 2, None, 1, 1, None, 2, 2]]) == [[10, 40]]  # empty cells are skipped
    assert lines_of([[2, 2, 1.5, 1, 1, 1.5, 2, 2]]) == [[10, 60]]  # mixed cells, too
    assert lines_of([[3, 3, 2, 2, 1, 1, 2, 2, 3, 3]]) == [[10, 80], [30, 60]]
    assert lines_of([[2, 2, 1, 1], [2, 2, 1, 1]]) == []  # no line goes on in the next row


@pytest.mark.parametrize("depths", [[2, 2, 1, 2, 2], [2, 1, 1, 2, 2], [2, 2, 1, 1, 2], [2, 2, 1.95, 1.95, 2, 2]])
def test_thin_runs_and_small_steps_say_nothing(depths):
    assert lines_of([depths]) == []


def test_noise_widens_the_step():
    assert lines_of([[2, 2, 1, 1, 2, 2]], noise=0.24) == [[10, 40]]
    assert lines_of([[2, 2, 1, 1, 2, 2]], noise=0.26) == []


def test_columns_count_like_rows():
    rows = [[2, 2, 1, 1, 2, 2]]
    assert lines_of(list(zip(*rows, strict=True))) == lines_of(rows)


def test_no_points():
    assert lines_of([]) == []


@given(st.lists(st.sampled_from(DEPTHS), min_size=1, max_size=24), st.sampled_from([0.0, 0.1]))
def test_random_rows(depths, noise):
    assert lines_of([depths], noise) == lines_by_hand(depths, noise)


@given(st.lists(st.lists(st.sampled_from(DEPTHS), min_size=7, max_size=7), min_size=2, max_size=3))
def test_rows_do_not_mix(rows):
    points = [sum(z is not None for z in row) for row in rows]
    first = [10 * sum(points[:i]) for i in range(len(rows))]
    by_row = [[a + shift, b + shift] for row, shift in zip(rows, first, strict=True) for a, b in lines_by_hand(row, 0)]
    assert lines_of(rows) == sorted(by_row)  # columns of at most three cells have no lines


def statistics(colors, spread=3.0):
    count = len(colors)
    ones, color = torch.ones(count, dtype=torch.float64), torch.tensor(colors, dtype=torch.float64)
    vectors = torch.zeros(count, 3, dtype=torch.float64)
    variance = torch.full((count, 3), spread**2 / 3, dtype=torch.float64)
    squares = torch.zeros(count, 3, 3, dtype=torch.float64)
    return RegionStatistics(
        ones, vectors, squares, vectors, ones, ones, color, variance, vectors, 0 * ones, 0 * ones, None
    )


def test_lines_of_superpoints_add_up():
    grey, red = [50.0, 0, 0], [50.0, 60, 0]
    of_superpoint = torch.tensor([0, 0, 1, 1, 2, 3])
    occlusions = Occlusions(
        pairs=torch.tensor([[0, 1, 0, 0, 4], [2, 3, 4, 5, 5]]),
        num_lines=torch.tensor([3, 2, 9, 9, 3]),
        may_continue=torch.tensor([True, False, True, True, True]),
        between=torch.tensor([[-1, -1, -1, 3, -1]] * 3),
    )
    same, none = statistics([grey] * 4), torch.empty(2, 0, dtype=torch.int64)
    pairs, against = continued_surfaces(occlusions.grouped(of_superpoint), same, none)
    assert pairs.tolist() == [[0], [2]]  # 0 and 1 have 3 votes, 0 and 3 have a third one between, 2 and 3 have 3 lines
    assert against.tolist() == [0]
    more = occlusions._replace(num_lines=torch.tensor([6, 2, 9, 9, 4]))
    pairs, against = continued_surfaces(more.grouped(of_superpoint), same, none)
    assert pairs.tolist() == [[0, 0, 2], [1, 2, 3]]
    assert against.tolist() == [0.25, 0, 0]
    touching = torch.tensor([[0], [1]])
    assert continued_surfaces(more.grouped(of_superpoint), same, touching)[0].tolist() == [[0, 2], [2, 3]]
    fewer = occlusions._replace(num_lines=torch.tensor([4, 5, 9, 9, 3]))
    assert continued_surfaces(fewer.grouped(of_superpoint), same, none)[0].tolist() == [[0], [2]]  # 4 of 9 lines
    beside = occlusions._replace(between=torch.tensor([[-1, -1, 1, 3, -1]] * 3))
    assert continued_surfaces(beside.grouped(of_superpoint), same, none)[0].tolist() == [
        [0],
        [2],
    ]  # what is between is one of both
    other = statistics([grey] * 2 + [red] * 2)
    assert continued_surfaces(occlusions.grouped(of_superpoint), other, none)[0].tolist() == [[], []]
    assert continued_surfaces(occlusions.grouped(of_superpoint), same._replace(color=None), none)[0].tolist() == [
        [],
        [],
    ]


def places_seen_through(seen, places, step=0.0):
    ways = torch.tensor(places, dtype=torch.float64)[None]
    return _is_seen_through(ways, torch.full((len(places),), step, dtype=torch.float64), seen)[0].tolist()


def looking_along_z(*rows, shift=0.0):
    """A frame of focal length 1 pixel from x = -shift, whose rows of depths are seen as they are written."""
    visible, pose = visible_of(rows), torch.eye(4)
    pose[0, 3] = shift
    empty = torch.zeros(3, len(rows), max(map(len, rows))).byte()
    return Observation("", empty[0].int(), visible, torch.eye(3), pose, empty, empty[0])


def test_free_space_is_what_is_seen_through():
    row = [2.0] * 3 + [1.0] * 3
    seen = looking_along_z(*[row] * 3)
    pixels = [(0, 1), (1, 1), (2, 1), (4, 1), (7, 1), (-2, 1)]
    # Column 0 and 1 show 2 m, column 2 has a neighbour 1 m away, columns 7 and -2 are not in the image.
    at = {z: [[u * z, v * z, z] for u, v in pixels] for z in (0.5, 1.0, 1.9, 2.0, 2.5)}
    assert places_seen_through([seen], at[0.5]) == [True, True, True, True, False, False]
    assert places_seen_through([seen], at[1.0]) == [True, True, False, False, False, False]
    assert places_seen_through([seen], at[1.9]) == [True, True, False, False, False, False]
    assert places_seen_through([seen], at[1.9], step=0.11) == [False] * 6
    assert places_seen_through([seen], at[2.0]) == places_seen_through([seen], at[2.5]) == [False] * 6
    assert places_seen_through([seen], [[0, 0, -1.0], [0, 0, 0.0]]) == [False, False]  # behind the camera
    assert places_seen_through([looking_along_z([])], at[1.0]) == [False] * 6  # it sees nothing


def test_frames_vote_on_free_space():
    free, there, hidden = (looking_along_z(*[[z] * 3] * 3) for z in (2.0, 1.0, 0.5))
    place = [[1.0, 1, 1]]
    assert places_seen_through([free, hidden, hidden], place) == [True]
    assert places_seen_through([free, there], place) == [False]
    assert places_seen_through([free, there, free], place) == [True]
    # From 2 m to the left, the place is 3 columns to the right: outside.
    assert places_seen_through([looking_along_z(*[[2.0] * 3] * 3, shift=2.0)], place) == [False]
    assert places_seen_through([looking_along_z(*[[2.0] * 4] * 3, shift=2.0)], place) == [True]


def room_with_a_post(right=2.0, right_color=0.6, colors=True, images=True):
    """A wall 2 m away that a post 1 m away divides, seen by one camera; the right part can be at another depth."""
    height, width, focal = 96, 128, 120.0
    row, column = (x.flatten() for x in torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij"))
    is_post = (column >= 56) & (column < 72)
    z = torch.where(is_post, 1.0, torch.where(column < 64, 2.0, right))
    points = torch.stack([(column + 0.5 - width / 2) / focal * z, (row + 0.5 - height / 2) / focal * z, z], 1)
    generator = torch.Generator().manual_seed(0)
    points += 0.001 * torch.randn(points.shape, generator=generator)
    color = torch.where(is_post, 0.1, torch.where(column < 64, 0.6, right_color))[:, None].expand(-1, 3)
    color = (color + 0.01 * torch.randn(color.shape, generator=generator)).clamp(0, 1)
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    frame = Frame(color.T.reshape(3, height, width), intrinsics, torch.eye(4))
    wall = (~is_post & (column < 52), is_post & (column > 58) & (column < 69), ~is_post & (column > 76))
    return Scene(points, [frame] if images else [], colors=color if colors else None), wall


def panels_with_a_post(step_aside):
    """Two panels 2 m away with free space between them, a wall behind, and a post that hides the gap from one camera.

    Another camera that steps aside looks past the post, through the gap.

    Returns:
        The most frequent labels of the panels.
    """
    height, width, focal = 96, 128, 120.0
    things = (  # depth, grey, and where it is
        (1.0, 0.1, lambda x: x.abs() < 0.14),
        (2.0, 0.6, lambda x: (x.abs() > 0.2) & (x.abs() < 0.7)),
        (3.0, 0.9, lambda x: x.abs() < 2),
    )
    generator = torch.Generator().manual_seed(0)
    x, y = torch.meshgrid(torch.arange(-2, 2, 0.015), torch.arange(-1.2, 1.2, 0.015), indexing="ij")
    parts = [torch.stack([x, y, z + 0 * x], 2)[is_there(x)] for z, _, is_there in things]
    gray = torch.tensor([grey for _, grey, _ in things]).repeat_interleave(torch.tensor([len(part) for part in parts]))
    colors = (gray[:, None] + 0.01 * torch.randn(len(gray), 3, generator=generator)).clamp(0, 1)
    points = torch.cat(parts) + 0.001 * torch.randn(len(gray), 3, generator=generator)
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    frames = []
    for shift in (0.0, step_aside):
        image, pose = torch.zeros(width), torch.eye(4)
        pose[0, 3] = -shift
        for z, grey, is_there in reversed(things):
            image[is_there((torch.arange(width) - width / 2) / focal * z + shift)] = grey
        frames.append(Frame(image.expand(3, height, width), intrinsics, pose))
    labels = tj.JointSegmenter()(Scene(points, frames, colors=colors)).points
    side, panels = torch.sign(points[:, 0]), gray == 0.6
    return [labels[panels & (side == sign)].mode().values.item() for sign in (-1, 1)]


@pytest.mark.slow
def test_a_view_through_the_gap_keeps_panels_apart():
    left, right = panels_with_a_post(step_aside=0.0)
    assert left == right
    left, right = panels_with_a_post(step_aside=0.6)
    assert left != right


def labels_of(**options):
    scene, parts = room_with_a_post(**options)
    labels = tj.JointSegmenter()(scene).points
    of = [labels[part].unique().tolist() for part in parts]
    assert all(len(values) == 1 for values in of)
    return [values[0] for values in of]


def test_a_wall_behind_a_post_is_one_segment():
    left, post, right = labels_of()
    assert left == right != post


def test_a_wall_without_colors_has_those_of_its_images():
    left, post, right = labels_of(colors=False)
    assert left == right != post


@pytest.mark.parametrize(
    "options",
    [
        {"right": 2.4},
        {"right_color": 0.95},
        {"right_color": 0.95, "colors": False},
        {"images": False},
        {"images": False, "colors": False},
    ],
)
def test_other_walls_stay_apart(options):
    assert len(set(labels_of(**options))) == 3


def test_the_wall_is_whole_at_coarse_levels_only():
    scene, (left, _, right) = room_with_a_post()
    hierarchy = tj.JointSegmenter()(scene).hierarchy
    for granularity, joined in ((0.4, True), (0.5, True), (0.65, False)):
        labels = hierarchy.at(granularity)
        assert (labels[left][0] == labels[right][0]) == joined


def test_each_frame_brings_its_lines(scene_of):
    scene, segmenter = scene_of(3).scene, tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(scene.frames)
    noise = segmenter.graph.scales.noise
    for seen in segmenter.state.observations:
        assert torch.equal(seen.lines, lines_across(seen.visible, noise))
    assert any(seen.lines.numel() for seen in segmenter.state.observations)
