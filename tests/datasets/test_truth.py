"""Points in boxes."""

import pytest
import torch

from torchjoint.datasets.truth import instances_in_boxes

EYE = torch.eye(3, dtype=torch.float64)
QUARTER = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)  # about z: the length along y


def test_sizes_are_along_the_box_s_own_axes():
    points = torch.tensor([[1.9, 0, 0], [0, 1.9, 0], [0, 0, 0.4], [0, 0, 0.6]])
    sizes = torch.tensor([[4.0, 2, 1]], dtype=torch.float64)
    center = torch.zeros(1, 3, dtype=torch.float64)
    assert instances_in_boxes(points, center, sizes, EYE[None], "a").tolist() == [0, -1, 0, -1]
    assert instances_in_boxes(points, center, sizes, QUARTER[None], "a").tolist() == [-1, 0, 0, -1]


def test_the_smaller_box_wins_and_of_equal_ones_the_later():
    centers = torch.zeros(3, 3, dtype=torch.float64)
    sizes = torch.tensor([[1.0, 1, 1], [4, 4, 4], [1, 1, 1]], dtype=torch.float64)
    points = torch.tensor([[0.0, 0, 0], [0.5, 0.5, 0.5], [1, 0, 0], [3, 0, 0]])
    with pytest.warns(UserWarning, match="a: this box is there twice; its points belong to the last one"):
        labels = instances_in_boxes(points, centers, sizes, EYE.expand(3, 3, 3), "abc")
    assert labels.tolist() == [2, 2, 1, -1]


def test_no_boxes_and_no_points():
    none = torch.empty(0, 3, dtype=torch.float64)
    assert instances_in_boxes(torch.rand(3, 3), none, none, torch.empty(0, 3, 3).double(), "").tolist() == [-1, -1, -1]
    assert instances_in_boxes(torch.empty(0, 3), none + 0, none, torch.empty(0, 3, 3).double(), "").tolist() == []
