"""Method auto: what a cloud is decides how it is segmented."""

import logging
import re
from functools import partial

import pytest
import torch
from lidar_scans import HEIGHT, scan
from torchjoint_lab.training.boundary_model_file import save_boundary_model
from tqdm import tqdm

import torchjoint as tj
from torchjoint.config import presets
from torchjoint.segments.learned.boundary_model import BoundaryModel, load_boundary_model
from torchjoint.segments.method import choose_method
from torchjoint.segments.scan.method import segment_levels

AUTO = tj.Config().set(["point_segments.method=auto", "boundary.detector=gradient"])
BOX = ((8.0, -1.0, -HEIGHT), (12.0, 1.0, 0.1))


@pytest.fixture(scope="module")
def street():
    return scan(BOX)[0]


@pytest.fixture(scope="module")
def room(scene_of):
    return scene_of(0, num_points=6000).scene


def reset(config, points):
    segmenter = tj.JointSegmenter(config)
    segmenter.reset(points)
    return segmenter


def method_of(config, points):
    return choose_method(config, points).name


def test_a_cloud_decides(street, room):
    assert method_of(AUTO, street) == "scan"
    assert method_of(AUTO, room.points) == "learned"
    for method in ("paper", "learned", "scan"):
        assert method_of(AUTO.set([f"point_segments.method={method}"]), street) == method


def test_a_scan_is_segmented_as_a_scan(street):
    segmenter = reset(AUTO, street)
    assert segmenter.state.views.shape == (0,)  # no edges
    assert torch.equal(segmenter.compute().points, segment_levels(street).at())
    assert segmenter.config == AUTO


def test_another_cloud_is_segmented_by_the_model(room):
    auto, learned = reset(AUTO, room.points), reset(AUTO.set(["point_segments.method=learned"]), room.points)
    for segmenter in (auto, learned):
        segmenter.update(room.frames[:2])
    assert torch.equal(auto.compute(images=False).points, learned.compute(images=False).points)


def test_points_that_are_metres_apart_are_told(room):
    with pytest.warns(UserWarning, match="neighbours are metres apart; are the coordinates in millimetres"):
        tj.JointSegmenter()(tj.Scene(1000 * room.points))


def test_each_reset_decides_anew(street, room):
    segmenter = reset(AUTO, street)
    segmenter.reset(room.points)
    assert segmenter.state.views.shape[0] > 0
    segmenter.reset(street)
    assert segmenter.state.views.shape == (0,)


@pytest.mark.slow
def test_auto_and_what_it_chose_store_the_same(street, room):
    for cloud, chosen, other in ((street, "scan", "learned"), (room.points, "learned", "scan")):
        for first, second in ((AUTO, f"point_segments.method={chosen}"), (AUTO, "point_segments.method=auto")):
            seen = reset(first, cloud)
            expected = seen.compute().points
            for config in (first.set([second]), AUTO):
                assert torch.equal(seen.compute(config=config).points, expected)
        with pytest.raises(ValueError, match=r"stored evidence depends on point_segments\.method"):
            reset(AUTO, cloud).compute(config=AUTO.set([f"point_segments.method={other}"]))


def test_a_model_of_ones_own(room, tmp_path):
    file = tmp_path / "one.npz"
    save_boundary_model(file, BoundaryModel(load_boundary_model().members[:1]))
    own = AUTO.set([f"point_segments.method={file}"])
    default, segmenter = reset(AUTO, room.points), reset(own, room.points)
    for one in (default, segmenter):
        one.update(room.frames[:2])
    found = segmenter.compute(images=False)
    assert not torch.equal(found.hierarchy.heights, default.compute(images=False).hierarchy.heights)
    tried = default.compute(images=False, config=own)  # frames are not seen again
    assert torch.equal(tried.points, found.points)
    assert torch.equal(tried.hierarchy.heights, found.hierarchy.heights)


def test_a_bad_model_is_told_before_all_frames(room, tmp_path):
    segmenter = tj.JointSegmenter(AUTO.set([f"point_segments.method={tmp_path / 'no.npz'}"]))
    with pytest.raises(FileNotFoundError, match=r"no\.npz: missing; expected a model"):
        segmenter.reset(room.points)


def test_parameters_of_the_scan_can_be_tried_out(street):
    coarse = AUTO.set(["scan.gap=2"])
    assert torch.equal(reset(AUTO, street).compute(config=coarse).points, segment_levels(street, coarse.scan).at())


