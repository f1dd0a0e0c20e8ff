"""Step 6, method learned: sums over images of how far two regions lie in the same image segments."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def agreement_sums(
    piece: Tensor,
    segment: Tensor,
    num_points: Tensor,
    segment_size: Tensor,
    frame_of_segment: Tensor,
    of_piece: Tensor,
    num_regions: int,
    pairs: Tensor,
    min_points: int,
    resolution: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compare pairs of regions in all images that see both.

    A region has the rows of all of its pieces, and the rows of one image segment are added. An image sees a region if
    it sees at least ``min_points`` of its points. The agreement of two regions in an image is the sum, over its
    segments, of the smaller of the two shares that the segment has of the regions' visible points. All sums are of
    whole numbers, so neither the order of the rows nor the number of threads changes the result.

    Args:
        piece: ``[I]`` int32, of each row.
        segment: ``[I]`` int32, image segment of each row, 0 ... L - 1.
        num_points: ``[I]`` int32 >= 0, visible points of the piece in the segment.
        segment_size: ``[L]`` int64, visible points in the segment; at most 2^31 - 1 in a frame.
        frame_of_segment: ``[L]`` int64, ascending.
        of_piece: ``[P]`` int64, region of each piece, 0 ... R - 1.
        num_regions: R.
        pairs: ``[2, B]`` int64, pairs of regions.
        min_points: > 0.
        resolution: agreements are rounded to multiples of this before they are added; in [2^-31, 1].

    Returns:
        ``[R]`` float64: largest intersection over union of the region and an image segment. ``[3, B]`` float64: the
        same of the union of two regions, over the segments that contain points of both; smallest agreement, inf if no
        image sees both; largest agreement, -inf if none does. ``[5, B]`` int64: sum of the agreements times n n', where
        n and n' are the numbers of points that the image sees; sum of n n'; sum of the rounded agreements, in units of
        the resolution; sum of their squares; number of images that see both. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a number out of range, frames that do not ascend, a region that has more
            points in a segment than the segment has.

    Example:
        >>> import torch
        >>> rows = (torch.tensor(x).int() for x in ([0, 1, 1], [0, 0, 1], [4, 2, 2]))  # half of 1 lies where 0 lies
        >>> sizes, frames, pairs = torch.tensor([6, 2]), torch.tensor([0, 0]), torch.tensor([[0], [1]])
        >>> agreement_sums(*rows, sizes, frames, torch.arange(2), 2, pairs, min_points=3, resolution=0.25)
        (tensor([0.6667, 0.5000], dtype=torch.float64), tensor([[0.7500],
                [0.5000],
                [0.5000]], dtype=torch.float64), tensor([[ 8],
                [16],
                [ 2],
                [ 4],
                [ 1]]))
    """
    check_array("piece", piece, torch.int32, (None,), "[I]")
    for name, value in (("segment", segment), ("num_points", num_points)):
        check_array(name, value, torch.int32, (len(piece),), f"[I] = [{len(piece)}]")
    check_array("segment_size", segment_size, torch.int64, (None,), "[L]")
    length = len(segment_size)
    check_array("frame_of_segment", frame_of_segment, torch.int64, (length,), f"[L] = [{length}]")
    check_array("of_piece", of_piece, torch.int64, (None,), "[P]")
    check_number("num_regions", num_regions, (int,))
    check_array("pairs", pairs, torch.int64, (2, None), "[2, B]")
    check_number("min_points", min_points, (int,))
    check_number("resolution", resolution, (int, float))
    result = call(
        torch.ops.torchjoint.agreement_sums.default,
        piece, segment, num_points, segment_size, frame_of_segment, of_piece, num_regions, pairs, min_points,
        float(resolution),
    )  # fmt: skip
    return cast("tuple[Tensor, Tensor, Tensor]", result)


@torch.library.register_fake("torchjoint::agreement_sums")
def _fake(
    piece: Tensor,
    segment: Tensor,
    num_points: Tensor,
    segment_size: Tensor,
    frame_of_segment: Tensor,
    of_piece: Tensor,
    num_regions: int,
    pairs: Tensor,
    *_: object,
) -> tuple[Tensor, Tensor, Tensor]:
    best = of_piece.new_empty(num_regions, dtype=torch.float64)
    return best, best.new_empty(3, pairs.shape[1]), pairs.new_empty(5, pairs.shape[1])
