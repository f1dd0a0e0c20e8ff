"""Samples with one thing altered, which were read as something else without a word: now an error or a warning."""

import json
import re
import shutil
import warnings

import pytest
import samples
import torch
import traps
from PIL import Image

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.scene.checks import as_intrinsics, as_pose


@pytest.fixture
def sample(tmp_path):
    """Writes a sample and returns its path."""
    return lambda name: samples.write(name, tmp_path / "sample")


def alter(folder, pattern, old, new):
    """Replaces the first match in the first file of that name; returns the file's name."""
    file = sorted(folder.rglob(pattern))[0]
    text, count = re.subn(old, new, file.read_text(), count=1)
    assert count == 1
    file.write_text(text)
    return file.name


NUMBERS = [
    ("folder", "*.pose.txt", r"^1\S*"),
    ("folder", "camera-intrinsics.txt", r"^2\S*"),
    ("kitti", "000007.txt", r"(?<=P2: )20"),
    ("kitti", "label_2/*.txt", r"0\.1(?= 0\.3)"),
    ("arkitscenes", "*.pincam", r"14\.0"),
    ("arkitscenes", "*.traj", r"(?<= )\S+$"),
    ("colmap", "cameras.txt", r"20\.5"),
    ("colmap", "images.txt", r"0\.25"),
    ("replica", "traj.txt", r"(?<= )0\.0\S*"),
    ("scannet_exported", "pose/0.txt", r"\S+(?=\n)"),
    ("scannet_exported", "intrinsic_color.txt", r"^\S+"),
    ("tum", "groundtruth.txt", r"0\.00\S*"),
]


@pytest.mark.parametrize(("name", "file", "number"), NUMBERS)
def test_digits_with_a_line_between_them(name, file, number, sample, tmp_path):
    path = sample(name)
    file = alter(tmp_path, file, number, "1_0")
    with pytest.raises(ValueError, match=rf"{file}.*: expected finite numbers, got .*1_0"):
        list(tj.load_scene(path).frames)


def test_digits_with_a_line_in_scannets_info(sample, tmp_path):
    path = sample("scannet_exported")
    for file in (path / "intrinsic").iterdir():
        file.unlink()
    alter(tmp_path, "scene0001_00.txt", r"(?<=fx_color = )\S+", "1_6")
    with pytest.raises(ValueError, match=r"scene0001_00\.txt: expected finite numbers, got '1_6"):
        tj.load_scene(path)


LARGE = [
    ("folder", "*.pose.txt", r"(?<= )\S+(?=\n)"),
    ("folder", "camera-intrinsics.txt", r"^2\S*"),
    ("kitti", "calib/*.txt", r"(?<=P2: )20"),
    ("kitti", "calib/*.txt", r"-0\.27"),
    ("arkitscenes", "*.pincam", r"14\.0"),
    ("arkitscenes", "*.traj", r"(?<= )\S+(?=\n)"),
    ("colmap", "cameras.txt", r"20\.5"),
    ("colmap", "images.txt", r"0\.25"),
    ("nerfstudio", "transforms.json", r'(?<="fl_x": )[\d.]+'),
    ("nuscenes", "sample.json", r"\b20\b"),
    ("scannet_exported", "intrinsic_color.txt", r"^\S+"),
    ("tum", "groundtruth.txt", r"0\.00\S*"),
]


@pytest.mark.parametrize("large", ["1e30", str(2**40)])
@pytest.mark.parametrize(("name", "file", "number"), LARGE)
def test_numbers_too_large_for_a_scene(name, file, number, large, sample, tmp_path):
    path = sample(name)
    file = alter(tmp_path, file, number, large)
    with pytest.raises(ValueError, match=rf"{file}.*: expected coordinates up to 1e\+12, got (1e\+30|1\.1e\+12)"):
        tj.load_scene(path)


@pytest.mark.parametrize("check", [as_pose, as_intrinsics])
def test_large_numbers_of_a_camera(check):
    matrix = torch.eye(4 if check is as_pose else 3, dtype=torch.float64)
    matrix[0, -1] = -1e30
    with pytest.raises(ValueError, match=r"it: expected coordinates up to 1e\+12, got 1e\+30"):
        check(matrix, "it")


