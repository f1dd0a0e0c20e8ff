"""Parameters of step 6 where points are grouped into regions, and these merged: our own addition to the method."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class RegionsConfig(Stage):
    """Step 6, regions: small regions by Felzenszwalb-Huttenlocher, for the plane on each side of a crease."""

    scale: float = parameter(
        0.003, "k; more gives larger regions, which must not reach across creases; 0: every point is one, and has the "
        "plane of its normal", unit="weight x points", low=0, sensible="0.001-0.01",
    )  # fmt: skip
    min_size: int = parameter(
        15, "smaller regions are joined to a neighbour", unit="points", low=0,
        sensible="5-30",
    )  # fmt: skip


@dataclass(frozen=True)
class PiecesConfig(Stage):
    """Step 6, regions: small pieces; an edge's r is the mean of its own and of what images say of its two pieces."""

    threshold: float | None = parameter(
        0.03, "mean cost of a border up to which points become one piece, never to be parted again; well below "
        "`region_merging.threshold`; less gives smaller pieces; null: no pieces, r is that of the edges alone", low=0,
        high=2, sensible="null, or 0.01-0.1",
    )  # fmt: skip
    min_size: int = parameter(
        8, "smaller pieces are joined to a neighbour, whatever the border costs", unit="points", low=0, sensible="3-20"
    )


@dataclass(frozen=True)
class RegionMergingConfig(Stage):
    """Step 6, regions: merging of neighbours by the mean cost of what crosses their whole border."""

    threshold: float = parameter(
        0.41, "tau, mean cost of a border up to which regions merge; a concave right angle costs 1, a flat edge that "
        "no image sees w_r (1 - r_o), which should be less than this", low=0, high=2, sensible="0.2-0.5",
    )  # fmt: skip
    agreement: float = parameter(
        0.45, "how much of a crease's cost is taken back where images see one segment on both sides", low=0, high=1,
        sensible="0-0.7",
    )  # fmt: skip
    min_size: int = parameter(
        8, "smaller segments are joined to a neighbour; where there are pieces, none is smaller than `pieces.min_size` "
        "anyway", unit="points", low=0, sensible="3-500",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSupportConfig(Stage):
    """Step 6, regions: a small segment stays if an image has a segment of its shape."""

    min_size: int = parameter(
        500, "where there are images, smaller segments need one that confirms them, or else are joined to a neighbour; "
        "0: none does", unit="points", low=0, sensible="0-1000",
    )  # fmt: skip
    overlap: float = parameter(
        0.72, "intersection over union, in points, of a segment with one of an image, from which on that confirms it",
        low=0, high=1, sensible="0.4-0.8",
    )  # fmt: skip


@dataclass(frozen=True)
class OcclusionBridgingConfig(Stage):
    """Step 6, regions: joins what something in front cuts in two."""

    min_votes: int | None = parameter(
        None, "lines of sight across what is in front, on both sides of which one surface goes on, from which on two "
        "segments become one; null: never", low=1, sensible="null, or 3-10",
    )  # fmt: skip
    share: float = parameter(
        0.5, "of the lines across, those on which the surface goes on", low=0, high=1, sensible="0.3-0.8"
    )
    cell: int = parameter(
        4, "side of the squares that the image is looked at in: about as wide as points are apart there", unit="px",
        low=1, high=100, sensible="2-12",
    )  # fmt: skip
    depth_step: float = parameter(
        0.03, "how much nearer it must be to be in front", unit="m", above=0, sensible="0.02-0.1"
    )
    flatness: float = parameter(
        0.015, "how far off the other's plane a surface may go on, and a twentieth of the gap more", unit="m", above=0,
        sensible="0.01-0.05",
    )  # fmt: skip
    max_gap: float = parameter(1.0, "wider gaps are not bridged", unit="m", above=0, sensible="0.3-3")
