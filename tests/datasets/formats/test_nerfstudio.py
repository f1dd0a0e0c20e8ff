"""transforms.json of nerfstudio and instant-ngp."""

import json
import math
import shutil

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from posed_files import assert_same_frames, assert_same_segmentation, eight_bits, save_depth, save_image

import torchjoint as tj
from torchjoint.datasets.cameras import Camera
from torchjoint.datasets.files.ply import write_cloud

#: What nerfstudio did to the world of COLMAP; the poses and the cloud are after it.
APPLIED = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-0.0, -1.0, -0.0, -0.0]]


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3)


def intrinsics_of(frame):
    k = frame.intrinsics
    height, width = frame.size
    return {
        "fl_x": float(k[0, 0]), "fl_y": float(k[1, 1]), "cx": float(k[0, 2]) + 0.5, "cy": float(k[1, 2]) + 0.5,
        "w": width, "h": height,
    }  # fmt: skip


def write(folder, synthetic):
    frames = []
    for index, frame in enumerate(synthetic.scene.frames):
        save_image(folder / "images" / f"frame_{index + 1:05d}.png", frame.image)
        camera_to_world = np.linalg.inv(frame.world_to_camera.numpy())
        camera_to_world[:, 1:3] *= -1
        matrix = camera_to_world.tolist()
        frames.insert(0, {"file_path": f"./images/frame_{index + 1:05d}.png", "transform_matrix": matrix})
    values = {"camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "applied_transform": APPLIED}
    values |= intrinsics_of(synthetic.scene.frames[0]) | {"ply_file_path": "sparse_pc.ply", "frames": frames}
    save(folder, values)
    write_cloud(folder / "sparse_pc.ply", synthetic.scene.points, synthetic.scene.colors)
    return folder


def save(folder, values):
    (folder / "transforms.json").write_text(json.dumps(values))


def read(folder):
    return json.loads((folder / "transforms.json").read_text())


@pytest.fixture
def folder(tmp_path, synthetic):
    return write(tmp_path / "scene", synthetic)


def test_a_scene_comes_back(folder, synthetic):
    scene, expected = tj.load_scene(folder), eight_bits(synthetic)
    assert_same_frames(scene.frames, expected.frames)
    assert [frame.name for frame in scene.frames] == [f"frame_{index:05d}" for index in range(1, 7)]
    assert torch.equal(scene.points, expected.points)
    assert_same_segmentation(scene, expected)


@pytest.mark.parametrize("turn", [1, 3, 6])
def test_a_turned_photograph_whose_size_is_not_given(folder, turn):
    """Its own size was taken for that of the camera, so that it always seemed to be right as it is stored."""
    values, tags = read(folder), Image.Exif()
    save(folder, {key: value for key, value in values.items() if key not in ("w", "h")})
    tags[ExifTags.Base.Orientation] = turn
    file = folder / "images" / "frame_00002.png"
    Image.open(file).save(file, exif=tags)
    if turn == 1:
        assert len(tj.load_scene(folder).frames) == 6
    else:
        with pytest.raises(ValueError, match=rf"frame_00002\.png: EXIF .*orientation {turn}.*turn the image, or"):
            tj.load_scene(folder)


def test_paths_of_windows(folder):
    values = read(folder)
    for frame in values["frames"]:
        frame["file_path"] = ".\\" + frame["file_path"].replace("/", "\\")
    save(folder, values)
    assert [frame.name for frame in tj.load_scene(folder).frames] == [f"frame_{index:05d}" for index in range(1, 7)]


def test_paths_without_suffix(folder):
    values = read(folder)
    for frame in values["frames"]:
        path = folder / frame["file_path"]
        Image.open(path).convert("RGB").save(path.with_suffix(".jpg"))
        path.unlink()
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    save(folder, values)
    assert len(tj.load_scene(folder).frames[0].image) == 3


def test_masks_of_frames_are_told(folder):
    values = read(folder)
    values["frames"][0] |= {"mask_path": "masks/frame_00001.png", "depth_path": "depth/1.png"}  # of instant-ngp
    save(folder, values)
    with pytest.warns(UserWarning, match="not read: mask_path, depth_path"):
        tj.load_scene(folder)


def test_a_frame_may_have_its_own_focal_length(folder):
    """That of the file does not win, also if it is given in another way."""
    values = read(folder)
    values["frames"][-1]["camera_angle_x"] = 1.0
    save(folder, values)
    first, second = tj.load_scene(folder).frames[:2]
    expected = first.size[1] / 2 / math.tan(0.5)
    assert first.intrinsics.diagonal()[:2].tolist() == pytest.approx([expected, expected])
    assert float(second.intrinsics[0, 0]) == values["fl_x"]


def test_files_of_a_folder_of_blender_are_its_scenes(folder):
    for name in ("train", "test"):
        (folder / f"transforms_{name}.json").write_bytes((folder / "transforms.json").read_bytes())
    (folder / "transforms.json").unlink()
    assert tj.datasets.list_scenes(folder) == {name: folder / f"transforms_{name}.json" for name in ("test", "train")}
    with pytest.raises(ValueError, match=r"is a data set; choose one of its scenes, such as .*transforms_test\.json"):
        tj.load_scene(folder)


def test_the_file_itself_can_be_given(folder):
    (folder / "transforms.json").rename(folder / "transforms_train.json")
    scene = tj.load_scene(folder / "transforms_train.json")
    assert len(scene.frames) == 6
    assert scene.name == "scene"


def test_axes_and_pixels_by_hand(folder):
    # A camera at (0, 0, 5) that looks along OpenGL's -z sees the origin 5 m ahead; what is up there is up here, -y.
    values = read(folder)
    values["frames"] = values["frames"][:1]
    values["frames"][0]["transform_matrix"] = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]
    save(folder, values | {"cx": 80, "cy": 60})
    frame = tj.load_scene(folder).frames[0]
    assert frame.world_to_camera.tolist() == [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]]
    assert frame.intrinsics[:2, 2].tolist() == [79.5, 59.5]  # the middle of 160 x 120 pixels


