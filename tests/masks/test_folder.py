"""A folder of masks and a scene: matched by name in every data set, with a report of what has no match."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import samples
import torch
from folder_files import write_folder
from PIL import Image

import torchjoint as tj
from torchjoint.masks.folder import check_files, frame_names
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene.frame import PoseDoubt

SIZE = 6, 8


def scene_of(*names):
    camera = {"intrinsics": torch.eye(3), "world_to_camera": torch.eye(4)}
    labels = torch.zeros(SIZE, dtype=torch.int64)
    return tj.Scene(torch.rand(5, 3), [tj.Frame(torch.rand(3, *SIZE), **camera, name=n, labels=labels) for n in names])


def write_labels(path, size=SIZE, value=1):
    path.parent.mkdir(parents=True, exist_ok=True)
    labels = np.zeros(size, dtype=np.uint8)
    labels[:, : size[1] // 2] = value
    Image.fromarray(labels).save(path)


@pytest.mark.parametrize(
    "name", [name for name in samples.FORMATS if samples.format_of(name) not in samples.WITHOUT_IMAGES]
)
def test_frames_of_every_data_set_get_the_masks_of_their_name(tmp_path, name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = tj.load_scene(samples.write(name, tmp_path / "sample"))
    names = [frame.name for frame in scene.frames]
    assert frame_names(scene.frames) == names
    for index, frame in enumerate(scene.frames):
        write_labels(tmp_path / "masks" / f"{frame.name}.png", frame.size, index + 1)
    masked = tj.masks.read_folder(tmp_path / "masks", scene)
    assert [frame.name for frame in masked.frames] == names
    for frame in masked.frames:
        assert len(frame.masks) == 1
        assert frame.labels is None
        assert frame.masks.size == frame.size


def test_each_kind_of_file(tmp_path):
    write_labels(tmp_path / "a.png")
    write_labels(tmp_path / "b" / "7.PNG", value=255)
    stack = torch.zeros(2, *SIZE, dtype=torch.bool)
    tj.masks.save_masks(tmp_path / "c.npz", tj.masks.from_stack(stack))
    (tmp_path / "d.json").write_text(json.dumps([{"segmentation": {"size": SIZE, "counts": [48]}}] * 3))
    write_labels(tmp_path / "e.masks.png")
    (tmp_path / "README.md").write_text("none")
    (tmp_path / ".hidden").mkdir()
    masked = tj.masks.read_folder(tmp_path, scene_of(*"abcde"))
    assert [len(frame.masks) for frame in masked.frames] == [1, 1, 2, 3, 1]
    assert masked.frames[1].masks.ids == (7,)


def test_names_in_an_archive_of_ones_own(tmp_path):
    stack = np.zeros((2, *SIZE), bool)
    stack[0, 0, 0] = stack[1, 1, 1] = True
    labels = np.where(stack[0], 5, np.where(stack[1], 9, -1))
    for name, masks in (("stack", stack), ("labels", labels)):
        np.savez(tmp_path / f"{name}.npz", masks=masks, scores=[0.5, 1.0], names=["cup", "book"])
        assert tj.masks.read_masks(tmp_path / f"{name}.npz").names == ("cup", "book")
    unsigned = np.where(stack[0], 5, np.where(stack[1], 9, 0)).astype(np.uint8)  # -1 is no number of theirs
    np.savez(tmp_path / "zero.npz", masks=unsigned, score=[0.5, 1.0])
    with pytest.warns(UserWarning, match=r"masks in \.npz: expected masks, scores and names; not read: score"):
        assert tj.masks.read_masks(tmp_path / "zero.npz").covered().sum() == 2
    assert len(tj.masks.from_labels(torch.from_numpy(unsigned))) == 2
    np.savez(tmp_path / "few.npz", masks=stack, names=["cup"])
    with pytest.raises(ValueError, match="ids: expected integers of 64 bits, got 'P0'"):
        replace(tj.masks.read_masks(tmp_path / "stack.npz"), ids=(1, "P0"))
    with pytest.raises(ValueError, match=r"few.npz.*names: expected one for each of 2 masks, got 1"):
        tj.masks.read_masks(tmp_path / "few.npz")


@pytest.mark.filterwarnings("ignore:.* have no mask")
def test_a_coco_file(tmp_path):
    """One of its file names was written on Windows."""
    files = ("left/b.jpg", r"left\a.jpg")
    images = [{"id": i, "file_name": file, "height": 6, "width": 8} for i, file in enumerate(files)]
    annotations = [{"id": 7, "image_id": 1, "segmentation": [[0, 0, 4, 0, 4, 6, 0, 6]], "category_id": 1}]
    path = tmp_path / "instances.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    with pytest.warns(UserWarning, match=r"instances\.json: 1 images have no mask: leave out"):
        masked = tj.masks.read_folder(path, scene_of("a", "b"))
    assert [len(frame.masks) for frame in masked.frames] == [1, 0]
    assert masked.frames[0].masks.covered().sum() == 24
    annotations[0]["segmentation"] = [[0, 0]]
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    with pytest.raises(ValueError, match=r"instances.json, image 'a': annotations\[0\]'s segmentation"):
        tj.masks.read_folder(path, scene_of("a", "b")).frames[0]
    path.write_text(json.dumps({"images": images, "annotations": [{"image_id": 5}]}))
    with pytest.raises(ValueError, match=r"instances\.json: expected images with file_name and id, annotations with"):
        tj.masks.read_folder(path, scene_of("a"))
    path.write_text(json.dumps({"images": [images[1] | {"id": 0}, images[0]], "annotations": []}))
    with pytest.raises(ValueError, match=r"instances\.json: .*: image 0 is there twice"):  # both had the masks of both
        tj.masks.read_folder(path, scene_of("a", "b"))
    path.write_text(json.dumps(annotations))
    with pytest.raises(ValueError, match=r"instances\.json: .*; a list of results is for tj\.masks\.from_coco, image"):
        tj.masks.read_folder(path, scene_of("a"))


def test_groups_in_a_coco_file_are_left_out(tmp_path):
    images = [{"id": i, "file_name": f"{name}.jpg", "height": 6, "width": 8} for i, name in enumerate("ab")]
    record = {"segmentation": {"size": SIZE, "counts": [48]}}
    annotations = [record | {"image_id": i, "iscrowd": crowd} for i in range(2) for crowd in (1, 0)]
    path = tmp_path / "instances.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    with pytest.warns(UserWarning, match=r"instances\.json: 2 of 4 masks are groups of things") as told:
        frames = list(tj.masks.read_folder(path, scene_of("a", "b")).frames)
    assert [len(frame.masks) for frame in frames] == [1, 1]
    assert len(told) == 1


def coco_of_squares(path, side, category):
    """Five squares in each of two images that are said to be of 6 x 8 pixels, and a category 1."""
    images = [{"id": i, "file_name": f"{name}.jpg", "height": 6, "width": 8} for i, name in enumerate("ab")]
    square = {"segmentation": [[0, 0, side, 0, side, side]], "category_id": category}
    annotations = [square | {"image_id": i} for i in range(2) for _ in range(5)]
    categories = [{"id": 1, "name": "chair"}]
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))
    return tj.masks.read_folder(path, scene_of("a", "b"))


def test_polygons_of_smaller_images_are_told(tmp_path):
    with pytest.warns(UserWarning, match=r"a\.json: all polygons lie in one corner of the images"):
        coco_of_squares(tmp_path / "a.json", 1.5, 1)
    with pytest.warns(UserWarning, match=r"b\.json: 10 of 10 polygons reach beyond their images: .*or y before x"):
        coco_of_squares(tmp_path / "b.json", 7, 1)
    for side in (2, 6):  # in silence
        coco_of_squares(tmp_path / "c.json", side, 1)


def test_annotations_that_contradict_themselves(tmp_path):
    image = {"id": 1, "file_name": "a.jpg", "height": 6, "width": 8}
    record = {"id": 3, "image_id": 1, "segmentation": [[0, 0, 4, 0, 4, 2, 0, 2]], "bbox": [0, 0, 4, 2]}
    path = tmp_path / "a.json"

    def read(*annotations):
        path.write_text(json.dumps({"images": [image], "annotations": annotations}))
        return tj.masks.read_folder(path, scene_of("a")).frames[0].masks

    assert len(read(record, record | {"id": 4, "bbox": []}, record | {"id": None}, record | {"id": None})) == 4
    assert len(read(*(record | {"id": 4 + i, "bbox": box} for i, box in enumerate((5, [0.1, 0.2, 0.5, 0.5]))))) == 2
    with pytest.raises(ValueError, match=r"a\.json: annotation \(image, id\) \(1, 3\) is there twice"):
        read(record, record)
    told = (
        r"annotations\[0\]'s segmentation: expected a mask in its bbox, x y \[3\.0, 0\.0\], width height \[2\.0, 2\.0\]"
    )
    with pytest.raises(ValueError, match=told):
        read(record | {"bbox": [3, 0, 2, 2], "segmentation": [[0, 0, 1, 0, 1, 6, 0, 6]]})


def test_unknown_categories_are_told(tmp_path):
    with pytest.warns(UserWarning, match=r"a\.json: no category has the id of some masks, .*: \[7\]"):
        coco_of_squares(tmp_path / "a.json", 5, 7)


def test_a_coco_file_of_cvat(tmp_path):
    """As Datumaro, with which CVAT writes, has written a polygon, a mask of the brush and a rectangle."""
    of_all = {"image_id": 1, "attributes": {"occluded": False}}
    polygon = {"id": 1, "category_id": 1, "segmentation": [[0.0, 0.0, 3.0, 0.0, 3.0, 2.0, 0.0, 2.0]], "iscrowd": 0}
    runs = {"counts": [13, 3, 3, 3, 3, 3, 20], "size": [6, 8]}
    brush = {"id": 2, "category_id": 2, "segmentation": runs, "area": 9.0, "bbox": [2.0, 1.0, 2.0, 2.0], "iscrowd": 1}
    rectangle = {"id": 3, "category_id": 1, "segmentation": [], "area": 6.0, "bbox": [1.0, 1.0, 3.0, 2.0], "iscrowd": 0}
    image = {"id": 1, "width": 8, "height": 6, "file_name": "left/a.jpg", "license": 0, "date_captured": 0}
    record = {
        "licenses": [{"name": "", "id": 0, "url": ""}],
        "info": {"contributor": "", "date_created": ""},
        "categories": [{"id": i, "name": name, "supercategory": ""} for i, name in ((1, "object"), (2, "chair"))],
        "images": [image],
        "annotations": [one | of_all for one in (polygon, brush, rectangle)],
    }
    path = tmp_path / "instances_default.json"
    path.write_text(json.dumps(record))
    with pytest.warns(UserWarning, match=r"default\.json: 1 of 3 annotations have no polygon; they are left out"):
        masks = tj.masks.read_folder(path, scene_of("a")).frames[0].masks
    assert (masks.ids, masks.names) == ((1, 2), ("object", "chair"))
    assert masks.stack()[0].nonzero().tolist() == [[y, x] for y in range(2) for x in range(3)]
    assert masks.stack()[1].nonzero().tolist() == [[y, x] for y in range(1, 4) for x in range(2, 5)]


@pytest.mark.parametrize(("stems", "ids"), [("37b", (3, 7, 0)), ("0ab", (0, 1, 2)), ("ab", (0, 1)), ("9", (9,))])
def test_pngs_without_a_number_get_a_free_one(tmp_path, stems, ids):
    for stem in stems:
        Image.fromarray(np.eye(4, dtype=np.uint8) * 255).save(tmp_path / f"{stem}.png")
    assert tj.masks.read_masks(tmp_path).ids == ids


def test_frames_and_masks_without_a_partner_are_reported(tmp_path):
    for name in ("b", "x", "y"):
        write_labels(tmp_path / f"{name}.png")
    with (
        pytest.warns(UserWarning, match="masks: 2 of 3 have no frame: x, y"),
        pytest.warns(UserWarning, match="masks: 2 of 3 frames have none and are segmented without masks: a, c"),
    ):
        masked = tj.masks.read_folder(tmp_path, scene_of(*"abc"))
    assert [frame.masks is None for frame in masked.frames] == [True, False, True]
    assert masked.frames[0].labels is not None
    with pytest.warns(UserWarning, match="have no frame"), pytest.warns(UserWarning, match="are left out: a, c"):
        left = tj.masks.read_folder(tmp_path, scene_of(*"abc"), without="leave out")
    assert [frame.name for frame in left.frames] == ["b"]


@pytest.mark.parametrize(
    ("most", "used", "without"),
    [(1, "c", 0), (2, "cf", 0), (3, "cdf", 0), (4, "acdf", 1), (9, "abcdefg", 4), (0, "", 0)],
)
def test_few_frames_are_those_with_masks(tmp_path, most, used, without):
    for name in "cdf":
        write_labels(tmp_path / f"{name}.png")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        masked = tj.masks.read_folder(tmp_path, scene_of(*"abcdefg"), max_frames=most)
    assert "".join(frame.name for frame in masked.frames) == used
    assert [f"{without} of {len(used)} frames have none" in str(one.message) for one in told] == [True] * bool(without)


def test_frames_that_are_left_out_are_all_counted(tmp_path):
    write_labels(tmp_path / "c.png")
    with pytest.warns(UserWarning, match="masks: 4 of 5 frames have none and are left out: a, b, d, e"):
        masked = tj.masks.read_folder(tmp_path, scene_of(*"abcde"), "leave out", max_frames=3)
    assert [frame.name for frame in masked.frames] == ["c"]
    with pytest.raises(ValueError, match="max_frames: expected >= 0, got -1"):
        tj.masks.read_folder(tmp_path, scene_of("c"), max_frames=-1)


def test_a_coco_file_in_a_folder_is_told(tmp_path):
    (tmp_path / "instances.json").write_text('{"images": [], "annotations": [], "categories": []}')
    for read in (tj.masks.folder.check_files, lambda folder: tj.masks.read_folder(folder, scene_of("a"))):
        with pytest.raises(ValueError, match=r"got a COCO data set; give the file itself: .*instances\.json$"):
            read(tmp_path)


def test_masks_of_nearly_the_whole_image_are_told(tmp_path):
    stack = torch.ones(2, *SIZE, dtype=torch.bool)
    stack[1, :2] = False
    for name in "ab":
        tj.masks.save_masks(tmp_path / f"{name}.npz", tj.masks.from_stack(stack))
    write_labels(tmp_path / "c.png")
    with pytest.warns(UserWarning, match="2 masks, in 2 of 3 images, cover over 90% of them; they join what they"):
        tj.masks.folder.check_files(tmp_path)


def test_what_cannot_be_matched_is_an_error(tmp_path):
    (tmp_path / "a.npy").touch()  # of no known kind
    for there in ("a.npy", "x"):
        told = f"no masks .*have the name of a frame; rename them, or .*: masks {there}; frames a, b"
        with pytest.raises(ValueError, match=told):
            tj.masks.read_folder(tmp_path, scene_of("a", "b"))
        write_labels(tmp_path / "x.png")
    write_labels(tmp_path / "a.png")
    tj.masks.save_masks(tmp_path / "a.npz", tj.masks.from_stack(torch.zeros(0, *SIZE, dtype=torch.bool)))
    with pytest.raises(ValueError, match=r"two masks for 'a', the second one is a.png"):
        tj.masks.read_folder(tmp_path, scene_of("a", "b"))
    (tmp_path / "a.npz").rename(tmp_path / "a.masks.npz")
    with pytest.raises(ValueError, match=r"two masks for frame 'a', the second one is 'a'|'a.masks'"):
        tj.masks.read_folder(tmp_path, scene_of("a", "b"))
    with pytest.raises(FileNotFoundError, match="nothing: missing; expected a folder of masks, or a COCO file"):
        tj.masks.read_folder(tmp_path / "nothing", scene_of("a"))
    with pytest.raises(ValueError, match="without: expected 'segment' or 'leave out', got 'drop'"):
        tj.masks.read_folder(tmp_path, scene_of("a"), without="drop")


@pytest.mark.parametrize(("dtype", "top", "is_told"), [("u1", 255, True), ("u2", 65535, True), ("u2", 255, False)])
def test_a_largest_label_that_may_mean_none(tmp_path, dtype, top, is_told):
    """VOC and others write 255 where nothing is labelled: it was a mask around all things."""
    Image.fromarray(np.array([[0, 1, 2], [top, 2, 2]], dtype)).save(tmp_path / "a.png")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert tj.masks.read_masks(tmp_path / "a.png").ids == (1, 2, top)
    assert [f"{top} is a label in images of labels" in str(one.message) for one in told][:1] == [True] * is_told
    assert len({str(one.message) for one in told}) == is_told * (1 + (dtype == "u2"))  # u2: as of other labels, too


def test_a_largest_label_of_an_archive_that_may_mean_none(tmp_path):
    np.savez(tmp_path / "a.npz", masks=np.array([[0, 1, 2], [65535, 2, 2]], np.uint16))
    with pytest.warns(UserWarning, match=r"65535 is a label; if it was -1 \(none\)"):
        tj.masks.read_masks(tmp_path / "a.npz")


def test_an_image_of_0_and_255_is_told_to_be_one_mask(tmp_path):
    write_labels(tmp_path / "a.png", value=255)
    with pytest.warns(UserWarning, match=r"only 0 and 255 is taken as one mask; of several things, .* in NAME/"):
        assert len(tj.masks.read_masks(tmp_path / "a.png")) == 1


def test_a_list_without_masks_is_of_an_image_of_any_size(tmp_path):
    (tmp_path / "a.json").write_text("[]")
    check_files(tmp_path)
    masks = tj.masks.read_folder(tmp_path, scene_of("a")).frames[0].masks
    assert (len(masks), masks.size) == (0, SIZE)
    assert tj.masks.read_masks(tmp_path / "a.json").resized((3, 9)).size == (3, 9)  # without a warning


def test_masks_are_read_with_their_frame(tmp_path):
    for name in "ab":
        write_labels(tmp_path / f"{name}.png")
    masked = tj.masks.read_folder(tmp_path, scene_of("a", "b"))
    (tmp_path / "b.png").write_bytes((tmp_path / "b.png").read_bytes()[:40])
    assert len(masked.frames[0].masks) == 1
    with pytest.raises(ValueError, match=r"b.png: not a whole image"):
        masked.frames[1]


def test_names_of_lazy_frames_are_known_without_reading():
    frames = LazySequence(3, lambda _: pytest.fail("read a frame"), ["a", "b", "c"])
    assert frame_names(tj.Scene(torch.rand(5, 3), frames).select_frames([2, 0]).frames) == ["c", "a"]


class TestCommand:
    def test_segment_takes_masks(self, tmp_path, run):
        scene = tj.synthetic.make_scene(2, num_views=3, num_points=1500, height=60, width=80)
        recording = write_folder(tmp_path / "recording", scene)
        names = [frame.name for frame in tj.load_scene(recording).frames]
        for name in names[1:]:
            write_labels(tmp_path / "masks" / f"{name}.png", (60, 80))
        out = tmp_path / "out"
        left_out = f"1 of 3 frames have none and are left out: {names[0]}"
        with pytest.warns(UserWarning, match=left_out), pytest.warns(PoseDoubt, match="borders of masks"):
            run("segment", recording, "-o", out, "--masks", tmp_path / "masks", "--without-masks", "leave-out")
        assert sorted(file.stem for file in (out / "images").glob("*.png")) == names[1:]
        with pytest.raises(SystemExit, match=r"-o: expected another path than the input's, .*masks, got"):
            run("segment", recording, "-o", tmp_path / "masks", "--masks", tmp_path / "masks")
        with pytest.raises(SystemExit, match=r"torchjoint: error: --masks: .*nothing does not exist"):
            run("segment", recording, "-o", tmp_path / "other", "--masks", tmp_path / "nothing")

    def test_damaged_masks_are_found_before_a_cloud_is_fused(self, tmp_path, run, monkeypatch):
        reads = "torchjoint.recordings.segment."
        monkeypatch.setattr(f"{reads}load_scene", lambda *_, **__: pytest.fail("fuses for an hour"))
        monkeypatch.setattr(f"{reads}find_format", lambda *_: None)
        (tmp_path / "recording").mkdir()
        for name, content in (("0.png", b"no image"), ("0.png", b"\x89PNG\r\n\x1a\n and no more"), ("0.npz", b"PK")):
            (tmp_path / "masks").mkdir(exist_ok=True)
            path = tmp_path / "masks" / name
            path.write_bytes(content)
            with pytest.raises(SystemExit, match=rf"torchjoint: error: {path}: n[^<]*$"):  # no <_io.BytesIO object>
                run("segment", tmp_path / "recording", "-o", tmp_path / "out", "--masks", tmp_path / "masks")
            path.unlink()
