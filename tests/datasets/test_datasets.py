"""Reading recordings from disk."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from folder_files import write_folder, write_truth
from PIL import Image

import torchjoint as tj
from torchjoint.datasets import fusion
from torchjoint.datasets.cameras import invert_pose
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.files.readers import fingerprint, read_array, read_depth, read_image
from torchjoint.datasets.formats.folder import read_frames
from torchjoint.datasets.fusion import fuse_cloud
from torchjoint.results.output_folder import output_folder, own_files


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(1)


@pytest.fixture
def folder(tmp_path, synthetic):
    return write_folder(tmp_path / "recording", synthetic)


def test_a_folder_comes_back(folder, synthetic):
    scene = tj.load_scene(folder)
    assert torch.equal(scene.points, synthetic.scene.points)
    torch.testing.assert_close(scene.colors, synthetic.scene.colors, atol=0.003, rtol=0)
    assert [frame.name for frame in scene.frames] == [f"frame-{i * 5:06d}" for i in range(6)]
    for got, expected in zip(scene.frames, synthetic.scene.frames, strict=True):
        torch.testing.assert_close(got.image, expected.image, atol=0.003, rtol=0)
        torch.testing.assert_close(got.world_to_camera, expected.world_to_camera)
        torch.testing.assert_close(got.intrinsics, expected.intrinsics)
        assert got.depth[0, 0] == 0
        torch.testing.assert_close(got.depth[1:], expected.depth[1:], atol=0.001, rtol=0)


def test_frames_are_read_when_they_are_asked_for(folder):
    scene = tj.load_scene(folder)
    (folder / "frame-000005.color.png").write_bytes(b"no image")
    assert scene.frames[0].size == (120, 160)
    with pytest.raises(ValueError, match=r"frame-000005\.color\.png: not a whole image"):
        scene.frames[1]
    assert len(scene.frames[2:4]) == 2


def test_label_images_become_initial_segmentations(folder):
    labels = np.zeros((120, 160), dtype=np.uint16)
    labels[:, 80:] = 300
    Image.fromarray(labels).save(folder / "frame-000000.labels.png")
    with pytest.warns(UserWarning, match="labels: 5 of 6 frames have no"):
        scene = tj.load_scene(folder)
    assert scene.frames[0].labels.unique().tolist() == [-1, 299]
    assert scene.frames[1].labels is None


def test_a_cloud_is_fused_and_kept(tmp_path, synthetic):
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    kept = tmp_path / "cloud.ply"
    scene = tj.load_scene(recording, cloud=kept, voxel_size=0.05)
    again = tj.load_scene(recording, cloud=kept)
    assert len(scene.points) > 1000
    assert torch.equal(scene.points, again.points)
    assert torch.equal(scene.colors, again.colors)  # a run that resumes has the colours of one that did not stop
    fresh = tj.load_scene(recording, voxel_size=0.05)
    assert torch.equal(scene.points, fresh.points)
    # The fused cloud lies on what the sensor measured: most points are near one of the synthetic cloud's.
    distance = torch.cdist(scene.points, synthetic.scene.points).amin(1)
    assert distance.median() < 0.08


def test_frames_alone_are_loaded_without_fusing(tmp_path, synthetic, monkeypatch):
    monkeypatch.setattr("torchjoint.datasets.recording.fuse_or_recall", lambda *_: pytest.fail("fused"))
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    np.save(recording / "cloud.truth.npy", np.zeros(1000, np.int32))  # of a cloud that is not here
    scene = tj.load_scene(recording, fuse=False)
    assert (len(scene.points), len(scene.frames), scene.truth) == (1, len(synthetic.scene.frames), None)
    whole = tj.load_scene(write_folder(tmp_path / "whole", synthetic), fuse=False)  # its cloud is no fused one
    assert len(whole.points) == len(synthetic.scene.points)


@pytest.mark.parametrize("northing", [0.0, 4_000_000.0])
def test_a_fused_cloud_is_found_in_the_cache(tmp_path, synthetic, monkeypatch, northing):
    """Far from the origin it is float64; from the cache it came as float32, wrong by half a metre."""
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    for file in recording.glob("*.pose.txt"):
        pose = np.loadtxt(file)
        pose[1, 3] += northing
        np.savetxt(file, pose)
    fused = tj.load_scene(recording, voxel_size=0.05)  # without a cache
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    first = tj.load_scene(recording, voxel_size=0.05)
    (kept,) = (tmp_path / "cache" / "clouds").iterdir()
    monkeypatch.setattr("torchjoint.datasets.fusion._fuse", lambda *_, **__: 1 / 0)
    again = tj.load_scene(recording, voxel_size=0.05)
    for scene in (first, again):
        assert scene.points.dtype == fused.points.dtype
        assert torch.equal(scene.points, fused.points)
        assert torch.equal(scene.colors, fused.colors)
    with pytest.raises(ZeroDivisionError):  # another voxel size is another cloud
        tj.load_scene(recording, voxel_size=0.06)
    data = bytearray(kept.read_bytes())
    data[len(data) // 2] ^= 1  # the coordinate of a point
    for damaged in (bytes(data), bytes(data[:-1]), b"", b"ply, but damaged"):
        kept.write_bytes(damaged)
        with pytest.raises(ZeroDivisionError):
            tj.load_scene(recording, voxel_size=0.05)
    monkeypatch.undo()


def test_depth_of_equal_size_and_time_is_fused_anew(tmp_path, synthetic, monkeypatch):
    """A copy that keeps the times (rsync, cp -p) got the cloud of the depth images before it."""
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    fused = tj.load_scene(recording, voxel_size=0.05)
    for file in recording.glob("*.depth.png"):
        before, depth = file.stat(), np.array(Image.open(file))
        depth[:, :80] = 0
        Image.fromarray(depth).save(file)
        with file.open("ab") as stream:
            stream.truncate(before.st_size)  # zeros after the end of a PNG are ignored
        os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert len(tj.load_scene(recording, voxel_size=0.05).points) < len(fused.points)


def test_a_recording_that_is_exchanged_while_it_is_fused(tmp_path, synthetic, monkeypatch):
    """Its cloud was found in the cache when the first recording was back in its place."""
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    other = shutil.copytree(recording, tmp_path / "other")
    for file in other.glob("*.depth.png"):
        Image.fromarray(np.where(np.arange(160) < 80, np.array(Image.open(file)), 0).astype(np.uint16)).save(file)
    fused, fuse = tj.load_scene(recording, voxel_size=0.05), fusion._fuse
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))

    def exchanged(*arguments):
        recording.rename(tmp_path / "away")
        other.rename(recording)
        return fuse(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(fusion, "_fuse", exchanged)
        tj.load_scene(recording, voxel_size=0.05)
    recording.rename(other)
    (tmp_path / "away").rename(recording)
    assert torch.equal(tj.load_scene(recording, voxel_size=0.05).points, fused.points)


def test_a_cloud_that_is_fused_far_from_the_origin_is_as_exact(synthetic):
    offset = torch.tensor([1024.0 * 500, -1024.0 * 5000, 0], dtype=torch.float64)  # 2^14 voxels or multiples of that
    back = torch.eye(4, dtype=torch.float64)
    back[:3, 3] = -offset
    there = [replace(frame, world_to_camera=frame.world_to_camera @ back) for frame in synthetic.scene.frames]
    here, moved = (fuse_cloud(frames, 0.0625)[0] for frames in (synthetic.scene.frames, there))
    assert moved.dtype == torch.float64
    torch.testing.assert_close(moved - offset, here.double(), atol=1e-6, rtol=0)


def test_a_recording_needs_a_cloud_or_depth(tmp_path, synthetic):
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False, depth=False)
    with pytest.raises(ValueError, match=r"none has a depth image, and there is no cloud\.ply"):
        tj.load_scene(recording)


@pytest.mark.parametrize("voxel_size", [0, -1, float("nan")])
def test_bad_voxel_size(tmp_path, synthetic, voxel_size):
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    with pytest.raises(ValueError, match="voxel_size: expected"):
        tj.load_scene(recording, voxel_size=voxel_size)


@pytest.mark.parametrize("text", [None, "-inf " * 16])  # of 7-Scenes and ScanNet: the camera was lost
def test_a_missing_pose(folder, synthetic, text):
    write_truth(folder, synthetic)
    (folder / "frame-000010.pose.txt").unlink()
    if text is not None:
        (folder / "frame-000010.pose.txt").write_text(text)
    with pytest.warns(UserWarning, match=r": frame-000010: 1 of \d images have no pose and are left out"):
        scene = tj.load_scene(folder)
    assert [frame.name for frame in scene.frames][:3] == ["frame-000000", "frame-000005", "frame-000015"]
    assert torch.equal(scene.truth.images[2], synthetic.image_labels[3])
    for file in folder.glob("*.pose.txt"):
        file.unlink()
    with pytest.raises(FileNotFoundError, match=r"none of \d colour images has a pose, a file NAME\.pose\.txt"):
        tj.load_scene(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3", r"frame-000010\.pose\.txt: expected 4x4 = 16 numbers, got 3"),
        ("a " * 16, r"frame-000010\.pose\.txt: expected finite numbers"),
        ("1 " * 16, r"frame-000010\.pose\.txt: expected a rigid transform"),
    ],
)
def test_bad_poses(folder, text, message):
    (folder / "frame-000010.pose.txt").write_text(text)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)  # before any frame is worked on


def test_two_images_of_one_frame(folder):
    shutil.copy(folder / "frame-000010.color.png", folder / "frame-000010.color.jpg")
    with pytest.raises(ValueError, match="the colour image of frame 'frame-000010' is there twice"):
        tj.load_scene(folder)


def test_missing_intrinsics(folder):
    (folder / "camera-intrinsics.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"camera-intrinsics\.txt: missing; expected a 3x3 matrix"):
        tj.load_scene(folder)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_truncated_jpeg(folder, tmp_path, share):
    picture = tmp_path / "whole.jpg"
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    Image.fromarray(noise).save(picture)
    data = picture.read_bytes()
    (folder / "frame-000000.color.png").unlink()
    (folder / "frame-000000.color.jpg").write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ValueError, match=r"frame-000000\.color\.jpg: not a whole image"):
        tj.load_scene(folder).frames[0]


def test_a_truncated_cloud(folder):
    data = (folder / "cloud.ply").read_bytes()
    (folder / "cloud.ply").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"cloud\.ply: "):
        tj.load_scene(folder)


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.PLY"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("kind", ["uchar", "float"])
def test_other_people_s_clouds(tmp_path, name, newline, kind):
    one = "255" if kind == "uchar" else "1.0"
    lines = ["ply", "format ascii 1.0", "comment by hand", "element vertex 2", "property double x", "property double y"]
    lines += ["property double z", *(f"property {kind} {color}" for color in ("red", "green", "blue")), "end_header"]
    (tmp_path / name).write_text(newline.join([*lines, f"1 2 3 {one} 0 0", f"4 5 6 0 {one} 0", ""]), newline="")
    points, colors, normals = read_cloud_file(tmp_path / name)[:3]
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert colors.tolist() == [[1, 0, 0], [0, 1, 0]]
    assert normals is None
    (tmp_path / name).write_text(newline.join([*lines, f"1 2 3 {one} 0 0"]), newline="")
    with pytest.raises(ValueError, match=r"truncated, or too long: expected 2 lines \(2 of vertex\), got 1"):
        read_cloud_file(tmp_path / name)


def test_a_cloud_with_nan(tmp_path):
    (tmp_path / "c.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n1 2 3\nnan nan nan\n"
    )
    with pytest.raises(ValueError, match=r"c\.ply: 1 of 2 points are NaN or infinite; --drop-invalid"):
        read_cloud_file(tmp_path / "c.ply")


def test_16_bit_colour(folder):
    Image.fromarray(np.ones((120, 160), dtype=np.uint16)).save(folder / "frame-000000.color.png")
    with pytest.raises(ValueError, match=r"color\.png: expected an 8-bit image, got mode I;16"):
        tj.load_scene(folder).frames[0]


def test_depth_of_another_size_and_depth_in_8_bits(folder):
    Image.fromarray(np.ones((10, 10), dtype=np.uint16)).save(folder / "frame-000000.depth.png")
    with pytest.raises(
        ValueError,
        match=r"image 'frame-000000' of .*: expected depth of .*, got 160 x 120 pixels and depth of \[10, 10\]",
    ):
        tj.load_scene(folder).frames[0]
    Image.fromarray(np.ones((120, 160), dtype=np.uint8)).save(folder / "frame-000000.depth.png")
    with pytest.raises(ValueError, match=r"depth\.png: expected a 16-bit grey image, got mode L"):
        tj.load_scene(folder).frames[0]


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<u2", ">i4", "?"])
def test_arrays(tmp_path, dtype):
    values = np.asfortranarray(np.arange(12).reshape(3, 4)).astype(dtype)
    np.save(tmp_path / "a.npy", values)
    assert read_array(tmp_path / "a.npy").tolist() == values.tolist()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"(30, 4)", b"(90, 4)", "a shape that fits the file"),  # before there is memory for it
        (b", }", b"( ", ""),  # which Python's tokenizer has an error of its own for
        (b"<f8", b"|O8", ""),
        (b"NUMPY", b"NUMPX", "magic string"),
    ],
)
def test_arrays_that_are_not_whole(tmp_path, old, new, message):
    file = tmp_path / "a.npy"
    np.save(file, np.zeros((30, 4)))
    assert old in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(old, new.ljust(len(old))))
    with pytest.raises(ValueError, match=rf"a\.npy: not a whole \.npy array of numbers: .*{message}"):
        read_array(file)


def test_no_such_scene(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"scene: .*nowhere does not exist"):
        tj.load_scene(tmp_path / "nowhere")


def test_an_unknown_format_says_what_is_missing(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"it has no files\. `torchjoint formats` lists all"):
        tj.load_scene(tmp_path / "empty")
    (tmp_path / "thing.mp4").write_text("x")
    with pytest.raises(ValueError, match=r"it is a file that ends in '\.mp4'\. .*`torchjoint formats` lists all"):
        tj.load_scene(tmp_path / "thing.mp4")
    (tmp_path / "raw.zip").write_text("x")
    with pytest.raises(ValueError, match=r"ends in '\.zip' \(unpack it\)\. "):
        tj.load_scene(tmp_path / "raw.zip")
    (tmp_path / "scan").mkdir()  # a phone's mesh: the most similar format was a folder of frames
    for name in ("room.obj", "room.mtl", "room.png"):
        (tmp_path / "scan" / name).write_text("x")
    with pytest.raises(ValueError, match=r"For a cloud alone, give the file: .*room\.obj\."):
        tj.load_scene(tmp_path / "scan")
    (tmp_path / "none" / "a").mkdir(parents=True)  # a letter of each format's words
    with pytest.raises(ValueError, match=r"it has 1 folder\. `torchjoint formats` lists all"):
        tj.load_scene(tmp_path / "none")
    (tmp_path / "none" / "1.bin").touch()
    with pytest.raises(ValueError, match=r"1 \.bin file, 1 folder\. For a cloud alone, give the file: "):
        tj.load_scene(tmp_path / "none")
    (tmp_path / "none" / "run.yaml").touch()
    with pytest.raises(ValueError, match="none: expected a recording, got a result; `torchjoint show` shows it"):
        tj.load_scene(tmp_path / "none")
    for name in ("rgb", "depth"):
        (tmp_path / "tum" / name).mkdir(parents=True)
    for name in ("rgb.txt", "depth.txt"):
        (tmp_path / "tum" / name).write_text("x")
    with pytest.raises(ValueError, match=r"2 folders, 2 \.txt files\. The most similar one needs rgb\.txt and ground"):
        tj.load_scene(tmp_path / "tum")
    (tmp_path / "empty" / "cloud.ply").write_text("x")
    with pytest.raises(ValueError, match=r"it has 1 \.ply file\. For a cloud alone, give the file: .*cloud\.ply\. `"):
        tj.load_scene(tmp_path / "empty")
    for name in ("a.laz", "b.laz"):
        (tmp_path / "tum" / name).write_text("x")
    with pytest.raises(ValueError, match=r"objects of all its tiles, merge them .*`torchjoint label OUT A\.laz -o NEW"):
        tj.load_scene(tmp_path / "tum")


def test_clouds_keep_labels_for_other_tools(tmp_path):
    points, labels = torch.rand(7, 3), torch.arange(7)
    write_cloud(tmp_path / "out.ply", points, torch.rand(7, 3), labels)
    from open3d import t

    cloud = t.io.read_point_cloud(str(tmp_path / "out.ply"))
    assert cloud.point.label.numpy().ravel().tolist() == labels.tolist()
    assert torch.equal(read_cloud_file(tmp_path / "out.ply")[0].float(), points)
    assert [file.name for file in tmp_path.iterdir()] == ["out.ply"]


def test_inverting_a_pose(scene_of):
    frame = scene_of(0).scene.frames[0].world_to_camera
    torch.testing.assert_close(invert_pose(frame), torch.linalg.inv(frame))


class TestKitchen:
    """The real recording."""

    def test_frames(self, shared):
        frames = read_frames(shared / "data" / "kitchen")
        assert len(frames) == 200
        frame = frames[3]
        assert frame.name == "frame-000015"
        assert frame.size == (480, 640)
        assert 0.5 < frame.depth[frame.depth > 0].median() < 5

    def test_depth_and_colour_files(self, shared):
        folder = shared / "data" / "kitchen"
        assert read_image(folder / "frame-000000.color.jpg").shape == (3, 480, 640)
        assert read_depth(folder / "frame-000000.depth.png").max() < 65

    @pytest.mark.slow
    def test_segmenting_a_few_frames(self, shared, tmp_path):
        source = shared / "data" / "kitchen"
        some = tmp_path / "some"
        some.mkdir()
        for index in range(0, 100, 20):
            for suffix in ("color.jpg", "depth.png", "pose.txt"):
                shutil.copy(source / f"frame-{index:06d}.{suffix}", some)
        shutil.copy(source / "camera-intrinsics.txt", some)
        scene = tj.load_scene(some, voxel_size=0.03)
        result = tj.JointSegmenter()(scene)
        assert 5 < result.num_point_segments < 200
        # The views overlap: what the first two see is largely the same objects.
        shared_ids = set(result.images[0].unique().tolist()) & set(result.images[1].unique().tolist())
        assert len([i for i in shared_ids if i < result.num_point_segments]) > 3


class TestFingerprint:
    """Whether a recording has changed since the state of a run was saved."""

    def test_images_behind_a_linked_folder(self, tmp_path):
        (tmp_path / "images").mkdir()
        (tmp_path / "images" / "0.png").write_bytes(b"one")
        (tmp_path / "recording").mkdir()
        (tmp_path / "recording" / "images").symlink_to(tmp_path / "images")
        before = fingerprint(tmp_path / "recording")
        assert fingerprint(tmp_path / "recording") == before
        (tmp_path / "images" / "0.png").write_bytes(b"other")
        assert fingerprint(tmp_path / "recording") != before

    @pytest.mark.parametrize(
        ("recording", "file"),
        [
            ("replica/room0", "replica/cam_params.json"),
            ("replica/room0", "replica/room0_mesh.ply"),
            ("posed_images/scene0000_00", "scans/scene0000_00/scene0000_00_vh_clean_2.ply"),
            ("scene/dslr", "scene/scans/mesh_aligned_0.05.ply"),
            ("scene/sparse/0", "scene/images/left/0.jpg"),
            ("scene/sparse/0", "scene/dense/0/fused.ply"),
            ("scene/colmap", "scene/images/0.jpg"),
            ("scene/part/0", "scene/images/0.jpg"),
        ],
    )
    def test_what_lies_around_it(self, recording, file, tmp_path):
        """A cloud that was fused with another camera was taken from the cache."""
        recording, file = tmp_path / recording, tmp_path / file
        recording.mkdir(parents=True)
        if "scene/" in str(recording):
            (recording / ("transforms.json" if recording.name == "colmap" else "cameras.bin")).write_bytes(b"")
        file.parent.mkdir(parents=True, exist_ok=True)
        found = {fingerprint(recording)}
        for content in (b"one", b"other"):
            file.write_bytes(content)
            found.add(fingerprint(recording))
        assert len(found) == 3
        (recording.parent / "mine.txt").write_bytes(b"")
        assert fingerprint(recording) in found

    @pytest.mark.parametrize("name", ["predictions.npz", "transforms.json"])
    def test_a_file_that_is_read_with_its_folder(self, name, tmp_path):
        """Another cloud beside VGGT's file was not noticed; another recording was taken for a change of the first."""
        for folder in ("one", "other"):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / name).write_bytes(b"")
        before = fingerprint(tmp_path / "one" / name)
        (tmp_path / "other" / name).write_bytes(b"other")
        assert fingerprint(tmp_path / "one" / name) == before
        (tmp_path / "one" / "cloud.ply").write_bytes(b"")
        assert fingerprint(tmp_path / "one" / name) != before

    def test_a_scan_is_its_files_and_no_others(self, tmp_path):
        """A log beside a scan was told as a change of the scan while it was segmented."""
        scan, calibration = tmp_path / "velodyne" / "000001.bin", tmp_path / "calib" / "000001.txt"
        for file in (scan, calibration):
            file.parent.mkdir()
            file.write_bytes(b"one")
        found = {fingerprint(scan)}
        (scan.parent / "run.log").write_bytes(b"")
        (scan.parent / "000002.bin").write_bytes(b"one")
        (scan.parent / "000001.partial").mkdir()  # of a run in this folder
        assert {fingerprint(scan)} == found
        for file in (scan, calibration):
            file.write_bytes(b"other")
            found.add(fingerprint(scan))
        assert len(found) == 3

    def test_a_relative_path_is_the_same_recording(self, tmp_path, monkeypatch, scene_of):
        write_folder(tmp_path / "recording", scene_of(2))
        monkeypatch.chdir(tmp_path)
        assert fingerprint(Path("recording")) == fingerprint(tmp_path / "recording")

    def test_links_that_lead_back(self, tmp_path):
        (tmp_path / "0.png").write_bytes(b"one")
        (tmp_path / "again").symlink_to(tmp_path)
        assert fingerprint(tmp_path)

    def test_a_result_inside_the_recording_does_not_count(self, tmp_path):
        (tmp_path / "0.png").write_bytes(b"one")
        out = tmp_path / "results" / "out"
        out.parent.mkdir()
        before = fingerprint(tmp_path, own_files(out))
        with output_folder(out, "source") as partial:
            (partial / "half").write_text("x")
            assert fingerprint(tmp_path, own_files(out)) == before
        assert fingerprint(tmp_path, own_files(out)) == before
        assert fingerprint(tmp_path) != before

    def test_what_is_not_there_is_not_looked_for_elsewhere(self):
        """Of a file that stands alone its folder counts, which is the whole disk for a missing one right below /."""
        with pytest.raises(FileNotFoundError, match="/nowhere does not exist"):
            fingerprint(Path("/nowhere"))


def test_a_pose_without_its_image_is_told(tmp_path, synthetic):
    folder = write_folder(tmp_path / "scene", synthetic)
    (folder / "frame-000010.color.png").unlink()
    with pytest.warns(UserWarning, match=r"1 of 6 images have a pose, but are missing, and are left out"):
        assert len(tj.load_scene(folder).frames) == 5


def test_a_truth_whose_largest_number_may_be_void_is_told(tmp_path, synthetic):
    recording = write_folder(tmp_path / "recording", synthetic)
    labels = synthetic.point_labels.numpy().copy()
    labels[:9] = -1
    np.save(recording / "cloud.truth.npy", labels.astype(np.uint16))
    with pytest.warns(UserWarning, match="65535") as told:  # and not that this file is not read
        tj.load_scene(recording)
    assert all("65535 is a label; if it was -1" in str(one.message) for one in told)
    assert f"{recording / 'cloud.truth.npy'}: 65535 is" in str(told[0].message)
