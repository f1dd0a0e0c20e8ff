"""ScanNet's scans: the sensor stream, exported frames, cameras of another resolution, instances."""

import json
import struct
import zipfile
import zlib

import numpy as np
import pytest
import torch
from PIL import Image
from scannet_files import (
    Shot,
    lost,
    shots_of,
    write_exported,
    write_image_truth,
    write_info,
    write_intrinsics,
    write_mesh,
    write_point_truth,
    write_sens,
)

import torchjoint as tj
from torchjoint.datasets.cameras import register_depth, resize_nearest
from torchjoint.datasets.formats.scannet import Calibration, SensFile, find_cameras

SCAN = "scene0011_00"


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3, num_views=4)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / SCAN).mkdir()
    return tmp_path / SCAN


def write_annotated(folder, synthetic):
    scene = synthetic.scene
    write_mesh(folder / f"{SCAN}_vh_clean_2.ply", scene.points, (scene.colors * 255).round())
    write_point_truth(folder, SCAN, synthetic.point_labels)
    write_image_truth(folder, synthetic.image_labels)


def check(scene, synthetic, kept):
    """A scene against what was written, but for the frames that were lost."""
    intrinsics = synthetic.scene.frames[0].intrinsics
    torch.testing.assert_close(scene.points, synthetic.scene.points)
    torch.testing.assert_close(scene.colors, synthetic.scene.colors, atol=0.003, rtol=0)
    assert [frame.name for frame in scene.frames] == [str(i) for i in kept]
    for frame, i in zip(scene.frames, kept, strict=True):
        expected = synthetic.scene.frames[i]
        assert (frame.image - expected.image).abs().mean() < 0.02  # JPEG
        torch.testing.assert_close(frame.intrinsics, intrinsics, atol=1e-4, rtol=0)
        torch.testing.assert_close(frame.world_to_camera, expected.world_to_camera, atol=2e-5, rtol=0)
        torch.testing.assert_close(frame.depth, expected.depth, atol=0.0006, rtol=0)
    assert torch.equal(scene.truth.points, synthetic.point_labels)
    assert len(scene.truth.images) == len(kept)
    for labels, i in zip(scene.truth.images, kept, strict=True):
        assert torch.equal(labels, synthetic.image_labels[i])


def test_a_scan_comes_back(folder, synthetic):
    shots = list(shots_of(synthetic.scene))
    shots[1] = lost(shots[1])
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(folder / f"{SCAN}.sens", shots, intrinsics, intrinsics)
    write_annotated(folder, synthetic)
    check(tj.load_scene(folder), synthetic, [0, 2, 3])
    assert tj.load_scene(folder).name == SCAN
    check(tj.load_scene((folder / f"{SCAN}.sens").rename(folder / f"{SCAN}.SENS")), synthetic, [0, 2, 3])


@pytest.mark.parametrize("calibration", ["intrinsic/", "SCAN.txt"])
def test_exported_frames_come_back(folder, synthetic, calibration):
    shots = list(shots_of(synthetic.scene))
    shots[2] = lost(shots[2])
    write_exported(folder, shots)
    write_annotated(folder, synthetic)
    intrinsics = synthetic.scene.frames[0].intrinsics
    if calibration == "SCAN.txt":  # of a sensor of twice the resolution
        double = intrinsics * 2
        double[:2, 2] += 0.5
        double[2, 2] = 1
        write_info(folder / f"{SCAN}.txt", double.tolist(), intrinsics.tolist(), (240, 320), (120, 160))
    else:
        write_intrinsics(folder, intrinsics, intrinsics)
    check(tj.load_scene(folder), synthetic, [0, 1, 3])


def test_frames_are_in_the_order_of_their_numbers(folder):
    shot = Shot(np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.uint16), np.eye(4))
    write_exported(folder, [shot] * 12, step=20)
    write_mesh(folder / f"{SCAN}_vh_clean_2.ply", np.eye(3), np.zeros((3, 3)))
    write_intrinsics(folder, np.diag([8, 8, 1]), np.diag([8, 8, 1]))
    assert [frame.name for frame in tj.load_scene(folder).frames] == [str(20 * i) for i in range(12)]


