"""Images without a pose are left out, and every format tells so in the same words."""

import contextlib
import dataclasses
import shutil
import struct
import warnings
from pathlib import Path

import laspy
import numpy as np
import pytest
import samples
import torch
from las_town import town, write_las
from samples import ros
from samples._parts import write_noise

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.fusion import fuse_cloud, fuse_or_recall
from torchjoint.datasets.recording import tell_left_out
from torchjoint.scene.frame import camera_center


def without_pose(name, folder):
    """A sample with one image more than poses, or with one pose less."""
    path = samples.write(name, folder / "sample")
    if name == "tum":
        lines = (path / "rgb.txt").read_text().splitlines()
        (path / "rgb.txt").write_text("\n".join([*lines, f"9999.0 {lines[-1].split()[1]}"]) + "\n")
    elif name == "arkitscenes":
        image = next(path.rglob("lowres_wide/*.png"))
        shutil.copy(image, image.with_name(f"{image.stem.rpartition('_')[0]}_9999.000.png"))
    elif name == "replica":
        lines = (path / "traj.txt").read_text().splitlines()
        (path / "traj.txt").write_text("\n".join(lines[:-1]) + "\n")
    elif name == "colmap":
        write_noise(path / "images" / "left 7.png", 7)
    elif name == "bop":
        image = next(path.rglob("rgb/*.png"))
        shutil.copy(image, image.with_name("000777.png"))
    elif name == "folder":
        next(path.glob("*.pose.txt")).unlink()
    elif name == "nerfstudio":
        image = next(path.rglob("*0.png"))
        shutil.copy(image, image.with_name(image.name.replace("0.png", "777.png")))
    return path


@pytest.mark.parametrize(
    "name",
    ["tum", "arkitscenes", "bop", "replica", "colmap", "scannet", "scannet_exported", "posed_images",
     "nerfstudio", "folder"],
)  # fmt: skip
def test_they_are_told(name, tmp_path):
    path = without_pose(name, tmp_path)
    with pytest.warns(
        UserWarning, match=r": 1 of \d images have no pose( within [0-9.]+ s,)? and are left out$"
    ) as told:
        scene = tj.load_scene(path, voxel_size=0.1)
    (message,) = [str(one.message) for one in told if "images have no pose" in str(one.message)]
    assert f"1 of {len(scene.frames) + 1} images" in message


@pytest.mark.parametrize(
    ("name", "images"),
    [
        ("scannet_exported", "color/*"),
        ("polycam", "keyframes/corrected_images/*"),
        ("record3d_exr", "EXR_RGBD/rgb/0.jpg"),
        ("arkitscenes", "*/lowres_wide/*"),
        ("ycb_video", "*-color.png"),
    ],
)
def test_poses_without_images_are_told(name, images, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    next(path.glob(images)).unlink()
    with pytest.warns(UserWarning, match=r": 1 of \d images have a pose, but are missing, and are left out"):
        tj.load_scene(path)


@pytest.mark.parametrize(
    ("name", "below"), [("folder", "a"), ("s3dis", "."), ("scannetpp", "."), ("scannet_exported", "scans")]
)
def test_folders_beside_recordings(name, below, tmp_path):
    scene = samples.write(name, tmp_path / "all" / below)
    (scene.with_name("other") / "images").mkdir(parents=True)
    with pytest.warns(UserWarning, match="1 of 2 folders are of no known format, and are left out: other"):
        assert [*tj.datasets.list_scenes(tmp_path / "all").values()] == [scene]


def test_a_folder_of_two_formats(tmp_path):
    path = samples.write("nerfstudio", tmp_path / "sample")
    shutil.copytree(samples.write("replica", tmp_path / "other"), path, dirs_exist_ok=True)
    shutil.copy(next((tmp_path / "other").rglob("cam_params.json")), path)
    with pytest.warns(UserWarning, match=r"has files of nerfstudio and replica; read as nerfstudio; format .* another"):
        tj.load_scene(path)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "has files of")
        assert len(tj.load_scene(path, format="replica").frames) > 0


def test_things_of_s3dis_whose_files_have_other_names(tmp_path):
    path = samples.write("s3dis", tmp_path / "sample")
    (path / "Annotations" / "deeper").mkdir()
    for name in ("arm-chair_1.txt", "deeper/chair_1.txt"):
        (path / "Annotations" / "chair_1.txt").rename(path / "Annotations" / name)
        with pytest.warns(UserWarning, match=r": 1 files in Annotations are no CLASS_N\.txt; not read: (arm-)?chair_1"):
            tj.load_scene(path)
        (path / "Annotations" / name).rename(path / "Annotations" / "chair_1.txt")
    for file in (path / "Annotations").iterdir():
        file.rename(file.with_suffix(".text"))
    with pytest.raises(ValueError, match=r"of no known format.* needs Annotations/ with CLASS_N\.txt"):
        tj.load_scene(path.parent)


