"""Scores image segmentations with and without boundaries, against the segmentations of several annotators.

The image segmentation is step 2 of the method, with one setting for all images.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.contours import close_contours
from torchjoint.images.pixel_graph import segment_image
from torchjoint.metrics import objects_and_parts, segmentation_covering
from torchjoint.runtime.threads import parallel_map
from torchjoint_lab.datasets.bsds import BsdsImage


class RegionSetting(NamedTuple):
    """Parameters of the image segmentation."""

    contours: tuple[float, float] | None  #: smoothing (pixels) and exponent of closed contours; None: not closed
    graph: ImageGraphConfig
    segments: ImageSegmentsConfig


#: For a structured forest: the best of 15 random settings on every other image of BSDS500's val, by covering + F
#: (lab/studies/boundaries.py).
WITH_BOUNDARIES = RegionSetting(
    (1.5, 3.0),
    ImageGraphConfig(smoothing=0.8, color_weight=0.0914, boundary_weight=1.0),
    ImageSegmentsConfig(scale=13.2, min_size=637),
)
#: The same for segmentation by colour alone.
WITHOUT_BOUNDARIES = RegionSetting(
    None,
    ImageGraphConfig(smoothing=1.0, color_weight=1.0, boundary_weight=0.0),
    ImageSegmentsConfig(scale=2.39, min_size=855),
)


class RegionScores(NamedTuple):
    """Means over the images of a data set; each image is compared with all its annotators."""

    covering: float  #: of the annotated regions by the predicted regions, the usual covering
    symmetric_covering: float
    f: float  #: for objects and parts
    num_segments: float  #: segments per image


def evaluate_regions(
    predict: Callable[[BsdsImage], Tensor],
    records: Sequence[BsdsImage],
    settings: Sequence[RegionSetting],
    *,
    progress: bool = False,
) -> list[RegionScores]:
    """Scores the image segmentation at several settings.

    Each image is read only once, and its boundaries are detected only once.

    Args:
        predict: returns the boundary strength [H, W] in [0, 1] of a record.
        records: see :func:`torchjoint_lab.datasets.bsds.bsds_images`.
        settings: parameters to compare; with a ``boundary_weight`` of 0, segmentation is by colour alone.
        progress: show a progress bar.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error; ValueError also without a record.
    """
    if not records:
        raise ValueError("records: expected at least one image, got none")
    with tqdm(total=len(records), desc="scoring regions", unit="image", disable=not progress) as bar:

        def score(record: BsdsImage) -> list[RegionScores]:
            image, truths = record.image, record.segmentations
            try:
                boundary = predict(record).float()
                scores = [score_regions(_segment(image, boundary, setting), truths) for setting in settings]
            except (TypeError, ValueError) as error:
                raise type(error)(f"image {record.name}: {error}") from error
            bar.update()
            return scores

        with torch.no_grad():
            by_image = parallel_map(score, records)
    return [RegionScores(*map(fmean, zip(*scores, strict=True))) for scores in zip(*by_image, strict=True)]


def _segment(image: Tensor, boundary: Tensor, setting: RegionSetting) -> Tensor:
    if boundary.shape != image.shape[1:]:
        raise ValueError(f"boundaries: expected shape {list(image.shape[1:])}, got {list(boundary.shape)}")
    if setting.contours is not None and setting.graph.boundary_weight > 0:
        boundary = close_contours(boundary[None], *setting.contours)[0]
    return segment_image(image, boundary, setting.graph, setting.segments)


def score_regions(labels: Tensor, truths: Sequence[Tensor]) -> RegionScores:
    """Scores one image's regions [H, W] against the regions [H, W] of all annotators, int64."""
    covering = segmentation_covering(labels, truths)
    f = objects_and_parts(labels, truths).f
    return RegionScores(covering.target_by_pred, covering.symmetric, f, float(len(labels.unique())))
