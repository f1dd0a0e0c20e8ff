"""A scan's segments."""

import math

import numpy as np
import pytest
import torch
from lidar_scans import HEIGHT, height_over_ground, scan
from torchjoint_lab.evaluation.scores import mean_scores, score

from torchjoint.config import ScanConfig
from torchjoint.datasets import list_scenes, load_scene
from torchjoint.datasets.files.clouds import read_scan
from torchjoint.metrics import mean_best_iou
from torchjoint.segments.scan import gaps
from torchjoint.segments.scan import method as scan_segments
from torchjoint.segments.scan.gaps import Gaps
from torchjoint.segments.scan.ground import GROUND_HEIGHT
from torchjoint.segments.scan.method import segment_levels, with_near_rings
from torchjoint.segments.scan.recognition import Rings, directions
from torchjoint.views.visibility import in_any_view

BOXES = (
    ((8.0, -1.0, -HEIGHT), (12.0, 1.0, 0.1)),
    ((6.0, 4.0, -HEIGHT), (6.6, 4.6, 0.1)),
    ((-16.0, -2.0, -HEIGHT), (-12.0, 0.5, 0.0)),  # across the seam
    ((0.0, -9.0, -HEIGHT), (4.0, -7.5, -0.3)),
)


def test_the_gap_is_that_of_the_nearer_end():
    points = torch.tensor([[10.0, 0, 0], [10, 0, 0.375], [40, 0, 0], [40, 3, 0], [40, 4, 0]])
    config = ScanConfig(gap=0.2, gap_growth=0.02)
    found = Gaps.of(points, config.gap + config.gap_growth * directions(points).range, torch.arange(5))
    # .375 / (.2 + .2) < 1 gap; 3 / (.2 + .8) = 3; 1 / (.2 + .02 * 40.1) < 1
    assert found.components(torch.ones(5, dtype=torch.bool)).tolist() == [1, 1, 2, 3, 3]
    assert found.components(torch.tensor([True, False, True, True, True])).tolist() == [1, 0, 3, 4, 4]


def test_boxes_on_the_ground():
    points, what = scan(*BOXES)
    labels = segment_levels(points).at()
    stands = height_over_ground(points) >= GROUND_HEIGHT
    assert len(labels[what == 0].unique()) == 1
    assert len(labels.unique()) == 1 + len(BOXES)
    assert mean_best_iou(labels[stands], what[stands]) == 1
    assert mean_best_iou(labels, what) > 0.9


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_outliers_do_not_lower_the_ground(share):
    points, what = scan(*BOXES)
    low, high = points.amin(0), points.amax(0)
    low[2] = -10.0  # most outliers are below the ground
    count = round(share * len(points))
    outliers = low + (high - low) * torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
    labels = segment_levels(torch.cat([points, outliers])).at()[: len(points)]
    assert mean_best_iou(labels, what) > mean_best_iou(segment_levels(points).at(), what) - 0.05


def test_points_that_stand_alone_are_not_used_unless_all_do(monkeypatch):
    points, _ = scan(*BOXES)
    found = []
    for spacing in (torch.inf, 0.0):
        alone = torch.full((len(points),), spacing, dtype=torch.float64)
        monkeypatch.setattr(scan_segments, "local_spacing", lambda *_, alone=alone: alone)
        found.append(segment_levels(points).at())
    assert torch.equal(*found)


def test_rings_are_drawn_together():
    points = torch.tensor([[10.0, 0, 0], [0, 10 * math.cos(0.2), -10 * math.sin(0.2)]])
    seen = directions(points)
    assert with_near_rings(points, seen, None, ScanConfig()) is points
    assert with_near_rings(points, seen, Rings(0.004, 64), ScanConfig()) is points  # .02 > 4 x .004
    drawn = with_near_rings(points, seen, Rings(0.01, 32), ScanConfig())  # to the half
    expected = torch.tensor([[10.0, 0, 0], [0, 10 * math.cos(0.1), -10 * math.sin(0.1)]])
    torch.testing.assert_close(drawn, expected)


@pytest.mark.parametrize("beams", [16, 32, 64])
def test_few_beams_show_a_car_in_one_piece(beams):
    points, what = scan(((14.0, -2.0, -HEIGHT), (15.8, 2.0, 0.1)), beams=beams)  # nobody sees its roof
    labels = segment_levels(points).at()
    car = what == 1
    assert len({int(label) for label in labels[car].unique()} - {int(labels[what == 0].mode().values)}) == 1


def test_labels_are_numbered_by_first_points():
    points, _ = scan(*BOXES)
    labels = segment_levels(points).at()
    first = [int((labels == label).nonzero()[0]) for label in range(int(labels.max()) + 1)]
    assert first == sorted(first)
    assert labels.dtype == torch.int64


