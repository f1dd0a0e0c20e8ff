"""masks.json: which segment each mask became, and what lies in masks."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from folder_files import write_folder

import torchjoint as tj
from torchjoint.cli.output import at_level
from torchjoint.datasets.files.ply import read_ply
from torchjoint.results.edits import Edit, Edits, write_edits
from torchjoint.results.exports.boxes import export_csv
from torchjoint.results.inputs import write_inputs
from torchjoint.results.manifest import manifest_checksum
from torchjoint.results.mask_report import count_masks, masked_segments, names_of_masks, select_masked
from torchjoint.results.parts import Parts, edited
from torchjoint.scene import LabelImages

EVERYTHING = tj.masks.from_stack(torch.ones(1, 120, 160, dtype=torch.bool))


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(0, num_points=6000)


def scene_with(synthetic, *masks):
    """The first frames of a scene, with masks."""
    frames = [replace(frame, masks=of) for frame, of in zip(synthetic.scene.frames, masks, strict=False)]
    return replace(synthetic.scene, frames=frames)


def report(tmp_path, scene, images, count=3):
    points = torch.arange(len(scene.points)) % count
    segmentation = tj.Segmentation(points, LabelImages(images), names=tuple("abcdef"[: len(images)]))
    write_inputs(tmp_path, scene, segmentation)
    return json.loads((tmp_path / "masks.json").read_text())


def test_by_hand(tmp_path, synthetic):
    labels = torch.full((120, 160), 2)
    labels[:60, :80] = 0
    labels[60:] = 3  # a segment of this image only
    stack = torch.zeros(2, 120, 160, dtype=torch.bool)
    stack[0, :60, :60] = True  # three quarters of segment 0
    stack[1, 50:, :] = True  # all of segment 3, and ten rows of 0 and 2
    masks = replace(tj.masks.from_stack(stack, [0.5, 1.0]), ids=(7, 9), names=("cup", "floor"))
    found = report(tmp_path, scene_with(synthetic, masks), [labels])
    assert found["frames"] == [
        {
            "name": "a",
            "masks": [
                {"id": 7, "name": "cup", "score": 0.5, "segment": 0, "iou": 0.75, "pixels": 3600},
                {"id": 9, "name": "floor", "score": 1.0, "segment": 3, "iou": 0.8571, "pixels": 11200},
            ],
        }
    ]
    assert names_of_masks(tmp_path) == {0: "cup", 3: "floor"}
    inside = (60 * 60 + 10 * 20) / 4800
    assert found["segments"] == [
        {"id": 0, "masked": round(inside, 4), "frames": 1, "names": {"cup": 0.5}},
        {"id": 2, "masked": round(10 / 60, 4), "frames": 0, "names": {}},
    ]
    assert count_masks(tmp_path) == (1, 1, 2)  # the floor has no segment in the cloud


def test_scores_decide_between_names(tmp_path, synthetic):
    stack = torch.zeros(3, 120, 160, dtype=torch.bool)
    stack[:, :60] = True  # a detector's doubles of one thing
    masks = replace(tj.masks.from_stack(stack, [0.3, 0.9, 0.4]), names=("cup", "mug", "cup"))
    labels = torch.ones(120, 160, dtype=torch.int64)
    labels[:60] = 0
    first, _ = report(tmp_path, scene_with(synthetic, masks, masks), [labels, labels])["segments"]
    assert (first["frames"], first["names"]) == (2, {"mug": 1.8, "cup": 1.4})
    assert names_of_masks(tmp_path)[0] == "mug"


def test_frames_without_masks_do_not_count(tmp_path, synthetic):
    labels = torch.zeros(120, 160, dtype=torch.int64)
    found = report(tmp_path, scene_with(synthetic, None, EVERYTHING), [labels, labels])
    assert [frame["name"] for frame in found["frames"]] == ["b"]
    assert found["segments"] == [{"id": 0, "masked": 1.0, "frames": 1, "names": {}}]


def test_a_mask_over_nothing_has_no_segment(tmp_path, synthetic):
    labels = torch.full((120, 160), -1)
    found = report(tmp_path, scene_with(synthetic, EVERYTHING), [labels])
    assert found["frames"][0]["masks"][0]["segment"] == -1
    assert found["segments"] == []


def test_without_masks_there_is_no_file(tmp_path, synthetic):
    write_inputs(tmp_path, synthetic.scene, tj.JointSegmenter()(synthetic.scene))
    assert not (tmp_path / "masks.json").exists()


@pytest.fixture(scope="module")
def thing(synthetic):
    counts = torch.stack([torch.bincount(one.flatten() + 1, minlength=40)[:40] for one in synthetic.image_labels])
    return int(counts.sum(0)[3:].argmax()) + 2


@pytest.fixture(scope="module")
def out(synthetic, thing, tmp_path_factory):
    from torchjoint.cli.main import main

    folder = tmp_path_factory.mktemp("masked")
    recording = write_folder(folder / "recording", synthetic, depth=False)
    for index, labels in enumerate(synthetic.image_labels):
        masks = tj.masks.from_stack((labels == thing)[None])
        tj.masks.save_masks(folder / "masks" / f"frame-{index * 5:06d}.npz", replace(masks, ids=(4,), names=("it",)))
    with pytest.MonkeyPatch.context() as patch:
        words = ["segment", recording, "-o", folder / "out", "--masks", folder / "masks"]
        patch.setattr("sys.argv", ["torchjoint", *map(str, words)])
        main()
    return folder / "out"


class TestARun:
    """The largest true thing that is no wall or floor is the only one with masks."""

    def test_the_thing_has_its_name(self, out, synthetic, thing):
        found = json.loads((out / "masks.json").read_text())
        named = [segment for segment in found["segments"] if segment["names"]]
        assert len(named) >= 1
        best = max(named, key=lambda segment: segment["frames"])
        own = tj.load_result(out).points == best["id"]
        true = synthetic.point_labels == thing
        assert float((own & true).sum() / (own | true).sum()) > 0.5
        assert {mask["id"] for frame in found["frames"] for mask in frame["masks"]} == {4}
        assert tj.load_result(out).segment_names == {segment["id"]: "it" for segment in named}
        listed = json.loads((out / "segments.json").read_text())["segments"]
        assert {one["id"]: one["name"] for one in listed if one["name"]} == {one["id"]: "it" for one in named}

    def test_finer_levels_only_inherit_names(self, out):
        loaded = tj.load_result(out)
        with pytest.warns(UserWarning, match="smaller things have the names of those that they are parts of"):
            assert set(at_level(out, loaded, 1.0).segment_names.values()) == {"it"}
        at_level(out, loaded, 0.0)  # without a warning

    def test_a_name_by_hand_counts_more(self, out, run, tmp_path):
        copy = shutil.copytree(out, tmp_path / "out")
        plain = tj.load_result(copy)
        (segment, *_), parts = plain.segment_names, Parts(plain)
        superpoints = tuple(np.flatnonzero(parts.stored == segment).tolist())
        for name, expected in (("sofa", "sofa"), ("", None)):
            write_edits(copy, Edits(parts.count, steps=(Edit("name", superpoints[:1], name),)))
            assert tj.load_result(copy).segment_names.get(segment) == expected
            run("export", copy, "--format", "csv", "-o", tmp_path / "a.csv", "--overwrite")
            assert (",sofa," in (tmp_path / "a.csv").read_text()) == (expected is not None)

    def test_a_thing_of_one_image_keeps_its_name(self, out):
        loaded = tj.load_result(out)
        alone, parts = loaded.num_point_segments, Parts(loaded)
        loaded = replace(loaded, segment_names={alone: "far"})
        steps = (Edit("name", (0,), "sofa"),)
        assert edited(loaded, Edits(parts.count, steps=steps)).segment_names == {0: "sofa", alone: "far"}
        last = edited(loaded, Edits(parts.count, steps=(Edit("split", (parts.largest(parts.of_point),)),)))
        for other in (last, loaded.at(0), loaded.at(1), last.at(1)):
            assert other.segment_names == {other.num_point_segments: "far"}

    def test_images_without_masks_show_nothing_masked(self, out):
        loaded = tj.load_result(out, edits=False)
        alone = torch.full_like(loaded.images[0], loaded.num_point_segments)
        for name, kept in ((loaded.names[0], True), ("other", False)):
            names, images = (name, *loaded.names[1:]), (alone, *loaded.images[1:])
            chosen = select_masked(out, replace(loaded, images=images, names=names))
            assert bool((chosen.images[0] == alone).all()) == kept

    def test_an_export_of_what_is_masked(self, out, run, tmp_path):
        kept = [s["id"] for s in json.loads((out / "masks.json").read_text())["segments"] if s["masked"] >= 0.5]
        run("export", out, "--format", "npz", "-o", tmp_path / "a.npz", "--only-masked")
        labels, sure = (np.load(tmp_path / "a.npz")[name] for name in ("labels", "confidence"))
        assert len(sure) == labels.max() + 1
        stored = tj.load_result(out, edits=False).points.numpy()
        assert (labels == np.where(np.isin(stored, kept), stored, -1)).all()
        run("export", out, "--format", "ply", "-o", tmp_path / "ply", "--only-masked")
        written = {int(file.stem.removesuffix("-it")): file for file in (tmp_path / "ply").glob("*.ply")}
        assert sorted(written) == kept
        assert any(file.stem.endswith("-it") for file in written.values())
        assert len(read_ply(written[kept[0]]).points) == (stored == kept[0]).sum()
        run("export", out, "--format", "coco", "-o", tmp_path / "a.json", "--only-masked")
        made = json.loads((tmp_path / "a.json").read_text())
        assert {one["id"] for one in made["categories"]} == {one["category_id"] for one in made["annotations"]}

    def test_boxes_of_what_is_masked_come_back(self, out, run, tmp_path, capsys):
        """What the file had left out counted as deleted, and joined other things: also beside one box drawn anew."""
        copy, file, full = shutil.copytree(out, tmp_path / "out"), tmp_path / "a.txt", tmp_path / "b.txt"
        run("export", copy, "--format", "openpcdet", "-o", file, "--only-masked")
        run("export", copy, "--format", "openpcdet", "-o", full)
        drawn, *others = sorted({*full.read_text().splitlines()} - {*file.read_text().splitlines()})
        for added in ("", f"{drawn}\n"):
            file.write_text(file.read_text() + added)
            run("edits", "import", copy, file)
            told = capsys.readouterr().out
            assert "joined to others: 0" in told
            assert f"had left them out): {len(others) + (not added)}\n" in told
        assert not (copy / "edits.json").exists()

    def test_boxes_of_what_is_masked_after_a_correction(self, out, run, tmp_path, capsys):
        """One masked thing that had joined another let all others join: their boxes counted as deleted."""
        copy, file = shutil.copytree(out, tmp_path / "out"), tmp_path / "a.json"
        stored, masked = tj.load_result(copy), masked_segments(copy)
        parts, other = Parts(stored), next(one for one in range(stored.num_point_segments) if one not in masked)
        ends = [int(parts.of_point[stored.points == one][0]) for one in (other, masked[0])]
        run("export", copy, "--format", "cvat", "-o", file, "--only-masked")
        write_edits(copy, Edits(parts.count, steps=(Edit("join", tuple(ends)),), of=manifest_checksum(copy)))
        run("edits", "import", copy, file)
        assert "joined to others: 0" in capsys.readouterr().out

    def test_what_is_kept_is_as_sure_as_before(self, out):
        loaded = tj.load_result(out, edits=False)
        chosen = select_masked(out, loaded)
        assert chosen.confidence is not None
        assert torch.equal(chosen.confidence, loaded.confidence[: chosen.num_point_segments])

    def test_names_are_those_of_the_run(self, out, run, tmp_path):
        """Masks of another result would put names on other things; half a character cannot be written."""
        copy = shutil.copytree(out, tmp_path / "out")
        text = (copy / "masks.json").read_text()
        (copy / "masks.json").write_text(text.replace('"it"', '"h\\ud800"'))
        with pytest.raises(ValueError, match=r"masks\.json: expected the file that the run wrote"):
            tj.load_result(copy)
        loaded = tj.load_result(copy, verify=False)
        assert set(loaded.segment_names.values()) == {"h\\ud800"}
        export_csv(tmp_path / "a.csv", loaded)

    def test_errors(self, out, run, tmp_path):
        with pytest.raises(SystemExit, match="--only-masked: expected no --granularity"):
            run("export", out, "--format", "npz", "--only-masked", "--granularity", 0.5)
        other = tmp_path / "other"
        other.mkdir()
        for name in ("points.npz", "run.yaml"):
            (other / name).write_bytes((out / name).read_bytes())
        (other / "masks.json").write_text('{"frames": [], "segments": [{"id": 100000, "masked": 1}]}')
        with pytest.raises(ValueError, match=r"masks\.json: not the masks of this result"):
            select_masked(other, tj.load_result(out))
        (other / "masks.json").write_text('{"frames": [], "segments": [{"id": 0, "masked": 0.4}]}')
        with pytest.raises(ValueError, match=r"masks\.json: no segment lies in masks with half of its pixels"):
            select_masked(other, tj.load_result(out))
        (other / "masks.json").unlink()
        with pytest.raises(FileNotFoundError, match="expected a result of a recording with masks"):
            select_masked(other, tj.load_result(out))
