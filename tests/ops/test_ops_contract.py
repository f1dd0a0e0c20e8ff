"""What holds for every operator: errors, torch.compile, opcheck, the GIL; and that the package lists its folders."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from operator_arguments import (
    BOOSTED_TREES,
    EDGES,
    EYE,
    IMAGES,
    LABELS,
    MASK_MERGES,
    MERGE_REGIONS,
    NAN,
    NEIGHBORS,
    PIXELS,
    POINTS,
    POSITIONS,
    PROPAGATE_LABELS,
    REGION_DENDROGRAM,
    REGION_PLANES,
    ROWS,
    SINK,
    SOURCE,
    STRUCTURED_FOREST,
    VALID,
    VALUES,
)

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
from torchjoint.ops._call import call


def changed(tensor: torch.Tensor, value: float, *position: int) -> torch.Tensor:
    tensor = tensor.clone()
    tensor[position] = value
    return tensor


ERRORS: list[tuple[Callable[..., Any], dict[str, Any], type[Exception], str]] = [
    (felzenszwalb, {"edge_index": [[0], [1]]}, TypeError, "edge_index: expected a torch.Tensor, got list"),
    (felzenszwalb, {"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    (felzenszwalb, {"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    (felzenszwalb, {"edge_index": EDGES[0]}, ValueError, "edge_index: expected shape [2, E], got [3]"),
    (felzenszwalb, {"edge_index": EDGES.to("meta")}, ValueError, "edge_index: expected a CPU tensor, got one on meta"),
    (felzenszwalb, {"edge_index": EDGES.to_sparse()}, ValueError, "edge_index: expected a dense tensor"),
    (felzenszwalb, {"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    (felzenszwalb, {"edge_index": changed(EDGES, -1, 0, 1)}, ValueError, "numbers in [0, 4), got -1 at edge 1"),
    (felzenszwalb, {"edge_index": changed(EDGES, 2**40, 0, 1)}, ValueError, f"got {2**40} at edge 1"),
    (felzenszwalb, {"num_nodes": 0}, ValueError, "edge_index: expected node numbers in [0, 0), got 0 at edge 0"),
    (felzenszwalb, {"weight": None}, TypeError, "weight: expected a torch.Tensor, got NoneType"),
    (felzenszwalb, {"weight": VALUES.half()}, TypeError, "weight: expected dtype torch.float32 or torch.float64, got"),
    (felzenszwalb, {"weight": VALUES[:2]}, ValueError, "weight: expected shape [E] = [3], got [2]"),
    (felzenszwalb, {"weight": VALUES[None]}, ValueError, "weight: expected shape [E], got [1, 3]"),
    (felzenszwalb, {"weight": VALUES.to("meta")}, ValueError, "weight: expected a CPU tensor, got one on meta"),
    (felzenszwalb, {"weight": changed(VALUES, NAN, 1)}, ValueError, "weight: expected no NaN, got NaN at edge 1"),
    (felzenszwalb, {"num_nodes": -1}, ValueError, "num_nodes: expected a number >= 0, got -1"),
    (felzenszwalb, {"num_nodes": 4.0}, TypeError, "num_nodes: expected int, got float"),
    (felzenszwalb, {"num_nodes": True}, TypeError, "num_nodes: expected int, got bool"),
    (felzenszwalb, {"num_nodes": 2**31}, ValueError, "num_nodes: expected less than 2^31, got 2147483648"),
    (felzenszwalb, {"scale": -0.5}, ValueError, "scale: expected a number >= 0, got -0.5"),
    (felzenszwalb, {"scale": NAN}, ValueError, "scale: expected a number >= 0, got nan"),
    (felzenszwalb, {"scale": "1"}, TypeError, "scale: expected int or float, got str"),
    (felzenszwalb, {"min_size": -1}, ValueError, "min_size: expected a number >= 0, got -1"),
    (felzenszwalb, {"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
    (felzenszwalb_image, {"images": IMAGES.numpy()}, TypeError, "images: expected a torch.Tensor, got ndarray"),
    (felzenszwalb_image, {"images": IMAGES.double()}, TypeError, "images: expected dtype torch.float32, got"),
    (felzenszwalb_image, {"images": IMAGES.byte()}, TypeError, "images: expected dtype torch.float32, got torch.uint8"),
    (felzenszwalb_image, {"images": IMAGES[0]}, ValueError, "images: expected shape [B, C, H, W], got [3, 2, 4]"),
    (felzenszwalb_image, {"images": changed(IMAGES, NAN, 1, 2)}, ValueError, "images: expected numbers between"),
    (felzenszwalb_image, {"images": changed(IMAGES, torch.inf, 0)}, ValueError, "images: expected numbers between"),
    (felzenszwalb_image, {"boundaries": IMAGES}, ValueError, "boundaries: expected shape [B, H, W] = [2, 2, 4], got"),
    (felzenszwalb_image, {"boundaries": IMAGES[:1, 0]}, ValueError, "boundaries: expected shape [B, H, W] = [2, 2, 4]"),
    (felzenszwalb_image, {"boundaries": -IMAGES[:, 0] / 0}, ValueError, "boundaries: expected numbers between"),
    (felzenszwalb_image, {"boundaries": 3}, TypeError, "boundaries: expected a torch.Tensor, got int"),
    (felzenszwalb_image, {"scale": -1.0}, ValueError, "scale: expected a number >= 0, got -1.0"),
    (felzenszwalb_image, {"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
    (felzenszwalb_image, {"color_weight": NAN}, ValueError, "color_weight: expected a number >= 0, got nan"),
    (felzenszwalb_image, {"boundary_weight": -2}, ValueError, "boundary_weight: expected a number >= 0, got -2"),
    (min_cut, {"edge_index": EDGES.float()}, TypeError, "edge_index: expected dtype torch.int64, got torch.float32"),
    (min_cut, {"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    (min_cut, {"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    (min_cut, {"edge_index": changed(EDGES, -7, 1, 0)}, ValueError, "numbers in [0, 4), got -7 at edge 0"),
    (min_cut, {"capacity": VALUES.long()}, TypeError, "capacity: expected dtype torch.float32 or torch.float64, got"),
    (min_cut, {"capacity": VALUES[1:]}, ValueError, "capacity: expected shape [E] = [3], got [2]"),
    (min_cut, {"capacity": -VALUES}, ValueError, "capacity: expected finite numbers >= 0, got -0.1 at edge 0"),
    (min_cut, {"capacity": changed(VALUES, NAN, 2)}, ValueError, "capacity: expected finite numbers >= 0, got nan"),
    (min_cut, {"capacity": changed(VALUES, torch.inf, 2)}, ValueError, "numbers >= 0, got inf at edge 2"),
    (min_cut, {"source_capacity": SOURCE[None]}, ValueError, "source_capacity: expected shape [N], got [1, 4]"),
    (min_cut, {"source_capacity": SOURCE - 1}, ValueError, "source_capacity: expected numbers >= 0, got -1 at node 1"),
    (min_cut, {"source_capacity": SOURCE.bool()}, TypeError, "source_capacity: expected dtype torch.float32 or"),
    (min_cut, {"sink_capacity": SINK[:3]}, ValueError, "sink_capacity: expected shape [N] = [4], got [3]"),
    (min_cut, {"sink_capacity": changed(SINK, NAN, 1)}, ValueError, "sink_capacity: expected numbers >= 0, got nan"),
    (min_cut, {"sink_capacity": SOURCE}, ValueError, "source_capacity and sink_capacity: both are infinite at node 0"),
    (nearest_neighbors, {"points": POINTS.numpy()}, TypeError, "points: expected a torch.Tensor, got ndarray"),
    (nearest_neighbors, {"points": POINTS.half()}, TypeError, "points: expected dtype torch.float32 or torch.float64"),
    (nearest_neighbors, {"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [4, 2]"),
    (nearest_neighbors, {"points": changed(POINTS, NAN, 2, 1)}, ValueError, "finite coordinates, got nan in row 2"),
    (nearest_neighbors, {"points": changed(POINTS, torch.inf, 3, 0)}, ValueError, "coordinates, got inf in row 3"),
    (nearest_neighbors, {"count": -1}, ValueError, "count: expected a number >= 0, got -1"),
    (nearest_neighbors, {"num_distances": 1.0}, TypeError, "num_distances: expected int, got float"),
    (neighbor_edges, {"neighbors": [[1], [0]]}, TypeError, "neighbors: expected a torch.Tensor, got list"),
    (neighbor_edges, {"neighbors": NEIGHBORS.float()}, TypeError, "expected dtype torch.int32 or torch.int64, got"),
    (neighbor_edges, {"neighbors": NEIGHBORS[0]}, ValueError, "neighbors: expected shape [N, K], got [2]"),
    (neighbor_edges, {"neighbors": NEIGHBORS.to("meta")}, ValueError, "neighbors: expected a CPU tensor, got one on"),
    (neighbor_edges, {"neighbors": changed(NEIGHBORS, 4, 2, 1)}, ValueError, "numbers in [0, 4), got 4 in row 2"),
    (neighbor_edges, {"neighbors": changed(NEIGHBORS, -1, 0, 0).int()}, ValueError, "in [0, 4), got -1 in row 0"),
    (neighbor_edges, {"neighbors": changed(NEIGHBORS, 2**40, 3, 0)}, ValueError, f"got {2**40} in row 3"),
    (neighbor_edges, {"order": ROWS.long()}, TypeError, "order: expected dtype torch.int32, got torch.int64"),
    (neighbor_edges, {"order": ROWS[:3]}, ValueError, "order: expected shape [N] = [4], got [3]"),
    (neighbor_edges, {"order": changed(ROWS, 4, 2)}, ValueError, "order: expected numbers in [0, 4), got 4 at 2"),
    (fit_normals, {"order": changed(ROWS, 2, 3)}, ValueError, "order: expected a permutation, got 2 again at 3"),
    (fit_normals, {"points": POINTS.long()}, TypeError, "points: expected dtype torch.float32 or torch.float64, got"),
    (fit_normals, {"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [4, 2]"),
    (
        fit_normals,
        {"points": POINTS[:3], "order": None},
        ValueError,
        "neighbors: expected shape [N, K] = [3, K], got [4, 2]",
    ),
    (fit_normals, {"neighbors": NEIGHBORS.short()}, TypeError, "expected dtype torch.int32 or torch.int64, got"),
    (fit_normals, {"neighbors": changed(NEIGHBORS, 4, 1, 0)}, ValueError, "numbers in [0, 4), got 4 in row 1"),
    (project, {"points": [[0, 0, 1]]}, TypeError, "points: expected a torch.Tensor, got list"),
    (project, {"points": EYE}, TypeError, "points: expected dtype torch.float32, got torch.float64"),
    (project, {"points": POSITIONS}, ValueError, "points: expected shape [N, 3], got [3]"),
    (project, {"camera_from_world": EYE[:3]}, ValueError, "camera_from_world: expected shape [4, 4], got [3, 4]"),
    (project, {"intrinsics": EYE.float()}, TypeError, "intrinsics: expected dtype torch.float64, got torch.float32"),
    (project, {"near": 0.0}, ValueError, "near: expected a number > 0, got 0"),
    (project, {"far": NAN}, ValueError, "far: expected a number >= 0, got nan"),
    (project, {"height": 4.5}, TypeError, "height: expected int, got float"),
    (project, {"width": -1}, ValueError, "width: expected a number >= 0, got -1"),
    (project, {"margin": -1}, ValueError, "margin: expected a number >= 0, got -1"),
    (splat_depth, {"row": PIXELS[None]}, ValueError, "row: expected shape [M], got [1, 3]"),
    (splat_depth, {"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    (splat_depth, {"column": PIXELS - 1}, ValueError, "column: expected numbers in [0, 4), got -1 at 0"),
    (splat_depth, {"column": PIXELS[:2]}, ValueError, "column: expected shape [M] = [3], got [2]"),
    (splat_depth, {"depth": PIXELS}, TypeError, "depth: expected dtype torch.float32, got torch.int64"),
    (splat_depth, {"depth": changed(POSITIONS, NAN, 1)}, ValueError, "depth: expected no NaN, got NaN at 1"),
    (splat_depth, {"reach": PIXELS - 1}, ValueError, "reach: expected numbers in [0, 2147483647), got -1 at 0"),
    (splat_depth, {"height": -1}, ValueError, "height: expected a number >= 0, got -1"),
    (splat_depth, {"height": 2**20, "width": 2**20}, ValueError, "expected an image of at most 2^31 - 1 pixels"),
    (window_overlaps, {"order": PIXELS}, TypeError, "order: expected dtype torch.int32, got torch.int64"),
    (window_overlaps, {"other_end": PIXELS[:2].int()}, ValueError, "other_end: expected shape [E] = [3], got [2]"),
    (
        window_overlaps,
        {"other_end": PIXELS.int() - 1},
        ValueError,
        "other_end: expected numbers in [0, 4), got -1 at 0",
    ),
    (window_overlaps, {"start": PIXELS[:0].int()}, ValueError, "start: expected shape [N + 1], got [0]"),
    (
        window_overlaps,
        {"start": torch.tensor([0, 9, 9, 9, 9]).int()},
        ValueError,
        "start: expected ascending numbers in [0, E]",
    ),
    (window_overlaps, {"point": torch.tensor([0, 1, 4])}, ValueError, "point: expected numbers in [0, 4), got 4 at 2"),
    (window_overlaps, {"point": torch.tensor([0, 1, 0])}, ValueError, "point: expected every point once, got 0 again"),
    (window_overlaps, {"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    (window_overlaps, {"column": PIXELS - 1}, ValueError, "column: expected numbers in [0, 4), got -1 at 0"),
    (window_overlaps, {"labels": LABELS.long()}, TypeError, "labels: expected dtype torch.int32, got torch.int64"),
    (window_overlaps, {"window": 2}, ValueError, "window: expected an odd number below 32768, got 2"),
    (line_maxima, {"order": PIXELS}, TypeError, "order: expected dtype torch.int32, got torch.int64"),
    (line_maxima, {"other_end": PIXELS.int() - 1}, ValueError, "other_end: expected numbers in [0, 4), got -1 at 0"),
    (line_maxima, {"start": torch.tensor([0, 2, 1, 3, 3]).int()}, ValueError, "start: expected ascending numbers"),
    (line_maxima, {"point": torch.tensor([3, 1, 3])}, ValueError, "point: expected every point once, got 3 again at 2"),
    (line_maxima, {"row": PIXELS + 1}, ValueError, "row: expected numbers in [0, 3), got 3 at 2"),
    (line_maxima, {"column": PIXELS[:2]}, ValueError, "column: expected shape [M] = [3], got [2]"),
    (line_maxima, {"image": LABELS}, TypeError, "image: expected dtype torch.uint8, got torch.int32"),
    (line_maxima, {"image": LABELS[0].byte()}, ValueError, "image: expected shape [H, W], got [4]"),
    (pair_counts, {"u": PIXELS}, TypeError, "u: expected dtype torch.float32, got torch.int64"),
    (pair_counts, {"u": changed(POSITIONS, NAN, 1)}, ValueError, "u: expected finite numbers, got nan at 1"),
    (pair_counts, {"v": changed(POSITIONS, torch.inf, 1)}, ValueError, "v: expected finite numbers, got inf at 1"),
    (pair_counts, {"v": POSITIONS[:2]}, ValueError, "v: expected shape [M] = [3], got [2]"),
    (pair_counts, {"pixel": PIXELS - 1}, ValueError, "pixel: expected numbers in [0, 2147483647), got -1 at 0"),
    (pair_counts, {"segment": PIXELS - 2}, ValueError, "segment: expected numbers in [0, 2147483647), got -2 at 0"),
    (pair_counts, {"label": PIXELS + 2**40}, ValueError, f"label: expected numbers in [0, 2147483647), got {2**40}"),
    (pair_counts, {"radius": 0}, ValueError, "radius: expected a finite number > 0, got 0"),
    (pair_counts, {"radius": "1"}, TypeError, "radius: expected int or float, got str"),
    (parse_numbers, {"text": "1 2 3"}, TypeError, "text: expected a torch.Tensor, got str"),
    (parse_numbers, {"text": PIXELS}, TypeError, "text: expected dtype torch.uint8, got torch.int64"),
    (parse_numbers, {"text": LABELS.byte()}, ValueError, "text: expected shape [B], got [3, 4]"),
    (parse_numbers, {"num_rows": -1}, ValueError, "num_rows: expected a number >= 0, got -1"),
    (parse_numbers, {"num_rows": 3}, ValueError, "text: expected 3 numbers in row 2, got 1 words"),
    (parse_numbers, {"num_columns": 0}, ValueError, "num_columns: expected a number > 0, got 0"),
    (parse_numbers, {"num_columns": 3.0}, TypeError, "num_columns: expected int, got float"),
    (segment_graphs, {"labels": LABELS[0]}, ValueError, "labels: expected shape [H, W], got [4]"),
    (segment_graphs, {"labels": LABELS + 1}, ValueError, "labels: expected numbers in [0, 2), got 2 at 2"),
    (segment_graphs, {"labels": LABELS - 1}, ValueError, "labels: expected numbers in [0, 2), got -2 at 3"),
    (segment_graphs, {"chosen": PIXELS}, TypeError, "chosen: expected dtype torch.bool, got torch.int64"),
    (segment_graphs, {"colors": torch.rand(3, 4, 3)}, ValueError, "colors: expected shape [3, H, W] = [3, 3, 4], got"),
    (segment_graphs, {"boundary": torch.rand(3)}, ValueError, "boundary: expected shape [H, W] = [3, 4], got [3]"),
    (segment_graphs, {"color_weight": -1}, ValueError, "color_weight: expected a number >= 0, got -1"),
    (segment_graphs, {"boundary_weight": NAN}, ValueError, "boundary_weight: expected a number >= 0, got nan"),
    (match_pixels, {"pred": LABELS}, TypeError, "pred: expected dtype torch.bool, got torch.int32"),
    (match_pixels, {"pred": LABELS[0] > 0}, ValueError, "pred: expected shape [H, W], got [4]"),
    (match_pixels, {"target": LABELS.T > 0}, ValueError, "target: expected shape [H, W] = [3, 4], got [4, 3]"),
    (match_pixels, {"radius": -1}, ValueError, "radius: expected a number >= 0, got -1"),
    (match_pixels, {"radius": torch.inf}, ValueError, "radius: expected a finite number >= 0, got inf"),
    (match_pixels, {"radius": "1"}, TypeError, "radius: expected int or float, got str"),
    (propagate_labels, {"markers": LABELS.long()}, TypeError, "markers: expected dtype torch.int32, got torch.int64"),
    (
        propagate_labels,
        {"colors": torch.rand(1, 3, 4)},
        ValueError,
        "colors: expected shape [3, H, W] = [3, 3, 4], got",
    ),
    (
        propagate_labels,
        {"colors": torch.full((3, 3, 4), NAN)},
        ValueError,
        "colors: expected numbers in [0, 1], got nan",
    ),
    (propagate_labels, {"boundary": torch.ones(3)}, ValueError, "boundary: expected shape [H, W] = [3, 4], got [3]"),
    (
        propagate_labels,
        {"boundary": torch.full((3, 4), 1.5)},
        ValueError,
        "boundary: expected numbers in [0, 1], got 1.5",
    ),
    (propagate_labels, {"color_weight": -1.0}, ValueError, "color_weight: expected a number >= 0, got -1.0"),
    (propagate_labels, {"boundary_weight": 1001.0}, ValueError, "boundary_weight: expected 0 to 1000, got 1001"),
    (outvoted_markers, {"markers": LABELS[0]}, ValueError, "markers: expected shape [H, W], got [4]"),
    (outvoted_markers, {"colors": torch.ones(3, 4)}, ValueError, "colors: expected shape [3, H, W] = [3, 3, 4], got"),
    (outvoted_markers, {"colors": torch.full((3, 3, 4), NAN)}, ValueError, "colors: expected numbers in [0, 1], got"),
    (outvoted_markers, {"color_weight": torch.inf}, ValueError, "color_weight: expected 0 to 1000, got inf"),
    (outvoted_markers, {"num_voters": 0}, ValueError, "num_voters: expected 1 to 2^31 - 1, got 0"),
    (outvoted_markers, {"near": -1.0}, ValueError, "near: expected a number >= 0, got -1.0"),
    (merge_regions, {"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    (merge_regions, {"edge_index": EDGES.t()}, ValueError, "edge_index: expected shape [2, E], got [3, 2]"),
    (merge_regions, {"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    (merge_regions, {"edge_index": changed(EDGES, -1, 0, 1)}, ValueError, "numbers in [0, 4), got -1 at edge 1"),
    (merge_regions, {"cost": VALUES.double()}, TypeError, "cost: expected dtype torch.float32, got torch.float64"),
    (merge_regions, {"cost": VALUES[:2]}, ValueError, "cost: expected shape [E] = [3], got [2]"),
    (merge_regions, {"cost": changed(VALUES, NAN, 1)}, ValueError, "cost: expected numbers in [0, 1024], got nan at"),
    (merge_regions, {"cost": -VALUES}, ValueError, "cost: expected numbers in [0, 1024], got -0.1 at edge 0"),
    (merge_regions, {"cost": VALUES + 1024}, ValueError, "cost: expected numbers in [0, 1024], got 1024.1 at edge 0"),
    (merge_regions, {"size": torch.ones(4)}, TypeError, "size: expected dtype torch.int64, got torch.float32"),
    (merge_regions, {"size": PIXELS[None]}, ValueError, "size: expected shape [R], got [1, 3]"),
    (merge_regions, {"size": torch.tensor([9, 1, -2, 3])}, ValueError, "size: expected numbers >= 0, got -2 at 2"),
    (merge_regions, {"threshold": -0.1}, ValueError, "threshold: expected a number >= 0, got -0.1"),
    (merge_regions, {"threshold": NAN}, ValueError, "threshold: expected a number >= 0, got nan"),
    (merge_regions, {"threshold": "1"}, TypeError, "threshold: expected int or float, got str"),
    (merge_regions, {"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
    (merge_regions, {"min_size": -1}, ValueError, "min_size: expected a number >= 0, got -1"),
    (mask_merges, {"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    (mask_merges, {"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    (mask_merges, {"cost": VALUES}, ValueError, "cost: expected numbers in [0, 1], got 5 at edge 1"),
    (
        mask_merges,
        {"cost": changed(VALUES / 9, NAN, 1)},
        ValueError,
        "cost: expected numbers in [0, 1], got nan at edge",
    ),
    (mask_merges, {"size": torch.tensor([9, 0, 2, 3])}, ValueError, "size: expected numbers > 0, got 0 at 1"),
    (
        mask_merges,
        {"in_mask": torch.tensor([[4], [0], [1]])},
        ValueError,
        "in_mask[0]: expected numbers in [0, 4), got",
    ),
    (
        mask_merges,
        {"in_mask": torch.tensor([[0], [2], [1]])},
        ValueError,
        "in_mask[1]: expected numbers in [0, 2), got",
    ),
    (mask_merges, {"in_mask": torch.tensor([[0], [0], [-1]])}, ValueError, "in_mask[2]: expected numbers >= 0, got -1"),
    (
        mask_merges,
        {"in_mask": torch.tensor([[2], [0], [1]])},
        ValueError,
        "region 2 has points in mask 0, but in_frame",
    ),
    (mask_merges, {"in_mask": torch.tensor([[0], [0], [6]])}, ValueError, "region 0 has more points in mask 0 than in"),
    (mask_merges, {"in_mask": PIXELS}, ValueError, "in_mask: expected shape [3, I], got [3]"),
    (mask_merges, {"in_frame": torch.tensor([[-1], [0], [1]])}, ValueError, "in_frame[0]: expected numbers in [0, 4)"),
    (mask_merges, {"in_frame": torch.tensor([[0], [0], [-1]])}, ValueError, "in_frame[2]: expected numbers >= 0, got"),
    (mask_merges, {"weight": torch.tensor([257, 0])}, ValueError, "weight: expected numbers in [0, 256], got 257 at 0"),
    (mask_merges, {"weight": VALUES[:2]}, TypeError, "weight: expected dtype torch.int64, got torch.float32"),
    (mask_merges, {"frame_of_mask": PIXELS}, ValueError, "frame_of_mask: expected shape [M] = [2], got [3]"),
    (mask_merges, {"apart_weight": -1}, ValueError, "apart_weight: expected a number >= 0, got -1"),
    (mask_merges, {"prior_weight": 0}, ValueError, "prior_weight: expected a finite number > 0, got 0"),
    (mask_merges, {"prior_weight": torch.inf}, ValueError, "prior_weight: expected a finite number > 0, got inf"),
    (mask_merges, {"apart_weight": torch.inf}, ValueError, "apart_weight: expected a finite number >= 0, got inf"),
    (mask_merges, {"prior_weight": NAN}, ValueError, "prior_weight: expected a number >= 0, got nan"),
    (mask_merges, {"threshold": "1"}, TypeError, "threshold: expected int or float, got str"),
    (mask_merges, {"stays": PIXELS}, TypeError, "stays: expected dtype torch.bool, got torch.int64"),
    (mask_merges, {"stays": PIXELS > 0}, ValueError, "stays: expected shape [R] = [4], got [3]"),
    (mask_merges, {"min_size": 2.0}, TypeError, "min_size: expected int, got float"),
    (region_dendrogram, {"edge_index": EDGES.int()}, TypeError, "edge_index: expected dtype torch.int64, got torch.int32"),
    (region_dendrogram, {"edge_index": changed(EDGES, 4, 1, 2)}, ValueError, "numbers in [0, 4), got 4 at edge 2"),
    (region_dendrogram, {"cost": VALUES.double()}, TypeError, "cost: expected dtype torch.float32, got torch.float64"),
    (region_dendrogram, {"cost": VALUES[:2]}, ValueError, "cost: expected shape [E] = [3], got [2]"),
    (region_dendrogram, {"cost": changed(VALUES, NAN, 1)}, ValueError, "cost: expected numbers in [0, 1024], got nan at"),
    (region_dendrogram, {"num_regions": -1}, ValueError, "num_regions: expected a number >= 0, got -1"),
    (region_dendrogram, {"num_regions": 4.0}, TypeError, "num_regions: expected int, got float"),
    (region_dendrogram, {"num_regions": 2**31}, ValueError, "num_regions: expected 0 to 2^31 - 1, got 2147483648"),
    (region_dendrogram, {"threshold": -0.1}, ValueError, "threshold: expected a number >= 0, got -0.1"),
    (region_dendrogram, {"threshold": "1"}, TypeError, "threshold: expected int or float, got str"),
    (group_summaries, {"values": POSITIONS.double()}, TypeError, "values: expected dtype torch.float32, got"),
    (ascending_order, {"values": POSITIONS.double()}, TypeError, "values: expected dtype torch.float32, got"),
    (ascending_order, {"values": POSITIONS[None]}, ValueError, "values: expected shape [C], got [1, 3]"),
    (group_summaries, {"order": PIXELS[:2].int()}, ValueError, "order: expected shape [C] = [3], got [2]"),
    (group_summaries, {"order": PIXELS}, TypeError, "order: expected dtype torch.int32, got torch.int64"),
    (group_summaries, {"order": PIXELS.int() + 1}, ValueError, "order: expected numbers in [0, 3), got 3 at 2"),
    (group_summaries, {"order": PIXELS.int() * 0}, ValueError, "order: expected a permutation, got 0 again at 1"),
    (group_summaries, {"order": PIXELS.int().flip(0)}, ValueError, "ascending values, got a smaller one at 2"),
    (group_summaries, {"group": PIXELS - 2}, ValueError, "group: expected numbers in [0, 2), got -2 at 0"),
    (group_summaries, {"group": PIXELS + 1}, ValueError, "group: expected numbers in [0, 2), got 2 at 1"),
    (group_summaries, {"num_groups": -1}, ValueError, "num_groups: expected a number >= 0, got -1"),
    (group_summaries, {"quantiles": POSITIONS}, ValueError, "quantiles: expected numbers in [0, 1], got 2 at 2"),
    (group_summaries, {"quantiles": POSITIONS * NAN}, ValueError, "quantiles: expected numbers in [0, 1], got nan"),
    (region_planes, {"points": EYE[:, :3]}, TypeError, "points: expected dtype torch.float32, got torch.float64"),
    (region_planes, {"points": POINTS[:, :2]}, ValueError, "points: expected shape [N, 3], got [4, 2]"),
    (region_planes, {"neighbors": NEIGHBORS.short()}, TypeError, "expected dtype torch.int32 or torch.int64, got"),
    (region_planes, {"neighbors": NEIGHBORS[:3]}, ValueError, "neighbors: expected shape [N, K] = [4, K], got [3, 2]"),
    (region_planes, {"neighbors": changed(NEIGHBORS, 4, 1, 0)}, ValueError, "numbers in [0, 4), got 4 in row 1"),
    (region_planes, {"neighbors": changed(NEIGHBORS, -1, 3, 0).int()}, ValueError, "in [0, 4), got -1 in row 3"),
    (region_planes, {"region": PIXELS}, ValueError, "region: expected shape [N] = [4], got [3]"),
    (region_planes, {"region": SOURCE}, TypeError, "region: expected dtype torch.int64, got torch.float32"),
    (region_planes, {"normals": POINTS[:3]}, ValueError, "normals: expected shape [N, 3] = [4, 3], got [3, 3]"),
    (region_planes, {"min_points": 2}, ValueError, "min_points: expected at least 3, got 2"),
    (region_planes, {"min_points": -3}, ValueError, "min_points: expected a number >= 0, got -3"),
    (region_planes, {"min_points": 3.0}, TypeError, "min_points: expected int, got float"),
    (ultrametric_contours, {"boundary": IMAGES[0]}, ValueError, "boundary: expected shape [H, W], got [3, 2, 4]"),
    (ultrametric_contours, {"boundary": LABELS}, TypeError, "boundary: expected dtype torch.float32, got torch.int32"),
    (
        ultrametric_contours,
        {"boundary": IMAGES[0, 0] + 0.9},
        ValueError,
        "boundary: expected numbers in [0, 1], got 1.",
    ),
    (ultrametric_contours, {"boundary": IMAGES[0, 0] * NAN}, ValueError, "numbers in [0, 1], got nan at 0"),
    (
        ultrametric_contours,
        {"relief": IMAGES[0, 0].T},
        ValueError,
        "relief: expected shape [H, W] = [2, 4], got [4, 2]",
    ),
    (
        boosted_trees,
        {"values": BOOSTED_TREES["values"].double()},
        TypeError,
        "values: expected dtype torch.float32, got",
    ),
    (boosted_trees, {"values": VALUES}, ValueError, "values: expected shape [B, F], got [3]"),
    (
        boosted_trees,
        {"values": BOOSTED_TREES["values"][:, :1]},
        ValueError,
        "numbers in [0, 1), got 1 at node 0 of tree 1",
    ),
    (boosted_trees, {"feature": BOOSTED_TREES["left"].long()}, TypeError, "feature: expected dtype torch.int32, got"),
    (boosted_trees, {"feature": BOOSTED_TREES["left"][0]}, ValueError, "feature: expected shape [T, M], got [3]"),
    (
        boosted_trees,
        {"feature": BOOSTED_TREES["left"]},
        ValueError,
        "feature: expected numbers in [0, 2), got -1 at node",
    ),
    (boosted_trees, {"threshold": VALUES.double()}, ValueError, "threshold: expected shape [T, M] = [2, 3], got [3]"),
    (
        boosted_trees,
        {"threshold": changed(BOOSTED_TREES["threshold"], torch.inf, 1, 0)},
        ValueError,
        "threshold: expected finite numbers, got inf at node 0 of tree 1",
    ),
    (boosted_trees, {"missing_left": BOOSTED_TREES["left"]}, TypeError, "missing_left: expected dtype torch.bool, got"),
    (
        boosted_trees,
        {"left": changed(BOOSTED_TREES["left"], 0, 0, 0)},
        ValueError,
        "left: expected -1 or places after the node's, below 3, got 0 at node 0 of tree 0",
    ),
    (
        boosted_trees,
        {"left": changed(BOOSTED_TREES["left"], 3, 1, 0)},
        ValueError,
        "below 3, got 3 at node 0 of tree 1",
    ),
    (
        boosted_trees,
        {"left": BOOSTED_TREES["left"][:1]},
        ValueError,
        "left: expected shape [T, M] = [2, 3], got [1, 3]",
    ),
    (boosted_trees, {"right": changed(BOOSTED_TREES["right"], -2, 0, 1)}, ValueError, "right: expected -1 or places"),
    (
        boosted_trees,
        {"right": changed(BOOSTED_TREES["right"], -1, 0, 0)},
        ValueError,
        "right: expected -1 exactly where left is -1, got -1 at node 0 of tree 0",
    ),
    (boosted_trees, {"leaf_value": VALUES}, TypeError, "leaf_value: expected dtype torch.float64, got torch.float32"),
    (
        boosted_trees,
        {"leaf_value": BOOSTED_TREES["leaf_value"] * NAN},
        ValueError,
        "leaf_value: expected finite numbers",
    ),
    (ultrametric_contours, {"relief": changed(IMAGES[0, 0], NAN, 1, 1)}, ValueError, "expected no NaN, got NaN at 5"),
]


@pytest.mark.parametrize(("op", "change", "error", "message"), ERRORS)
def test_errors_name_the_argument(
    op: Callable[..., Any], change: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=re.escape(message)) as caught:
        op(**VALID[op] | change)
    assert ".cpp" not in str(caught.value)


#: What an exception of C++ becomes without the wrapper; from torch 2.15 on the second.
REFUSED = (ValueError, RuntimeError)


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ("edge_index: expected node numbers in [0, 4), got 9 at edge 2", ValueError),
        ("std::bad_alloc", MemoryError),
        ("[enforce fail at alloc_cpu.cpp:121] data. DefaultCPUAllocator: not enough memory", RuntimeError),
        ("expected scalar type Long but found Float", RuntimeError),
    ],
)
def test_errors_have_the_same_types_with_every_torch(message: str, error: type[Exception]) -> None:
    class OfTorch215:
        _schema = torch.ops.torchjoint.felzenszwalb.default._schema

        def __call__(self, *arguments: object) -> None:
            raise RuntimeError(message)

    with pytest.raises(error) as caught:
        call(OfTorch215(), EDGES)
    assert type(caught.value) is error


@pytest.mark.parametrize("op", VALID, ids=lambda op: op.__name__)
def test_every_wrapper_translates_errors(op: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    packet = getattr(torch.ops.torchjoint, op.__name__)

    class Refusing:
        """As every kernel refuses an argument with torch 2.15."""

        _schema = packet.default._schema

        def __call__(self, *arguments: object) -> None:
            raise RuntimeError(f"{self._schema.arguments[0].name}: wrong")

    monkeypatch.setattr(packet, "default", Refusing())
    with pytest.raises(ValueError, match=": wrong"):
        op(**VALID[op])


def test_kernels_called_directly_refuse_what_the_wrappers_do() -> None:
    fh, mc = torch.ops.torchjoint.felzenszwalb.default, torch.ops.torchjoint.min_cut.default
    image = torch.ops.torchjoint.felzenszwalb_image.default
    ne, fn = torch.ops.torchjoint.neighbor_edges.default, torch.ops.torchjoint.fit_normals.default
    named = {op: getattr(torch.ops.torchjoint, op.__name__).default for op in VALID}
    for op, change in (
        (project, {"points": EYE}),
        (project, {"points": POSITIONS}),
        (project, {"camera_from_world": EYE[:3]}),
        (project, {"intrinsics": EYE}),
        (project, {"width": 2**40}),
        (project, {"margin": NAN}),
        (splat_depth, {"row": torch.tensor(0)}),
        (splat_depth, {"column": PIXELS[:2]}),
        (splat_depth, {"reach": PIXELS.int()}),
        (splat_depth, {"height": -1}),
        (window_overlaps, {"order": PIXELS[:2].int()}),
        (window_overlaps, {"row": PIXELS[:2]}),
        (window_overlaps, {"labels": LABELS[0]}),
        (window_overlaps, {"window": -1}),
        (line_maxima, {"start": PIXELS[:0].int()}),
        (line_maxima, {"column": PIXELS[:2]}),
        (line_maxima, {"image": LABELS}),
        (pair_counts, {"segment": PIXELS[:2]}),
        (pair_counts, {"radius": NAN}),
        (parse_numbers, {"text": LABELS}),
        (parse_numbers, {"num_rows": -1}),
        (parse_numbers, {"num_columns": 2**62}),
        (segment_graphs, {"colors": torch.rand(3, 4, 3)}),
        (segment_graphs, {"boundary": torch.rand(3)}),
        (segment_graphs, {"chosen": PIXELS}),
        (segment_graphs, {"color_weight": NAN}),
        (propagate_labels, {"markers": LABELS.long()}),
        (propagate_labels, {"colors": torch.rand(3, 4, 3)}),
        (propagate_labels, {"boundary": torch.rand(3)}),
        (propagate_labels, {"boundary_weight": NAN}),
        (outvoted_markers, {"markers": LABELS.long()}),
        (outvoted_markers, {"colors": torch.rand(3, 4)}),
        (outvoted_markers, {"near": NAN}),
        (merge_regions, {"edge_index": EDGES.int()}),
        (merge_regions, {"cost": VALUES[:2]}),
        (merge_regions, {"cost": VALUES.double()}),
        (merge_regions, {"size": PIXELS[None]}),
        (merge_regions, {"threshold": NAN}),
        (merge_regions, {"min_size": -1}),
        (mask_merges, {"in_mask": EDGES}),
        (mask_merges, {"in_frame": EDGES}),
        (mask_merges, {"weight": VALUES}),
        (mask_merges, {"prior_weight": 0.0}),
        (mask_merges, {"stays": PIXELS}),
        (region_dendrogram, {"edge_index": EDGES.t()}),
        (region_dendrogram, {"cost": VALUES.double()}),
        (region_dendrogram, {"num_regions": -1}),
        (region_dendrogram, {"threshold": NAN}),
        (group_summaries, {"values": EDGES}),
        (group_summaries, {"order": PIXELS[:2].int()}),
        (ascending_order, {"values": EDGES}),
        (group_summaries, {"num_groups": -1}),
        (group_summaries, {"quantiles": EYE}),
        (region_planes, {"points": POINTS[:, :2]}),
        (region_planes, {"neighbors": NEIGHBORS[:3]}),
        (region_planes, {"neighbors": NEIGHBORS.float()}),
        (region_planes, {"region": PIXELS}),
        (region_planes, {"normals": EYE[:, :3]}),
        (region_planes, {"min_points": 2}),
        (boosted_trees, {"values": VALUES}),
        (boosted_trees, {"feature": PIXELS}),
        (boosted_trees, {"feature": torch.empty(2, 0, dtype=torch.int32)}),
        (boosted_trees, {"threshold": BOOSTED_TREES["leaf_value"][:1]}),
        (boosted_trees, {"leaf_value": BOOSTED_TREES["leaf_value"].float()}),
        (structured_forest, {"images": IMAGES[0]}),
        (structured_forest, {"children": LABELS}),
        (structured_forest, {"features": LABELS}),
        (structured_forest, {"thresholds": IMAGES[0, 0]}),
        (structured_forest, {"boundary_counts": LABELS}),
        (structured_forest, {"boundary_pixels": LABELS}),
        (structured_forest, {"images": torch.zeros(1, 3, 1, 2**14 + 1)}),
        (match_pixels, {"pred": LABELS}),
        (match_pixels, {"target": LABELS.T > 0}),
        (match_pixels, {"radius": NAN}),
        (ultrametric_contours, {"boundary": IMAGES[0]}),
        (ultrametric_contours, {"relief": IMAGES[0, 0].T}),
        (ultrametric_contours, {"relief": IMAGES[0, 0].double()}),
    ):
        with pytest.raises(REFUSED, match="expected"):
            named[op](**(VALID[op] | change))
    for refused in (
        lambda: fh(EDGES.int(), VALUES, 4, 1.0),
        lambda: fh(EDGES.t(), VALUES, 4, 1.0),
        lambda: fh(EDGES, VALUES.half(), 4, 1.0),
        lambda: fh(EDGES, VALUES[:2], 4, 1.0),
        lambda: fh(EDGES, VALUES, -1, 1.0),
        lambda: fh(EDGES, VALUES, 2**31, 1.0),
        lambda: fh(EDGES, VALUES, 4, NAN),
        lambda: fh(EDGES, VALUES, 4, 1.0, -1),
        lambda: image(IMAGES[0], None, 1.0),
        lambda: image(IMAGES.double(), None, 1.0),
        lambda: image(IMAGES, IMAGES[:, 0, :1], 1.0),
        lambda: image(IMAGES, None, NAN),
        lambda: image(IMAGES, None, 1.0, -1),
        lambda: image(IMAGES, None, 1.0, 1, NAN),
        lambda: image(IMAGES, None, 1.0, 1, 1.0, -1.0),
        lambda: mc(EDGES, VALUES[:2], SOURCE, SINK),
        lambda: mc(EDGES, VALUES, SOURCE, SINK[:2]),
        lambda: mc(EDGES, VALUES, SOURCE[None], SINK),
        lambda: ne(NEIGHBORS.float()),
        lambda: ne(NEIGHBORS[0]),
        lambda: fn(POINTS.half(), NEIGHBORS),
        lambda: fn(POINTS[:, :2], NEIGHBORS),
        lambda: fn(POINTS[:3], NEIGHBORS),
    ):
        with pytest.raises(REFUSED, match="expected"):
            refused()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_opcheck(dtype: torch.dtype) -> None:
    values, source, sink = VALUES.to(dtype), SOURCE.to(dtype), SINK.to(dtype)
    for operator, arguments in (
        (torch.ops.torchjoint.felzenszwalb.default, (EDGES, values, 4, 1.0, 2)),
        (torch.ops.torchjoint.felzenszwalb_image.default, (IMAGES, IMAGES[:, 0], 1.0, 2)),
        (torch.ops.torchjoint.felzenszwalb_image.default, (IMAGES, None, 1.0)),
        (torch.ops.torchjoint.min_cut.default, (EDGES, values, source, sink)),
        (torch.ops.torchjoint.neighbor_edges.default, (NEIGHBORS,)),
        (torch.ops.torchjoint.fit_normals.default, (POINTS.to(dtype), NEIGHBORS.int())),
    ):
        results = torch.library.opcheck(operator, arguments)
        assert results
        assert set(results.values()) == {"SUCCESS"}


@pytest.mark.parametrize("op", VALID)
def test_opcheck_of_every_operator(op: Callable[..., Any]) -> None:
    results = torch.library.opcheck(getattr(torch.ops.torchjoint, op.__name__).default, tuple(VALID[op].values()))
    assert results
    assert set(results.values()) == {"SUCCESS"}


def test_no_gradient_flows() -> None:
    weight = VALUES.clone().requires_grad_()
    assert not felzenszwalb(EDGES, weight, 4, 1.0).requires_grad
    assert not felzenszwalb_image(IMAGES.clone().requires_grad_(), scale=1.0).requires_grad
    assert not any(result.requires_grad for result in min_cut(EDGES, weight, SOURCE, SINK))
    assert not fit_normals(POINTS.clone().requires_grad_(), NEIGHBORS).requires_grad
    assert not merge_regions(**MERGE_REGIONS | {"cost": weight}).requires_grad
    assert not any(result.requires_grad for result in mask_merges(**MASK_MERGES | {"cost": weight / 9}))
    assert not any(result.requires_grad for result in region_dendrogram(**REGION_DENDROGRAM | {"cost": weight}))
    with_grad = {name: REGION_PLANES[name].clone().requires_grad_() for name in ("points", "normals")}
    assert not any(result.requires_grad for result in region_planes(**REGION_PLANES | with_grad))
    values = BOOSTED_TREES["values"].clone().requires_grad_()
    assert not boosted_trees(**BOOSTED_TREES | {"values": values}).requires_grad
    with_grad = torch.rand(3, 3, 4).requires_grad_()
    assert not outvoted_markers(LABELS, with_grad, 9.0, 3, 3.0).requires_grad
    assert not propagate_labels(**PROPAGATE_LABELS | {"boundary": torch.rand(3, 4).requires_grad_()}).requires_grad


#: The first traces as the other does and writes no C++.
BACKENDS = ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)]


@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("backend", BACKENDS)
def test_compile_without_graph_breaks(backend: str) -> None:
    @torch.compile(fullgraph=True, dynamic=True, backend=backend)
    def compiled(
        edge_index: torch.Tensor, weight: torch.Tensor, source: torch.Tensor, sink: torch.Tensor, scale: float
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        labels = felzenszwalb(edge_index, weight * 2, source.shape[0], scale, 1)
        side, flow = min_cut(edge_index, weight + 1, source, sink)
        return labels + 1, ~side, flow * 2

    for num_nodes, scale in ((4, 1.0), (9, 0.5), (30, 2.0)):
        generator = torch.Generator().manual_seed(num_nodes)
        edges = torch.randint(num_nodes, (2, 3 * num_nodes), generator=generator)
        weight, source = torch.rand(2, 3 * num_nodes, generator=generator)
        source, sink = source[:num_nodes] * 9, source[-num_nodes:] * 9
        labels, other_side, flow = compiled(edges, weight, source, sink, scale)
        side, expected_flow = min_cut(edges, weight + 1, source, sink)
        assert torch.equal(labels, felzenszwalb(edges, weight * 2, num_nodes, scale, 1) + 1)
        assert torch.equal(other_side, ~side)
        assert torch.equal(flow, expected_flow * 2)

    with pytest.raises(REFUSED, match=re.escape("expected node numbers in [0, 30), got 99 at edge 0")):
        compiled(changed(edges, 99, 0, 0), weight, source, sink, scale)
    first = r"capacity: expected finite numbers >= 0, got nan at edge 0|weight: expected no NaN, got NaN at edge 0"
    with pytest.raises(REFUSED, match=first):  # whichever operator the backend runs first
        compiled(edges, changed(weight, NAN, 0), source, sink, scale)


@pytest.mark.filterwarnings("ignore")  # the compiler's own
@pytest.mark.parametrize("backend", BACKENDS)
def test_neighbours_compile_without_graph_breaks(backend: str) -> None:
    def weigh(points: torch.Tensor, neighbors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        edges = neighbor_edges(neighbors)  # their number depends on the values
        normals = fit_normals(points * 2, neighbors)
        return edges + 1, (normals[edges[0]] * normals[edges[1]]).sum(dim=1)

    with torch._dynamo.config.patch(capture_dynamic_output_shape_ops=True):
        compiled = torch.compile(weigh, fullgraph=True, dynamic=True, backend=backend)
        for num_points in (5, 12, 40):
            generator = torch.Generator().manual_seed(num_points)
            points = torch.rand(num_points, 3, generator=generator)
            neighbors = torch.randint(num_points, (num_points, 4), generator=generator)
            torch.testing.assert_close(compiled(points, neighbors), weigh(points, neighbors))


def large_graph(num_edges: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(num_edges, (2, num_edges), generator=generator), torch.rand(num_edges, generator=generator)


LONG_OPERATORS = (
    felzenszwalb,
    felzenszwalb_image,
    min_cut,
    nearest_neighbors,
    neighbor_edges,
    fit_normals,
    group_summaries,
    mask_merges,
    merge_regions,
    region_dendrogram,
    region_planes,
    parse_numbers,
    propagate_labels,
    outvoted_markers,
    boosted_trees,
    structured_forest,
)


def long_call(op: Callable[..., Any], share: float = 1) -> Callable[[], Any]:
    """A call of the operator that takes some tenths of a second, or about such a share of that."""
    side = share**0.5
    if op is felzenszwalb_image:
        images = torch.rand(1, 3, int(1500 * side), int(1500 * side), generator=torch.Generator().manual_seed(0))
        return lambda: felzenszwalb_image(images, scale=1.0)
    if op is structured_forest:
        images = torch.rand(1, 3, int(1500 * side), int(1500 * side), generator=torch.Generator().manual_seed(0))
        return lambda: structured_forest(**STRUCTURED_FOREST | {"images": images})
    if op is propagate_labels:
        generator = torch.Generator().manual_seed(0)
        image = torch.rand(4, int(1000 * side), int(1000 * side), generator=generator)
        markers = torch.where(image[0] < 0.01, torch.arange(image.shape[2]), -1).int()
        return lambda: propagate_labels(markers, image[:3], image[3], 9.0, 2.0)
    if op is outvoted_markers:
        generator = torch.Generator().manual_seed(0)
        colors = torch.rand(3, int(400 * side), int(400 * side), generator=generator)
        return lambda: outvoted_markers((10 * colors[0]).int(), colors, 10.0, 12, 3.0)
    if op is parse_numbers:
        num_rows = int(4_000_000 * share)
        text = torch.tensor(list(b"1.25 -3.5\n"), dtype=torch.uint8).repeat(num_rows)
        return lambda: parse_numbers(text, num_rows, 2)
    if op is nearest_neighbors:
        points = torch.rand(int(200_000 * share), 3, generator=torch.Generator().manual_seed(0))
        return lambda: nearest_neighbors(points, 16)
    if op in (neighbor_edges, fit_normals, region_planes):
        generator = torch.Generator().manual_seed(0)
        points = torch.rand(int(500_000 * share), 3, generator=generator)
        neighbors = torch.randint(len(points), (len(points), 16), generator=generator)
        if op is region_planes:
            region = torch.arange(len(points)) % 2
            return lambda: region_planes(points, neighbors, region, points)
        return lambda: op(**{"points": points} if op is fit_normals else {}, neighbors=neighbors)
    if op is boosted_trees:
        places = torch.arange(1, 64, dtype=torch.int32).expand(40, -1)
        left = torch.where((places % 2 == 1) & (places < 63), places, -1)  # of two children the first is a leaf
        trees = {
            "feature": torch.zeros_like(left), "threshold": torch.zeros(left.shape, dtype=torch.float64),
            "missing_left": torch.zeros_like(left, dtype=torch.bool), "left": left,
            "right": torch.where(left > 0, left + 1, -1),
            "leaf_value": torch.rand(left.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)),
        }  # fmt: skip
        values = torch.rand(int(200_000 * share), 2, generator=torch.Generator().manual_seed(0))
        return lambda: boosted_trees(values, **trees)
    if op is merge_regions:
        edges, cost = large_graph(int(100_000 * share))
        return lambda: merge_regions(edges, cost, torch.ones(len(cost), dtype=torch.int64), 0.4, 2)
    if op is mask_merges:
        edges, cost = large_graph(int(10_000 * share))
        rows = torch.stack([torch.arange(len(cost)), torch.arange(len(cost)) % 7, torch.ones(len(cost)).long()])
        weight, frame_of_mask = torch.full((7,), 256), torch.arange(7)
        return lambda: mask_merges(edges, cost, rows[2], rows, rows, weight, frame_of_mask, 0.6, 0.1, 0.5)
    if op is group_summaries:
        values = torch.rand(int(3_000_000 * share), generator=torch.Generator().manual_seed(0))
        order, group = ascending_order(values), torch.arange(len(values)) % 1000
        return lambda: group_summaries(values, order, group, 1000, torch.tensor([0.5]))
    if op is ascending_order:
        return lambda: ascending_order(torch.arange(int(3_000_000 * share)).float())
    if op is region_dendrogram:
        edges, cost = large_graph(int(100_000 * share))
        return lambda: region_dendrogram(edges, cost, len(cost), 0.4)
    edges, weight = large_graph(int((3_000_000 if op is felzenszwalb else 1_000_000) * share))
    if op is felzenszwalb:
        return lambda: felzenszwalb(edges, weight, len(weight), 1.0)
    return lambda: min_cut(edges, weight, 9 * weight, 9 * weight.flip(0))


@pytest.mark.parametrize("op", LONG_OPERATORS)
def test_gil_is_released(op: Callable[..., Any]) -> None:
    """While one thread is inside the operator, another one runs Python, and so may be inside it, too."""
    call = long_call(op)

    def ticks_inside() -> int:
        inside: list[float] = []

        def timed() -> None:
            start = time.perf_counter()
            call()
            inside.extend((start, time.perf_counter()))

        thread = threading.Thread(target=timed)
        ticks = []
        thread.start()
        while thread.is_alive():
            ticks.append(time.perf_counter())
            time.sleep(0.001)
        start, end = inside
        margin = (end - start) / 4
        return sum(start + margin < tick < end - margin for tick in ticks)

    # With the GIL held no tick ever falls into the call, except perhaps at its very ends; without, one may be unlucky.
    assert any(ticks_inside() >= 3 for _ in range(20))


@pytest.mark.parametrize("op", LONG_OPERATORS)
def test_two_threads_at_once_give_the_same_results(op: Callable[..., Any]) -> None:
    call = long_call(op, share=0.2)
    expected = call()
    with ThreadPoolExecutor(2) as pool:
        for result in pool.map(lambda _: call(), range(2)):
            torch.testing.assert_close(result, expected, rtol=0, atol=0)


@pytest.mark.slow
@pytest.mark.parametrize("times", [300, pytest.param(1000, marks=pytest.mark.slow)])
def test_memory_does_not_grow(times: int) -> None:
    """So many calls of each operator leave no more behind than their first hundred did."""
    code = f"""
