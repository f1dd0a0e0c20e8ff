"""Names of parameters (all steps) that no longer exist, for an error message that says where their values are now."""

from __future__ import annotations


def _constant(name: str, file: str) -> str:
    return f"is a constant now: {name} in torchjoint/{file}"


#: Names of removed parameters and stages -> what became of them, as the end of a sentence.
REMOVED = {
    "boundary.smoothing": _constant("SMOOTHING", "images/gradient_boundary.py"),
    "boundary.contrast": _constant("CONTRAST", "images/gradient_boundary.py"),
    "contours.smoothing": _constant("SMOOTHING", "images/contours.py"),
    "contours.exponent": _constant("EXPONENT", "images/contours.py"),
    "point_graph.plane_neighbors": _constant("PLANE_NEIGHBORS", "cloud/graph.py"),
    "point_graph.angle_weight": "is 1 now: only its ratio to the other weights and to point_segments.scale counts",
    "visibility.near": "is gone: any depth in front of the camera counts, whatever the unit",
    "visibility.far": "is gone: any depth in front of the camera counts, whatever the unit",
    "visibility.max_footprint": _constant("MAX_FOOTPRINT", "views/visibility.py"),
    "visibility.slant_tolerance": _constant("SLANT_TOLERANCE", "views/visibility.py"),
    "visibility.margin": _constant("MARGIN", "views/visibility.py"),
    "visibility.radius_factor": _constant("RADIUS_FACTOR", "views/visibility.py"),
    "propagation.saturation": "is gone: one view of an edge counts as much as many, as its default 1 said",
    "regions": _constant("SMOOTH_REGIONS", "segments/planes.py"),
    "pieces.min_size": _constant("MIN_PIECE", "segments/segments.py"),
    "occlusion_bridging.share": _constant("SHARE", "lab/torchjoint_lab/regions/occlusion_bridging.py"),
    "occlusion_bridging.cell": _constant("CELL", "lab/torchjoint_lab/regions/occlusion_bridging.py"),
    "occlusion_bridging.depth_step": _constant("DEPTH_STEP", "lab/torchjoint_lab/regions/occlusion_bridging.py"),
    "occlusion_bridging.flatness": _constant("FLATNESS", "lab/torchjoint_lab/regions/occlusion_bridging.py"),
    "occlusion_bridging.max_gap": _constant("MAX_GAP", "lab/torchjoint_lab/regions/occlusion_bridging.py"),
    "scan.azimuth_cell": _constant("AZIMUTH_CELL", "segments/scan/ground.py"),
    "scan.elevation_cell": _constant("ELEVATION_CELL", "segments/scan/ground.py"),
    "scan.max_slope": _constant("MAX_SLOPE", "segments/scan/ground.py"),
    "scan.max_step": _constant("MAX_STEP", "segments/scan/ground.py"),
    "scan.max_bump": _constant("MAX_BUMP", "segments/scan/ground.py"),
    "scan.ground_height": _constant("GROUND_HEIGHT", "segments/scan/ground.py"),
    "scan.neighbors": _constant("NEIGHBORS", "segments/scan/scan_segments.py"),
    "scan.joining_gap": _constant("JOINING_GAP", "segments/scan/scan_segments.py"),
    "refinement.boundary_weight": (
        "is a share of refinement.color_weight now: BOUNDARY_SHARE in torchjoint/labels/geodesic.py"
    ),
    "refinement.min_points": _constant("MIN_POINTS", "labels/geodesic.py"),
    "refinement.unseen": _constant("UNSEEN", "labels/geodesic.py"),
    "refinement.radius": _constant("RADIUS", "labels/pixel_pairs.py"),
    "refinement.max_splits": _constant("MAX_SPLITS", "labels/segment_cuts.py"),
}
