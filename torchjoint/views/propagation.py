"""Step 5: what the image segmentations say about each edge of the point graph.

The evidence is two plain sums over images, v and the sum of overlaps, so frames can come in any order, be spread
over processes, and be added up.
"""

from __future__ import annotations

from torch import Tensor

from torchjoint import ops
from torchjoint.config import PropagationConfig
from torchjoint.views.csr_adjacency import CsrAdjacency
from torchjoint.views.visibility import Visible

#: Overlaps are rounded to multiples of this before they are summed: sums of up to 2^29 of them are then exact in
#: float64, so that the order of the frames cannot change a single bit.
OVERLAP_RESOLUTION = 2.0**-24


def edge_overlaps(edges: CsrAdjacency, visible: Visible, labels: Tensor, window: int) -> tuple[Tensor, Tensor]:
    """One image's contribution to the sums: the overlap of the t x t windows around the pixels of each edge's ends.

    Overlap is histogram intersection over the smaller window's size (eq. 5). Windows are clipped at the image's border;
    pixels without a label are left out of them.

    Args:
        labels: [H, W] int32, -1 = none.
        window: t, odd.

    Returns:
        ([S] int64, [S] float64): the edges that the image has something to say about (both ends are visible and have
        a label in their windows), each once, and their overlaps in [0, 1], rounded to OVERLAP_RESOLUTION.
    """
    edge, overlap = ops.window_overlaps(*edges, visible.point, visible.row, visible.column, labels, window)
    return edge, round_overlaps(overlap)


def round_overlaps(overlap: Tensor) -> Tensor:
    """Overlaps, float64, rounded to multiples of OVERLAP_RESOLUTION: their sums are exact, in any order."""
    return (overlap / OVERLAP_RESOLUTION).round_() * OVERLAP_RESOLUTION


def disagreement(views: Tensor, overlap_sum: Tensor, num_images: int, config: PropagationConfig) -> Tensor:
    """The images' disagreement r of each edge (eq. 6), in [0, 1]; 1 - r_o where no image sees both ends.

    With `normalization: all` the paper's letter, r = 1 - r_o + (v r_o - sum o) / L with L = `num_images`. In hundreds
    of images v / L is tiny and r nearly constant; `saturating` is r = 1 - r_o + min(v / s, 1) (r_o - sum o / v).

    Args:
        views: [E] v, number of images that see both ends.
        overlap_sum: [E] float64, sum of their overlaps.
        num_images: L, the number of images.

    Returns:
        [E] float32.
    """
    v = views.double()
    neutral = 1 - config.overlap_threshold
    if config.normalization == "all":
        r = neutral + (v * config.overlap_threshold - overlap_sum) / max(num_images, 1)
    else:
        trust = (v / config.saturation).clamp(max=1)
        r = neutral + trust * (config.overlap_threshold - overlap_sum / v.clamp(min=1))
    return r.clamp(0, 1).float()  # but for rounding it is in there
