"""Region scores: by hand, with and without boundaries, and on some of the real images."""

import numpy as np
import pytest
import torch
from bsds_files import write_bsds
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.evaluation.region_scores import (
    WITH_BOUNDARIES,
    WITHOUT_BOUNDARIES,
    RegionSetting,
    evaluate_regions,
    score_regions,
)

from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.boundary import GradientBoundary

HALVES = (np.arange(60) >= 30).repeat(40).reshape(60, 40).T.astype(int) + 1


def test_by_hand():
    """One annotator sees two halves, which are found, the other nothing but one region."""
    halves = torch.from_numpy(HALVES) - 1
    assert score_regions(halves, [halves]) == (1, 1, 1, 2)
    scores = score_regions(halves, [halves, torch.zeros_like(halves)])
    assert scores.covering == (1 + 0.5) / 2
    assert scores.symmetric_covering == (1 + 0.5) / 2
    assert scores.num_segments == 2


def test_boundaries_tell_apart_what_colours_do_not(tmp_path):
    records = bsds_images(write_bsds(tmp_path, {"a": [np.ones_like(HALVES)], "b": [HALVES]}), "val")
    line = torch.zeros(40, 60)
    line[:, 29:31] = 1
    segments = ImageSegmentsConfig(scale=1.0, min_size=100)
    blind = RegionSetting((1.0, 3.0), ImageGraphConfig(color_weight=0.0, boundary_weight=0.0), segments)
    seeing = RegionSetting((1.0, 3.0), ImageGraphConfig(color_weight=0.0, boundary_weight=1.0), segments)
    without, with_ = evaluate_regions(lambda record: line * (record.name == "b"), records, [blind, seeing])
    assert without == ((1 + 0.5) / 2, (1 + 0.5) / 2, without.f, 1)
    assert with_.covering > 0.95
    assert with_.num_segments == 1.5
    assert with_.f == 1 > without.f


def test_what_is_wrong(tmp_path):
    with pytest.raises(ValueError, match="records: expected at least one image, got none"):
        evaluate_regions(lambda record: record.image[0], [], [WITH_BOUNDARIES])
    records = bsds_images(write_bsds(tmp_path, {"a": [HALVES]}), "val")
    with pytest.raises(ValueError, match="boundaries: expected shape"):
        evaluate_regions(lambda record: torch.zeros(3, 3), records, [WITH_BOUNDARIES])
    assert evaluate_regions(lambda record: record.image[0], records, []) == []


def test_real_images(shared):
    records = bsds_images(shared / "data" / "bsds500", "train")[:2]
    detector = GradientBoundary()
    scores = evaluate_regions(lambda r: detector(r.image[None])[0], records, [WITH_BOUNDARIES, WITHOUT_BOUNDARIES])
    for one in scores:
        assert 0.2 < one.symmetric_covering < 0.9
        assert 0 < one.f < 1
        assert one.num_segments > 2
