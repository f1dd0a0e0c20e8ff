"""Steps 7 and 8: the final labels of the images. The config and the frame's masks select the method."""

import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.labels.cuts import cut
from torchjoint.labels.geodesic import SuperpointNumbers, propagate, propagate_superpoints
from torchjoint.labels.joint_ids import private_id_offsets
from torchjoint.labels.mask_labels import label_masks
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.store import Packed, pack
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy, LabelImages
from torchjoint.segments.learned.masks import MaskLinkage
from torchjoint.segments.learned.superpoint_graph import masks_of_superpoints
from torchjoint.views.observations import Observation, Observations


def label_images(
    seen: Observations,
    point_labels: Tensor,
    graph: PointGraph,
    config: Config,
    stopwatch: Stopwatch,
    hierarchy: Hierarchy | None = None,
    *,
    progress: bool = False,
) -> tuple[LabelImages, dict[int, Packed]]:
    """The final labels of all images, in one id space with the points.

    Args:
        seen: the frames.
        point_labels: [N] int64, 3D labels of all points.
        graph: of the points.
        config: the refinement, and the image graph.
        stopwatch: records the seconds of each image.
        hierarchy: the levels of the points, if there are any; `point_labels` are of the default level.
        progress: show a progress bar.

    Returns:
        the labels; and, with a hierarchy, the superpoint in each pixel, packed, by index, of the frames without masks.
    """
    numbers = None
    if hierarchy is not None:
        numbers = SuperpointNumbers.of(hierarchy.superpoint, hierarchy.segments_of_superpoints(hierarchy.default))
    known: dict[int, Packed] = {}
    unmasked = unmasked_labels(seen, point_labels)
    bar = tqdm(total=len(seen), desc="images", unit="frame", disable=not (progress and len(seen)))

    def refine(index: int) -> tuple[Packed, int]:
        observation = seen[index]
        with stopwatch("image labels"):
            if numbers is None or observation.masks is not None:
                refined, next_free = label_image(observation, point_labels, graph, unmasked, config)
            else:
                refined, next_free, superpoints = propagate_superpoints(observation, len(unmasked), numbers, config)
                known[index] = pack(superpoints)
        bar.update()
        return pack(refined), next_free

    with bar:
        refined = parallel_map(refine, range(len(seen)))
    offsets = private_id_offsets([next_free for _, next_free in refined], seen, len(unmasked))
    return LabelImages([image for image, _ in refined], len(unmasked), offsets), known


def unmasked_labels(seen: Observations, point_labels: Tensor) -> Tensor:
    """Whether most views show each of the S 3D segments without a mask, and no mask confirms it; [S] bool."""
    linkage = MaskLinkage.of(masks_of_superpoints(point_labels, seen), torch.bincount(point_labels))
    segments = torch.arange(int(point_labels.max()) + 1)
    return segments < 0 if linkage is None else linkage.masks.unmasked(segments) & ~linkage.confirmed(segments)


def label_image(
    seen: Observation, point_labels: Tensor, graph: PointGraph, unmasked: Tensor, config: Config
) -> tuple[Tensor, int]:
    """The final labels of one image, from the 3D labels of the points that it sees.

    Args:
        seen: the frame.
        point_labels: [N] int64, 3D labels of all points.
        graph: of the points.
        unmasked: [S] bool, as :func:`unmasked_labels` gives it.
        config: the refinement, and the image graph.

    Returns:
        ([H, W] int32, the next free id): labels below S are 3D segments, labels from S on occur in this image only.
        Pixels that are -1 in the initial labels stay -1. Pixels outside all masks get labels.
    """
    labels_there = point_labels[seen.visible.point]
    if config.point_segments.method == "paper":
        return cut(seen, labels_there, torch.bincount(point_labels), config)
    if seen.masks is not None:
        return label_masks(seen, seen.masks, labels_there, graph.spacing[seen.visible.point], unmasked, config)
    return propagate(seen, labels_there, len(unmasked), config)
