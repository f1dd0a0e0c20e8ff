"""COLMAP's reconstructions, as text and binary."""

import functools
import math
import shutil
import struct

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from posed_files import assert_same_frames, assert_same_segmentation, eight_bits, quaternion_of, save_image

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud

NUMBERS = {
    "SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "FULL_OPENCV": 6,
    "OPENCV_FISHEYE": 5, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9,
}  # fmt: skip


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3)


def pinhole_of(frame):
    k = frame.intrinsics
    return [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5]


def write_cameras(model, kind, cameras):
    """`cameras`: id -> (model, width, height, parameters)."""
    if kind == "txt":
        lines = ["# Camera list with one line of data per camera:"]
        for key, (name, width, height, values) in cameras.items():
            lines.append(" ".join(map(str, (key, name, width, height, *values))))
        (model / "cameras.txt").write_text("\n".join(lines) + "\n")
        return
    data = struct.pack("<Q", len(cameras))
    for key, (name, width, height, values) in cameras.items():
        data += struct.pack(f"<IiQQ{len(values)}d", key, NUMBERS.get(name, name), width, height, *values)
    (model / "cameras.bin").write_bytes(data)


def write_images(model, kind, images):
    """`images`: (name, camera, world-to-camera); every other one has 2D points."""
    if kind == "txt":
        lines = ["# Image list with two lines of data per image:", "#   POINTS2D[] as (X, Y, POINT3D_ID)"]
        for index, (name, camera, pose) in enumerate(images):
            values = (*quaternion_of(pose[:3, :3]), *pose[:3, 3].tolist())
            lines.append(f"{900 - index} {' '.join(map(repr, map(float, values)))} {camera} {name}")
            lines.append("2362.39 248.498 58396 1784.7 268.254 -1" if index % 2 else "")
        (model / "images.txt").write_text("\n".join(lines) + "\n")
        return
    data = struct.pack("<Q", len(images))
    for index, (name, camera, pose) in enumerate(images):
        data += struct.pack("<I7dI", 900 - index, *quaternion_of(pose[:3, :3]), *pose[:3, 3].tolist(), camera)
        data += name.encode() + b"\0" + struct.pack("<Q", index % 2) + struct.pack("<ddq", 1.5, 2.5, -1) * (index % 2)
    (model / "images.bin").write_bytes(data)


def write_points(model, kind, points, colors):
    """By descending id, with tracks of two images or none."""
    values = [(p, (c * 255).round().int().tolist()) for p, c in zip(points.double().tolist(), colors, strict=True)]
    values = list(enumerate(values))[::-1]
    if kind == "txt":
        lines = ["# 3D point list with one line of data per point:"]
        for key, (point, color) in values:
            track = " 900 1 899 0" if key % 2 else ""
            lines.append(" ".join(map(repr, (key + 5, *point, *color, 1.25))) + track)
        (model / "points3D.txt").write_text("\n".join(lines) + "\n")
        return
    data = struct.pack("<Q", len(values))
    for key, (point, color) in values:
        data += struct.pack("<Q3d3BdQ", key + 5, *point, *color, 1.25, 2 * (key % 2))
        data += struct.pack("<IIII", 900, 1, 899, 0) * (key % 2)
    (model / "points3D.bin").write_bytes(data)


def images_of(synthetic):
    return [(f"{index}.png", 3, frame.world_to_camera) for index, frame in enumerate(synthetic.scene.frames)]


def write(folder, synthetic, kind, model="sparse/0"):
    model = folder / model
    model.mkdir(parents=True)
    for index, frame in enumerate(synthetic.scene.frames):
        save_image(folder / "images" / f"{index}.png", frame.image)
    write_cameras(model, kind, {3: ("PINHOLE", 160, 120, pinhole_of(synthetic.scene.frames[0]))})
    write_images(model, kind, images_of(synthetic)[::-1])
    write_points(model, kind, synthetic.scene.points, synthetic.scene.colors)
    return folder


@pytest.fixture(params=[pytest.param("txt", marks=pytest.mark.slow), "bin"])
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def written(synthetic, tmp_path_factory):
    """The folder of each kind, written once."""
    return functools.cache(lambda kind: write(tmp_path_factory.mktemp("written") / kind, synthetic, kind))