class TestIntrinsics:
    def test_of_each_frame(self, folder, synthetic):
        values = read(folder)
        for frame in values["frames"]:
            frame |= intrinsics_of(synthetic.scene.frames[0])
        values["frames"][0]["fl_x"] = 99.0
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            del values[key]
        save(folder, values)
        assert [float(frame.intrinsics[0, 0]) for frame in tj.load_scene(folder).frames].count(99.0) == 1

    @pytest.mark.parametrize("also", [{}, {"camera_angle_y": 2 * np.arctan(0.5)}])
    def test_of_an_angle(self, folder, also):
        values = {
            key: value for key, value in read(folder).items() if key not in ("fl_x", "fl_y", "cx", "cy", "w", "h")
        }
        save(folder, values | {"camera_angle_x": np.pi / 2} | also)
        focal_y = 120.0 if also else 80.0
        expected = torch.tensor([[80, 0, 79.5], [0, focal_y, 59.5], [0, 0, 1]], dtype=torch.float64)
        torch.testing.assert_close(tj.load_scene(folder).frames[0].intrinsics, expected)

    def test_resized_images(self, folder):
        save(folder, read(folder) | {"w": 320, "h": 240, "fl_x": 200, "fl_y": 200, "cx": 160, "cy": 120})
        expected = torch.tensor([[100, 0, 79.5], [0, 100, 59.5], [0, 0, 1]], dtype=torch.float64)
        torch.testing.assert_close(tj.load_scene(folder).frames[0].intrinsics, expected)

    @pytest.mark.parametrize("model", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
    def test_fisheyes_are_undistorted(self, folder, model):
        lens = {"k1": 0.02, "k2": -0.01, "k3": 0.004, "k4": 0.001}
        save(folder, read(folder) | lens | model)
        camera = Camera(tj.load_scene(folder).frames[0].intrinsics, (120, 160), tuple(lens.values()), fisheye=True)
        image = torch.from_numpy(np.array(Image.open(folder / "images" / "frame_00001.png"))).permute(2, 0, 1)
        assert torch.equal(tj.load_scene(folder).frames[0].image, camera.frame(image, torch.eye(4)).image)

    def test_distorted_images_are_undistorted(self, folder):
        save(folder, read(folder) | {"k1": -0.2, "p2": 0.01})
        frame = tj.load_scene(folder).frames[0]
        assert frame.size == (120, 160)
        assert float(frame.intrinsics[0, 0]) < read(folder)["fl_x"]  # all of a barrel's pixels: a wider view
        save(folder, read(folder) | {"k1": 0, "p2": 0, "distortion_params": [-0.2, 0, 0, 0, 0, 0.01]})
        assert torch.equal(tj.load_scene(folder).frames[0].image, frame.image)

    @pytest.mark.parametrize(
        ("of_all", "of_frame"),
        [
            ({"distortion_params": [-0.2, 0, 0, 0, 0, 0]}, {"k1": 0}),
            ({"k1": -0.2}, {"k1": 0, "distortion_params": [0] * 6}),
        ],
    )
    def test_the_lens_of_a_frame_goes_before_that_of_all(self, folder, of_all, of_frame):
        plain = tj.load_scene(folder).frames[1].image
        values = read(folder)
        for frame in values["frames"]:
            frame |= of_frame
        save(folder, values | of_all)
        assert torch.equal(tj.load_scene(folder).frames[1].image, plain)


@pytest.mark.filterwarnings("ignore:depth. 5 of 6 frames have no depth image")
class TestDepth:
    def load(self, folder, name, **values):
        transforms = read(folder) | values
        transforms["frames"][-1]["depth_file_path"] = name
        save(folder, transforms)
        return tj.load_scene(folder).frames[0].depth

    @pytest.mark.parametrize(("factor", "units"), [({}, 1000), ({"depth_unit_scale_factor": 0.0002}, 5000)])
    def test_images(self, folder, synthetic, factor, units):
        depth = synthetic.scene.frames[0].depth
        save_depth(folder / "depth" / "0.png", depth, units)
        torch.testing.assert_close(self.load(folder, "depth/0.png", **factor), depth, atol=0.5 / units + 1e-6, rtol=0)

    @pytest.mark.parametrize(
        ("dtype", "factor", "expected"),
        [
            (np.float32, {}, 3.0),
            (np.float64, {}, 3.0),
            (np.uint16, {}, 0.003),
            (np.float32, {"depth_unit_scale_factor": 0.5}, 1.5),
            (np.int32, {"depth_unit_scale_factor": 0.5}, 1.5),
        ],
    )
    def test_arrays(self, folder, dtype, factor, expected):
        np.save(folder / "0.npy", np.full((120, 160, 1), 3, dtype=dtype))
        torch.testing.assert_close(self.load(folder, "0.npy", **factor), torch.full((120, 160), expected))

    def test_unknown_depth_and_a_lower_resolution(self, folder):
        values = np.ones((60, 80), dtype=np.float32)
        values[0, :3] = [np.nan, np.inf, -1]
        np.save(folder / "0.npy", values)
        assert self.load(folder, "0.npy")[:2, :8].tolist() == [[0, 0, 0, 0, 0, 0, 1, 1]] * 2

    def test_the_largest_integer_is_unknown_as_in_an_image(self, folder):
        np.save(folder / "0.npy", np.where(np.arange(160) < 80, 65535, 2000).astype(np.uint16)[None].repeat(120, 0))
        assert self.load(folder, "0.npy").unique().tolist() == [0, 2]

    def test_a_cloud_is_fused(self, folder, synthetic):
        transforms = read(folder)
        del transforms["ply_file_path"]
        for index, frame in enumerate(reversed(transforms["frames"])):
            frame["depth_file_path"] = f"{index}.png"
            save_depth(folder / f"{index}.png", synthetic.scene.frames[index].depth, 1000)
        save(folder, transforms)
        scene = tj.load_scene(folder, voxel_size=0.05)
        assert torch.cdist(scene.points, synthetic.scene.points).amin(1).median() < 0.08

    @pytest.mark.parametrize("wrong", [np.zeros((120, 160, 3)), np.zeros((9, 160)), np.zeros((2, 2), dtype=complex)])
    def test_other_arrays(self, folder, wrong):
        np.save(folder / "0.npy", wrong)
        with pytest.raises(
            ValueError, match=r"depth of frame .*(expected shape|expected the aspect ratio)|0\.npy: .*expected numbers"
        ):
            self.load(folder, "0.npy")


class TestClouds:
    def test_cloud_ply_goes_first(self, folder):
        write_cloud(folder / "cloud.ply", torch.rand(7, 3))
        assert len(tj.load_scene(folder).points) == 7

    def test_one_that_is_missing(self, folder):
        (folder / "sparse_pc.ply").unlink()
        with pytest.raises(
            FileNotFoundError, match=r"sparse_pc\.ply: missing; expected the cloud that .*transforms\.json"
        ):
            tj.load_scene(folder)

    def test_none_at_all(self, folder):
        values = read(folder)
        del values["ply_file_path"]
        save(folder, values)
        with pytest.raises(ValueError, match=r"none has a depth image, and there is no cloud\.ply"):
            tj.load_scene(folder)


class TestPaths:
    def rename(self, folder, name):
        values = read(folder)
        values["frames"] = [values["frames"][0] | {"file_path": name}]
        save(folder, values)

    def test_without_suffix_and_with_alpha(self, folder):
        Image.new("RGBA", (160, 120), (255, 0, 0, 7)).save(folder / "r_0.png")
        self.rename(folder, "./r_0")
        frame = tj.load_scene(folder).frames[0]
        assert frame.image[:, 5, 5].tolist() == [1, 0, 0]
        assert frame.name == "r_0"

    def test_images_beside_the_folder(self, folder):
        shutil.move(folder / "images", folder.parent / "images")
        self.rename(folder, "../images/frame_00003.png")
        assert len(tj.load_scene(folder).frames) == 1

    @pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "images/../../x.png"])
    def test_elsewhere(self, folder, name):
        self.rename(folder, name)
        with pytest.raises(ValueError, match=r"transforms\.json: frames\[0\]: file_path: expected a file inside"):
            tj.load_scene(folder)

    def test_one_that_is_missing(self, folder):
        self.rename(folder, "images/7.png")
        with pytest.raises(
            FileNotFoundError, match=r"images/7\.png: missing; expected an image that .*frames\[0\] gives"
        ):
            tj.load_scene(folder)

    def test_frames_are_read_when_they_are_asked_for(self, folder):
        scene = tj.load_scene(folder)
        (folder / "images" / "frame_00002.png").write_bytes(b"no image")
        assert scene.frames[0].size == (120, 160)
        with pytest.raises(ValueError, match=r"frame_00002\.png: not a whole image"):
            scene.frames[1]