def test_cameras_of_another_resolution():
    # ScanNet's own numbers: 1296 x 968 at half and at a quarter of the resolution.
    camera = Calibration(torch.tensor([[1170.0, 0, 647.75], [0, 1168, 483.75], [0, 0, 1]]).double(), ((968, 1296),))
    assert camera.scaled_to((484, 648)).tolist() == [[585, 0, 323.625], [0, 584, 241.625], [0, 0, 1]]
    assert camera.scaled_to((968, 1296)).tolist() == camera.intrinsics.tolist()
    # An intrinsic_color.txt does not say for which size it is: the principal point tells.
    guessed = Calibration(camera.intrinsics, ((968, 1296), (480, 640)), is_certain=False)
    assert guessed.scaled_to((484, 648)).tolist() == camera.scaled_to((484, 648)).tolist()
    fitting = Calibration(torch.tensor([[577.0, 0, 318], [0, 578, 241], [0, 0, 1]]).double(), ((968, 1296),), False)
    assert fitting.scaled_to((480, 640)).tolist() == fitting.intrinsics.tolist()


def test_exported_depth_has_the_colour_camera_s_view(tmp_path):
    """ScanNet's own numbers: what SCAN.txt tells of the depth sensor was before the two were aligned."""
    color = [[1170.187988, 0, 647.75], [0, 1170.187988, 483.75], [0, 0, 1]]
    depth = [[571.623718, 0, 319.5], [0, 571.623718, 239.5], [0, 0, 1]]
    write_info(tmp_path / "s.txt", color, depth, (968, 1296), (480, 640))
    got = find_cameras(tmp_path, tmp_path / "s.txt").depth.scaled_to((480, 640))
    torch.testing.assert_close(got.diagonal()[:2], torch.tensor([577.870611, 580.258506]).double())
    # Its intrinsic_depth.txt is just intrinsic_color.txt, scaled.
    exact = Calibration(
        torch.tensor([[1169.621094, 0, 646.295044], [0, 1167.105103, 489.927032], [0, 0, 1]]).double(), ((968, 1296),)
    )
    expected = torch.tensor([[577.590698, 0, 318.905426], [0, 578.729797, 242.683609], [0, 0, 1]]).double()
    torch.testing.assert_close(exact.scaled_to((480, 640)), expected, atol=5e-3, rtol=0)


def test_depth_is_brought_to_the_colour_image():
    depth = torch.arange(12, dtype=torch.float32).reshape(3, 4) + 1
    depth_camera = torch.tensor([[2.0, 0, 1.5], [0, 2, 1], [0, 0, 1]]).double()
    # Twice the resolution, and a wider view: its outermost columns look past the depth image.
    camera = torch.tensor([[4.0, 0, 4.5], [0, 4, 2.5], [0, 0, 1]]).double()
    got = register_depth(depth, depth_camera, camera, (6, 10))
    # Column u sees x = (u - 4.5) / 4, that is depth column 2 x + 1.5 = u / 2 - .75; row v depth row v / 2 - .25.
    columns = [None, 0, 0, 1, 1, 2, 2, 3, 3, None]
    rows = [0, 0, 1, 1, 2, 2]
    expected = [[0.0 if c is None else float(depth[r, c]) for c in columns] for r in rows]
    assert got.tolist() == expected
    with pytest.raises(ValueError, match="expected cameras without skew"):
        register_depth(depth, depth_camera, torch.tensor([[4.0, 1, 4.5], [0, 4, 2.5], [0, 0, 1]]).double(), (6, 10))