@pytest.mark.parametrize(
    ("method", "unread"),
    [("auto", "scan.gap, paper.scale"), ("scan", "point_graph.neighbors, paper.scale"), ("paper", "scan.gap")],
)
def test_parameters_that_the_method_does_not_read(room, method, unread):
    config = AUTO.set([f"point_segments.method={method}", "scan.gap=2", "paper.scale=3", "point_graph.neighbors=9"])
    with pytest.warns(
        UserWarning, match=f"^{unread}: without effect here, where method {method.replace('auto', 'learned')}"
    ):
        tj.JointSegmenter(config)(tj.Scene(room.points))


@pytest.mark.parametrize(
    "options",
    [
        ("visibility.depth_tolerance=0.02", "visibility.method=hidden_point_removal"),
        ("boundary.multi_scale=true", "boundary.detector=gradient"),
    ],
)
def test_parameters_of_another_choice(room, options):
    with pytest.warns(UserWarning, match=f"^{options[0].split('=')[0]}: without effect here"):
        reset(tj.Config().set(options), room.points)
    reset(tj.Config().set(options[:1]), room.points)


def test_points_of_a_scan_are_not_merged(street):
    with pytest.warns(UserWarning, match="^merge_within: without effect here, where method scan"):
        tj.JointSegmenter(AUTO, merge_within=0.1).reset(street)


def test_presets_and_runs_that_go_on_tell_nothing(room):
    for name in presets():
        tj.JointSegmenter.from_preset(name).reset(room.points)
    begun, again = (tj.JointSegmenter(AUTO.set(["scan.gap=2"])) for _ in range(2))
    scene = tj.Scene(room.points, room.frames[:1])
    with pytest.warns(UserWarning, match=r"^scan\.gap: without effect"):
        begun(scene)
    assert list(again.steps(scene, resume=lambda _: begun.state)) == [1]


def test_segmenters_of_parts_can_be_merged(room):
    first, second = reset(AUTO, room.points), reset(AUTO, room.points)
    first.update(room.frames[:1])
    second.update(room.frames[1:2])
    first.merge(second)
    assert len(first.state.observations) == 2


class TestLine:
    def line(self, caplog, config, points, normals=None):
        caplog.clear()
        with caplog.at_level(logging.INFO, logger="torchjoint"):
            tj.JointSegmenter(config).reset(points, normals=normals)
        (record,) = caplog.records
        return record.getMessage()

    def test_of_a_scan(self, caplog, street):
        found = self.line(caplog, AUTO, street)
        assert found == f"points: {len(street)} of a turning LiDAR with about 33 rings (certain); step 6 by method scan"

    def test_of_what_is_only_said_to_be_a_scan(self, caplog, room):
        found = self.line(caplog, AUTO.set(["point_segments.method=scan"]), room.points)
        assert found == "points: 6000, no scan of a LiDAR recognised; step 6 by method scan"

    def test_of_another_cloud(self, caplog, room):
        found = self.line(caplog, AUTO, room.points)
        assert found.startswith("points: 6000, spacing ")
        assert found.endswith(" neighbours, no colours (those of images are used, if any); step 6 by method learned")
        assert " mm, noise " in found

    def test_of_given_normals(self, caplog, room):
        normals = torch.nn.functional.normalize(room.points, dim=1)
        assert ", normals given, no colours" in self.line(caplog, AUTO, room.points, normals)

    def test_of_the_other_methods(self, caplog, room):
        assert self.line(caplog, tj.Config.from_preset("paper"), room.points) == "points: 6000; step 6 by method paper"


def test_the_command_line_prints_it(run, tmp_path, capsys, shared):
    scan_file, settings = shared / "data/kitti/training/velodyne/000001.bin", ["point_segments.method=auto"]
    settings.append("boundary.detector=gradient")
    run("segment", scan_file, "-o", tmp_path / "out", "--in-view", "--set", *settings)
    line = r"torchjoint: points: 18608 of a turning LiDAR with about 4\d rings \(certain\); step 6 by method scan\n"
    told = capsys.readouterr().err
    assert re.search(line, told)
    assert told.endswith(f"torchjoint: writing {tmp_path / 'out'}\n")
    assert not logging.getLogger("torchjoint").handlers


def test_the_bar_of_step_6_moves(capsys, monkeypatch, room):
    """Each copy of the cloud has two parts."""
    monkeypatch.setattr("torchjoint.joint.tqdm", partial(tqdm, mininterval=0, miniters=0))
    tj.JointSegmenter()(tj.Scene(room.points), progress=True)
    shown = capsys.readouterr().err
    assert all(f"points: {round(16.5 * part):3d}%" in shown for part in range(7))
    assert "points: 100%" in shown