@pytest.mark.parametrize(
    ("of_all", "of_frame", "message"),
    [
        ({"fl_x": "500"}, {}, r"frames\[0\]: fl_x: expected a finite number, got '500'"),
        ({"fl_x": True}, {}, r"frames\[0\]: fl_x: expected a finite number, got True"),
        ({"fl_x": 10**400}, {}, r"frames\[0\]: fl_x: expected a finite number"),
        ({"fl_x": float("nan")}, {}, r"frames\[0\]: fl_x: expected a finite number, got nan"),
        ({"fl_x": None}, {}, r"frames\[0\]: expected fl_x or camera_angle_x, got neither"),
        ({"fl_x": None, "camera_angle_x": 4}, {}, r"frames\[0\]: camera_angle_x: expected an angle of view in radians"),
        ({"w": -1}, {}, r"frames\[0\]: w, h: expected a size in pixels"),
        ({"h": 300}, {}, r"image 'frame_0000\d' of .*: expected the aspect ratio of 160 x 300 pixels, got 160 x 120"),
        ({"fl_y": -5}, {}, r"intrinsics of .*frames\[0\]: expected \[\[fx"),
        ({"camera_model": "EQUIRECT"}, {}, r"frames\[0\]: camera_model: .* got 'EQUIRECT'; undistort the images first"),
        ({"k4": 0.1}, {}, r"frames\[0\]: k4: expected 0 for a perspective camera, got 0\.1"),
        ({"k5": 0.1}, {}, r"frames\[0\]: k5: expected 0 for a perspective camera, got 0\.1"),
        ({"ftheta_p1": 0.1}, {}, r"frames\[0\]: ftheta_p1: expected 0 for a perspective camera, got 0\.1"),
        ({"p1": 0.1, "is_fisheye": True}, {}, r"frames\[0\]: p1: expected 0 for a fisheye camera, got 0\.1"),
        (
            {"distortion_params": [0] * 6, "k1": 0.1},
            {},
            r"k1: expected 0\.0 as in distortion_params, or 0, got another",
        ),
        ({"K1": 0.1, "k1": None}, {}, r"frames\[0\]: expected the key 'k1', got 'K1'"),
        ({}, {"Depth_File_Path": "a.png"}, r"frames\[0\]: expected the key 'depth_file_path', got 'Depth_File_Path'"),
        ({"frames": {}}, {}, r"transforms\.json: frames: expected a list, got dict"),
        ({"frames": []}, {}, r"transforms\.json: frames: expected at least one, got none"),
        ({"frames": [3]}, {}, r"transforms\.json: frames\[0\]: expected an object, got 3"),
        ({}, {"transform_matrix": None}, r"frames\[0\]: transform_matrix: missing"),
        ({}, {"transform_matrix": [[1, 2, 3]]}, r"frames\[0\]: transform_matrix: expected rows of 4 numbers, got list"),
        (
            {},
            {"transform_matrix": [[1, 2, 3, "4"]]},
            r"frames\[0\]: transform_matrix: expected a finite number, got '4'",
        ),
        ({}, {"transform_matrix": [[1, 0, 0, 0]]}, r"transform_matrix: expected shape \[4, 4\], got \[1, 4\]"),
        ({}, {"transform_matrix": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]}, r"transform_matrix: expected a rigid"),
        ({}, {"file_path": 3}, r"frames\[0\]: file_path: expected a string, got 3"),
        ({}, {"file_path": "images/frame_00001.png"}, r"frames: image '.*images/frame_00001\.png' is there twice"),
        (
            {},
            {"depth_file_path": "sparse_pc.ply", "depth_unit_scale_factor": 0},
            r"scale_factor: expected the metres per unit, above 0",
        ),
        ({"depth_file_path": "sparse_pc.ply"}, {}, r"json: depth image 'sparse_pc\.ply' is there twice"),
    ],
)
def test_wrong_values(folder, of_all, of_frame, message):
    values = read(folder)
    values["frames"][0] |= of_frame
    save(folder, values | of_all)
    with pytest.raises(ValueError, match=message):
        list(tj.load_scene(folder).frames)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"transforms\.json: not a whole JSON file"),
        ("[" * 100_000, r"transforms\.json: not a whole JSON file"),
        ("[]", r"transforms\.json: expected an object, got list"),
        ("{}", r"transforms\.json: frames: missing"),
    ],
)
def test_other_json(folder, text, message):
    (folder / "transforms.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)


def test_too_large_a_file(folder, monkeypatch):
    monkeypatch.setattr("torchjoint.runtime.bounds.JSON_BYTES", 100)
    with pytest.raises(ValueError, match=r"transforms\.json: expected at most 100 bytes of poses as of"):
        tj.load_scene(folder)
