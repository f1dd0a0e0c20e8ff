"""A result that others can use: read back with its frames, measured, cropped, exported."""

import dataclasses
import json
import pickle
import shutil

import numpy as np
import pytest
import torch
from PIL import Image

import torchjoint as tj
from torchjoint.results import folder
from torchjoint.results.edits import Edit, Edits, write_edits
from torchjoint.results.exports import SUFFIXES
from torchjoint.results.exports.clouds import export_las
from torchjoint.results.figures import overlay, overview
from torchjoint.results.folder import read_granularity, write_result
from torchjoint.results.objects import oriented_box
from torchjoint.results.render import label_colors
from torchjoint.results.upright import fitted, up_direction
from torchjoint.runtime.archives import read_archive

GRADIENT = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


@pytest.fixture(scope="module")
def result(scene):
    return tj.Result.of(tj.JointSegmenter(GRADIENT)(scene), scene, GRADIENT)


@pytest.fixture(scope="module")
def out(scene, result, tmp_path_factory):
    folder = tmp_path_factory.mktemp("result") / "out"
    folder.mkdir()
    write_result(folder, scene, result, GRADIENT, "test")
    return folder


def test_results_can_be_sent_to_other_processes(result, out):
    for one in (result, tj.load_result(out)):
        sent = pickle.loads(pickle.dumps(one))
        for level in (0.2, 0.5):
            there, here = sent.at(level), one.at(level)
            assert torch.equal(there.points, here.points)
            assert all(map(torch.equal, there.images, here.images))
        assert torch.equal(sent.scene.frames[1].image, one.scene.frames[1].image)


def test_a_result_is_read_back(out, scene, result):
    read = tj.load_result(str(out))
    assert torch.equal(read.points, result.points)
    assert torch.equal(read.scene.points, scene.points)
    assert torch.equal(read.scene.colors, scene.colors)
    assert read.config == GRADIENT
    assert read.names == result.names
    for got, expected in zip(read.scene.frames, scene.frames, strict=True):
        assert torch.equal(got.intrinsics, expected.intrinsics)
        assert torch.equal(got.world_to_camera, expected.world_to_camera)
        assert (got.image - expected.image).abs().mean() < 0.02  # as JPEG keeps it
    coarse = read.at(0.2)
    assert isinstance(coarse, tj.Result)
    assert coarse.num_point_segments < read.num_point_segments


def test_points_are_read_once(out, monkeypatch):
    read = []
    monkeypatch.setattr(folder, "read_archive", lambda file: read.append(file.name) or read_archive(file))
    tj.load_result(out)
    assert read == ["points.npz"]


@pytest.mark.parametrize("segment", [0.5, "0", None])
def test_an_id_that_is_none(result, segment):
    for what in (result.crops, result.cloud):
        with pytest.raises(TypeError, match="segment: expected an id, an integer, got "):
            what(segment)
    assert len(result.cloud(np.int64(0)).points) == len(result.cloud(0).points)


def test_an_id_without_points(result):
    """Corrections by hand may leave gaps between ids."""
    gap = result.num_point_segments
    changed = dataclasses.replace(result, points=torch.where(result.points == 0, gap + 1, result.points))
    for what in (changed.crops, changed.cloud):
        for segment in (0, gap, gap + 2, 2**70, -1):
            with pytest.raises(ValueError, match=rf"segment: expected an id of .*, got {segment}: no point has it"):
                what(segment)
    assert len(changed.cloud(gap + 1).points) == len(result.cloud(0).points)


def test_a_result_without_cameras_has_no_frames(out, tmp_path):
    for name in ("points.npz", "run.yaml"):
        (tmp_path / name).write_bytes((out / name).read_bytes())
    assert len(tj.load_result(tmp_path, verify=False).scene.frames) == 0
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "other.png").write_bytes(next((out / "images").iterdir()).read_bytes())
    (tmp_path / "cameras.json").write_bytes((out / "cameras.json").read_bytes())
    with pytest.raises(ValueError, match=r"cameras\.json: not the cameras of these images: KeyError\('other'\)"):
        tj.load_result(tmp_path, verify=False)


