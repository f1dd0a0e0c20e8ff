"""Every operator with arguments that are right, and how much memory a process has."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from torchjoint.ops import (
    ascending_order,
    boosted_trees,
    felzenszwalb,
    felzenszwalb_image,
    fit_normals,
    group_summaries,
    line_maxima,
    mask_merges,
    match_pixels,
    merge_regions,
    min_cut,
    nearest_neighbors,
    neighbor_edges,
    outvoted_markers,
    pair_counts,
    parse_numbers,
    project,
    propagate_labels,
    region_dendrogram,
    region_planes,
    segment_graphs,
    splat_depth,
    structured_forest,
    ultrametric_contours,
    window_overlaps,
)

EDGES = torch.tensor([[0, 1, 2], [1, 2, 3]])
VALUES = torch.tensor([0.1, 5.0, 0.2])
SOURCE = torch.tensor([torch.inf, 0.0, 0.0, 0.0])
SINK = torch.tensor([0.0, 0.0, 0.0, 2.0])
NAN = float("nan")

FELZENSZWALB = {"edge_index": EDGES, "weight": VALUES, "num_nodes": 4, "scale": 1.0, "min_size": 0}
IMAGES = torch.arange(48.0).view(2, 3, 2, 4) / 48
POINTS = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
NEIGHBORS = torch.tensor([[1, 2], [0, 2], [0, 1], [1, 2]])
ROWS = torch.tensor([2, 0, 3, 1], dtype=torch.int32)

EYE = torch.eye(4, dtype=torch.float64)
PIXELS = torch.tensor([0, 1, 2])
POSITIONS = torch.tensor([0.0, 1.0, 2.0])
LABELS = torch.tensor([[0, 0, 1, -1], [0, 1, 1, 1], [1, 1, 0, 0]], dtype=torch.int32)
PROJECT = {
    "points": torch.tensor([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), "camera_from_world": EYE,
    "intrinsics": EYE[:3, :3] * 4, "near": 0.1, "far": 9.0, "height": 4, "width": 6, "margin": 1.0,
}  # fmt: skip
SPLAT_DEPTH = {
    "row": PIXELS, "column": PIXELS, "depth": POSITIONS, "reach": torch.tensor([0, 1, 2]), "height": 3, "width": 4,
}  # fmt: skip
WINDOW_OVERLAPS = {
    "order": torch.tensor([0, 1, 2], dtype=torch.int32), "other_end": torch.tensor([1, 2, 3], dtype=torch.int32),
    "start": torch.tensor([0, 1, 2, 3, 3], dtype=torch.int32), "point": torch.tensor([0, 1, 3]), "row": PIXELS,
    "column": PIXELS, "labels": LABELS, "window": 3,
}  # fmt: skip
LINE_MAXIMA = {name: value for name, value in WINDOW_OVERLAPS.items() if name not in ("labels", "window")}
LINE_MAXIMA |= {"image": LABELS.byte()}
PAIR_COUNTS = {
    "u": POSITIONS, "v": POSITIONS, "pixel": PIXELS, "segment": torch.tensor([0, 0, -1]),
    "label": torch.tensor([3, 4, 3]), "radius": 2.0,
}  # fmt: skip
PARSE_NUMBERS = {
    "text": torch.tensor(list(b"1 -2.5e3\t.5\n 1e22 inf 0.1234567890123456789 \n4"), dtype=torch.uint8), "num_rows": 2,
    "num_columns": 3,
}  # fmt: skip
SEGMENT_GRAPHS = {
    "labels": LABELS, "chosen": torch.tensor([False, True]), "colors": torch.rand(3, 3, 4),
    "boundary": torch.rand(3, 4), "color_weight": 1.0, "boundary_weight": 0.5,
}  # fmt: skip
MATCH_PIXELS = {"pred": LABELS > 0, "target": LABELS == 0, "radius": 1.5}
PROPAGATE_LABELS = {
    "markers": LABELS, "colors": torch.rand(3, 3, 4), "boundary": torch.rand(3, 4), "color_weight": 9.0,
    "boundary_weight": 2.0, "min_markers": 2,
}  # fmt: skip
OUTVOTED_MARKERS = {
    "markers": LABELS, "colors": torch.rand(3, 3, 4), "color_weight": 9.0, "num_voters": 3, "near": 3.0,
}  # fmt: skip
MERGE_REGIONS = {
    "edge_index": EDGES, "cost": VALUES, "size": torch.tensor([9, 1, 2, 3]), "threshold": 0.5, "min_size": 2,
}  # fmt: skip
GROUP_SUMMARIES = {
    "values": POSITIONS, "order": PIXELS.int(), "group": torch.tensor([0, -1, 1]), "num_groups": 2,
    "quantiles": torch.tensor([0.5, 1.0]),
}  # fmt: skip
REGION_DENDROGRAM = {"edge_index": EDGES, "cost": VALUES, "num_regions": 4, "threshold": 0.5}
MASK_MERGES = {
    "edge_index": EDGES, "cost": VALUES.clamp(max=1), "size": torch.tensor([9, 1, 2, 3]),
    "in_mask": torch.tensor([[0, 1, 1], [0, 0, 1], [4, 1, 1]]), "in_frame": torch.tensor([[0, 1], [0, 0], [5, 1]]),
    "weight": torch.tensor([256, 100]), "frame_of_mask": torch.tensor([0, 0]), "apart_weight": 0.6,
    "prior_weight": 0.1, "threshold": 0.5, "stays": torch.tensor([True, False, False, False]), "min_size": 2,
}  # fmt: skip
REGION_PLANES = {
    "points": POINTS, "neighbors": NEIGHBORS, "region": torch.tensor([0, 0, 0, 1]), "normals": POINTS + 1,
    "min_points": 3,
}  # fmt: skip
BOOSTED_TREES = {
    "values": torch.tensor([[0.5, 2.0], [0.6, NAN], [NAN, 1.0]]),
    "feature": torch.tensor([[0, 0, 0], [1, 0, 0]], dtype=torch.int32),
    "threshold": torch.tensor([[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]], dtype=torch.float64),
    "missing_left": torch.tensor([[True, False, False], [False, False, False]]),
    "left": torch.tensor([[1, -1, -1], [2, -1, -1]], dtype=torch.int32),
    "right": torch.tensor([[2, -1, -1], [1, -1, -1]], dtype=torch.int32),
    "leaf_value": torch.tensor([[0.0, -1.0, 2.0], [0.0, 0.25, 0.5]], dtype=torch.float64),
}
STRUCTURED_FOREST = {
    "images": IMAGES, "children": torch.tensor([[2, 0, 0], [0, 0, 0]], dtype=torch.int32),
    "features": torch.tensor([[7, 0, 0], [0, 0, 0]], dtype=torch.int32), "thresholds": torch.full((2, 3), 0.3),
    "boundary_counts": torch.tensor([[0, 1, 2], [1, 0, 0]], dtype=torch.int32),
    "boundary_pixels": torch.tensor([136, 1, 2, 255], dtype=torch.uint8), "trees_per_site": 1, "stride": 2,
}  # fmt: skip
#: Every operator, with arguments that are right.
VALID: dict[Callable[..., Any], dict[str, Any]] = {
    felzenszwalb: FELZENSZWALB,
    felzenszwalb_image: {"images": IMAGES, "boundaries": IMAGES[:, 0], "scale": 1.0},
    min_cut: {"edge_index": EDGES, "capacity": VALUES, "source_capacity": SOURCE, "sink_capacity": SINK},
    nearest_neighbors: {"points": POINTS, "count": 2, "num_distances": 1},
    neighbor_edges: {"neighbors": NEIGHBORS, "order": ROWS},
    fit_normals: {"points": POINTS, "neighbors": NEIGHBORS, "order": ROWS},
    project: PROJECT,
    splat_depth: SPLAT_DEPTH,
    window_overlaps: WINDOW_OVERLAPS,
    line_maxima: LINE_MAXIMA,
    pair_counts: PAIR_COUNTS,
    parse_numbers: PARSE_NUMBERS,
    segment_graphs: SEGMENT_GRAPHS,
    match_pixels: MATCH_PIXELS,
    propagate_labels: PROPAGATE_LABELS,
    outvoted_markers: OUTVOTED_MARKERS,
    merge_regions: MERGE_REGIONS,
    ascending_order: {"values": POSITIONS},
    group_summaries: GROUP_SUMMARIES,
    region_dendrogram: REGION_DENDROGRAM,
    mask_merges: MASK_MERGES,
    region_planes: REGION_PLANES,
    boosted_trees: BOOSTED_TREES,
    structured_forest: STRUCTURED_FOREST,
    ultrametric_contours: {"boundary": IMAGES[0, 0], "relief": IMAGES[0, 1]},
}


def resident_memory() -> int:
    """Bytes of this process in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
