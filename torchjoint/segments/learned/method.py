"""Step 6, method learned, the default: merges superpoints of the cloud where a model says that they are one object.

It measures distances in units of the cloud's noise and spacing.
"""

import warnings

from torchjoint.cloud.graph import PointGraph, build_point_graph
from torchjoint.cloud.local import LocalFrame, local_cloud
from torchjoint.cloud.scales import working_cloud
from torchjoint.config import Config
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Cloud, Hierarchy
from torchjoint.segments.learned.boundary_model import OF_IMAGES, PACKAGED, BoundaryModel, load_boundary_model
from torchjoint.segments.learned.consensus import COPIES, build_consensus, jittered
from torchjoint.segments.learned.masks import move_to_majority
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph, masks_of_superpoints
from torchjoint.segments.learned.superpoints import build_superpoint_graph, measure_colors
from torchjoint.views.evidence import Evidence

#: Largest distance of a grey point from the axis of greys, units of Lab: of rounded colours.
GREY = 1.0
#: Metres: no scanner's points are so far apart.
FAR_APART = 3.0


def prepare(cloud: Cloud, config: Config, merge_within: float) -> PointGraph:
    """Measures the scales, thins a cloud that is much denser than its noise, and builds the graph.

    Colours or normals that are all equal count as none.
    """
    _model(config)  # reports a bad file here, not after all frames
    cloud = cloud.without_constants()
    frame = LocalFrame.of(cloud.points)
    local, of_cloud = local_cloud(cloud, frame, merge_within)
    working, scales, of_local = working_cloud(local)
    if float(scales.spacing.median()) > FAR_APART:
        told = "points: neighbours are metres apart; are the coordinates in millimetres? They are taken as metres"
        warnings.warn(told, stacklevel=4)
    graph = build_point_graph(working, config.point_graph.neighbors, scales)
    return graph.of(frame, of_cloud if of_local is None else of_local[of_cloud])


def segment(graph: PointGraph, evidence: Evidence, config: Config) -> Hierarchy:
    """All levels of the segmentation."""
    if graph.scales is None:
        raise ValueError("graph: method learned needs a graph that was built with the scales of the cloud")
    scales, observations = graph.scales, evidence.observations
    colors = measure_colors(graph, observations)
    # The model of images learned from cameras of colours only, and errs where all is grey.
    sees_images = len(observations) > 0 and colors.lab is not None and bool((colors.lab[:, 1:].abs() > GREY).any())

    def copy(number: int) -> SuperpointGraph:
        return build_superpoint_graph(jittered(graph, scales, number) if number else graph, scales, evidence, colors)

    hierarchy = build_consensus(LazySequence(COPIES, copy), _model(config, sees_images))
    masks = masks_of_superpoints(hierarchy.superpoint, observations)
    return hierarchy if masks is None else move_to_majority(hierarchy, graph.edge_index, masks, observations)


def measured(graph: PointGraph) -> str:
    """Spacing and noise of the points, and where the normals come from."""
    if graph.scales is None:
        return ""
    spacing, noise = (1000 * float(of_points.median()) for of_points in (graph.scales.spacing, graph.scales.noise))
    normals = "given" if graph.has_given_normals else f"from {graph.scales.normal_neighbors} neighbours"
    return f", spacing {float(f'{spacing:.3g}'):g} mm, noise {float(f'{noise:.2g}'):g} mm, normals {normals}"


def _model(config: Config, sees_images: bool = False) -> BoundaryModel:
    method, packaged = config.point_segments.method, OF_IMAGES if sees_images else PACKAGED
    return load_boundary_model(method if method.endswith(".npz") else None, packaged=packaged)