def test_segments_json_says_what_is_in_the_labels(out, scene, result):
    record = json.loads((out / "segments.json").read_text())
    assert len(record["segments"]) == result.num_point_segments
    assert record["units"] == "those of the cloud"  # a survey may be in feet
    for segment in record["segments"]:
        mask = result.points == segment["id"]
        assert segment["points"] == int(mask.sum())
        np.testing.assert_allclose(segment["center"], scene.points[mask].double().mean(0), atol=1e-5)
        np.testing.assert_allclose(segment["color"], scene.colors[mask].double().mean(0), atol=1e-4)
        inside = (scene.points[mask].double().numpy() - segment["box"]["center"]) @ np.array(segment["box"]["axes"]).T
        np.testing.assert_allclose(np.abs(inside).max(0), np.array(segment["box"]["size"]) / 2, atol=1e-4)
        seen = {view["name"]: view for view in segment["frames"]}
        for name, labels in zip(result.names, result.images, strict=True):
            rows, columns = torch.nonzero(labels == segment["id"], as_tuple=True)
            assert (len(rows) > 0) == (name in seen)
            if len(rows):
                x, y = int(columns.min()), int(rows.min())
                box = [x, y, int(columns.max()) - x + 1, int(rows.max()) - y + 1]
                assert seen[name] == {"name": name, "pixels": len(rows), "box": box}


def test_overlays_can_be_looked_at(out, result):
    painted = np.array(Image.open(out / "images_color" / f"{result.names[0]}.jpg"))
    assert painted.shape == (120, 160, 3)
    assert painted.std() > 20  # not black
    one = overlay(torch.full((1, 4, 3), 128, dtype=torch.uint8), torch.tensor([[-1, -1, 0, 0]]), 1)
    assert one[0, 0].tolist() == [128] * 3
    assert one[0, 1].tolist() == [255] * 3  # the border
    color = (255 * label_colors(torch.tensor([0]), 1)).round()
    assert one[0, 2].tolist() == ((128 + color[0]) // 2).tolist()


def test_colors_of_images_are_of_their_labels():
    labels = torch.arange(-2, 6).repeat(3, 1)  # more pixels than labels: as in an image
    for label, color in zip(labels[0], label_colors(labels, 3)[1], strict=True):
        assert torch.equal(color, label_colors(label.view(1), 3)[0])


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.3])
def test_boxes_are_small_and_upright(turn):
    rng = np.random.default_rng(0)
    size = np.array([2.0, 0.5, 1.0])
    turned = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T / 2
    points = (np.concatenate([corners, rng.uniform(-0.5, 0.5, (50, 3))]) * size) @ turned + [5.0, 6.0, 7.0]
    box = oriented_box(points, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(box.size, size, atol=1e-5)
    np.testing.assert_allclose(box.center, [5, 6, 7], atol=1e-5)
    np.testing.assert_allclose(np.abs(box.axes @ turned.T), np.eye(3), atol=1e-5)


@pytest.mark.parametrize("points", [[[1.0, 2, 3]], [[0.0, 0, 0], [1, 1, 0]], [[0.0, 0, 0], [0, 0, 2]]])
def test_boxes_of_few_points(points):
    box = oriented_box(np.array(points), np.array([0.0, 0.0, 1.0]))
    assert np.isfinite(box.axes).all()
    np.testing.assert_allclose(box.axes @ box.axes.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(box.size.max(), np.ptp(points, axis=0).max() if box.size[2] else box.size[0], atol=1e-6)


@pytest.mark.parametrize("density", [1, 20])  # 20: so many points that only some are looked at
def test_boxes_have_thin_legs_and_no_flying_points(density):
    random = np.random.default_rng(0).uniform
    top, leg = (
        random((0, 0, 0.7), (1.2, 0.6, 0.72), (3000 * density, 3)),
        random(0, (0.03, 0.03, 0.7), (60 * density, 3)),
    )
    flying = np.concatenate([top, leg, random((2, 0, 0.7), (2.3, 0.2, 0.9), (200 * density, 3))])
    for up in np.eye(3):
        size = oriented_box(np.concatenate([top, leg]), up).size
        np.testing.assert_allclose(np.sort(size), [0.6, 0.71, 1.2], atol=0.02)
        np.testing.assert_allclose(oriented_box(flying, up).size, size, atol=0.02)


def test_up_is_against_gravity_in_any_world_frame(scene):
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
    turn = turn * turn.det()
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = turn.T
    frames = [tj.Frame(f.image, f.intrinsics, f.world_to_camera @ pose) for f in scene.frames]
    for chosen in (frames, frames[:1]):  # one camera, which looks down: only the floor says how far
        turned = tj.Scene((scene.points.double() @ turn.T).float(), chosen)
        assert float(up_direction(turned) @ (turn @ torch.tensor([0.0, 0, 1], dtype=torch.float64))) > 0.999
    leaning = scene.points @ torch.tensor([[0.99, 0, -0.14], [0, 1, 0], [0.14, 0, 0.99]])
    assert up_direction(tj.Scene(leaning)).tolist() == [0, 0, 1]  # without cameras


@pytest.mark.parametrize(("turns", "degrees"), [((0, 0, 0, 0), 35), ((0, 1, 2, 3), 54)])
def test_a_room_is_seen_from_higher_than_one_wall(turns, degrees):
    """Cameras that look around stand in a room; a wall would hide it from below."""
    frames = []
    for turn in turns:
        pose = torch.eye(4, dtype=torch.float64)  # y down: -y is up
        pose[:3, :3] = torch.linalg.matrix_power(torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).double(), turn)
        frames.append(tj.Frame(torch.zeros(3, 4, 4), torch.eye(3), pose))
    scene = tj.Scene(torch.rand(50, 3, generator=torch.Generator().manual_seed(0)), frames)
    view = fitted(scene, np.array([0.0, -1, 0]), 0.8, 1.5)
    away = view.position - view.target
    assert np.degrees(np.arcsin(-away[1] / np.linalg.norm(away))) == pytest.approx(degrees, abs=1)


@pytest.mark.parametrize(("turns", "aspect"), [((0,), 0.5), ((0, 1, 2, 3), 0.5), ((0, 1, 2, 3), 1.5), ((1, 3), 1.5)])
def test_a_long_cloud_lies_as_the_picture_does(turns, aspect):
    """In portrait it is seen along, in landscape across, unless the cameras tell; all of it is in the picture."""
    frames = []
    for turn in turns:
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = torch.linalg.matrix_power(torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).double(), turn)
        frames.append(tj.Frame(torch.zeros(3, 4, 4), torch.eye(3), pose))
    points = torch.rand(9000, 3, generator=torch.Generator().manual_seed(0))
    for sides in ([4.0, 1, 1], [1.0, 1, 4]):
        scene = tj.Scene(points * torch.tensor(sides), frames if sides[0] > 1 or len(turns) > 1 else ())
        view = fitted(scene, np.array([0.0, -1, 0]), 0.8, aspect)
        seen = (scene.points.double().numpy() - view.position) @ view.axes.T
        shares = seen[:, :2] / seen[:, 2:] / np.tan(0.4) / [aspect, 1]
        assert (np.abs(shares) < 1).all(1).mean() > 0.996
        assert np.ptp(shares, axis=0).max() > 1.7
        wide, high = np.ptp(shares, axis=0) * [aspect, 1]
        assert (wide > high) == (aspect > 1)