def test_a_lost_image_of_replica_moves_no_pose(tmp_path):
    path = samples.write("replica", tmp_path / "sample")
    second = sorted((path / "results").glob("frame*.jpg"))[1]
    for file in (second, second.with_name("depth000001.png")):
        for number in "78":
            shutil.copy(file, file.with_name(file.name.replace("1", number)))
    lines = (path / "traj.txt").read_text().splitlines()
    (path / "traj.txt").write_text("\n".join([*lines, lines[-1]]) + "\n")
    with pytest.raises(ValueError, match=r"traj\.txt: frame 2 has no image, and 1 images have no pose"):
        tj.load_scene(path)
    (path / "traj.txt").write_text("\n".join([*lines, *lines]) + "\n")
    with pytest.warns(UserWarning, match="numbers of images are missing; poses are taken in their order"):
        tj.load_scene(path)


def test_tum_of_equal_times_and_unlisted_images(tmp_path):
    path = samples.write("tum", tmp_path / "sample")
    lines = (path / "rgb.txt").read_text().splitlines()
    time, image = lines[-1].split()
    shutil.copy(path / image, path / "rgb" / "9999.0.png")
    shutil.copy(path / image, (path / image).with_name(f"9{Path(image).name}"))
    (path / "rgb.txt").write_text("\n".join([*lines, f"{time} rgb/9999.0.png"]) + "\n")
    with pytest.warns(UserWarning, match="left out") as told:
        tj.load_scene(path, voxel_size=0.1)
    told = [str(one.message) for one in told]
    assert any("2 of " in one and "images have no pose and are left out" in one for one in told)


def test_images_of_replica_are_in_the_order_of_their_numbers(tmp_path):
    path = samples.write("replica", tmp_path / "sample")
    first, *others = sorted((path / "results").glob("frame*.jpg"))
    for file in (*others, *first.parent.glob("depth*")):
        file.unlink()
    pose = (path / "traj.txt").read_text().splitlines()[0].split()
    lines = []
    for number in range(11):
        pose[3] = str(number)
        lines.append(" ".join(pose))
        shutil.copy(first, first.with_name(f"frame{number}.jpg"))
    first.rename(first.with_name("frame0 (1).jpg"))  # a browser's copy: it moved all poses behind it
    (path / "traj.txt").write_text("\n".join(lines) + "\n")
    write_cloud(path / "cloud.ply", torch.rand(9, 3))
    frames = tj.load_scene(path).frames
    assert [frame.name for frame in frames] == [f"frame{number}" for number in range(11)]
    assert [round(float(camera_center(frame.world_to_camera)[0])) for frame in frames] == list(range(11))


@pytest.mark.parametrize("rest", [b"", bytes(4096), b"\n", bytes(11) + b"\1"])
def test_points_behind_those_of_a_pcd(rest, tmp_path):
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(head.encode() + np.arange(6, dtype=np.float32).tobytes() + rest)
    is_told = pytest.warns(UserWarning, match=r"a\.pcd: 12 bytes behind the 2 points of its header are not read")
    with is_told if rest.strip(b"\0\n") else contextlib.nullcontext():
        assert len(tj.load_scene(tmp_path / "a.pcd").points) == 2


def test_arrays_behind_the_first_of_a_npy(tmp_path):
    with (tmp_path / "a.npy").open("wb") as stream:
        for count in (9, 4):
            np.save(stream, np.random.default_rng(0).random((count, 3)))
    with pytest.raises(ValueError, match=r"a\.npy: .*expected one array, got more behind the first, of shape \[9, 3\]"):
        tj.load_scene(tmp_path / "a.npy")


def test_ros(tmp_path):
    late = ("/camera/image_raw", 3.0, ros.image(3.0, ros.colors(2), "bgr8"))
    bag = ros.record(tmp_path / "late", [*ros.messages(), late])
    with pytest.warns(UserWarning, match=r"late: 1 of 3 images have no pose within 0\.02 s, and are left out"):
        tj.load_scene(bag, voxel_size=0.1)


def test_ros_of_equal_times(tmp_path):
    """Some drivers leave the time in the header of all messages as it is."""
    same = ("/camera/image_raw", 0.15, ros.image(0.104, ros.colors(1), "bgr8"))
    bag = ros.record(tmp_path / "same", [*ros.messages(), same])
    with pytest.warns(UserWarning, match=r"image_raw: 1 of 3 images have the time of another in a header, and are"):
        assert len(tj.load_scene(bag, voxel_size=0.1).frames) == 2


def test_las_behind_the_last_point(tmp_path):
    """A writer that was killed has not put the number of its points into the header."""
    file = write_las(tmp_path / "site.las", town(1_000, 3))
    content = bytearray(file.read_bytes())
    struct.pack_into("<Q", content, 247, 600)
    file.write_bytes(content)
    with pytest.warns(UserWarning, match=r"site\.las: \d+ bytes behind the 600 points of its header are not read"):
        assert len(tj.load_scene(file).points) == 600


