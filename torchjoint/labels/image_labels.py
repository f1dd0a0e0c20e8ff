"""Steps 7 and 8: the final labels of the images. The config and the frame's masks select the method."""

from __future__ import annotations

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.config import Config
from torchjoint.labels.geodesic import propagate
from torchjoint.labels.joint_ids import private_id_offsets
from torchjoint.labels.mask_labels import label_masks
from torchjoint.labels.segment_refinement import cut
from torchjoint.runtime.packing import Packed, pack
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import LabelImages
from torchjoint.views.observation import Observation
from torchjoint.views.observations import Observations


def label_images(
    seen: Observations, point_labels: Tensor, config: Config, stopwatch: Stopwatch, *, progress: bool = False
) -> LabelImages:
    """The final labels of all images, in one id space with the points.

    Args:
        seen: the frames.
        point_labels: [N] int64, 3D labels of all points.
        config: the refinement, and the image graph.
        stopwatch: records the seconds of each image.
        progress: show a progress bar.
    """
    sizes = torch.bincount(point_labels)
    bar = tqdm(total=len(seen), desc="images", unit="frame", disable=not progress)

    def refine(observation: Observation) -> tuple[Packed, int]:
        with stopwatch("image labels"):
            refined, next_free = label_image(observation, point_labels, sizes, config)
        bar.update()
        return pack(refined), next_free

    with bar:
        refined = parallel_map(refine, seen)
    offsets = private_id_offsets([next_free for _, next_free in refined], seen, len(sizes))
    return LabelImages([image for image, _ in refined], len(sizes), offsets)


def label_image(seen: Observation, point_labels: Tensor, segment_sizes: Tensor, config: Config) -> tuple[Tensor, int]:
    """The final labels of one image, from the 3D labels of the points that it sees.

    Args:
        seen: the frame.
        point_labels: [N] int64, 3D labels of all points.
        segment_sizes: [S] int64, number of points of each 3D segment.
        config: the refinement, and the image graph.

    Returns:
        ([H, W] int32, the next free id): labels below S are 3D segments, labels from S on occur in this image only.
        Pixels that are -1 in the initial labels stay -1. Pixels outside all masks get labels.
    """
    labels_there = point_labels[seen.visible.point]
    if config.point_segments.method == "paper":
        return cut(seen, labels_there, segment_sizes, config)
    if seen.masks is not None:
        return label_masks(seen, seen.masks, labels_there, segment_sizes.shape[0], config)
    return propagate(seen, labels_there, segment_sizes.shape[0], config)
