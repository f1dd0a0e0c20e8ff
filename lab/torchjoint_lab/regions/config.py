"""Parameters of step 6, method regions: region merging, image support and occlusion bridging (not in the paper)."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class PiecesConfig(Stage):
    """Step 6, method regions: small pieces; an edge's r becomes the mean of its own r and the r between its pieces."""

    threshold: float | None = parameter(
        0.03, "mean boundary cost up to which points merge into pieces; well below `region_merging.threshold`, because "
        "pieces are never split again; less gives smaller pieces; null: no pieces, only the edges' own r", low=0,
        high=2, sensible="null, or 0.01-0.1",
    )  # fmt: skip


@dataclass(frozen=True)
class RegionMergingConfig(Stage):
    """Step 6, method regions: region merging by mean boundary cost (average linkage)."""

    threshold: float = parameter(
        0.42, "tau, mean boundary cost up to which regions merge; more gives larger segments; a concave right angle "
        "costs 1; a flat edge that no image sees costs w_r (1 - r_o), which should be below tau", low=0, high=2,
        sensible="0.2-0.5",
    )  # fmt: skip
    agreement: float = parameter(
        0.22, "a, share of a crease's cost that is removed where images see one segment on both sides; more lets "
        "images join parts across creases; 0: never", low=0, high=1, sensible="0-0.7",
    )  # fmt: skip
    min_size: int = parameter(
        20, "smallest segment; smaller segments are joined to a neighbour; has no effect below 8, the smallest "
        "piece, if pieces are used", unit="points", low=0, sensible="3-500",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSupportConfig(Stage):
    """Step 6, method regions: image support, a small segment stays only if an image has a matching segment."""

    min_size: int = parameter(
        100, "smaller segments need image support, or they are joined to a neighbour (if there are images); more "
        "removes more fragments; 0: no segment needs support", unit="points", low=0, sensible="0-1000",
    )  # fmt: skip
    overlap: float = parameter(
        0.62, "smallest intersection over union, in points, of a segment and an image segment that supports it; more "
        "asks for better support", low=0, high=1, sensible="0.4-0.8",
    )  # fmt: skip


@dataclass(frozen=True)
class OcclusionBridgingConfig(Stage):
    """Step 6, method regions: occlusion bridging, joins the parts of a surface that an occluder separates."""

    min_votes: int | None = parameter(
        4, "smallest number of image lines across an occluder on which one plane continues on both sides; the two "
        "segments are then joined; more joins fewer; null: never", low=1, sensible="null, or 3-10",
    )  # fmt: skip