@pytest.mark.parametrize(("count", "size", "told"), [(49_000, 70_000, "21000"), (49_000, 49_500, "500")])
def test_laz_behind_the_last_point(tmp_path, count, size, told):
    file = write_las(tmp_path / "site.laz", town(size, 30))
    content = bytearray(file.read_bytes())
    struct.pack_into("<Q", content, 247, count)
    file.write_bytes(content)
    with pytest.warns(
        UserWarning, match=rf"site\.laz: at least {told} points behind the {count} of its header are not read"
    ):
        assert len(tj.load_scene(file).points) == count
    struct.pack_into("<Q", content, 247, size + 1)
    file.write_bytes(content)
    with pytest.raises(ValueError, match=rf"site\.laz: .*truncated: {size + 1} points in its header, {size} in its"):
        tj.load_scene(file)


@pytest.mark.parametrize("count", [49_000, 119_999, 120_000])
def test_laz_of_an_early_format(tmp_path, count):
    """The last chunk, of up to 50,000 points, does not tell its number."""
    las = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    las.xyz = town(120_000, 30)
    las.write(tmp_path / "site.laz")
    content = bytearray((tmp_path / "site.laz").read_bytes())
    struct.pack_into("<I", content, 107, count)
    (tmp_path / "site.laz").write_bytes(content)
    rest = {49_000: 51_001, 119_999: 1}.get(count)
    told = rf"at least {rest} points behind the {count} of its header" if rest else None
    with pytest.warns(UserWarning, match=told) if told else contextlib.nullcontext():
        assert len(tj.load_scene(tmp_path / "site.laz").points) == count


def test_the_largest_of_several_models(tmp_path):
    """COLMAP numbers parts that it could not join; version 3.12 adds rigs and frames."""
    path = samples.write("colmap", tmp_path / "sample")
    whole, part = path / "sparse" / "1", path / "sparse" / "0"
    part.rename(whole)
    (whole / "rigs.txt").write_text("1 1 CAMERA 3\n2 1 CAMERA 1\n")
    (whole / "frames.txt").write_text(
        "1 1 0.8 0.6 0 0 0 0.5 0.25 1 CAMERA 3 5\n2 2 0.8 0.6 0 0 -0.1 0.5 0.25 1 CAMERA 1 4\n"
    )
    assert [frame.name for frame in tj.load_scene(path).frames] == ["left 0", "left 1"]
    shutil.copytree(whole, part)
    lines = (part / "images.txt").read_text().splitlines()
    (part / "images.txt").write_text("\n".join(lines[:4]) + "\n")
    with pytest.warns(UserWarning, match=r"2 models, .*: sparse/1 is read; images: sparse/0 has 1, sparse/1 has 2"):
        scene = tj.load_scene(path)
    assert len(scene.frames) == 2
    assert len(tj.load_scene(part).frames) == 1
    np.testing.assert_array_equal(scene.points, tj.load_scene(whole).points)
    for number in "01":  # the cloud is that of the model
        (path / "dense" / number).mkdir(parents=True)
        write_cloud(path / "dense" / number / "fused.ply", torch.full((3, 3), float(number)) + torch.eye(3))
        assert tj.load_scene(path / "sparse" / number).points.min() == int(number)
    with pytest.warns(UserWarning, match="sparse/1 is read"):
        assert tj.load_scene(path).points.min() == 1


@pytest.mark.parametrize(
    ("name", "depth"),
    [
        ("folder", "*.depth.png"),
        ("polycam", "keyframes/depth/10000000.png"),
        ("record3d_exr", "EXR_RGBD/depth/0.exr"),
        ("scannet_exported", "depth/0.png"),
        ("ycb_video", "*-depth.png"),
    ],
)
def test_lost_depth_beside_a_cloud(name, depth, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    tj.load_scene(path)
    next(path.glob(depth)).unlink()
    with pytest.warns(UserWarning, match=r"^depth: 1 of \d+ frames have no depth image$"):
        tj.load_scene(path)


def test_frames_without_depth_among_others(scene_of, tmp_path, monkeypatch):
    frames = list(scene_of(3).scene.frames)
    frames[1] = dataclasses.replace(frames[1], depth=None)
    assert fuse_cloud(frames, 0.05)[2] == 1
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    for _ in range(2):  # the second one comes from the cache
        with pytest.warns(
            UserWarning, match=rf"depth: 1 of {len(frames)} frames have no depth image; the cloud is fused"
        ):
            fuse_or_recall(tmp_path, frames, 0.05, False)


def test_a_description_that_counts_too_few(recwarn):
    """metadata.yaml of a ROS recording may say 2 images where there are 6."""
    tell_left_out("walk", -4, 2)
    assert not recwarn