import gc, sys, torch
sys.path.insert(0, "tests")
from operator_arguments import VALID, resident_memory
torch.set_num_threads(1)
def calls(times):
    for _ in range(times):
        for op, arguments in VALID.items():
            op(**arguments | large.get(op, {{}}))
            try:
                op(**arguments | {{next(iter(arguments)): None}})
            except TypeError:
                pass
    gc.collect()
    return resident_memory()
edges, weight = torch.randint(900, (2, 4000)), torch.rand(4000)
graph = {{"edge_index": edges, "weight": weight, "num_nodes": 900}}
large = {{op: graph for op in VALID if graph.keys() <= VALID[op].keys()}}
before = calls(100)
print(calls({times}) - before)
"""
    root = Path(__file__).parents[2]
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert int(result.stdout) < 2**20  # a leak of one of the graphs would be 15 MB or more


@pytest.mark.slow
def test_a_source_folder_without_binary_says_what_to_type(tmp_path: Path) -> None:
    """As after `git clone`, where Python finds the folder before an installed package."""
    root, checkout = Path(__file__).parents[2], tmp_path / "my checkout"
    left_out = shutil.ignore_patterns("_C*", "csrc", "models", "__pycache__")
    shutil.copytree(root / "torchjoint", checkout / "torchjoint", ignore=left_out)
    shutil.copy(root / "pyproject.toml", checkout)
    # An editable install, as the tests' own, would lend its binary.
    code = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "Editable" not in getattr(finder, "__name__", "")]
import torchjoint
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=checkout)
    assert result.returncode != 0
    error = result.stderr.strip().splitlines()[-1]
    assert error.startswith(f"ImportError: this is the source folder of torchjoint, {checkout / 'torchjoint'}, and it ")
    assert "Leave the checkout (cd ..)" in error
    assert re.search(rf"pip install -e ['\"]?{re.escape(str(checkout))}['\"]?$", error)


@pytest.mark.slow
def test_missing_binary_is_explained() -> None:
    code = "import sys; sys.modules['torchjoint._C'] = None\nimport torchjoint.ops"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode != 0
    assert "ImportError: the compiled extension torchjoint._C is missing or does not load" in result.stderr


def test_every_folder_is_packaged() -> None:
    root = Path(__file__).parents[2]
    listed = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {".".join(path.parent.relative_to(root).parts) for path in (root / "torchjoint").rglob("__init__.py")}
    assert found | {"torchjoint.configs"} == set(listed)