def test_a_cloud_with_a_large_number(tmp_path):
    (tmp_path / "a.xyz").write_text("0 0 0\n1 0 1e30\n0 1 0\n")
    with pytest.raises(ValueError, match=r"a\.xyz: expected coordinates up to 1e\+12, got 1e\+30"):
        read_cloud_file(tmp_path / "a.xyz")


DEPTHS = [
    ("folder", "frame-*.depth.png"),
    ("scannet_exported", "depth/*.png"),
    ("posed_images", "0*.png"),
    ("replica", "depth*.png"),
    ("arkitscenes", "lowres_depth/*.png"),
    ("bop", "depth/*.png"),
    ("polycam", "depth/*.png"),
    ("ycb_video", "*-depth.png"),
    ("scannetpp_iphone", "depth/*.png"),
]
LABELS = [("folder", "frame-*.truth.png"), ("ycb_video", "*-label.png")]


@pytest.mark.parametrize("suffix", [".TIF", ".tiff", "number"])
@pytest.mark.parametrize(("name", "pattern"), DEPTHS + LABELS)
def test_images_of_another_suffix_or_number(name, pattern, suffix, sample, tmp_path):
    path = sample(name)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        tj.load_scene(path)
    assert not any("not read" in str(one.message) for one in told)
    for file in sorted(tmp_path.rglob(pattern)):
        file.rename(file.with_name(f"9{file.name}") if suffix == "number" else file.with_suffix(suffix))
    with pytest.warns(UserWarning, match=r"not read: no frame has an? (depth|image of)"):
        tj.load_scene(path)


def test_initial_labels_of_another_suffix(sample):
    path = sample("folder")
    shutil.copy(path / "frame-000000.truth.png", path / "frame-000000.labels.tif")
    with pytest.warns(UserWarning, match=r"000000\.labels\.tif: not read: no frame has an image of labels"):
        tj.load_scene(path)
    shutil.copy(path / "frame-000000.truth.png", path / "frame-000001.labels.png")
    with pytest.warns(UserWarning, match=r"labels: \d+ of \d+ frames have no \.labels\.png"):
        tj.load_scene(path)


def test_depth_of_tum_without_its_list(sample):
    path = sample("tum")
    (path / "depth.txt").unlink()
    with pytest.warns(UserWarning, match=r"depth.*\.png: not read: no frame has a depth image"):
        tj.load_scene(path)


@pytest.mark.parametrize("name", ["folder", "scannet_exported", "posed_images", "arkitscenes", "replica", "ycb_video"])
def test_a_cloud_of_an_upper_case_suffix(name, sample, tmp_path):
    path = sample(name)
    whole = traps.content_of(path)
    for file in tmp_path.rglob("*.ply"):
        file.rename(file.with_suffix(".PLY"))
    assert traps.same(traps.content_of(path), whole)


def resize(file, box, size):
    Image.open(file).crop(box).resize(size).save(file)


@pytest.mark.parametrize(("box", "size"), [((0, 0, 16, 12), (8, 6)), ((0, 0, 12, 12), (12, 12))])
def test_ycb_colour_that_was_resized_or_cropped(box, size, sample):
    path = sample("ycb_video")
    resize(path / "000002-color.jpg", box, size)
    with pytest.raises(ValueError, match=r"000002'.*000002-meta\.mat.*: expected depth of the image's size"):
        list(tj.load_scene(path).frames)


@pytest.mark.parametrize("box", [(0, 0, 12, 12), (0, 0, 16, 16), (2, 0, 9, 5)], ids=["cropped", "padded", "part"])
@pytest.mark.parametrize("pattern", ["1.jpg", "00001.jpg", "depth/1.png", "00001.png"])
def test_one_image_of_another_size(pattern, box, sample, tmp_path):
    path = sample("scannet_exported" if "0" not in pattern else "posed_images")
    file = next(tmp_path.rglob(pattern))
    resize(file, box, (box[2] - box[0], box[3] - box[1]))
    with pytest.raises(ValueError, match=rf"{file.name}: expected \[\d+, \d+\] pixels, as 0+\.\w+ has, got"):
        list(tj.load_scene(path).frames)


