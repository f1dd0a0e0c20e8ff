"""`torchjoint-lab real`: scores against a truth of some things, the sets, resuming, rivals, the table, the picture."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from PIL import Image
from samples.folder import write
from torchjoint_lab.benchmark.real import report, worst_scenes
from torchjoint_lab.benchmark.real_scenes import MASKS, RealScene, find_real_scenes, read_plain, with_masks
from torchjoint_lab.evaluation.partial_truth import PartialTruth, judge

import torchjoint as tj


def truth_of(*values):
    """A truth as files write it: -1 void, -2 no thing."""
    label = torch.tensor(values)
    return PartialTruth(label.clamp(min=-1), label == -2)


class TestPartialTruth:
    def test_void_never_counts_and_other_counts_where_it_leaks(self):
        truth = truth_of(0, 0, 1, 1, -1, -2, -2)
        exact = judge(torch.tensor([0, 0, 1, 1, 1, 2, 2]), truth)
        assert exact == (1.0, 1.0, 1.0)
        leaking = judge(torch.tensor([0, 0, 1, 1, 1, 1, 1]), truth)
        assert leaking.best_iou == pytest.approx((1 + 2 / 4) / 2)
        assert leaking.found == 0.5  # not above .5

    def test_a_point_in_no_segment_is_in_none(self):
        assert judge(torch.tensor([-1, -1, 1, 1]), truth_of(0, 0, 1, 1)).best_iou == 0.5

    def test_segments_of_no_thing_are_not_judged(self):
        truth = truth_of(0, 0, 0, 0, *[-2] * 6)
        assert judge(torch.tensor([0, 0, 0, 0, 1, 1, 2, 2, 3, 4]), truth).f == 1

    def test_it_is_the_usual_score_if_all_is_known(self):
        generator = torch.Generator().manual_seed(0)
        truth, found = torch.randint(5, (2, 300), generator=generator)
        score = judge(found, PartialTruth(truth, torch.zeros(300, dtype=torch.bool)))
        assert score.f == pytest.approx(tj.metrics.objects_and_parts(found, truth).f)
        assert score.best_iou == pytest.approx(tj.metrics.mean_best_iou(found, truth))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A shelf of two frames, whose truth has void points and points of no thing."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "real" / "shelf").mkdir(parents=True)
    shelf = write(folder / "real" / "shelf")
    label = np.load(shelf / "cloud.truth.npy").astype(np.int64)
    label[:3], label[3:5] = -1, -2
    np.save(shelf / "cloud.truth.npy", label)
    for file in shelf.glob("*.truth.png"):
        pixels = np.array(Image.open(file)).astype(np.uint16) - 1
        pixels[0, :4], pixels[0, 4:8] = 65535, 65534
        Image.fromarray(pixels).save(file)
    return folder


class TestScenes:
    def test_a_plain_folder_with_points_of_no_thing(self, data):
        scene, truth = read_plain(data / "real" / "shelf")
        assert truth.instance[:6].tolist()[:5] == [-1] * 5
        assert truth.other.nonzero().flatten().tolist() == [3, 4]
        assert scene.truth.images[0][0].tolist() == [-1] * 8 + [0] * (scene.frames[0].size[1] - 8)

    def test_a_plain_folder_without_images(self, data, tmp_path):
        for name in ("cloud.ply", "cloud.truth.npy", "camera-intrinsics.txt"):
            shutil.copy(data / "real" / "shelf" / name, tmp_path)
        assert not len(read_plain(tmp_path).scene.frames)

    def test_masks_for_the_shelf(self, data):
        plain, *masked = find_real_scenes(data)
        assert plain == RealScene("shelf", "shelf-shelf", plain.load)
        assert [one.masks for one in masked] == list(MASKS)
        frame = with_masks(plain.load(), "perfect masks", 0).frames[0]
        assert len(frame.masks) == 2

    @pytest.mark.filterwarnings("ignore:.*are no stronger at the borders of masks")  # the glue is white before white
    def test_masks_of_one_thing_leave_the_others_whole(self, shared):
        """Not where images with masks have no other segments (.62)."""
        scene, truth = read_plain(shared / "data" / "real" / "shelf")
        images = zip(scene.frames, scene.truth.images, strict=True)
        frames = [dataclasses.replace(frame, masks=torch.as_tensor(image) == 19) for frame, image in images]
        found = tj.JointSegmenter()(dataclasses.replace(scene, frames=frames, truth=None)).points
        assert judge(found, truth).best_iou > 0.75

    @pytest.mark.parametrize(("sets", "message"), [(("shelves",), "--sets"), (("tote",), "tote was not found")])
    def test_wrong_sets(self, data, sets, message):
        with pytest.raises(ValueError, match=message):
            find_real_scenes(data, sets)

    def test_wrong_data(self, data, tmp_path):
        with pytest.raises(ValueError, match=r"--data: .* is not a folder"):
            find_real_scenes(data / "nothing")
        with pytest.raises(ValueError, match="has none of shelf, tote"):
            find_real_scenes(tmp_path)


@pytest.fixture(scope="module")
def out(data, run_lab, tmp_path_factory):
    """What the command wrote."""
    out = tmp_path_factory.mktemp("out") / "real"
    run_lab("real", "--data", data, "-o", out, "--runs", 2, "--rivals", 1)
    return out


class TestCommand:
    def test_it_fills_the_table_and_draws_the_worst(self, out):
        table = (out / "table.md").read_text()
        rows = [line.split("|")[1].strip() for line in table.splitlines()[2:]]
        means = ["**mean of the sets without LiDAR**", "**mean with masks**"]
        assert rows == ["shelf, 1", *(f"shelf, {masks}, 1" for masks in MASKS), *means]
        assert table.splitlines()[2].split("|")[3].strip().endswith(")")  # the rival's name
        with Image.open(out / "worst.jpg") as picture:
            assert picture.size[0] > 300

    def test_runs_have_scores_and_a_covering(self, out):
        first, second = (json.loads((out / "runs" / f"shelf-shelf.{run}.json").read_text()) for run in range(2))
        assert set(first) == {"f", "best_iou"}  # no thing has the 100 points of AP50
        assert set(second) == {"f", "best_iou", "covering"}
        assert all(0 <= value <= 1 for value in second.values())

    def test_it_goes_on_where_it_was(self, data, out, run_lab, monkeypatch):
        before = (out / "table.md").read_text()
        (out / "runs" / "shelf-shelf.1.json").unlink()
        segmented = []
        segment = tj.JointSegmenter.reset
        monkeypatch.setattr(tj.JointSegmenter, "reset", lambda self, *a: segmented.append(segment(self, *a)))
        run_lab("real", "--data", data, "-o", out, "--runs", 2, "--rivals", 1)
        assert len(segmented) == 1
        assert (out / "table.md").read_text() == before

    @pytest.mark.parametrize("name", ["table.md", "worst.jpg"])
    def test_files_of_no_earlier_start_stay(self, data, run_lab, tmp_path, name):
        (tmp_path / name).write_text("mine")
        with pytest.raises(SystemExit, match="exists already; choose another name with -o, or --overwrite"):
            run_lab("real", "--data", data, "-o", tmp_path, "--runs", 1)
        assert (tmp_path / name).read_text() == "mine"


def test_table_and_worst_scene_by_hand():
    scenes = [RealScene(*names, load=None) for names in (("rio", "rio-a"), ("rio", "rio-b"), ("kitti", "kitti-a"))]
    values = [(0.5, 0.7), (0.4, 0.6), (0.8, 0.9)]
    results = {
        one: [{"f": f, "best_iou": f, "ap50": f} for f in pair] for one, pair in zip(scenes, values, strict=True)
    }
    lines = report(results, {}).splitlines()
    # the mean of both scenes in each run is .45 and .65
    assert lines[2].split("|")[2].strip() == " / ".join(["0.550 ± 0.141"] * 3)
    assert "mean of the sets without LiDAR" in lines[4]
    assert "mean of LiDAR" in lines[5]
    assert [one.name for one in worst_scenes(results)] == ["rio-b", "kitti-a"]
