"""Step 5: the evidence of the image segmentations for each edge of the point graph (eq. 5-6).

The evidence is two sums over images: the number of views v, and the sum of overlaps. So the order of the frames has no
effect, and the sums of several processes can be added.
"""

from torch import Tensor

from torchjoint.cloud.graph import CsrAdjacency
from torchjoint.ops.internal import line_maxima, window_overlaps
from torchjoint.views.visibility import Visible

#: Overlaps are rounded to multiples of this before they are summed. Sums of up to 2^29 overlaps are then exact in
#: float64, so the order of the frames does not change a single bit.
OVERLAP_RESOLUTION = 2.0**-24


def edge_overlaps(edges: CsrAdjacency, visible: Visible, labels: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """The overlaps of one image: for each edge, of the t x t windows around the pixels of its two ends.

    The overlap is the histogram intersection divided by the size of the smaller window (eq. 5). Windows are clipped at
    the image border. Pixels without a label do not count.

    Args:
        edges: CSR adjacency of the point graph.
        visible: the points that the image sees.
        labels: [H, W] int32, -1 = none.
        window: t, pixels, odd.

    Returns:
        ([S] int64, [S] float64): the edges for which the image has evidence (both ends are visible and have a labelled
        pixel in their windows), each once; and their overlaps in [0, 1], rounded to OVERLAP_RESOLUTION.
    """
    edge, overlap = window_overlaps(*edges, visible.point, visible.row, visible.column, labels, window)
    return edge, round_overlaps(overlap)


def edge_contours(edges: CsrAdjacency, visible: Visible, boundary: Tensor) -> tuple[Tensor, Tensor]:
    """The strongest boundary of one image on the line between the two ends of each edge.

    Args:
        edges: CSR adjacency of the point graph.
        visible: the points that the image sees.
        boundary: [H, W] uint8, boundary strength x 255.

    Returns:
        ([S] int64, [S] uint8): the edges with two visible ends, each once, and the strength x 255.
    """
    return line_maxima(*edges, visible.point, visible.row, visible.column, boundary)


def round_overlaps(overlap: Tensor) -> Tensor:
    """Rounds overlaps [S] float64 to multiples of OVERLAP_RESOLUTION, so that their sums are exact in any order."""
    return (overlap / OVERLAP_RESOLUTION).round_() * OVERLAP_RESOLUTION


def disagreement(views: Tensor, overlap_sum: Tensor, threshold: float, num_images: int | None = None) -> Tensor:
    """The images' disagreement r of each edge (eq. 6), in [0, 1]; r = 1 - r_o if no image sees both ends.

    With L images this is eq. 6 as in the paper: r = 1 - r_o + (v r_o - sum o) / L. With hundreds of images v / L is
    tiny and r is nearly constant. Without L one view counts as much as many: r = 1 - sum o / v if v > 0.

    Args:
        views: [E] int64, v, number of images that see both ends of the edge.
        overlap_sum: [E] float64, sum of the overlaps in these images.
        threshold: r_o, the overlap at which an image is neutral.
        num_images: L; None: the edge's own number of views.

    Returns:
        [E] float32.
    """
    v = views.double()
    if num_images is not None:
        r = 1 - threshold + (v * threshold - overlap_sum) / max(num_images, 1)
    else:
        r = 1 - threshold + v.clamp(max=1) * (threshold - overlap_sum / v.clamp(min=1))
    return r.clamp(0, 1).float()  # only rounding can leave [0, 1]