@pytest.mark.parametrize("box", [(0, 0, 14, 11), (0, 0, 8, 6)])
@pytest.mark.parametrize(("name", "pattern"), [("folder", "frame-000001.color.*"), ("tum", "rgb/*.png")])
def test_one_camera_and_an_image_of_another_size(name, pattern, box, sample):
    """Without depth, nothing told that the camera is not that of a smaller image."""
    path = sample(name)
    for file in [*path.glob("*depth*"), *path.glob("depth/*")]:
        if file.is_file():
            file.unlink()
    file = sorted(path.glob(pattern))[-1]
    resize(file, box, box[2:])
    with pytest.raises(ValueError, match=rf"{file.name}: expected \[12, 16\] pixels, as .* has, got"):
        list(tj.load_scene(path).frames)


def test_cropped_depth_of_one_calibration(sample, tmp_path):
    path = sample("posed_images")
    (path / "depth_intrinsic.txt").unlink()
    for file in path.glob("*.png"):
        resize(file, (0, 0, 5, 6), (5, 6))
    with pytest.raises(ValueError, match=r"frame 00000, its depth: expected the aspect ratio of its camera, 16 x 12"):
        list(tj.load_scene(path).frames)


AXES = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    "values",
    [
        {"normalizedAxes": [2 * value for value in AXES]},
        {"normalizedAxes": [0.0] * 9},
        {"normalizedAxes": [1.0] * 9},
        {"axesLengths": [1.0, -1.0, 1.0]},
        {"centroid": [0.0, 1e30, 0.0]},
    ],
)
def test_boxes_of_arkitscenes(values, sample, tmp_path):
    path = sample("arkitscenes")
    file = path / "40753679_3dod_annotation.json"
    record = json.loads(file.read_text())
    record["data"][0]["segments"]["obbAligned"].update(values)
    file.write_text(json.dumps(record))
    with pytest.raises(
        ValueError, match=r"annotation\.json: data\[0\].*: expected (lengths > 0, and axes|coordinates)"
    ):
        tj.load_scene(path)


@pytest.mark.parametrize(
    ("name", "number"), [("kitti", r"(?<=0\.1 )0\.3"), ("nuscenes", r'(?<="bbox_3d": \[\n)\s+\S+(?=,)')]
)
def test_boxes_far_away(name, number, sample, tmp_path):
    path = sample(name)
    alter(tmp_path, "label_2/*.txt" if name == "kitti" else "sample.json", number, "1e30")
    with pytest.raises(
        ValueError, match=r"(07\.txt: line 1|instances\[0\]: bbox_3d): expected coordinates up to 1e\+12"
    ):
        tj.load_scene(path)


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("scannetpp", "dslr/colmap/cameras.txt"),
        ("scannetpp", "dslr/colmap/images.txt"),
        ("scannetpp", "dslr/colmap"),
        ("scannetpp_iphone", "iphone/pose_intrinsic_imu.json"),
        ("both", "dslr/colmap/images.txt"),
        ("both", "iphone/colmap/images.txt"),
    ],
)
def test_images_of_scannetpp_without_poses(name, file, sample, tmp_path):
    path = sample("scannetpp" if name == "both" else name)
    if name == "both":  # a camera of the iPhone, too
        other = samples.write("scannetpp_iphone", tmp_path / "other") / "iphone"
        shutil.copytree(other, path / "iphone")
        shutil.copytree(path / "dslr" / "colmap", path / "iphone" / "colmap")
    path = path / "iphone" if file.startswith("iphone/colmap") else path
    lost = (path.parent if path.name == "iphone" else path) / file
    shutil.rmtree(lost) if lost.is_dir() else lost.unlink()
    with pytest.raises(FileNotFoundError, match=rf"{file}.*: missing"):
        tj.load_scene(path)


