"""Reference versions of the operators on images (steps 1, 7 and 8); shapes and units are those of the operators."""

from __future__ import annotations

import math
from collections import deque
from heapq import heappop, heappush

import numpy as np
import torch
from torch import Tensor

#: The two regions on the sides of a region boundary, each named by its lowest pixel.
Sides = frozenset[tuple[int, int]]


def segment_graphs_reference(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.segment_graphs` computes; the arguments are not checked."""
    pixels: list[int] = []
    edges: list[tuple[int, int]] = []
    weights: list[float] = []
    node_ptr, edge_ptr = [0], [0]
    for segment in torch.nonzero(chosen).flatten().tolist():
        places = torch.nonzero(labels == segment).tolist()
        number = {tuple(place): i for i, place in enumerate(places)}
        own = []
        for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1)):
            for i, (row, column) in enumerate(places):
                here, there = (row, column), (row + down, column + right)
                if there not in number:
                    continue
                red, green, blue = (colors[:, *here] - colors[:, *there]).square().numpy()
                distance = np.sqrt((red + green) + blue)  # correctly rounded, unlike torch's sqrt (from MKL)
                weakest = min(boundary[here].numpy(), boundary[there].numpy())
                own.append(float(np.float32(color_weight) * distance + np.float32(boundary_weight) * weakest))
                edges.append((i, number[there]))
        total = 0.0
        for weight in own:  # not sum(): since Python 3.12 it is more precise than plain addition
            total += weight
        mean = total / max(len(own), 1)
        weights += [weight / mean if mean > 0 else weight for weight in own]
        pixels += [row * labels.shape[1] + column for row, column in places]
        node_ptr.append(len(pixels))
        edge_ptr.append(len(edges))
    edge_index = torch.tensor(edges, dtype=torch.int64).reshape(-1, 2).T.contiguous()
    relative_weight = torch.tensor(weights, dtype=torch.float64)
    return (
        torch.tensor(pixels, dtype=torch.int64),
        torch.tensor(node_ptr),
        edge_index,
        torch.tensor(edge_ptr),
        relative_weight,
    )


def match_pixels_reference(pred: Tensor, target: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.match_pixels` computes, with dictionaries; the arguments are not checked.

    Example:
        >>> pred, target = torch.tensor([[True, True, False]]), torch.tensor([[True, False, True]])
        >>> match_pixels_reference(pred, target, radius=1)
        (tensor([[ True,  True, False]]), tensor([[ True, False,  True]]))
    """
    reach = int(min(radius, max(pred.shape, default=0)))
    square = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1)]
    offsets = sorted((r * r + c * c, r, c) for r, c in square if r * r + c * c <= radius * radius)
    targets = {(r, c) for r, c in target.nonzero().tolist()}
    target_of: dict[tuple[int, int], tuple[int, int]] = {}
    pred_of: dict[tuple[int, int], tuple[int, int]] = {}

    def near(pixel: tuple[int, int]) -> list[tuple[int, int]]:
        return [there for _, r, c in offsets if (there := (pixel[0] + r, pixel[1] + c)) in targets]

    def augment(start: tuple[int, int]) -> None:
        reached_from: dict[tuple[int, int], tuple[int, int]] = {}
        queue = deque([start])
        while queue:
            pixel = queue.popleft()
            for there in near(pixel):
                if there in reached_from:
                    continue
                reached_from[there] = pixel
                if there in pred_of:
                    queue.append(pred_of[there])
                    continue
                end: tuple[int, int] | None = there
                while end is not None:
                    before = reached_from[end]
                    pred_of[end] = before
                    target_of[before], end = end, target_of.get(before)
                return

    preds = [(r, c) for r, c in pred.nonzero().tolist()]
    for _, r, c in offsets:
        for pixel in preds:
            there = (pixel[0] + r, pixel[1] + c)
            if pixel not in target_of and there in targets and there not in pred_of:
                target_of[pixel], pred_of[there] = there, pixel
    for pixel in preds:
        if pixel not in target_of:
            augment(pixel)

    pred_matched, target_matched = torch.zeros_like(pred), torch.zeros_like(target)
    for pixel, there in target_of.items():
        pred_matched[pixel] = target_matched[there] = True
    return pred_matched, target_matched


def ultrametric_contours_reference(boundary: Tensor, relief: Tensor) -> Tensor:
    """What :func:`torchjoint.ops.ultrametric_contours` computes; the arguments are not checked."""
    height, width = boundary.shape
    level = torch.round(boundary.double() * 65535).long().tolist()
    low = relief.tolist()
    inside = {(row, column) for row in range(height) for column in range(width)}

    def basin(pixel: tuple[int, int]) -> tuple[int, int]:
        while True:
            square = [(pixel[0] + down, pixel[1] + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
            lowest = min((low[row][column], (row, column)) for row, column in square if (row, column) in inside)[1]
            if lowest == pixel:
                return pixel
            pixel = lowest

    region = {pixel: basin(pixel) for pixel in sorted(inside)}
    pairs = [
        (here, there)
        for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1))
        for here in sorted(inside)
        if (there := (here[0] + down, here[1] + right)) in inside and region[here] != region[there]
    ]
    strengths: dict[Sides, list[int]] = {}
    for here, there in pairs:
        strongest = max(level[here[0]][here[1]], level[there[0]][there[1]])
        strengths.setdefault(frozenset((region[here], region[there])), []).append(strongest)
    number = {sides: i for i, sides in enumerate(strengths)}
    parts = {sides: [sides] for sides in strengths}

    heights: dict[Sides, float] = {}
    reached = 0.0
    while strengths:
        weakest = min(strengths, key=lambda sides: (sum(strengths[sides]) / len(strengths[sides]), number[sides]))
        reached = max(reached, sum(strengths[weakest]) / len(strengths[weakest]))
        heights |= dict.fromkeys(parts[weakest], reached)
        del strengths[weakest]
        kept, given = weakest
        for sides in [sides for sides in strengths if given in sides]:
            now = sides - {given} | {kept}
            is_joined = now in strengths
            number[now] = min(number[now], number[sides]) if is_joined else number[sides]
            parts[now] = parts[now] + parts[sides] if is_joined else parts[sides]
            strengths[now] = strengths.get(now, []) + strengths.pop(sides)

    contours = torch.zeros(height, width)
    for here, there in pairs:
        value = heights[frozenset((region[here], region[there]))] / 65535
        for pixel in (here, there):
            contours[pixel] = max(contours[pixel].item(), torch.tensor(value).item())
    return contours


def propagate_labels_reference(
    markers: Tensor,
    colors: Tensor,
    boundary: Tensor,
    color_weight: float,
    boundary_weight: float,
    min_markers: int = 1,
) -> Tensor:
    """What :func:`torchjoint.ops.propagate_labels` computes; the arguments are not checked."""
    image = colors, boundary, color_weight, boundary_weight
    if not (markers >= 0).any():
        return markers.clone()
    labels = _cheapest_labels(markers, *image)
    parts = _connected_parts(labels)
    stays = [sum(bool(markers[pixel] >= 0) for pixel in part) >= min_markers for part in parts]
    if not any(stays):
        return labels
    kept = labels.clone()
    for part, stay in zip(parts, stays, strict=True):
        for pixel in part if not stay else ():
            kept[pixel] = -1
    return _cheapest_labels(kept, *image)


def outvoted_markers_reference(
    markers: Tensor, colors: Tensor, color_weight: float, num_voters: int, near: float
) -> Tensor:
    """What :func:`torchjoint.ops.outvoted_markers` computes; the arguments are not checked."""
    outvoted = torch.zeros(markers.shape, dtype=torch.bool)
    pixel = torch.nonzero(markers >= 0)
    row, column = pixel.T
    label, place = markers[row, column], torch.cat([pixel.T, color_weight * colors[:, row, column]]).double()
    side = near * math.sqrt(markers.numel() / max(len(label), 1))
    side = max(1, math.ceil(min(side, max(markers.shape))))  # larger cells say nothing new
    for i in range(len(label)):
        same = label == label[i]
        if same[((pixel // side - pixel[i] // side).abs() <= 1).all(1)].all():
            continue
        down, right, red, green, blue = (place - place[:, i, None]).square()
        distance = (((down + right) + red) + green) + blue
        distance[i] = math.inf
        in_order = distance.sort().values
        votes = distance < (in_order[num_voters] if len(label) > num_voters else math.inf)
        agree, others = int((votes & same).sum()), int(same.sum()) - 1
        outvoted[row[i], column[i]] = 2 * agree < min(int(votes.sum()), others)
    return outvoted


def _connected_parts(labels: Tensor) -> list[list[tuple[int, int]]]:
    """The pixels (row, column) of each connected part of one label, 8-neighbourhood."""
    parts: list[list[tuple[int, int]]] = []
    left = {(row, column) for row in range(labels.shape[0]) for column in range(labels.shape[1])}
    while left:
        part = [left.pop()]
        for row, column in part:
            for there in ((row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)):
                if there in left and labels[there] == labels[row, column]:
                    left.remove(there)
                    part.append(there)
        parts.append(part)
    return parts


def _cheapest_labels(
    markers: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> Tensor:
    height, width = markers.shape
    red, green, blue = colors.numpy()
    strength = boundary.numpy()
    weights = np.float32(color_weight), np.float32(boundary_weight)
    labels = torch.full_like(markers, -1)
    queue = [(0, int(markers[row, column]), row, column) for row, column in torch.nonzero(markers >= 0).tolist()]
    queue.sort()
    while queue:
        cost, label, row, column = heappop(queue)
        if labels[row, column] >= 0:
            continue
        labels[row, column] = label
        here = row, column
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            there = row + down, column + right
            if not (0 <= there[0] < height and 0 <= there[1] < width):
                continue
            differences = [plane[here] - plane[there] for plane in (red, green, blue)]
            squares = [difference * difference for difference in differences]
            distance = np.sqrt((squares[0] + squares[1]) + squares[2])
            length = np.float32(1.41421356 if down and right else 1)
            weakest = min(strength[here], strength[there])
            step = np.rint(np.float32(8) * ((length + weights[0] * distance) + weights[1] * weakest))
            heappush(queue, (cost + int(step), label, *there))
    return labels