@pytest.fixture
def folder(tmp_path, written, kind):
    return shutil.copytree(written(kind), tmp_path / "scene")


@pytest.fixture
def model(folder):
    return folder / "sparse" / "0"


def test_a_reconstruction_comes_back(folder, synthetic):
    scene, expected = tj.load_scene(folder), eight_bits(synthetic)
    assert_same_frames(scene.frames, expected.frames)
    assert [frame.name for frame in scene.frames] == list("012345")
    assert torch.equal(scene.points, expected.points)
    torch.testing.assert_close(scene.colors, expected.colors, atol=1e-6, rtol=0)
    assert_same_segmentation(scene, expected)


def test_the_pose_by_hand(folder, model, kind):
    # 90 degrees about x (w x y z = .7071 .7071 0 0), then 1 2 3: the world's y comes to lie along the camera's z.
    pose = torch.tensor([[1.0, 0, 0, 1], [0, 0, -1, 2], [0, 1, 0, 3]], dtype=torch.float64)
    write_images(model, kind, [("0.png", 3, pose)])
    if kind == "txt":
        (model / "images.txt").write_text("1 0.70710678118 0.70710678118 0 0 1 2 3 3 0.png\n")  # and no second line
    frame = tj.load_scene(folder).frames[0]
    torch.testing.assert_close(frame.world_to_camera[:3], pose, atol=1e-9, rtol=0)
    torch.testing.assert_close(
        frame.world_to_camera @ torch.tensor([0.0, 1, 0, 1]).double(), torch.tensor([1.0, 2, 4, 1]).double()
    )


def test_frames_are_read_when_they_are_asked_for(folder):
    scene = tj.load_scene(folder)
    (folder / "images" / "1.png").write_bytes(b"no image")
    assert scene.frames[0].size == (120, 160)
    with pytest.raises(ValueError, match=r"1\.png: not a whole image"):
        scene.frames[1]


@pytest.mark.parametrize(
    ("place", "given"), [("sparse", "."), (".", "."), ("sparse/0", "sparse/0"), ("sparse", "sparse")]
)
def test_where_the_model_is(tmp_path, synthetic, place, given):
    folder = write(tmp_path / "scene", synthetic, "bin", place)
    write_cloud(folder / "fused.ply", torch.rand(7, 3))
    scene = tj.load_scene(folder / given)
    assert len(scene.frames) == 6
    assert len(scene.points) == 7


