"""Compiled operators that only this package calls; they may change without notice.

No gradient flows through them, and the number of threads does not change a result. The kernels check the arguments: an
error names the argument. ``tests/reference/`` has a slow and simple Python version of each, with an example.
"""

import torch
from torch import Tensor

from torchjoint.ops._call import call, dynamic_size, of_one_size, register_fakes
from torchjoint.ops._checks import check_array, check_number

#: Voxels along a side of a block of :func:`integrate_depth`.
SIDE = 8
#: Sums of a voxel: distances, weights, and three colours.
CHANNELS = 5
#: A distance of one truncation in the sums of a voxel.
UNIT = 2**14
#: The weight of a mask that is fully trusted. Weights are whole numbers, so that all sums are exact.
WEIGHT_UNIT = 256


# Before step 3: files and depth images


def integrate_depth(
    sums: Tensor, row: Tensor, block: Tensor, depth: Tensor, color: Tensor, intrinsics: Tensor, world_to_camera: Tensor,
    voxel_size: float, truncation: float, far: float,
) -> None:  # fmt: skip
    """Add what a depth image says of some blocks of voxels to their sums, in place (Curless and Levoy 1996).

    A voxel whose centre the camera sees, not farther than ``truncation`` behind the measured surface, gets the signed
    distance to it along the ray (positive in front, in units of ``truncation / UNIT``, at most ``UNIT``), a weight of
    one, and the colour of the pixel. All sums are of whole numbers: the order of images does not matter.

    Args:
        sums: ``[B, 512, 5]`` int32, contiguous: sums of distances, weights, red, green, blue of the voxels of each
            block, which are numbered as an array ``[8, 8, 8]``. Changed in place.
        row, block: ``[K]`` int64, ascending: the row in ``sums`` of each block to change; ``[K, 3]`` int64, its
            position in units of 8 voxels.
        depth: ``[H, W]`` float32 metres; pixels that are not in (0, ``far``], such as 0 and NaN, measured nothing.
        color: ``[H, W, 3]`` uint8 RGB.
        intrinsics, world_to_camera: ``[3, 3]`` float64 pixels; ``[4, 4]`` float64, a rigid transform.
        voxel_size, truncation, far: metres.
    """
    check_number("far", far, (int, float))
    camera = (intrinsics, world_to_camera, voxel_size, truncation, far)
    call("integrate_depth", sums, row, block, depth, color, *camera)


# Steps 1 and 5: images, and the edges of the graph in them


def structured_forest(
    images: Tensor, children: Tensor, features: Tensor, thresholds: Tensor, boundary_counts: Tensor,
    boundary_pixels: Tensor, trees_per_site: int, stride: int = 2,
) -> Tensor:  # fmt: skip
    """Compute boundary strength by structured forests: P. Dollár and C. L. Zitnick (PAMI 2015).

    Sites are `stride` pixels apart. At each site, some of the trees vote: the patch around the site, 32 pixels wide,
    reaches a leaf of the tree, and each boundary pixel of the leaf gets a vote. Sums of votes are smoothed. On images
    with even sides, the result equals that of OpenCV's ``detectEdges``, but for patches whose feature almost equals a
    threshold. An odd side is extended by one mirrored pixel. See :class:`torchjoint.images.forest.Forest`.

    Args:
        images: ``[B, 3, H, W]`` float32 RGB in [0, 1], at most 2^14 pixels a side.
        children: ``[T, N]`` int32, 0 at a leaf, else 1 + the index of the left child in the tree; the right child is
            the next node. Children come after their parents.
        features: ``[T, N]`` int32, the feature that a node tests, in [0, 7228): 13 x 16 x 16 values (channel, column,
            row; the row varies fastest), then differences of a channel between two cells of a 5 x 5 grid.
        thresholds: ``[T, N]`` float32, finite; a patch whose feature is less than the threshold goes left.
        boundary_counts: ``[T, N]`` int32, the number of `boundary_pixels` of a leaf.
        boundary_pixels: ``[P]`` uint8, column * 16 + row of boundary pixels in a leaf's patch, by trees, then nodes.
        trees_per_site, stride: 1 to T trees that vote at one site; 2 or 4 pixels, 4 is faster and less accurate.

    Returns:
        ``[B, H, W]`` float32, >= 0.
    """
    trees = (children, features, thresholds, boundary_counts, boundary_pixels, trees_per_site)
    return call("structured_forest", images, *trees, stride)