def test_labels_of_another_size():
    labels = torch.tensor([[0, 1], [2, 3]])
    assert resize_nearest(labels, (3, 4)).tolist() == [[0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]
    assert resize_nearest(torch.arange(6)[None], (1, 3)).tolist() == [[1, 3, 5]]


def test_instances_of_pixels_zipped_and_of_another_size(folder, synthetic):
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(folder / f"{SCAN}.sens", shots_of(synthetic.scene), intrinsics, intrinsics)
    write_annotated(folder, synthetic)
    with zipfile.ZipFile(folder / f"{SCAN}_2d-instance-filt.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in (folder / "instance-filt").iterdir():
            Image.open(file).resize((320, 240), Image.Resampling.NEAREST).save(file)
            archive.write(file, f"instance-filt/{file.name}")
            file.unlink()
    (folder / "instance-filt").rmdir()
    assert torch.equal(tj.load_scene(folder).truth.images[3], synthetic.image_labels[3])
    with zipfile.ZipFile(folder / f"{SCAN}_2d-instance-filt.zip", "w") as archive:
        archive.writestr("instance-filt/0.png", b"no image")
    with pytest.raises(
        FileNotFoundError, match=r"2d-instance-filt\.zip/instance-filt/1\.png: missing; expected the instances of every"
    ):
        tj.load_scene(folder)


def test_of_two_scans_in_a_folder_each_has_its_cloud(folder, synthetic, tmp_path, monkeypatch):
    """The second one got the fused cloud of the first one, from the cache."""
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    shots, intrinsics = list(shots_of(synthetic.scene)), synthetic.scene.frames[0].intrinsics
    for name, some in (("one", shots[:2]), ("two", shots[2:])):
        write_sens(folder / f"{name}.sens", some, intrinsics, intrinsics)
    one, two, again = (tj.load_scene(folder / f"{name}.sens", voxel_size=0.05).points for name in ("one", "two", "one"))
    assert torch.equal(one, again)
    assert one.shape != two.shape


@pytest.mark.slow
def test_a_damaged_archive(folder, synthetic):
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(folder / f"{SCAN}.sens", list(shots_of(synthetic.scene))[:1], intrinsics, intrinsics)
    file = folder / f"{SCAN}_2d-instance-filt.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("instance-filt/0.png", bytes(1000))
    with pytest.raises(ValueError, match=r"zip, instance-filt/0\.png: not a whole image"):
        tj.load_scene(folder).truth.images[0]
    whole = file.read_bytes()
    file.write_bytes(whole[:49] + b"\xff\xff" + whole[51:])
    with pytest.raises(ValueError, match=r"zip: instance-filt/0\.png in it is damaged"):
        tj.load_scene(folder).truth.images[0]
    file.write_bytes(whole[:40])
    with pytest.raises(ValueError, match="zip: not a whole archive"):
        tj.load_scene(folder)


def test_a_mesh_alone_is_a_scene(folder, synthetic):
    write_annotated(folder, synthetic)
    scene = tj.load_scene(folder)
    assert len(scene.frames) == 0
    assert torch.equal(scene.truth.points, synthetic.point_labels)
    assert not len(scene.truth.images)


def test_another_cloud_has_no_truth(folder, synthetic, tmp_path):
    write_annotated(folder, synthetic)
    write_mesh(tmp_path / "other.ply", np.eye(3), np.zeros((3, 3)))
    scene = tj.load_scene(folder, cloud=tmp_path / "other.ply")
    assert len(scene.points) == 3
    assert scene.truth is None


def test_a_cloud_is_fused_where_there_is_no_mesh(folder, synthetic):
    intrinsics = synthetic.scene.frames[0].intrinsics
    write_sens(folder / f"{SCAN}.sens", shots_of(synthetic.scene), intrinsics, intrinsics)
    scene = tj.load_scene(folder, voxel_size=0.05)
    distance = torch.cdist(scene.points, synthetic.scene.points).amin(1)
    assert len(scene.points) > 500
    assert distance.median() < 0.08


def test_the_data_set_s_scans_are_listed(tmp_path):
    for split, scan in (("scans", "scene0002_01"), ("scans", "scene0001_00"), ("scans_test", "scene0707_00")):
        (tmp_path / split / scan).mkdir(parents=True)
        write_mesh(tmp_path / split / scan / f"{scan}_vh_clean_2.ply", np.eye(3), np.zeros((3, 3)))
    (tmp_path / "scans" / "notes").mkdir()
    found = tj.datasets.list_scenes(tmp_path)
    assert list(found) == ["scene0001_00", "scene0002_01", "scene0707_00"]
    assert list(tj.datasets.list_scenes(tmp_path / "scans")) == ["scene0001_00", "scene0002_01"]
    assert len(tj.load_scene(found["scene0707_00"]).points) == 3


class TestStream:
    """What a .sens file claims is checked against its size before it is believed."""

    @pytest.fixture
    def file(self, tmp_path):
        rng = np.random.default_rng(0)
        shots = [
            Shot(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), np.full((3, 4), 1500 + i, np.uint16), np.eye(4))
            for i in range(3)
        ]
        write_sens(tmp_path / "s.sens", shots, np.diag([8, 8, 1]), np.diag([4, 4, 1]))
        return tmp_path / "s.sens"

    def patch(self, file, place, layout, *values):
        data = bytearray(file.read_bytes())
        struct.pack_into("<" + layout, data, place, *values)
        file.write_bytes(data)

    HEADER = 12 + len(b"StructureSensor") + 256  # up to the codecs

    def test_images_are_decoded_when_they_are_asked_for(self, file):
        data = file.read_bytes()
        second = [i for i in range(len(data)) if data[i : i + 3] == b"\xff\xd8\xff"][1]
        file.write_bytes(data[:second] + b"nojpeg" + data[second + 6 :])
        stream = SensFile(file)
        assert len(stream.poses) == 3
        assert stream.color(2).shape == (3, 6, 8)
        assert stream.depth(1).unique().tolist() == [pytest.approx(1.501)]
        with pytest.raises(ValueError, match=r"s\.sens, colour of frame 1: not a whole image"):
            stream.color(1)

    def test_images_of_another_aspect_ratio(self, file):
        self.patch(file, self.HEADER + 8, "II", 16, 12)
        assert SensFile(file).color(0).shape == (3, 6, 8)
        self.patch(file, self.HEADER + 8, "II", 16, 9)
        with pytest.raises(ValueError, match=r"frame 0: expected the aspect ratio of .*16 x 9 pixels, got 8 x 6"):
            list(tj.load_scene(file, voxel_size=0.1).frames)

    @pytest.mark.parametrize("count", [4, 2**40, 2**64 - 1])
    def test_more_frames_than_there_are(self, file, count):
        self.patch(file, self.HEADER + 28, "Q", count)
        with pytest.raises(ValueError, match=r"s\.sens: truncated: "):
            SensFile(file)

    @pytest.mark.parametrize("size", [10**5, 2**63, 2**64 - 1])
    def test_images_larger_than_the_file(self, file, size):
        place = self.HEADER + 36 + 64 + 16
        (depth,) = struct.unpack_from("<Q", file.read_bytes(), place + 8)
        self.patch(file, place, "Q", size)
        with pytest.raises(ValueError, match=rf"s\.sens: truncated: expected {size + depth} bytes"):
            SensFile(file)

    def test_a_name_longer_than_the_file(self, file):
        self.patch(file, 4, "Q", 2**62)
        with pytest.raises(ValueError, match=r"s\.sens: truncated: expected 4611686018427387904 bytes"):
            SensFile(file)

    def test_another_version_and_no_such_file(self, file):
        self.patch(file, 0, "I", 3)
        with pytest.raises(ValueError, match=r"expected a \.sens file of version 4, got version 3"):
            SensFile(file)
        file.write_bytes(b"")
        with pytest.raises(ValueError, match=r"s\.sens: is empty"):
            SensFile(file)
        with pytest.raises(FileNotFoundError, match=r"t\.sens: missing"):
            SensFile(file.with_name("t.sens"))

    @pytest.mark.parametrize(
        ("place", "layout", "value", "message"),
        [
            (0, "i", 0, "got codecs 0 and 1"),
            (4, "i", 2, "got codecs 2 and 2"),
            (8, "I", 2**31, "impossible image sizes 2147483648 x 6"),
            (20, "I", 0, "impossible image sizes 8 x 6, 4 x 0"),
            (24, "f", 0.0, "a positive number of depth units"),
            (24, "f", float("nan"), "a positive number of depth units"),
            (-256, "f", -8.0, "colour's intrinsics: expected"),
        ],
    )
    def test_impossible_headers(self, file, place, layout, value, message):
        self.patch(file, self.HEADER + place, layout, value)
        with pytest.raises(ValueError, match=message):
            SensFile(file)

    def test_depth_that_unpacks_to_something_else(self, tmp_path):
        shot = Shot(np.zeros((6, 8, 3), np.uint8), np.zeros((3, 4), np.uint16), np.eye(4))
        for number, depth in enumerate([zlib.compress(bytes(10**7)), zlib.compress(bytes(23)), b"x" * 30, b""]):
            file = tmp_path / f"{number}.sens"
            write_sens(file, [shot], np.diag([8, 8, 1]), np.diag([4, 4, 1]))
            data = file.read_bytes()
            blob = zlib.compress(bytes(24))
            start = data.rindex(blob)
            file.write_bytes(data[:start] + depth + data[start + len(blob) :])
            size_at = self.HEADER + 36 + 64 + 24
            self.patch(file, size_at, "Q", len(depth))
            with pytest.raises(ValueError, match=r"depth of frame 0: (expected|not) a .*zlib stream"):
                SensFile(file).depth(0)

    def test_depth_may_be_raw(self, tmp_path):
        raw = np.arange(12, dtype=np.uint16).reshape(3, 4) * 400
        raw[2, 3] = 65535
        shot = Shot(np.zeros((6, 8, 3), np.uint8), raw, np.eye(4))
        write_sens(tmp_path / "s.sens", [shot], np.eye(3), np.eye(3), shift=4000.0, codecs=(2, 0))
        expected = (raw / 4000).astype(np.float32)
        expected[2, 3] = 0
        np.testing.assert_allclose(SensFile(tmp_path / "s.sens").depth(0).numpy(), expected)


class TestTruth:
    """Annotations that do not fit."""

    @pytest.fixture
    def folder(self, folder):
        write_mesh(folder / f"{SCAN}_vh_clean_2.ply", np.arange(12).reshape(4, 3), np.zeros((4, 3)))
        write_point_truth(folder, SCAN, [0, 5, -1, 5])
        return folder

    def test_ids_are_the_objects(self, folder):
        assert tj.load_scene(folder).truth.points.tolist() == [0, 5, -1, 5]

    def test_of_another_mesh(self, folder):
        (folder / f"{SCAN}_vh_clean_2.0.010000.segs.json").write_text(json.dumps({"segIndices": [1, 2, 3]}))
        with pytest.raises(ValueError, match=r"segs\.json: expected the segments of 4 points, got 3"):
            tj.load_scene(folder)

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("[]", "expected an object, got list"),
            ('{"segIndices": 3}', "segIndices: expected a list of integers of at most 64 bits"),
            ('{"segIndices": [1, 2, 3, "4"]}', "segIndices: expected a list of integers of at most 64 bits"),
            ('{"segIndices": [1, 2, 3, 4.5]}', "segIndices: expected a list of integers of at most 64 bits"),
            (
                '{"segIndices": [1, 2, 3, 99999999999999999999]}',
                "segIndices: expected a list of integers of at most 64 bits",
            ),
            ('{"segIndices": [', "not a whole JSON file"),
            ("[" * 100_000, "not a whole JSON file"),
        ],
    )
    def test_segments_of_another_form(self, folder, content, message):
        (folder / f"{SCAN}_vh_clean_2.0.010000.segs.json").write_text(content)
        with pytest.raises(ValueError, match=rf"segs\.json: {message}"):
            tj.load_scene(folder)

    @pytest.mark.parametrize(
        ("groups", "message"),
        [
            ([{"objectId": -3, "segments": []}], r"segGroups\[0\]: objectId: expected an integer >= 0"),
            ([{"segments": []}], r"segGroups\[0\]: objectId: expected an integer >= 0"),
            ([[]], r"segGroups\[0\]: expected an object, got list"),
            ([{"objectId": 1}], r"segGroups\[0\]: segments: expected a list of integers"),
        ],
    )
    def test_objects_of_another_form(self, folder, groups, message):
        (folder / f"{SCAN}.aggregation.json").write_text(json.dumps({"segGroups": groups}))
        with pytest.raises(ValueError, match=rf"aggregation\.json: {message}"):
            tj.load_scene(folder)

    def test_without_segments(self, folder):
        (folder / f"{SCAN}_vh_clean_2.0.010000.segs.json").unlink()
        with pytest.raises(FileNotFoundError, match=r"segs\.json: missing"):
            tj.load_scene(folder)


