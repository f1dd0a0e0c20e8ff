"""Filled polygons: by hand, and against scikit-image's."""

import numpy as np
import pytest

from torchjoint.masks.rle import polygon_pixels


def filled_polygon(corners, size):
    filled = np.zeros(size, dtype=bool)
    filled.flat[polygon_pixels(corners, size)] = True
    return filled


def test_a_triangle_and_what_lies_on_its_edges():
    corners = np.array([[1.0, 0.0], [1.0, 3.0], [4.0, 3.0]])
    expected = ["01000", "01100", "01110", "01111"]
    assert filled_polygon(corners, (4, 5)).astype(int).tolist() == [[int(c) for c in row] for row in expected]


def test_edges_outside_of_the_image_fill_nothing():
    assert not filled_polygon(np.array([[-2.0, -3.0], [-3.0, 1.0], [-9.0, 1.0], [-7.0, -3.0]]), (3, 4)).any()


def test_it_fills_what_scikit_image_fills():
    draw = pytest.importorskip("skimage.draw")
    rng = np.random.default_rng(0)
    for _ in range(100):  # of odd places, for scikit-image misses some pixels that lie on an edge
        corners = rng.uniform(-8, 30, (rng.integers(3, 9), 2))
        size = (int(rng.integers(1, 30)), int(rng.integers(1, 30)))
        assert (filled_polygon(corners, size) == draw.polygon2mask(size, corners[:, ::-1])).all()
