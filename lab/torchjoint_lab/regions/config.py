"""Parameters of step 6, method regions (not in the paper): :class:`RegionsConfig`, the package's stages and its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import resources
from typing import ClassVar, Self

from torchjoint.config import Config, read_preset
from torchjoint.config.parameter import Stage, parameter

#: The presets that were tuned with this method.
PRESETS = ("regions", "indoor", "tabletop")


@dataclass(frozen=True)
class RegionCostsConfig(Stage):
    """Steps 3 and 6, method regions: the cost of each edge of the point graph."""

    normal_neighbors: int = parameter(
        45, "neighbours to which a point's normal is fitted; more suits noisy clouds, but rounds edges", low=3,
        high=500, sensible="10-80",
    )  # fmt: skip
    convex_factor: float = parameter(
        0.05, "factor on the angle where the surface is convex and the normals are oriented; less keeps convex objects "
        "whole, because boundaries between objects are mostly concave; 1: convex as concave", low=0, high=1,
        sensible="0.03-1",
    )  # fmt: skip
    weight: float = parameter(
        0.3, "w_r, weight of the images' disagreement r; more cuts where images show different segments; 0: images do "
        "not affect the point segments, cameras only orient the normals", low=0, high=1000, sensible="0.05-1",
    )  # fmt: skip
    overlap_threshold: float = parameter(
        0.7, "r_o, overlap of two windows at which an image is neutral; an edge that no image sees has r = 1 - r_o, so "
        "more makes such edges cheaper", low=0, high=1,
    )  # fmt: skip


@dataclass(frozen=True)
class SuperpointsConfig(Stage):
    """Step 6, method regions: an edge's r becomes the mean of its own r and that of its superpoints."""

    threshold: float | None = parameter(
        0.03, "mean boundary cost up to which points merge into superpoints; well below "
        "`region_merging.threshold`, because superpoints are never split again; less gives smaller ones; null: none, "
        "only the edges' own r", low=0, high=2, sensible="null, or 0.01-0.1",
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
        "superpoint, if superpoints are used", unit="points", low=0, sensible="3-500",
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


@dataclass(frozen=True)
class RegionsConfig(Config):
    """The parameters of the package, and those of method regions.

    Raises:
        ValueError, TypeError: as of :class:`torchjoint.Config`.
    """

    region_costs: RegionCostsConfig = field(default_factory=RegionCostsConfig)
    superpoints: SuperpointsConfig = field(default_factory=SuperpointsConfig)
    region_merging: RegionMergingConfig = field(default_factory=RegionMergingConfig)
    image_support: ImageSupportConfig = field(default_factory=ImageSupportConfig)
    occlusion_bridging: OcclusionBridgingConfig = field(default_factory=OcclusionBridgingConfig)

    afterwards: ClassVar[tuple[str, ...]] = (
        *Config.afterwards, "region_costs", "superpoints", "region_merging", "image_support", "occlusion_bridging",
    )  # fmt: skip
    before: ClassVar[tuple[str, ...]] = (*Config.before, "region_costs.normal_neighbors")

    @classmethod
    def from_preset(cls, name: str) -> Self:
        """Reads one of PRESETS, or a YAML file of your own.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        folder = resources.files("torchjoint_lab.configs")
        known = {preset: folder.joinpath(f"{preset}.yaml") for preset in PRESETS}
        return read_preset(name, known, cls.from_dict, "stages with parameters")