class TestExported:
    """Folders that lack something."""

    @pytest.fixture
    def folder(self, folder):
        shot = Shot(np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.uint16), np.eye(4))
        write_exported(folder, [shot] * 2)
        write_intrinsics(folder, np.diag([8, 8, 1]), np.diag([8, 8, 1]))
        write_mesh(folder / f"{SCAN}_vh_clean_2.ply", np.eye(3), np.zeros((3, 3)))
        return folder

    def test_without_the_depth_s_intrinsics(self, folder):
        depth = np.zeros((3, 4), np.uint16)
        depth[1, 2] = 1500
        Image.fromarray(depth).save(folder / "depth" / "0.png")
        color = [[8, 0, 3.5, 0], [0, 8, 2.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        np.savetxt(folder / "intrinsic" / "intrinsic_color.txt", color)
        (folder / "intrinsic" / "intrinsic_depth.txt").unlink()
        read = tj.load_scene(folder).frames[0].depth
        assert read.shape == (6, 8)
        assert torch.equal(read > 0, torch.from_numpy(np.kron(depth, np.ones((2, 2))) > 0))

    @pytest.mark.parametrize("file", ["pose/1.txt", "intrinsic/intrinsic_color.txt", "instance-filt/1.png"])
    def test_a_missing_file(self, folder, file):
        write_image_truth(folder, np.zeros((2, 6, 8), dtype=int))
        (folder / file).unlink()
        with pytest.raises(FileNotFoundError, match=rf"{file}: missing"):
            tj.load_scene(folder)

    def test_depth_is_optional(self, folder):
        (folder / "depth" / "1.png").unlink()
        with pytest.warns(UserWarning, match="depth: 1 of 2 frames have no depth image"):
            frames = tj.load_scene(folder).frames
        assert frames[0].depth is not None
        assert frames[1].depth is None

    def test_two_images_of_one_frame(self, folder):
        Image.new("RGB", (8, 6)).save(folder / "color" / "1.png")
        with pytest.raises(ValueError, match="the colour image of frame '1' is there twice"):
            tj.load_scene(folder)

    def test_a_pose_that_is_none(self, folder):
        np.savetxt(folder / "pose" / "1.txt", np.ones((4, 4)))
        with pytest.raises(ValueError, match=r"pose/1\.txt: expected a rigid transform"):
            tj.load_scene(folder)

    @pytest.mark.parametrize(
        ("spoil", "message"),
        [
            (("mx_color", "mx_colour"), r"scene0011_00\.txt: mx_color: missing"),
            (("fx_color = 8", "fx_color = eight"), "expected finite numbers"),
            (("colorWidth = 8", "colorWidth = 1e99"), "expected an image size in pixels"),
            (("colorWidth = 8", "colorWidth = nan"), "expected finite numbers"),
            (("fy_color = 8", "fy_color = -8"), "txt, colour: expected"),
            (("fx_color", "fx_colour"), "scene0011_00.txt has no calibration"),
        ],
    )
    def test_bad_calibrations(self, folder, spoil, message):
        for name in ("color", "depth"):
            (folder / "intrinsic" / f"intrinsic_{name}.txt").unlink()
        info = folder / f"{SCAN}.txt"
        write_info(info, np.diag([8, 8, 1]), np.diag([8, 8, 1]), (6, 8), (6, 8))
        assert tj.load_scene(folder).frames[0].intrinsics[0, 0] == 8
        info.write_text(info.read_text().replace(*spoil))
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            tj.load_scene(folder)
