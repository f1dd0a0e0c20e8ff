"""The searched parameter ranges of each method, by suite name; key "" holds the ranges for all other suites."""

from torchjoint_lab.benchmark.space import Between, Choice, Space

_REGIONS: Space = {
    "region_costs.normal_neighbors": Choice((20, 30, 45, 60)),
    "region_costs.convex_factor": Between(0.02, 0.3, or_zero=True),
    "region_merging.threshold": Between(0.1, 0.5),
    "region_merging.min_size": Between(3, 600, whole=True),
    "occlusion_bridging.min_votes": Choice((None, 4)),
}
_IMAGE_EVIDENCE: Space = {
    "region_costs.weight": Between(0.05, 1.0),
    "superpoints.threshold": Choice((None, 0.015, 0.03, 0.06)),
    "region_merging.agreement": Between(0.1, 0.9, or_zero=True),
    "image_support.min_size": Between(50, 1000, whole=True, or_zero=True),
    "image_support.overlap": Between(0.3, 0.8),
}
_EDGES: Space = {
    "point_graph.neighbors": Choice((10, 16, 24)),
    "paper.normal_neighbors": Choice((20, 30, 45, 60)),
    "paper.convex_factor": Between(0.03, 1.0),
    "paper.distance_weight": Between(0.05, 5.0, or_zero=True),
    "paper.color_weight": Between(0.05, 1.0, or_zero=True),
    "paper.scale": Between(0.3, 30.0),
    "paper.min_size": Between(50, 1000, whole=True),
}
_LIDAR_EDGES: Space = {
    "point_graph.neighbors": Choice((8, 12, 16, 24)),
    "paper.normal_neighbors": Choice((10, 20, 30)),
    "paper.convex_factor": Between(0.03, 1.0),
    "paper.distance_weight": Between(0.05, 5.0, or_zero=True),
    "paper.scale": Between(0.3, 30.0),
    "paper.min_size": Between(5, 100, whole=True),
}
_EVIDENCE: Space = {
    "propagation.window": Choice((1, 3, 5)),
    "paper.overlap_threshold": Choice((0.5, 0.7, 0.9)),
    "paper.weight": Between(0.02, 0.6),
}
_IMAGES: Space = {
    "image_segments.scale": Between(0.5, 30.0),
    "image_segments.min_size": Between(50, 2000, whole=True),
}
_SUPERPOINTS: Space = {
    "neighbors": Choice((8, 12, 16, 24)),
    "normal_neighbors": Choice((10, 20, 30, 45, 60)),
    "min_size": Between(50, 1000, whole=True),
}
_LIDAR_SUPERPOINTS: Space = {
    **_SUPERPOINTS,
    "reach": Choice((0.0, 0.3, 0.5, 0.7)),
    "min_size": Between(5, 100, whole=True),
}
_COLORED: Space = {
    "distance_weight": Between(0.05, 20.0, or_zero=True),
    "angle_weight": Between(0.1, 2.0),
    "scale": Between(0.3, 30.0),
}
_SCAN: Space = {
    "scan.object_height": Between(0.15, 0.4),
    "scan.gap": Between(0.1, 0.5),
    "scan.gap_growth": Between(0.01, 0.04),
    "scan.min_size": Between(5, 40, whole=True),
}

#: Method learned, which segments all other suites, has nothing to tune. Rooms use the default image settings: they have
#: too many images to segment them again for every setting.
JOINT: dict[str, Space] = {
    "synthetic": {**_REGIONS, **_IMAGE_EVIDENCE},
    "mosd": {**_REGIONS, **_IMAGE_EVIDENCE},
    "kitti": _SCAN,
}
GEOMETRY: dict[str, Space] = {"synthetic": _REGIONS, "mosd": _REGIONS, "kitti": _SCAN}
EDGES = {
    "": {**_EDGES, **_EVIDENCE},
    "mosd": {**_EDGES, **_EVIDENCE, **_IMAGES},
    "kitti": {**_LIDAR_EDGES, **_EVIDENCE, **_IMAGES},
}
INITIAL = {"": _IMAGES}
SCIKIT_IMAGE: dict[str, Space] = {
    "": {
        "scale": Between(30, 3000),
        "sigma": Choice((0.5, 0.8, 1.2, 2.0)),
        "min_size": Between(50, 2000, whole=True),
    }
}
NORMALS: dict[str, Space] = {
    "": {**_SUPERPOINTS, "scale": Between(0.0003, 1.0)},
    "kitti": {**_LIDAR_SUPERPOINTS, "scale": Between(0.0003, 1.0)},
}
COLORED: dict[str, Space] = {
    "": {**_SUPERPOINTS, **_COLORED, "color_weight": Between(0.05, 2.0, or_zero=True)},
    "kitti": {**_LIDAR_SUPERPOINTS, **_COLORED},
}
RANSAC_DBSCAN: dict[str, Space] = {
    "": {
        "distance": Between(0.005, 0.05),
        "min_share": Between(0.01, 0.3),
        "max_planes": Choice((1, 2, 4, 8, 16)),
        "eps": Between(0.01, 0.1),
        "min_points": Choice((4, 8, 16, 32)),
    },
    "kitti": {
        "distance": Between(0.05, 0.4),
        "min_share": Between(0.03, 0.3),
        "max_planes": Choice((1, 2, 3)),
        "eps": Between(0.2, 1.5),
        "min_points": Choice((2, 4, 8, 16)),
    },
}
