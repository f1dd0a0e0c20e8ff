"""Steps 7 and 8: the final labels of an image, from the 3D labels of the points that it sees."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.boundary import smooth
from torchjoint.config import Config
from torchjoint.joint_labels import by_first_appearance, joint_labels, look_up, starts_group
from torchjoint.refinement import merge_segments, split_segments
from torchjoint.state import Observation
from torchjoint.visibility import Visible


def label_image(seen: Observation, point_labels: Tensor, segment_sizes: Tensor, config: Config) -> tuple[Tensor, int]:
    """The final labels of one image, by the method that the config names.

    Args:
        seen: the frame.
        point_labels: [N] int64, 3D labels of all points.
        segment_sizes: [S] int64, number of points of each 3D segment.

    Returns:
        ([H, W] int32, the next free id): labels below S are 3D segments, from S on those of this image alone; pixels
        that are -1 in the initial labels stay so.
    """
    labels_there = point_labels[seen.visible.point]
    if config.refinement.method == "spread":
        return spread(seen, labels_there, segment_sizes.shape[0], config)
    return cut(seen, labels_there, segment_sizes, config)


def cut(seen: Observation, point_labels: Tensor, segment_sizes: Tensor, config: Config) -> tuple[Tensor, int]:
    """As in the paper: 3D labels merge and split the image's segments (step 7), and name them (step 8)."""
    labels = merge_segments(seen.labels, seen.visible, point_labels, config.refinement)
    image, boundary = seen.image.float() / 255, seen.boundary.float() / 255
    colors = smooth(image[None], config.image_graph.smoothing)[0]
    labels = split_segments(labels, colors, boundary, seen.visible, point_labels, config.refinement, config.image_graph)
    return joint_labels(labels, seen.visible, point_labels, segment_sizes, segment_sizes.shape[0])


def spread(seen: Observation, point_labels: Tensor, num_segments: int, config: Config) -> tuple[Tensor, int]:
    """Steps 7 and 8 in one: the points' labels spread over the image, and its edges decide where they meet.

    Each pixel gets the label of the point to which the cheapest path leads.

    Paths are cheap within a region and dear across edges (:func:`torchjoint.ops.spread_labels`). Initial segments that
    are large, and in which there is no point all the same, keep ids of their own, numbered from `num_segments` on.

    Args:
        seen: the frame.
        point_labels: [M] int64, 3D label of each visible point.
        num_segments: of the 3D segments.

    Returns:
        ([H, W] int32, the next free id); pixels that are -1 in the initial labels stay so.
    """
    height, width = seen.labels.shape
    markers = nearest_labels(seen.visible, point_labels, (height, width))
    colors = smooth(seen.image[None].float() / 255, config.image_graph.smoothing)[0].clamp_(0, 1)
    weights = config.refinement.color_weight, config.refinement.boundary_weight
    image = colors, seen.boundary.float() / 255, *weights
    labels = ops.spread_labels(markers, *image)
    if config.refinement.min_points > 1:
        labels = ops.spread_labels(_without_specks(labels, markers >= 0, config.refinement.min_points), *image)
    return _keep_unseen(labels, markers >= 0, seen.labels, config.refinement.unseen, num_segments)


def nearest_labels(visible: Visible, point_labels: Tensor, size: tuple[int, int]) -> Tensor:
    """The labels of the pixels that points fall in: of several points, that of the nearest to the camera.

    Of equally near ones it is that of the first.

    Args:
        point_labels: [M] int64, of the visible points.
        size: (H, W) of the image.

    Returns:
        [H, W] int32, -1 where there is no point.
    """
    pixel = visible.row * size[1] + visible.column
    order = torch.argsort(visible.z, stable=True)
    order = order[torch.argsort(pixel[order], stable=True)]
    first = order[starts_group(pixel[order])]
    labels = torch.full((size[0] * size[1],), -1, dtype=torch.int32)
    labels[pixel[first]] = point_labels[first].to(torch.int32)
    return labels.view(size)


def _without_specks(labels: Tensor, hit: Tensor, least: int) -> Tensor:
    """The labels [H, W], but -1 in connected parts of one label that fewer than `least` points are in.

    They are mostly points of the background, seen through gaps between those in front of it.

    Args:
        labels: [H, W] int32.
        hit: [H, W] bool, where points are; those that share a pixel count as one.
    """
    part = ops.felzenszwalb_image(labels.float()[None, None], scale=1e-9)[0]  # joins what does not differ at all
    num_points = torch.bincount(part[hit], minlength=int(part.max()) + 1 if part.numel() else 0)
    stays = num_points >= least
    return labels if not stays.any() else torch.where(stays[part], labels, -1)


def _keep_unseen(labels: Tensor, hit: Tensor, initial: Tensor, least: float, first_free: int) -> tuple[Tensor, int]:
    """Gives initial segments without a point ids of their own if `least` points were to be expected in them.

    Where the whole image is without points, all do.

    Args:
        labels: [H, W] int32.
        hit: [H, W] bool, where points are.
        initial: [H, W] int32, -1 = none.
        least: number of points, at the image's mean density.
        first_free: the first id.

    Returns:
        ([H, W] int32, the next free id).
    """
    num_initial = int(initial.max()) + 1 if initial.numel() else 0
    segment = initial.reshape(-1).long() + 1
    area = torch.bincount(segment, minlength=num_initial + 1)[1:]
    num_hit = torch.bincount(segment[hit.view(-1)], minlength=num_initial + 1)[1:]
    num_points = int(hit.sum())  # those that share a pixel count as one
    unseen = (num_hit == 0) & ((area * num_points >= least * hit.numel()) | (num_points == 0))
    kept = by_first_appearance(initial, unseen)
    names = torch.full((num_initial,), -1, dtype=torch.int32)
    names[kept] = first_free + torch.arange(len(kept), dtype=torch.int32)
    own = look_up(names, initial, -1)
    return torch.where((own >= 0) | (initial < 0), own, labels), first_free + len(kept)