class TestCameras:
    def load(self, folder, kind, *camera):
        write_cameras(folder / "sparse" / "0", kind, {3: camera, 8: ("SIMPLE_PINHOLE", 9, 9, [1, 2, 3])})
        return tj.load_scene(folder).frames[0]

    def test_one_focal_length(self, folder, kind):
        frame = self.load(folder, kind, "SIMPLE_PINHOLE", 160, 120, [150, 80, 60])
        assert frame.intrinsics.tolist() == [[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]

    @pytest.mark.parametrize(
        ("name", "parameters", "distortion"),
        [
            ("SIMPLE_RADIAL", [150, 80, 60, -0.1], [-0.1]),
            ("RADIAL", [150, 80, 60, -0.1, 0.02], [-0.1, 0.02]),
            ("OPENCV", [150, 150, 80, 60, -0.1, 0.02, 0.003, -0.004], [-0.1, 0.02, 0.003, -0.004]),
            ("FULL_OPENCV", [150, 150, 80, 60, *range(8)], None),
        ],
    )
    def test_lens_distortion_is_undone(self, folder, kind, synthetic, name, parameters, distortion):
        if distortion is None:
            distortion = [-0.1, 0.02, 0.003, -0.004, 0.01, 0.02, -0.01, 0.005]
            parameters = parameters[:4] + distortion
        frame = self.load(folder, kind, name, 160, 120, parameters)
        # What the image has at the lens's place of a direction, the straight one has at the pinhole's.
        k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *[0.0] * 8)[:8]
        original = eight_bits(synthetic).frames[0].image
        x, y = 0.25, -0.2
        r = x * x + y * y
        radial = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
        distorted = (
            150 * (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)) + 79.5,
            150 * (y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y) + 59.5,
        )
        straight = (frame.intrinsics @ torch.tensor([x, y, 1.0]).double())[:2].tolist()
        torch.testing.assert_close(sample(frame.image, *straight), sample(original, *distorted), atol=0.05, rtol=0)

    @pytest.mark.parametrize(
        ("name", "parameters", "distortion"),
        [
            ("OPENCV_FISHEYE", [150, 150, 80, 60, 0.02, -0.01, 0.003, 0.001], [0.02, -0.01, 0.003, 0.001]),
            ("SIMPLE_RADIAL_FISHEYE", [150, 80, 60, 0.02], [0.02]),
            ("RADIAL_FISHEYE", [150, 80, 60, 0.02, -0.01], [0.02, -0.01]),
        ],
    )
    def test_a_fisheye_is_undone(self, folder, kind, synthetic, name, parameters, distortion):
        frame = self.load(folder, kind, name, 160, 120, parameters)
        k1, k2, k3, k4 = (*distortion, *[0.0] * 4)[:4]
        x, y = 0.25, -0.2
        radius = math.hypot(x, y)
        angle = math.atan(radius)
        scale = angle * (1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8) / radius
        assert frame.intrinsics.tolist() == [[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]
        torch.testing.assert_close(
            sample(frame.image, 150 * x + 79.5, 150 * y + 59.5),
            sample(eight_bits(synthetic).frames[0].image, 150 * x * scale + 79.5, 150 * y * scale + 59.5),
            atol=0.05,
            rtol=0,
        )

    @pytest.mark.parametrize(("turn", "camera"), [(6, (120, 160)), (8, (120, 160)), (6, (160, 120)), (1, (160, 120))])
    def test_a_photograph_with_an_exif_tag(self, folder, kind, turn, camera):
        width, height = camera
        file = sorted((folder / "images").iterdir())[0]
        stored, tags = Image.open(file), Image.Exif()
        tags[ExifTags.Base.Orientation] = turn
        stored.save(file, exif=tags)
        frame = self.load(folder, kind, "PINHOLE", width, height, [150, 150, 80, 60])
        if camera == (120, 160):
            stored = stored.transpose(Image.Transpose.ROTATE_270 if turn == 6 else Image.Transpose.ROTATE_90)
        assert torch.equal((frame.image * 255).round().byte(), torch.from_numpy(np.array(stored)).permute(2, 0, 1))

    @pytest.mark.parametrize("turn", [2, 3, 4])
    def test_a_turn_that_the_size_does_not_tell(self, folder, kind, turn):
        file = sorted((folder / "images").iterdir())[0]
        tags = Image.Exif()
        tags[ExifTags.Base.Orientation] = turn
        Image.open(file).save(file, exif=tags)
        with pytest.raises(ValueError, match=rf"{file.name}: EXIF .*orientation {turn}.*turn the image, or"):
            self.load(folder, kind, "PINHOLE", 160, 120, [150, 150, 80, 60])

    def test_resized_images(self, folder, kind):
        frame = self.load(folder, kind, "PINHOLE", 320, 240, [300, 302, 160, 120])
        assert frame.intrinsics.tolist() == [[150, 0, 79.5], [0, 151, 59.5], [0, 0, 1]]

    def test_rotated_images(self, folder, kind):
        with pytest.raises(
            ValueError,
            match=r"image '0' of .*cameras\.(txt: line 2|bin: camera 3): expected the aspect ratio of 120 x 160",
        ):
            self.load(folder, kind, "PINHOLE", 120, 160, [150, 150, 60, 80])

    @pytest.mark.parametrize(("name", "number"), [("FOV", 7), ("THIN_PRISM_FISHEYE", 10), ("X", 99)])
    def test_other_models(self, folder, kind, name, number):
        with pytest.raises(
            ValueError, match=rf"expected a camera model of .*{name if number < 99 else ''}.*image_undistorter"
        ):
            self.load(folder, kind, name if kind == "txt" else number, 160, 120, [150] * 8)

    @pytest.mark.parametrize("parameters", [[0, 80, 60], [float("nan"), 80, 60]])
    def test_wrong_numbers(self, folder, kind, parameters):
        with pytest.raises(ValueError, match=r"(intrinsics of )?.*cameras.*(expected|got)"):
            self.load(folder, kind, "SIMPLE_PINHOLE", 160, 120, parameters)


def sample(image, x, y):
    """Colours at a place, bilinear."""
    left, top = int(x), int(y)
    patch = image[:, top : top + 2, left : left + 2]
    right, down = x - left, y - top
    weights = torch.tensor([[(1 - right) * (1 - down), right * (1 - down)], [(1 - right) * down, right * down]])
    return (patch * weights).sum((1, 2))


class TestImages:
    def test_folders_and_spaces_in_names(self, folder, model, kind, synthetic):
        names = ["left cam/1.png", "right/1.png"]
        for name in names:
            save_image(folder / "images" / name, synthetic.scene.frames[0].image)
        write_images(model, kind, [(name, 3, torch.eye(4)) for name in names[::-1]])
        assert [frame.name for frame in tj.load_scene(folder).frames] == ["left cam_1", "right_1"]

    def test_smaller_ones_where_there_are_no_others(self, folder):
        (folder / "images").rename(folder / "images_4")
        for file in (folder / "images_4").iterdir():
            Image.open(file).resize((40, 30)).save(file)
        frame = tj.load_scene(folder).frames[0]
        assert frame.size == (30, 40)

    @pytest.mark.parametrize(
        ("images", "error", "message"),
        [
            ([], ValueError, r"images\.\w+: expected images with poses, got none"),
            ([("0.png", 3), ("0.png", 3)], ValueError, r"images\.\w+: image '0\.png' is there twice"),
            ([("0.png", 4)], ValueError, r"image '0\.png' is of camera 4, which .*cameras\.\w+ lacks"),
            (
                [("7.png", 3)],
                FileNotFoundError,
                r"its image '7\.png' is missing; looked for it in .*images, .*images_2",
            ),
            ([("0.png", 3), ("7.png", 3)], FileNotFoundError, r"7\.png: missing; expected an image of the model in"),
            ([("../../0.png", 3)], ValueError, r"expected a file inside .*, got '\.\./\.\./0\.png'"),
        ],
    )
    def test_wrong_ones(self, folder, model, kind, images, error, message):
        write_images(model, kind, [(*image, torch.eye(4)) for image in images])
        with pytest.raises(error, match=message):
            tj.load_scene(folder)


class TestClouds:
    @pytest.mark.parametrize("name", ["cloud.ply", "fused.ply", "dense/fused.ply", "dense/0/fused.ply"])
    def test_dense_ones_go_first(self, folder, model, name):
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        write_cloud(folder / name, torch.rand(7, 3))
        for file in model.glob("points3D.*"):
            file.unlink()
        assert len(tj.load_scene(folder).points) == 7

    def test_no_cloud(self, folder, model):
        for file in model.glob("points3D.*"):
            file.unlink()
        with pytest.raises(
            FileNotFoundError, match=r"points3D\.(bin|txt): missing; expected (a binary file|COLMAP's 3D points)"
        ):
            tj.load_scene(folder)

    def test_no_points(self, folder, model, kind):
        write_points(model, kind, torch.zeros(0, 3), torch.zeros(0, 3))
        with pytest.raises(ValueError, match=r"points3D\.\w+: expected points, got none"):
            tj.load_scene(folder)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras", "3 PINHOLE 160 120\n", r"cameras\.txt: line 1: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got"),
        ("cameras", "3 PINHOLE 160 120 1 2 3\n", r"cameras\.txt: line 1: expected 4 parameters of PINHOLE, got 3"),
        ("cameras", "3 PINHOLE 16.5 120 1 2 3 4\n", r"cameras\.txt: line 1: expected an integer, got '16\.5'"),
        ("cameras", "3 PINHOLE 160 120 1 2 3 x\n", r"cameras\.txt: line 1: expected finite numbers, got '1 2 3 x'"),
        ("cameras", 2 * "3 PINHOLE 160 120 1 2 3 4\n", r"cameras\.txt: camera 3 is there twice"),
        ("images", "# x\n\n1 1 0 0 0 0 0 3 0.png\n", r"images\.txt: line 3: expected IMAGE_ID QW QX QY QZ TX TY TZ"),
        ("images", "1 1 1 0 0 0 0 0 3 0.png\n", r"images\.txt: expected unit quaternions, got 1 others, such as"),
        (
            "images",
            "1 1 0 0 0 0 0 0 3 0.png\n2 1 0 0 0 0 0 0 3 1.png\n",
            r"images\.txt: line 2: expected 2D points X Y POINT3D_ID of the image above, or an empty line, got '2 1 0",
        ),
        (
            "images",
            "1 1 0 0 0 0 0 0 3 a b c.png\n2 1 0 0 0 0 0 0 3 d e f.png\n",
            r"images\.txt: line 2: expected finite numbers, got 'd e f.png'",
        ),
        ("points3D", "1 0 0 0 1 2 3\n", r"points3D\.txt: line 1: expected POINT3D_ID X Y Z R G B ERROR TRACK, got"),
        ("points3D", "1 0 0 0 1 2 300 1\n", r"points3D\.txt: expected colours of 0 to 255, got 1 to 300"),
        ("points3D", "1 0 0 inf 1 2 3 1\n", r"points3D\.txt: line 1: expected finite numbers"),
    ],
)
def test_text_that_is_wrong(tmp_path, synthetic, name, text, message):
    folder = write(tmp_path / "scene", synthetic, "txt")
    (folder / "sparse" / "0" / f"{name}.txt").write_text(text)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)


