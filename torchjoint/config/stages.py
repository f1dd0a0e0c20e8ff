"""The parameters of each stage."""

import re
from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter

#: The package's own boundary detectors.
DETECTORS = ("structured_forest", "gradient")


@dataclass(frozen=True)
class BoundaryConfig(Stage):
    """Step 1: boundary detection, the strength of an object boundary at each pixel."""

    detector: str = parameter(
        "structured_forest", "boundary detector: structured_forest (trained on human segmentations), gradient (of the "
        "colours; needs no training, several times as fast), or your own module as my_package.my_module:MyBoundary",
    )  # fmt: skip
    model: str | None = parameter(
        None, "structured_forest: file of the forest, NAME.yml.gz; null: the forest that comes with the package"
    )
    multi_scale: bool = parameter(
        False,
        "structured_forest: also run on the image at half and double size; more accurate, about five times slower",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.detector not in DETECTORS and not re.fullmatch(r"\w+(\.\w+)*:\w+", self.detector):
            expected = f"{', '.join(DETECTORS)} or package.module:Class"
            raise ValueError(f"boundary.detector: expected {expected}, got {self.detector!r}")


@dataclass(frozen=True)
class ContoursConfig(Stage):
    """Step 1: closed contours instead of the detector's boundaries."""

    closed: bool = parameter(
        True,
        "replace the boundaries by closed contours, each with the mean boundary strength between the two regions "
        "it separates; false: use the detector's boundaries, as in the paper",
    )


@dataclass(frozen=True)
class ImageGraphConfig(Stage):
    """Step 1, eq. 2: edge weights of the 8-connected pixel graph."""

    smoothing: float = parameter(
        0.8, "standard deviation of the Gaussian blur of the colours (steps 1, 7 and 8); more suppresses noise and "
        "fine texture", unit="px", low=0, high=20,
        sensible="0-2",
    )  # fmt: skip
    color_weight: float = parameter(
        0.11, "w_c, weight of the RGB distance between two pixels; more cuts at fainter colour changes", low=0,
        sensible="0-1",
    )  # fmt: skip
    boundary_weight: float = parameter(
        1.0, "w_b, weight of the smaller boundary strength of two pixels; more cuts at fainter contours", low=0,
        sensible="0-2",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSegmentsConfig(Stage):
    """Step 2: Felzenszwalb-Huttenlocher segmentation of the pixel graph."""

    scale: float = parameter(
        3.0, "k of Felzenszwalb-Huttenlocher; more gives larger segments", unit="weight x px", low=0,
        sensible="0.5-30 for 640x480",
        too_low="segments of the images are scraps that say nothing: the result is as without images",
        too_high="a segment of an image spans several objects: small and flat things join what they lie on",
    )  # fmt: skip
    min_size: int = parameter(
        100, "smallest segment; smaller segments are joined to a neighbour", unit="px", low=0,
        sensible="20-300 for 640x480",
        too_low="prints and highlights are segments of the images: objects fall into parts",
        too_high="small things have no segment of their own in the images, and join what they lie on",
    )  # fmt: skip


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8, all methods but paper: geodesic propagation of the points' labels in each image."""

    color_weight: float = parameter(
        100.0, "path cost of an RGB distance of 1, as a path length; a boundary of strength 1 costs half as much; more "
        "makes labels meet at the edges of the image; 0: each pixel takes the nearest point's label", unit="px", low=0,
        high=1000, sensible="25-200",
    )  # fmt: skip


@dataclass(frozen=True)
class PaperConfig(Stage):
    """Steps 3-7, method paper: what only the paper's own way of segmenting points and images reads."""

    normal_neighbors: int = parameter(
        45, "step 3: neighbours to which a point's normal is fitted; more suits noisy clouds, but rounds edges", low=3,
        high=500, sensible="10-80",
    )  # fmt: skip
    distance_weight: float = parameter(
        0.2, "eq. 3: w_d, weight of the distance between two points (w_theta is 1 per radian); more separates sparse "
        "parts of the cloud from dense ones", unit="1/m", low=0, sensible="0-10",
    )  # fmt: skip
    convex_factor: float = parameter(
        1.0, "eq. 3: factor on the angle where the surface is convex and the normals are oriented; less keeps convex "
        "objects whole, because boundaries between objects are mostly concave; 1: as in the paper", low=0, high=1,
        sensible="0.03-1",
    )  # fmt: skip
    color_weight: float = parameter(
        0.0, "eq. 3: weight of the RGB distance between two points, not in the paper; more cuts at colour changes; "
        "needs Scene.colors", low=0, sensible="0-1",
    )  # fmt: skip
    overlap_threshold: float = parameter(
        0.5, "eq. 6: r_o, overlap of two windows at which an image is neutral; an edge that no image sees has "
        "r = 1 - r_o, so more makes such edges cheaper", low=0, high=1,
    )  # fmt: skip
    normalization: str = parameter(
        "all", "eq. 6: L, all (the number of images, as in the paper), or saturating (the edge's own number of views)",
        choices=("saturating", "all"),
    )  # fmt: skip
    weight: float = parameter(
        0.12, "eq. 4: w_r, weight of the images' disagreement r; more cuts where images show different segments; 0: "
        "images do not affect the point segments, cameras only orient the normals", low=0, high=1000,
        sensible="0.05-1",
    )  # fmt: skip
    scale: float = parameter(
        13.0, "step 6: k of Felzenszwalb-Huttenlocher; more gives larger segments", unit="weight x points", low=0
    )
    min_size: int = parameter(
        120, "step 6: smallest segment; smaller segments are joined to a neighbour", unit="points", low=0
    )
    merge_ratio: float | None = parameter(
        0.8, "eq. 12: r_m, two image segments merge if at least this share of the point pairs between them has one 3D "
        "label; less merges more, and chains whole images together on real data; null: never", low=0, high=1,
        sensible="null, or 0.8-1",
    )  # fmt: skip
    split_min_edges: int | None = parameter(
        10, "step 7: n_s, an image segment is cut in two if it contains at least this many pairs of points with "
        "different 3D labels; less cuts more; null: never", low=1, sensible="5-100",
    )  # fmt: skip


@dataclass(frozen=True)
class PointGraphConfig(Stage):
    """Step 3, eq. 3, all methods but scan: the graph of the nearest neighbours."""

    neighbors: int = parameter(
        16, "K, neighbours of a point in the graph; more bridges gaps and takes longer", low=1, high=200,
        sensible="8-30",
    )  # fmt: skip


@dataclass(frozen=True)
class PointSegmentsConfig(Stage):
    """Step 6: the method that segments the points."""

    method: str = parameter(
        "auto", "learned: regions merge where a trained model says that they belong to one object; scan: ground and "
        "objects of one LiDAR scan (z up, sensor at the origin), without evidence from images; paper: as in the paper, "
        "with the parameters of stage paper; auto: scan if the cloud is recognised as a scan of one or more LiDARs, "
        "else learned; NAME.npz: learned, with this model of torchjoint-lab train-boundary-model",
        choices=("auto", "learned", "scan", "paper", "NAME.npz"),
    )  # fmt: skip


@dataclass(frozen=True)
class ScanConfig(Stage):
    """Step 6, method scan: the ground of a LiDAR scan, and the objects on it."""

    object_height: float = parameter(
        0.25, "ground: what is lower than this belongs to it, if nothing rises from it; more takes low objects for "
        "ground, less leaves fragments of pavements and verges", unit="m", low=0, sensible="0.2-0.4",
        too_low="pavements and verges are many small segments",
        too_high="low things, such as kerbs, boxes and animals, belong to the ground",
    )  # fmt: skip
    gap: float = parameter(
        0.2, "gap inside things; more joins objects that stand side by side", unit="m", low=0,
        sensible="0.1-0.5",
        too_low="one car or tree is several segments",
        too_high="things that stand side by side, such as parked cars, are one segment",
    )  # fmt: skip
    gap_growth: float = parameter(
        0.02, "increase of the allowed gap per metre of range; more joins points far from the sensor", unit="m/m",
        low=0, sensible="0.01-0.04",
    )  # fmt: skip
    min_size: int = parameter(
        15, "smallest segment; smaller segments are joined to a neighbour within 1.1 gaps", unit="points", low=0,
        sensible="5-30",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap == 0 == self.gap_growth:
            raise ValueError("scan.gap: expected > 0 where gap_growth is 0, got 0.0")


@dataclass(frozen=True)
class VisibilityConfig(Stage):
    """Step 4: which points an image sees."""

    method: str = parameter(
        "zbuffer", "zbuffer: z-buffer of splats; hidden_point_removal: spherical flipping and a convex hull (Katz et "
        "al. 2007)",
        choices=("zbuffer", "hidden_point_removal"),
    )  # fmt: skip
    footprint: float = parameter(
        0.5, "zbuffer: half width of a point's splat in units of the point's spacing; more closes holes in surfaces, "
        "but also hides points beside an occluder", above=0, high=10, sensible="0.3-1",
    )  # fmt: skip
    depth_tolerance: float = parameter(
        0.01, "zbuffer: a point is visible up to this far behind the nearest splat; more tolerates noise and errors of "
        "poses, but lets hidden points through", unit="of the point's depth", above=0, sensible="0.005-0.02",
        too_low="a noisy cloud hides its own points: the images say nothing about many points",
        too_high="points behind an object count as seen: in images, an object has labels of what is behind it",
    )  # fmt: skip


@dataclass(frozen=True)
class PropagationConfig(Stage):
    """Step 5, eq. 5, all methods but scan: the images' evidence for each edge of the point graph."""

    window: int = parameter(
        1, "t, side of the window around a point's pixel (odd); more tolerates pose errors, but blurs boundaries",
        unit="px", low=1, high=31, sensible="1-7",
    )  # fmt: skip