def test_the_first_view_of_a_scan_leaves_far_points_out():
    """Half of a scan is within 10 m, and few of its points reach 200 m: what is near would be small."""
    random = np.random.default_rng(0)
    distance, turn = 10 * random.pareto(1.0, 5000).clip(0, 20), random.uniform(0, 2 * np.pi, 5000)
    scan = np.stack([distance * np.cos(turn), distance * np.sin(turn), random.uniform(0, 2, 5000)], 1)
    view = fitted(tj.Scene(torch.from_numpy(scan)), np.array([0.0, 0, 1]), 0.8, 1.5)
    seen = (scan - view.position) @ view.axes.T
    shares = np.abs(seen[:, :2] / seen[:, 2:] / np.tan(0.4) / [1.5, 1]).max(1)
    assert (shares < 1).mean() > 0.85
    assert np.linalg.norm(view.position - view.target) < 250  # m; with all points in the picture: 414


class TestCrops:
    def test_best_first(self, result):
        seen = max(result.records(), key=lambda record: len(record.views))
        crops = result.crops(seen.id, k=2)
        assert len(crops) == 2
        values = [crop.pixels * crop.whole**2 for crop in crops]
        assert values[0] >= values[1] > 0
        for crop in crops:
            x, y, width, height = crop.box
            assert crop.name == result.names[crop.frame]
            assert torch.equal(crop.mask, result.images[crop.frame][y : y + height, x : x + width] == seen.id)
            assert int(crop.mask.sum()) == crop.pixels
            image = result.scene.frames[crop.frame].image
            assert torch.equal(crop.image, image[:, y : y + height, x : x + width])
        assert len(result.crops(seen.id, k=99)) == len(seen.views)

    def test_the_whole_object_is_better_than_half_of_it(self):
        intrinsics = torch.tensor([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]], dtype=torch.float64)
        points = torch.tensor([[x / 4, 0.0, 2.0] for x in range(-2, 3)])
        aside = torch.eye(4, dtype=torch.float64)
        aside[0, 3] = 1.1  # two of five points are inside
        frames = [tj.Frame(torch.zeros(3, 11, 11), intrinsics, pose) for pose in (aside, torch.eye(4).double())]
        images = [torch.zeros(11, 11, dtype=torch.int64), torch.full((11, 11), -1)]
        images[1][4:9, 4:9] = 0
        labels = torch.zeros(5, dtype=torch.int64)
        result = tj.Result.of(tj.Segmentation(labels, images, names=("half", "whole")), tj.Scene(points, frames))
        assert [crop.name for crop in result.crops(0)] == ["whole", "half"]
        assert result.crops(0, margin=0.2)[0].box == (3, 3, 7, 7)

    @pytest.mark.parametrize(("arguments", "message"), [((-1,), "segment: expected an id"), ((0, 0), "k >= 1")])
    def test_errors(self, result, arguments, message):
        with pytest.raises(ValueError, match=message):
            result.crops(*arguments)

    def test_another_scene(self, result):
        with pytest.raises(ValueError, match="scene: expected 3000 points and 6 frames, got 3 and 0"):
            tj.Result.of(result, tj.Scene(torch.rand(3, 3)))

    def test_points_or_frames_in_another_order(self, result):
        scene = result.scene
        with pytest.raises(ValueError, match="points that were segmented, in their order and dtype, got others"):
            tj.Result.of(result, scene.select_points(torch.arange(3000).roll(1)))
        with pytest.raises(ValueError, match=r"expected frame 'frame-000000', got 'frame-000005'; of another order"):
            tj.Result.of(result, scene.select_frames(range(5, -1, -1)))
        assert tj.Result.of(result.at(0.9), tj.Scene(scene.points.double(), scene.frames)).names == result.names


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools about itself
class TestExports:
    @pytest.fixture
    def export(self, run, out, tmp_path):
        def command(kind, *arguments):
            target = tmp_path / f"export{SUFFIXES.get(kind, '')}"
            run("export", out, "--format", kind, "-o", target, *arguments)
            return target

        return command

    def test_coco(self, export, result):
        coco = pytest.importorskip("pycocotools.coco")
        read = coco.COCO(export("coco"))
        assert read.cats[1]["name"] == "thing"  # what has no name, as in exports of boxes
        for image_id, labels in enumerate(result.images, 1):
            drawn = torch.full_like(labels, -1)
            for annotation in read.loadAnns(read.getAnnIds(imgIds=image_id)):
                mask = torch.from_numpy(read.annToMask(annotation)).bool()
                assert annotation["area"] == int(mask.sum())
                assert annotation["in_cloud"] == (annotation["segment_id"] < result.num_point_segments)
                drawn[mask] = annotation["segment_id"]
                if annotation["in_cloud"]:
                    sure = float(result.confidence[annotation["segment_id"]])
                    assert annotation["score"] == pytest.approx(sure, abs=1e-4)
            assert torch.equal(drawn, labels)

    def test_sam(self, export, result):
        coder = pytest.importorskip("pycocotools.mask")
        record = json.loads((export("sam") / f"{result.names[1]}.json").read_text())
        drawn = np.full((120, 160), -1)
        for annotation in record["annotations"]:
            drawn[coder.decode(annotation["segmentation"]).astype(bool)] = annotation["id"]
            assert annotation["bbox"] == coder.toBbox(annotation["segmentation"]).tolist()
        np.testing.assert_array_equal(drawn, result.images[1])

    def test_las(self, export, result):
        cloud = pytest.importorskip("laspy").read(export("las"))
        np.testing.assert_allclose(cloud.xyz, result.scene.points, atol=1e-4)
        np.testing.assert_array_equal(cloud["label"], result.points)
        np.testing.assert_allclose(cloud["confidence"], result.point_confidence, atol=1e-6)
        np.testing.assert_allclose(np.array(cloud.green) / 65535, result.scene.colors[:, 1], atol=1e-4)

    def test_las_of_a_large_area(self, tmp_path):
        laspy = pytest.importorskip("laspy")
        points = torch.tensor([[-1e5, 0, 0], [2e5, 1, 1]], dtype=torch.float64)
        with pytest.warns(UserWarning, match=r"rounded to 0\.001 m"):
            export_las(tmp_path / "a.las", tj.Result.of(tj.Segmentation(torch.arange(2), ()), tj.Scene(points)))
        np.testing.assert_allclose(laspy.read(tmp_path / "a.las").xyz, points, atol=1e-3)

    def test_npz_of_another_level(self, export, result):
        with np.load(export("npz", "--granularity", 0.2)) as arrays:
            np.testing.assert_array_equal(arrays["labels"], result.at(0.2).points)
            np.testing.assert_array_equal(arrays["confidence"], result.at(0.2).confidence)
            np.testing.assert_array_equal(arrays["point_confidence"], result.at(0.2).point_confidence)
            for name, labels in zip(result.names, result.at(0.2).images, strict=True):
                np.testing.assert_array_equal(arrays[f"image:{name}"], labels)

    def test_another_level_tells_that_it_has_no_joins(self, export, out, result):
        write_edits(out, Edits(result.hierarchy.num_superpoints, None, (Edit("name", (0,), "cup"),)))
        try:
            with pytest.warns(UserWarning, match=r"edits\.json: --granularity .* without joins and splits; names stay"):
                export("npz", "--granularity", 0.2)
            with np.load(export("npz", "--overwrite")) as arrays:
                assert arrays["segment_names"].tolist() == ["cup"] + [""] * (result.num_point_segments - 1)
        finally:
            (out / "edits.json").unlink()

    def test_ply_is_replaced_but_nothing_else(self, export, result):
        folder = export("ply")
        assert len(list(folder.glob("*.ply"))) == result.num_point_segments
        with pytest.raises(SystemExit, match="exists already"):
            export("ply")
        export("ply", "--overwrite")
        (folder / "thesis.tex").write_text("precious")
        with pytest.raises(SystemExit, match=r"holds more than \.ply files"):
            export("ply", "--overwrite")
        assert (folder / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize(
    ("kind", "mine"),
    [
        ("ply", "scan.ply"),
        ("ply", "20240512_site.ply"),
        ("ply", "000000.ply"),
        ("scannet", "predicted_masks/room_001.txt"),
        ("scannet", "notes.txt"),
        ("scannet", "predicted_masks/thesis.txt"),
        ("sam", "mine.json"),
    ],
)
def test_files_of_the_same_kind_are_not_replaced(run, out, tmp_path, kind, mine):
    if kind == "sam":
        pytest.importorskip("pycocotools")
    for more in ([], ["--overwrite"]):
        run("export", out, "--format", kind, "-o", tmp_path / "a", *more)
    (tmp_path / "a" / mine).write_text("precious")
    with pytest.raises(SystemExit, match=r"holds more than \.\w+ files of an export"):
        run("export", out, "--format", kind, "-o", tmp_path / "a", "--overwrite")
    assert (tmp_path / "a" / mine).read_text() == "precious"


def test_names_at_other_levels():
    """A part of a cup is a cup; a cup and a box together have no name."""
    superpoint, merges = torch.tensor([0, 0, 1, 2]), torch.tensor([[0, 1], [0, 2]])
    hierarchy = tj.Hierarchy(superpoint, merges, torch.tensor([0.3, 0.7], dtype=torch.float64))
    result = tj.Result.of(tj.Segmentation(hierarchy.at(), (), hierarchy=hierarchy), tj.Scene(torch.rand(4, 3)))
    named = dataclasses.replace(result, segment_names={0: "cup", 1: "box"})
    assert named.at(1.0).segment_names == {0: "cup", 1: "cup", 2: "box"}
    assert named.at(0.5).segment_names == {0: "cup", 1: "box"}
    assert named.at(0.0).segment_names == {}
    assert named.at(1.0).at(0.5).segment_names == {0: "cup", 1: "box"}
    handle = dataclasses.replace(named.at(1.0), segment_names={1: "handle"})
    assert handle.at(0.5).segment_names == {}
    body = dataclasses.replace(named.at(1.0), segment_names={0: "body"})
    assert body.at(0.5).segment_names == {0: "body"}


def test_all_of_a_result_that_was_read_is_saved(out, tmp_path, monkeypatch):
    """That of frames was an error; vectors were lost; the level was told as .5."""
    monkeypatch.setattr("torchjoint.results.folder.overview", overview)
    shutil.copytree(out, tmp_path / "out")
    tj.load_result(tmp_path / "out").embed(lambda crops: crops.mean((2, 3)), size=8).save(tmp_path / "out")
    read = tj.load_result(tmp_path / "out").at(0.7)
    read.save(tmp_path / "again")
    again = tj.load_result(tmp_path / "again")
    assert torch.equal(again.points, read.points)
    assert torch.equal(again.embeddings.vectors, read.embeddings.vectors)
    assert torch.equal(again.at(read_granularity(tmp_path / "again")).points, read.points)
    plain = tj.Segmentation(read.points, list(read.images))
    assert tj.Result.of(plain, read.scene).names == read.names
    gap = tj.Result.of(tj.Segmentation(2 * (read.points > 0), ()), tj.Scene(read.scene.points))
    dataclasses.replace(gap, segment_names={1: "of no point", 2: "cup"}).save(tmp_path / "gap")
    assert tj.load_result(tmp_path / "gap").segment_names == {2: "cup"}
    frames = [dataclasses.replace(one, name="") for one in read.scene.frames]  # as of a program's own tensors
    tj.Result.of(plain, dataclasses.replace(read.scene, frames=frames)).save(tmp_path / "unnamed")
    unnamed = tj.load_result(tmp_path / "unnamed")
    assert unnamed.names == tuple(f"{index:06d}" for index in range(len(frames)))
    assert all(torch.equal(one, image) for one, image in zip(unnamed.images, read.images, strict=True))
    far = tj.Result.of(tj.Segmentation(1000 * read.points, ()), tj.Scene(read.scene.points))
    with pytest.raises(ValueError, match=r"points\.npz: not a whole result: labels: expected 0 to"):
        far.save(tmp_path / "far")
    other = dataclasses.replace(read, points=torch.cat([read.points[:-1], read.points[:1]]))
    with pytest.raises(ValueError, match="expected superpoints inside one segment"):
        other.save(tmp_path / "far")
    with pytest.raises(TypeError, match="segment_names: expected texts by ids, got '2': 'cup'"):
        dataclasses.replace(gap, segment_names={"2": "cup"}).save(tmp_path / "far")
    assert not [*tmp_path.glob("*far*")]
    with pytest.raises(ValueError, match="outside of the parts of a result"):
        read.save(tmp_path / "out" / "images" / "more.png")


def test_a_result_of_a_program_is_saved(scene, result, tmp_path):
    """Only the command line could write one."""
    at_level = tj.Result.of(result, scene, tj.Config()).at(0.7)
    named = dataclasses.replace(at_level, segment_names={0: "thing", 10**6: "of an image", -1: "of none"})
    named.save(tmp_path / "out")
    stored = tj.load_result(tmp_path / "out")
    assert torch.equal(stored.points, named.points)
    assert all(map(torch.equal, stored.images, named.images))
    assert torch.equal(stored.hierarchy.heights, named.hierarchy.heights)
    assert (stored.segment_names, stored.config) == ({0: "thing"}, tj.Config())
    assert len(stored.scene.frames) == len(scene.frames)
    assert [one.name for one in stored.records()[:2]] == ["thing", ""]
    with pytest.raises(FileExistsError, match="exists already"):
        named.save(tmp_path / "out")
    named.save(tmp_path / "out", overwrite=True)  # its names are no corrections by hand
    tj.Result.of(tj.Segmentation(torch.zeros(len(scene.points), dtype=torch.int64), ()), scene).save(
        tmp_path / "out", overwrite=True
    )
    again = tj.load_result(tmp_path / "out")
    assert (again.num_point_segments, len(again.images), again.segment_names) == (1, 0, {})
    again.save(tmp_path / "copy")  # of what was read
    assert torch.equal(tj.load_result(tmp_path / "copy").points, again.points)


def test_labels_of_other_points_or_frames_are_not_saved(scene, result, tmp_path):
    """`replace(result, scene=...)` saved the labels beside points in another order."""
    own, order = tj.Result.of(result, scene), torch.arange(len(scene.points)).flip(0)
    turned = dataclasses.replace(scene, frames=[*scene.frames][::-1])
    for other in (scene.select_points(order), scene.select_points(order > 9), turned):
        with pytest.raises(ValueError, match="scene: expected"):
            dataclasses.replace(own, scene=other).save(tmp_path / "out")
    assert not [*tmp_path.iterdir()]
