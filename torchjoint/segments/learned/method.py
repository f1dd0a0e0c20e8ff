"""Step 6, method learned, the default: merges pieces of the cloud where a model says that they are one object."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_point_graph
from torchjoint.cloud.prepared import PreparedCloud
from torchjoint.cloud.working_cloud import working_cloud
from torchjoint.config import Config
from torchjoint.images.exposure import brightened
from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.lazy import LazySequence
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.scene import Cloud, Frame, Hierarchy
from torchjoint.segments.learned.agglomeration import build_hierarchy
from torchjoint.segments.learned.boundary_model_file import load_boundary_model
from torchjoint.segments.learned.consensus import build_consensus
from torchjoint.segments.learned.draws import DRAWS, drawn_anew
from torchjoint.segments.learned.mask_majority import move_to_majority
from torchjoint.segments.learned.occluded_surfaces import lines_across
from torchjoint.segments.learned.piece_graph import PieceGraph
from torchjoint.segments.learned.pieces import build_piece_graph
from torchjoint.segments.method import Method
from torchjoint.views.frame_evidence import FrameEvidence
from torchjoint.views.propagation import edge_contours
from torchjoint.views.state import JointState


class Learned(Method):
    """Method learned. It measures distances in units of the cloud's noise and spacing; its model can be replaced."""

    name = "learned"

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        method = config.point_segments.method
        self._model = method if method.endswith(".npz") else None
        load_boundary_model(self._model)  # reports a bad file here, not after all frames

    def prepare(self, cloud: Cloud, merge_within: float) -> PreparedCloud:
        """As in the base class; but colours that are all equal count as no colours."""
        return super().prepare(cloud.with_telling_colors(), merge_within)

    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, Tensor | None]:
        """Measures the scales, thins a cloud that is much denser than its noise, and builds the graph."""
        working, scales, of_point = working_cloud(cloud)
        return build_point_graph(working, self.config.point_graph.neighbors, scales), of_point

    def developed(self, frame: Frame) -> Frame:
        """Brightened, if it is dark."""
        image = brightened(frame.image)
        return frame if image is frame.image else replace(frame, image=image)

    def observe(
        self, frame: Frame, segments: ImageSegments, cloud: PreparedCloud, stopwatch: Stopwatch
    ) -> FrameEvidence:
        """As in the base class; for frames without masks, also contours across edges and lines across occluders."""
        seen = super().observe(frame, segments, cloud, stopwatch)
        if segments.masks is not None:
            return seen
        with stopwatch("propagation"):
            observation, scales = seen.observation, cloud.graph.scales
            assert scales is not None  # build_graph has measured them
            contours = edge_contours(cloud.graph.adjacency, observation.visible, observation.boundary)
            lines = lines_across(observation.visible, scales.noise)
        return seen._replace(observation=replace(observation, lines=lines), contours=contours)

    def segment(self, graph: PointGraph, state: JointState) -> Hierarchy:
        """All levels of the segmentation.

        Raises:
            ValueError: the graph was built without scales.
        """
        if graph.scales is None:
            raise ValueError("graph: method learned needs a graph that was built with the scales of the cloud")
        scales, model = graph.scales, load_boundary_model(self._model)
        pieces = build_piece_graph(graph, scales, state)
        if pieces.masks is not None:  # they say much more than a judge, so there is one tree, of the model
            hierarchy = build_hierarchy(pieces, model)
            return move_to_majority(hierarchy, graph.edge_index, pieces.masks, state.observations)

        def draw(number: int) -> PieceGraph:
            return build_piece_graph(drawn_anew(graph, scales, number), scales, state) if number else pieces

        return build_consensus(LazySequence(DRAWS, draw), model)

    def measured(self, graph: PointGraph) -> str:
        """Spacing and noise of the points, and where the normals come from."""
        if graph.scales is None:
            return ""
        spacing, noise = (1000 * float(of_points.median()) for of_points in (graph.scales.spacing, graph.scales.noise))
        normals = "given" if graph.has_given_normals else f"from {graph.scales.normal_neighbors} neighbours"
        return f", spacing {spacing:.3g} mm, noise {noise:.2g} mm, normals {normals}"