def test_the_gap_parts_and_joins(monkeypatch):
    monkeypatch.setattr(gaps, "NEIGHBORS", 40)  # enough to see each other across the gap

    def two(apart):
        boxes = [((10.0, -1.0, -HEIGHT), (11.0, -apart / 2, 0)), ((10.0, apart / 2, -HEIGHT), (11.0, 1.0, 0))]
        points, what = scan(*boxes)
        labels = segment_levels(points).at()
        return labels[what == 1].mode().values == labels[what == 2].mode().values

    assert two(0.2)  # .2 + .02 * 10 = .4
    assert not two(0.7)


def test_beams_whose_neighbours_are_their_own_are_joined(monkeypatch):
    # A pole-like box: five points a beam, beams .15 m apart at 12 m, neighbours fewer than a beam has.
    points, what = scan(((12.0, -0.25, -HEIGHT), (12.3, 0.25, 1.5)))
    monkeypatch.setattr(gaps, "NEIGHBORS", 4)
    labels = segment_levels(points).at()
    assert len(labels[(what == 1) & (height_over_ground(points) >= GROUND_HEIGHT)].unique()) == 1


def test_bits_join_what_is_near_and_only_that(monkeypatch):
    points, what = scan(BOXES[0])
    near, far = torch.tensor([[7.63, 0.0, -0.5]]), torch.tensor([[20.0, 10.0, 0.5]])
    labels = segment_levels(torch.cat([points, near, far])).at()
    car = labels[: len(points)][what == 1].mode().values
    assert labels[-2] == car  # .37 m away: 1.05 gaps
    assert (labels == labels[-1]).sum() == 1
    monkeypatch.setattr(gaps, "JOINING_GAP", 1)
    labels = segment_levels(torch.cat([points, near, far])).at(1.0)
    assert (labels == labels[-2]).sum() == 1
    monkeypatch.setattr(gaps, "JOINING_GAP", 1e3)
    assert (segment_levels(torch.cat([points, near, far])).at() == car).sum() > 2


def test_nothing_but_ground():
    points, _ = scan()
    assert segment_levels(points).at().unique().tolist() == [0]
    assert segment_levels(torch.tensor([[3.0, 4.0, -1.0]])).at().tolist() == [0]
    assert segment_levels(torch.zeros(5, 3)).at().tolist() == [0] * 5


def test_one_point_over_the_ground():
    points, _ = scan()
    labels = segment_levels(torch.cat([points, torch.tensor([[10.0, 0, 1]])])).at()
    assert labels[-1] == 1
    assert (labels[:-1] == 0).all()


def test_threads_change_nothing(set_threads):
    points, _ = scan(*BOXES)
    points = points + 0.02 * torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
    found = []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(segment_levels(points).at())
        assert torch.get_num_threads() == threads
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])


@pytest.mark.parametrize("points", [torch.zeros(0, 3), torch.rand(3, 4), torch.full((2, 3), torch.inf)])
def test_bad_points(points):
    with pytest.raises(ValueError, match=r"points: (expected|2 of 2 points are NaN)"):
        segment_levels(points).at()


def test_bad_config():
    with pytest.raises(ValueError, match=r"scan\.gap: expected > 0 where gap_growth is 0"):
        ScanConfig(gap=0, gap_growth=0)


class TestRealScans:
    """What lab/studies/streets.py measures, with some room."""

    def test_the_boxes_of_kitti(self, shared):
        scores = []
        for path in list_scenes(shared / "data/kitti/training").values():
            scene = load_scene(path)
            scene = scene.select_points(in_any_view(scene.points, scene.frames))
            scores.append(score(segment_levels(scene.points).at(), scene.truth.points))
        mean = mean_scores(scores)
        assert mean.f >= 0.8
        assert mean.best_iou >= 0.9

    def test_a_whole_annotated_scan(self, shared):
        """Ground is one region with few crumbs, and every vehicle and person is a segment."""
        folder = shared / "data/semantickitti"
        points = read_scan(folder / "000964.bin", 4)[:, :3].contiguous()
        truth = torch.from_numpy(np.fromfile(folder / "000964.label", dtype=np.uint32).astype(np.int64))
        kind = truth & 0xFFFF
        ground = torch.isin(kind, torch.tensor([40, 44, 48, 49, 60, 72]))
        labels = segment_levels(points).at()
        size = torch.bincount(labels)
        of_ground = torch.bincount(labels[ground], minlength=len(size))
        assert int((2 * of_ground > size).sum()) - 1 <= 4
        assert of_ground.max() > 0.98 * ground.sum()
        best = []
        for thing in truth[torch.isin(kind, torch.tensor([10, 18, 252]))].unique():
            of_thing = truth == thing
            shared_points = torch.bincount(labels[of_thing], minlength=len(size))
            best.append((shared_points / (size + of_thing.sum() - shared_points)).max())
        assert len(best) == 15
        assert torch.stack(best).mean() > 0.9
