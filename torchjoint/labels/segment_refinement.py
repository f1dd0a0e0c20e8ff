"""Steps 7 and 8 by method paper: merges, splits and labels the segments of an image by the 3D labels."""

from __future__ import annotations

from torch import Tensor

from torchjoint.config import Config
from torchjoint.images.smoothing import smooth
from torchjoint.labels.joint_ids import joint_labels
from torchjoint.labels.segment_cuts import split_segments
from torchjoint.labels.segment_merging import merge_segments
from torchjoint.views.observation import Observation


def cut(seen: Observation, point_labels: Tensor, segment_sizes: Tensor, config: Config) -> tuple[Tensor, int]:
    """Refines an image as in the paper: merges and splits its segments (step 7), then labels them (step 8).

    Args:
        seen: the frame.
        point_labels: [M] int64, 3D label of each visible point.
        segment_sizes: [S] int64, number of points of each 3D segment.
        config: stage paper, and the image graph.

    Returns:
        ([H, W] int32, the next free id); labels below S are 3D segments; pixels that are -1 in the initial labels
        stay -1.
    """
    labels = merge_segments(seen.labels, seen.visible, point_labels, config.paper)
    image, boundary = seen.image.float() / 255, seen.boundary.float() / 255
    colors = smooth(image[None], config.image_graph.smoothing)[0]
    labels = split_segments(labels, colors, boundary, seen.visible, point_labels, config.paper, config.image_graph)
    return joint_labels(labels, seen.visible, point_labels, segment_sizes, segment_sizes.shape[0])