class TestBinary:
    @pytest.fixture
    def kind(self):
        return "bin"

    @pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
    def test_counts_are_checked_against_the_file(self, folder, model, name):
        file = model / f"{name}.bin"
        file.write_bytes(struct.pack("<Q", 1 << 60) + file.read_bytes()[8:])
        with pytest.raises(ValueError, match=rf"{name}\.bin: truncated: {1 << 60} records at byte 8 are more than"):
            tj.load_scene(folder)

    @pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
    def test_the_end(self, folder, model, name):
        file = model / f"{name}.bin"
        whole = file.read_bytes()
        file.write_bytes(whole + b"xyz")
        with pytest.raises(ValueError, match=rf"{name}\.bin: expected the end at byte {len(whole)}, got 3 more bytes"):
            tj.load_scene(folder)
        for kept in (b"", whole[:-1], whole[:20]):
            file.write_bytes(kept)
            with pytest.raises(ValueError, match=rf"{name}\.bin: (is empty|truncated)"):
                tj.load_scene(folder)

    def test_names_end(self, folder, model):
        data = (model / "images.bin").read_bytes()
        (model / "images.bin").write_bytes(data[:72] + b"a" * 10_000)
        with pytest.raises(ValueError, match=r"images\.bin: expected a string of at most 4096 bytes at byte 72"):
            tj.load_scene(folder)

    def test_it_goes_before_text(self, folder, model):
        (model / "images.txt").write_text("nonsense")
        assert len(tj.load_scene(folder).frames) == 6

    @pytest.mark.parametrize("lost", ["cameras", "images", "points3D"])
    def test_one_kind_of_files_is_read(self, folder, model, synthetic, lost):
        """As COLMAP does: a camera of one model is not that of another."""
        text = model.parent.parent / "text"
        write(text, synthetic, "txt", "sparse/0")
        expected = tj.load_scene(text)
        for part in ("cameras", "images", "points3D"):
            shutil.copy(text / "sparse" / "0" / f"{part}.txt", model)
        data = (model / "cameras.bin").read_bytes()
        (model / "cameras.bin").write_bytes(data[:32] + struct.pack("<d", 1000) + data[40:])  # of another camera
        (model / f"{lost}.bin").unlink()
        assert torch.equal(tj.load_scene(folder).frames[0].intrinsics, expected.frames[0].intrinsics)

    @pytest.mark.parametrize(
        ("name", "place", "layout", "value", "message"),
        [
            ("images", 8, "I", None, "image [0-9]+ is there twice"),
            ("points3D", 8, "Q", None, "point [0-9]+ is there twice"),
            ("points3D", 16, "d", float("nan"), "1 of [0-9]+ points are NaN or infinite; --drop-invalid"),
            ("points3D", 24, "d", 1e300, r"expected coordinates up to 1e\+12, got 1e\+300"),
        ],
    )
    def test_wrong_numbers_in_it(self, folder, model, name, place, layout, value, message):
        file = model / f"{name}.bin"
        content = bytearray(file.read_bytes())
        if value is None:  # the id of the second
            value = struct.unpack_from(f"<{layout}", content, place)[0] - 1
        struct.pack_into(f"<{layout}", content, place, value)
        file.write_bytes(content)
        with pytest.raises(ValueError, match=rf"{name}\.bin: {message}"):
            tj.load_scene(folder)
