"""Cameras of other conventions."""

import numpy as np
import pytest
import torch

from torchjoint.datasets.cameras import (
    Camera,
    pinhole_matrix,
    resize_depth,
    rotations_from_quaternions,
    scale_intrinsics,
    undistort,
)
from torchjoint.datasets.files.text import frame_names, path_inside

HALF = 0.5**0.5


class TestQuaternions:
    """x y z w."""

    @pytest.mark.parametrize(
        ("quaternion", "matrix"),
        [
            ([0, 0, 0, 1], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
            ([HALF, 0, 0, HALF], [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),  # 90 degrees about x: y to z
            ([0, HALF, 0, HALF], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),  # about y: z to x
            ([0, 0, HALF, HALF], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # about z: x to y
            ([0, 0, -HALF, -HALF], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
            ([0, 0, 0.707, 0.707], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # few digits
            ([1, 0, 0, 0], [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ],
    )
    def test_by_hand(self, quaternion, matrix):
        got = rotations_from_quaternions(np.array([quaternion], dtype=np.float64), "it").as_matrix()[0]
        np.testing.assert_allclose(got, matrix, atol=1e-12)

    @pytest.mark.parametrize("wrong", [[0, 0, 0, 0], [0, 0, 0, 1.1], [np.nan, 0, 0, 1], [1e200, 0, 0, 0]])
    def test_others_are_refused(self, wrong):
        with pytest.raises(ValueError, match=r"poses\.txt: expected unit quaternions, got 1 others, such as"):
            rotations_from_quaternions(np.array([[0, 0, 0, 1], wrong], dtype=np.float64), "poses.txt")


class TestImagesOfAnotherSize:
    def test_twice_the_size(self):
        got = scale_intrinsics(pinhole_matrix(20, 21, 7.5, 5.5), (12, 16), (24, 32))
        assert got.tolist() == [[40, 0, 15.5], [0, 42, 11.5], [0, 0, 1]]

    def test_half_size_puts_the_first_centre_between_four_pixels(self):
        # In half the size, a pixel's centre lies between the centres of the four it is made of.
        half = scale_intrinsics(pinhole_matrix(2, 2, 0.5, 0.5), (12, 16), (6, 8))
        assert half.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

    @pytest.mark.parametrize(("old", "new"), [((1051, 1957), (262, 489)), ((480, 640), (48, 64)), ((7, 9), (14, 18))])
    def test_sizes_are_rounded(self, old, new):
        scaled = scale_intrinsics(pinhole_matrix(500, 500, 3, 4), old, new)
        assert float(scaled[0, 0]) == pytest.approx(500 * new[1] / old[1])

    @pytest.mark.parametrize("new", [(640, 480), (480, 600), (240, 322)])
    def test_rotated_and_cropped_images_are_refused(self, new):
        camera = Camera(pinhole_matrix(500, 500, 320, 240), (480, 640), name="cameras.txt: line 3")
        with pytest.raises(
            ValueError, match=r"image 'a' of cameras\.txt: line 3: expected the aspect ratio of 640 x 480 pixels"
        ):
            camera.frame(torch.zeros(3, *new, dtype=torch.uint8), torch.eye(4), name="a")

    def test_depth_is_of_the_nearest_pixel(self):
        depth = torch.tensor([[1.0, 2.0], [3.0, 0.0]])
        assert resize_depth(depth, (2, 2)) is depth
        assert resize_depth(depth, (4, 4)).tolist() == [[1, 1, 2, 2], [1, 1, 2, 2], [3, 3, 0, 0], [3, 3, 0, 0]]
        assert resize_depth(resize_depth(depth, (6, 6)), (2, 2)).tolist() == depth.tolist()
        with pytest.raises(
            ValueError, match="depth of frame 'a': expected the aspect ratio of 2 x 2 pixels, got 4 x 2"
        ):
            resize_depth(depth, (2, 4), "a")


class TestDistortion:
    """Dots drawn where the model says that the lens puts them are found where the pinhole puts them."""

    SIZE = (120, 160)
    MATRIX = pinhole_matrix(150, 140, 81, 57)
    DISTORTION = (-0.2, 0.05, 0.004, -0.003, 0.01)

    def distorted(self, x, y):
        k1, k2, p1, p2, k3 = self.DISTORTION
        square = x * x + y * y
        radial = 1 + k1 * square + k2 * square**2 + k3 * square**3
        return (
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        )

    def dot(self, x, y):
        """A dot around a pixel, of 3 px."""
        rows, columns = np.mgrid[: self.SIZE[0], : self.SIZE[1]]
        values = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)
        return torch.from_numpy(values.round().astype(np.uint8)).expand(3, -1, -1)

    @pytest.mark.parametrize("direction", [(0.0, 0.0), (-0.35, -0.3), (0.4, 0.3), (-0.4, 0.25), (0.35, -0.28)])
    def test_a_grid_of_dots(self, direction):
        x, y = self.distorted(*direction)
        image = self.dot(150 * x + 81, 140 * y + 57)
        depth = torch.where(image[0] > 100, 2.0, 1.0)
        straight, straight_depth, matrix = undistort(image, depth, self.MATRIX, self.DISTORTION)
        expected = (matrix @ torch.tensor([*direction, 1.0], dtype=torch.float64))[:2]
        weight = straight[0].double()
        for axis, coordinate in ((1, expected[0]), (0, expected[1])):
            profile = weight.sum(1 - axis)
            center = (profile * torch.arange(len(profile))).sum() / profile.sum()
            assert float(center) == pytest.approx(float(coordinate), abs=0.15)
        assert set(straight_depth.unique().tolist()) == {1.0, 2.0}  # no means of the two, and no holes at the border
        assert straight_depth[round(float(expected[1])), round(float(expected[0]))] == 2

    def test_no_distortion_changes_nothing(self):
        image = self.dot(30, 40).contiguous()
        frame = Camera(self.MATRIX, self.SIZE, (0.0, 0.0, 0.0, 0.0)).frame(image, torch.eye(4))
        assert torch.equal(frame.image, image.float() / 255)
        assert torch.equal(frame.intrinsics, self.MATRIX)

    @pytest.mark.slow
    def test_resized_and_distorted(self):
        image = self.dot(30, 40).contiguous()
        small = Camera(scale_intrinsics(self.MATRIX, self.SIZE, (240, 320)), (240, 320), self.DISTORTION)
        direct = Camera(self.MATRIX, self.SIZE, self.DISTORTION)
        one, other = (camera.frame(image, torch.eye(4)) for camera in (small, direct))
        torch.testing.assert_close(one.intrinsics, other.intrinsics)
        assert torch.equal(one.image, other.image)

    @pytest.mark.parametrize(
        "wrong", [(1e6, 0, 0, 0), (-30, 0, 0, 0), (0, 0, 50, 0), (-0.9, 0, 0, 0), (0, 0, 0, 0, 0, -5, 0, 0)]
    )
    def test_what_cannot_be_undone(self, wrong):
        with pytest.raises(ValueError, match=r"camera: (distortion .* cannot be undone|images of .* cannot be)"):
            undistort(self.dot(30, 40), None, self.MATRIX, wrong)

    @pytest.mark.parametrize("wrong", [(1e6, 0, 0, 0), (-3, 0, 0, 0), (3, 0, 0, 0)])
    def test_a_fisheye_that_cannot_be_undone(self, wrong):
        with pytest.raises(ValueError, match=r"camera: (distortion .* cannot be undone|images of .* cannot be)"):
            undistort(self.dot(30, 40), None, self.MATRIX, wrong, fisheye=True)

    def test_a_fisheye_keeps_its_depth(self):
        depth = torch.full(self.SIZE, 2.0)
        straight, of_pixels, matrix = undistort(self.dot(81, 57), depth, self.MATRIX, (0.01, 0, 0, 0), fisheye=True)
        assert straight[0].argmax() == 57 * 160 + 81  # the middle stays
        assert (of_pixels == 2).all()
        assert torch.equal(matrix, self.MATRIX)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ((pinhole_matrix(float("nan"), 1, 0, 0),), "intrinsics of c: expected finite values"),
            ((pinhole_matrix(-1, 1, 0, 0),), r"intrinsics of c: expected \[\[fx, 0, cx\]"),
            ((pinhole_matrix(1, 1, 0, 0), (0, 3)), "c: expected images of at least one pixel, got 3 x 0"),
            ((pinhole_matrix(1, 1, 0, 0), (2, 3), (float("inf"),)), "c: expected finite distortion coefficients"),
        ],
    )
    def test_bad_cameras(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            Camera(*arguments, name="c")


class TestPaths:
    def test_inside(self, tmp_path):
        assert path_inside(tmp_path, "images/../a.png", "list") == tmp_path / "a.png"
        assert path_inside(tmp_path, str(tmp_path / "a.png"), "list") == tmp_path / "a.png"
        beside = tmp_path.parent / "images"
        assert path_inside(tmp_path, "../images/a.png", "list", or_inside=[beside]) == beside / "a.png"
        assert path_inside(tmp_path, "..a.png", "list") == tmp_path / "..a.png"
        assert path_inside(tmp_path, ".\\images\\a.png", "list") == tmp_path / "images" / "a.png"
        (tmp_path / "a\\b.png").touch()
        assert path_inside(tmp_path, "a\\b.png", "list") == tmp_path / "a\\b.png"

    @pytest.mark.parametrize("name", ["../a.png", "/etc/passwd", "images/../../a.png", "..", ".", "..\\a.png"])
    def test_outside(self, tmp_path, name):
        with pytest.raises(ValueError, match=r"list: expected a file inside .*; give a relative path, without"):
            path_inside(tmp_path, name, "list", or_inside=[tmp_path.parent / "images"])

    @pytest.mark.parametrize("name", ["", "a\0b", "x" * 300, "a/" * 3000, "\ud800"])
    def test_no_name(self, tmp_path, name):
        told = "" if name.isascii() else r" \(LC_ALL: utf-8\)"
        with pytest.raises(ValueError, match=rf"list: expected a path of a file, got .*'{told}$"):
            path_inside(tmp_path, name, "list")

    @pytest.mark.parametrize(
        ("files", "names"),
        [
            (["rgb/1305031102.175304.png"], ["1305031102.175304"]),
            (["./a/1.png", "a/2.jpg"], ["1", "2"]),
            (["a/1.png", "a/1.jpg"], ["1.png", "1.jpg"]),
            (["1.png", "a/b/1.png"], ["1", "a_b_1"]),
            (["/x/a/1.png", "/x/b/1.png"], ["a_1", "b_1"]),
        ],
    )
    def test_names_of_frames(self, files, names):
        assert frame_names(files) == names