def window_overlaps(
    order: Tensor, other_end: Tensor, start: Tensor, point: Tensor, row: Tensor, column: Tensor, labels: Tensor,
    window: int,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Compare the labels around the two ends of an edge, for all edges with two visible ends.

    The overlap of two windows is their histogram intersection divided by the size of the smaller window (eq. 5 of the
    paper). Windows are clipped at the image border, and pixels without a label do not count.

    Args:
        order, other_end, start: ``[E]``, ``[E]``, ``[N + 1]`` int32, the CSR adjacency of the graph, each undirected
            edge once (:class:`torchjoint.cloud.graph.CsrAdjacency`).
        point, row, column: ``[M]`` int64, the nodes that the image sees, each once, and the pixels that contain them.
        labels, window: ``[H, W]`` int32, negative = none; side of the windows, pixels, odd.

    Returns:
        ``edge`` ``[S]`` int64, the edges with two visible ends and a labelled pixel in both windows; ``overlap``
        ``[S]`` float64 in [0, 1]. In the order of ``point``, then of ``order``.
    """
    return call("window_overlaps", order, other_end, start, point, row, column, labels, window)


def line_maxima(
    order: Tensor, other_end: Tensor, start: Tensor, point: Tensor, row: Tensor, column: Tensor, image: Tensor
) -> tuple[Tensor, Tensor]:
    """Find the largest pixel of an image between the two ends of an edge, for all edges with two visible ends.

    ``image``, ``[H, W]`` uint8, is read at the pixels of both ends, and at a quarter, a half and three quarters of the
    line between them, rounded to the nearest pixel, ties to the even row or column. The other arguments are those of
    :func:`window_overlaps`.

    Returns:
        ``edge`` ``[S]`` int64, the edges with two visible ends; ``maximum`` ``[S]`` uint8. In the order of ``point``,
        then of ``order``.
    """
    return call("line_maxima", order, other_end, start, point, row, column, image)


# Step 6, method learned


def boosted_trees(
    values: Tensor, feature: Tensor, threshold: Tensor, missing_left: Tensor, left: Tensor, right: Tensor,
    leaf_value: Tensor,
) -> Tensor:  # fmt: skip
    """Sum the values of the leaves that each row reaches, over all trees, in their order.

    A row starts at node 0 of a tree. At an inner node it goes to the left child if its feature is at most the threshold
    (compared in float64, as in scikit-learn's HistGradientBoosting), otherwise to the right child. If the feature is
    NaN, ``missing_left`` decides.

    Args:
        values: ``[B, F]`` float32, the features of each row; NaN = missing.
        feature: ``[T, M]`` int32, the feature that a node tests, in [0, F). T trees are padded to M >= 1 nodes.
        threshold, missing_left: ``[T, M]`` float64, finite; ``[T, M]`` bool, whether rows without the feature go left.
        left, right: ``[T, M]`` int32, numbers of the children in the tree, above the node's own; both -1 at a leaf.
        leaf_value: ``[T, M]`` float64, finite; only those of leaves count.

    Returns:
        ``[B]`` float64.
    """
    trees = (feature, threshold, missing_left, left, right, leaf_value)
    check_array("values", values, torch.float32, (None, None), "[B, F]")
    check_array("feature", feature, torch.int32, (None, None), "[T, M]")
    names = ("threshold", "missing_left", "left", "right", "leaf_value")
    dtypes = (torch.float64, torch.bool, torch.int32, torch.int32, torch.float64)
    for name, value, dtype in zip(names, trees[1:], dtypes, strict=True):  # trees come from users' files
        check_array(name, value, dtype, tuple(feature.shape), "[T, M]")
    return call("boosted_trees", values, *trees)


def agreement_sums(
    region: Tensor, segment: Tensor, num_points: Tensor, segment_size: Tensor, frame_of_segment: Tensor,
    num_regions: int, pairs: Tensor, min_points: int, resolution: float,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """Compare pairs of regions in all images that see both.

    The rows of one region and one image segment are added. An image sees a region if it sees at least ``min_points`` of
    its points. The agreement of two regions in an image is the sum, over its
    segments, of the smaller of the two shares that the segment has of the regions' visible points. All sums are of
    whole numbers, so the order of the rows does not change the result.

    Args:
        region, segment, num_points: ``[I]`` int32, of each row; visible points of the region in the image segment.
        segment_size, frame_of_segment: ``[L]`` int64: visible points, at most 2^31 - 1 in a frame; ascending.
        num_regions: R.
        pairs: ``[2, B]`` int64, pairs of regions.
        min_points: > 0.
        resolution: agreements are rounded to multiples of this before they are added; in [2^-31, 1].

    Returns:
        ``[R]`` float64: largest intersection over union of the region and an image segment. ``[3, B]`` float64: the
        same of the union of two regions, over the segments that contain points of both; smallest agreement, inf if no
        image sees both; largest agreement, -inf if none does. ``[5, B]`` int64: sum of the agreements times n n', where
        n and n' are the numbers of points that the image sees; sum of n n'; sum of the rounded agreements, in units of
        the resolution; sum of their squares; number of images that see both.
    """
    seen = (region, segment, num_points, segment_size, frame_of_segment, num_regions)
    return call("agreement_sums", *seen, pairs, min_points, resolution)


def region_planes(
    points: Tensor, neighbors: Tensor, region: Tensor, normals: Tensor, min_points: int = 6
) -> tuple[Tensor, Tensor]:
    """Fit a plane to each point and its neighbours in the same region; sums in float64, relative to the point.

    Args:
        points: ``[N, 3]`` float32, finite.
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point, without the point itself.
        region: ``[N]`` int64, region of each point.
        normals: ``[N, 3]`` float32. A fitted normal gets the sign with which it points to the side of this normal. If
            too few of the points are in the region, this normal is returned.
        min_points: smallest number of points, including the point itself, to which a plane is fitted; >= 3.

    Returns:
        ``[N, 3]`` float32, the mean of the points in the region; ``[N, 3]`` float32, the normal, of unit length if it
        is fitted.
    """
    return call("region_planes", points, neighbors, region, normals, min_points)


def mask_merges(
    edge_index: Tensor, cost: Tensor, count: Tensor, size: Tensor, in_mask: Tensor, in_frame: Tensor, weight: Tensor,
    frame_of_mask: Tensor, apart_weight: float, prior_weight: float, threshold: float, stays: Tensor | None = None,
    min_size: int = 0,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Repeatedly merge the two adjacent regions with the lowest cost, up to a threshold, and list the merges.

    For two regions with n and n' points, consider all pairs of points, one of each region, that one frame sees. A mask
    of weight s that contains both points adds s to A. A mask that contains one of them adds s / 2 to D. A mask with
    neither adds nothing. With the mean prior p over the edges between the two regions, the cost of their boundary is

        (w D / (n n') + k p) / ((A + w D) / (n n') + k)

    So k is a number of views: the prior has the weight of k frames that see both regions completely. Of equal costs,
    the boundary that comes first in ``edge_index`` is merged. All sums are exact, whatever the order of columns.

    Args:
        edge_index: ``[2, E]`` int64, region numbers. Edges inside a region are ignored. Parallel edges all count.
        cost: ``[E]`` float32 in [0, 1], prior of each edge; rounded to multiples of 2^-20.
        count: ``[E]`` int64 > 0, how many parallel edges each edge stands for.
        size: ``[R]`` int64 > 0, points of each region.
        in_mask, in_frame: ``[3, I]``, ``[3, J]`` int64: region, mask or frame, the number of the region's points in it.
        weight, frame_of_mask: ``[M]`` int64; the weight s is in [0, WEIGHT_UNIT].
        apart_weight: w >= 0. Masks of parts are more common than masks of several objects, so w < 1.
        prior_weight, threshold: k > 0, frames; largest cost of two regions that merge, >= 0.
        stays, min_size: if ``min_size`` is not 0, two groups of regions merge only if one of them is small: it has
            fewer points, and contains no region of ``stays`` (optional ``[R]`` bool).

    Returns:
        ``[2, M']`` int64, for each merge the lowest regions a < b of the two groups that merge; ``[M']`` float64, the
        cost of their boundary. M' < R.
    """
    if stays is None:
        stays = torch.zeros(len(size), dtype=torch.bool)
    masks = (in_mask, in_frame, weight, frame_of_mask, apart_weight, prior_weight)
    return call("mask_merges", edge_index, cost, count, size, *masks, threshold, stays, min_size)


# Step 6, method scan


def local_spacing(points: Tensor, reach: Tensor, share: float, count: int) -> Tensor:
    """Measure the mean distance of each point to its nearest neighbours, if it is between a share of its reach and it.

    This takes a fraction of the time of a search for all neighbours.

    Args:
        points, reach: ``[N, 3]`` float32 metres, finite; ``[N]`` float64 metres, finite, not negative.
        share: in [0, 1].
        count: number of nearest neighbours, 1 to 8.

    Returns:
        ``[N]`` float64 metres: 0 if the mean distance is at most ``share * reach``, infinite if it is more than
        ``reach`` or if there are too few points.
    """
    return call("local_spacing", points, reach, share, count)


def gap_components(
    points: Tensor, gap: Tensor, neighbors: Tensor, used: Tensor, min_size: int = 0, joining: float = 1.0
) -> Tensor:
    """Find the connected components of points, each of which allows a gap of its own.

    Neighbours are connected if their distance is at most the smaller one of their gaps. Then small components join
    others: neighbours at a distance of at most ``joining`` such gaps are visited in the order of distance per gap (of
    equal ones: by the numbers of the points), and if a component of either has fewer than ``min_size`` points, both
    become one.

    Args:
        points, gap: ``[N, 3]`` float32 metres; ``[N]`` float64 metres, not negative.
        neighbors: ``[N, K]`` int32 or int64, neighbours of each point.
        used: ``[N]`` bool; other points are connected to nothing.
        min_size: smallest number of points of a component that joins no other.
        joining: largest distance at which small components join others, in gaps; at least 1.

    Returns:
        ``[N]`` int64 labels 0, 1, ... in the order of their first points.
    """
    return call("gap_components", points, gap, neighbors, used, min_size, joining)


def ground_heights(
    azimuth: Tensor, elevation: Tensor, distance: Tensor, height: Tensor, used: Tensor, num_columns: int,
    row_height: float, slope: float, step: float, bump: float, near: float, blind: float, sides: int,
) -> Tensor:  # fmt: skip
    """Follow the ground of a scan outward, in each column of azimuth, over the lowest points of its cells.

    A profile starts below the sensor, at the (lower) median of the columns' lowest points within ``near``. It goes on
    to the lowest point of the next cell of elevation, if this point is farther out than the profile so far, and than
    the blind distance, and if the height changes by at most ``step + slope * way``. The blind distance is the share
    ``blind`` of that at which the lowest beam (0.5 % quantile of elevations) meets level ground. Places more than
    ``bump`` above the median of the profiles of ``sides`` columns on each side are removed, then heights are
    interpolated linearly, along the profiles and between the middles of columns.

    Args:
        azimuth, elevation: ``[N]`` float64 radians in [-pi, pi] and [-pi/2, pi/2].
        distance, height: ``[N]`` float64 metres, finite: horizontal, and above the sensor.
        used: ``[N]`` bool, the points that may be ground, at least one.
        num_columns, row_height: number of columns of the whole turn; height of the cells, radians.
        slope, step, bump: metres per metre; metres; metres.
        near: metres; if no point is so near, it is the distance of the nearest.
        blind, sides: share; number of columns.

    Returns:
        ``[N]`` float64 metres above the sensor, the ground at each point.
    """
    seen, numbers = (azimuth, elevation, distance, height, used), (row_height, slope, step, bump, near, blind)
    return call("ground_heights", *seen, num_columns, *numbers, sides)


def has_points_above(
    column: Tensor, row: Tensor, height: Tensor, used: Tensor, which: Tensor, num_columns: int, num_rows: int,
    least: float, most: float,
) -> Tensor:  # fmt: skip
    """Whether a higher point lies in a point's cell of a grid, or in one of the 8 cells around it: ``[M]`` bool.

    The first and the last column are neighbours; the first and the last row are not.

    Args:
        column, row: ``[N]`` int64 in [0, ``num_columns``) and [0, ``num_rows``); less than 2^31 cells.
        height: ``[N]`` float64 metres, finite.
        used: ``[N]`` bool, the points that may be the higher ones.
        which: ``[M]`` int64, the points to test.
        num_columns, num_rows: size of the grid.
        least, most: metres; the higher point is more than ``least`` and less than ``most`` above the point.
    """
    check_number("least", least, (int, float))
    check_number("most", most, (int, float))
    return call("has_points_above", column, row, height, used, which, num_columns, num_rows, least, most)


# Steps 7 and 8


def pair_counts(
    u: Tensor, v: Tensor, pixel: Tensor, segment: Tensor, label: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """Count the pairs of points at most ``radius`` apart, grouped by the segments and labels of the points (eq. 7-9).

    Pairs with equal segments and equal labels (most pairs) are not counted. Neither are pairs within one pixel, and
    points without a segment. The pairs are not stored: only the points and the result need memory.

    Args:
        u, v: ``[M]`` float32, positions, finite.
        pixel, segment, label: ``[M]`` int64, of each point, >= 0; segment -1 = none.
        radius: in the units of ``u`` and ``v``; positive and finite. A distance of exactly ``radius`` counts.

    Returns:
        ``group`` ``[4, G]`` int64, rows lower segment, higher segment, lower label, higher label, in ascending order;
        and ``count`` ``[G]`` int64, the number of pairs in each group.
    """
    return call("pair_counts", u, v, pixel, segment, label, radius)


def segment_graphs(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Build a separate 8-connected pixel graph for each chosen segment.

    The weight of an edge is ``w = color_weight |c_i - c_j| + boundary_weight min(b_i, b_j)`` (eq. 2 of the paper) in
    float32, divided by the mean w over the edges of its segment (eq. 14).

    Args:
        labels: ``[H, W]`` int32, segment of each pixel, -1 = none.
        chosen: ``[K]`` bool, the chosen segments; labels are below K.
        colors, boundary: ``[3, H, W]`` and ``[H, W]`` float32.
        color_weight, boundary_weight: w_c and w_b, >= 0.

    Returns:
        The graphs of the C chosen segments, one after the other, in the order of their labels:
        ``pixel`` ``[n]`` int64, row x W + column of the nodes, ascending within a segment;
        ``node_ptr`` ``[C + 1]`` int64, the nodes of the s-th segment are ``node_ptr[s] : node_ptr[s + 1]``;
        ``edge_index`` ``[2, e]`` int64, node numbers within the segment, each edge once: first all edges to the right,
        then down, down-right and up-right, in the order of their first nodes; ``edge_ptr`` ``[C + 1]`` int64, likewise;
        ``relative_weight`` ``[e]`` float64, 0 if the mean is 0.
    """
    return call("segment_graphs", labels, chosen, colors, boundary, color_weight, boundary_weight)


def outvoted_markers(markers: Tensor, colors: Tensor, color_weight: float, num_voters: int, near: float) -> Tensor:
    """Find the markers of an image whose neighbours, by position and colour, mostly have other labels.

    The distance of two markers is that of their vectors (row, column, `color_weight` x red, green, blue). The nearest
    `num_voters` other markers vote. Markers that tie at the last place vote only if all of them fit. A marker is
    outvoted if the voters with its label are fewer than half of its voters, and also fewer than half of all other
    markers with its label, so that small objects keep their markers. Only markers near other labels are tested: in
    square cells of the image, another label must be in the marker's cell or in one of its eight neighbours.

    Args:
        markers, colors: ``[H, W]`` int32, labels; negative = no marker. ``[3, H, W]`` float32 RGB in [0, 1].
        color_weight, num_voters: pixels per RGB distance, 0 to 1000; at least 1.
        near: side of a cell, in mean distances of markers (square root of pixels per marker); rounded up to pixels.

    Returns:
        ``[H, W]`` bool.
    """
    return call("outvoted_markers", markers, colors, color_weight, num_voters, near)


# The shapes and dtypes of the results, for torch.compile


def _agreement_sums(num_regions: int, pairs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    best = pairs.new_empty(num_regions, dtype=torch.float64)
    return best, best.new_empty(3, pairs.shape[1]), pairs.new_empty(5, pairs.shape[1])


def _segment_graphs(labels: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    whole = labels.new_empty(0, dtype=torch.int64)
    num_nodes, num_edges, num_ends = dynamic_size(), dynamic_size(), dynamic_size()
    weight = whole.new_empty(num_edges, dtype=torch.float64)
    node_ptr, edge_ptr = whole.new_empty(num_ends), whole.new_empty(num_ends)
    return whole.new_empty(num_nodes), node_ptr, whole.new_empty(2, num_edges), edge_ptr, weight


register_fakes(
    integrate_depth=lambda *_: None,
    structured_forest=lambda images, *_: images.new_empty(images[:, 0].shape),
    window_overlaps=lambda order, *_: of_one_size(order, (torch.int64,), (torch.float64,)),
    line_maxima=lambda order, *_: of_one_size(order, (torch.int64,), (torch.uint8,)),
    boosted_trees=lambda values, *_: values.new_empty(len(values), dtype=torch.float64),
    agreement_sums=lambda *seen: _agreement_sums(seen[5], seen[6]),
    region_planes=lambda points, *_: (points.new_empty(points.shape), points.new_empty(points.shape)),
    mask_merges=lambda edge_index, *_: of_one_size(edge_index, (torch.int64, 2), (torch.float64,)),
    local_spacing=lambda _points, reach, *_: torch.empty_like(reach),
    gap_components=lambda points, *_: points.new_empty(len(points), dtype=torch.int64),
    ground_heights=lambda azimuth, *_: torch.empty_like(azimuth),
    has_points_above=lambda *grid: grid[4].new_empty(grid[4].shape, dtype=torch.bool),
    pair_counts=lambda u, *_: of_one_size(u, (torch.int64, 4), (torch.int64,)),
    segment_graphs=lambda labels, *_: _segment_graphs(labels),
    outvoted_markers=lambda markers, *_: markers.new_empty(markers.shape, dtype=torch.bool),
)