def test_two_poses_of_one_image_of_scannetpp(sample):
    path = sample("scannetpp")
    images = path / "dslr" / "colmap" / "images.txt"
    images.write_text(images.read_text().replace("DSC01.JPG", "other/DSC00.JPG"))
    with pytest.raises(ValueError, match=r"frames: image '.*DSC00\.JPG' is there twice"):
        tj.load_scene(path)


@pytest.mark.parametrize("name", ["scannetpp", "scannetpp_iphone"])
def test_lost_images_of_scannetpp(name, sample):
    path = sample(name)
    with pytest.warns(UserWarning, match="1 of 3 images have a pose, but are missing, and are left out"):
        assert len(tj.load_scene(path).frames) == 2


@pytest.mark.parametrize(("name", "file"), [("folder", "frame-000001.truth.png"), ("ycb_video", "000002-label.png")])
def test_truth_of_another_size_than_its_image(name, file, sample):
    path = sample(name)
    resize(path / file, (0, 0, 12, 12), (12, 12))
    with pytest.raises(ValueError, match=rf"{file}: expected \[12, 16\] pixels, as .*color.* has, got \[12, 12\]"):
        list(tj.load_scene(path).truth.images)


def test_objects_that_are_removed_from_a_list_of_bop(sample):
    path = sample("bop")
    record = json.loads((path / "scene_gt.json").read_text())
    record["36"].pop(0)
    (path / "scene_gt.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"gt\.json: 000036: expected an object for 000036_000001\.png, got 1"):
        tj.load_scene(path)


@pytest.mark.parametrize("value", [{}, "", "1", True, -5, {"k1": 1}])
def test_distortion_that_is_no_list(value, sample):
    path = sample("lidar_image_calibrated")
    record = json.loads((path / "camera_info.json").read_text())
    (path / "camera_info.json").write_text(json.dumps(record | {"D": value}))
    with pytest.raises(ValueError, match=r"camera_info\.json: D: expected 4, 5 or 8 numbers as of OpenCV, got"):
        tj.load_scene(path)


@pytest.mark.parametrize(("name", "objects"), [("scannet_exported", "*aggregation.json"), ("scannetpp", "*_anno.json")])
def test_segments_that_the_mesh_lacks(name, objects, sample, tmp_path):
    path = sample(name)
    file = alter(tmp_path, objects, r'(?<="segments": \[)', "77, ")
    with pytest.warns(UserWarning, match=rf"{file}: 1 segments of objects are not in .*seg.*\.json"):
        tj.load_scene(path)


OF_FOLDER = ("cloud.truth.npy", "*0.truth.png", "*0.color.jpg", "*0.pose.txt", "*0.depth.png", "camera-*.txt")
OTHERS = [
    ("s3dis", "Annotations/chair_1.txt"),
    ("scannet", "*.sens"),
    ("scannet", "*.aggregation.json"),
    ("arkitscenes", "*_annotation.json"),
]


@pytest.mark.parametrize(("name", "kind"), [*OTHERS, *(("folder", kind) for kind in OF_FOLDER)])
def test_an_upper_case_suffix(name, kind, sample):
    path = sample(name)
    whole, file = traps.content_of(path), next(path.glob(kind))
    file.rename(file.with_suffix(file.suffix.upper()))
    assert traps.same(traps.content_of(path), whole)


@pytest.mark.parametrize("value", ["false", "no", [0], 2])
def test_is_fisheye_that_is_neither_true_nor_false(value, sample):
    file = sample("nerfstudio") / "transforms.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"is_fisheye": value}))
    with pytest.raises(ValueError, match=r"transforms\.json: .*is_fisheye: expected true or false, got"):
        tj.load_scene(file)


def test_images_of_scannet_without_poses(sample):
    path = sample("scannet_exported")
    shutil.rmtree(path / "pose")
    with pytest.raises(FileNotFoundError, match="pose: missing; expected the poses of the images in color/"):
        tj.load_scene(path)
