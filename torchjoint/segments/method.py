"""Step 6: what a method of segmenting points is. It says which graph, and which evidence of frames, it needs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.prepared import PreparedCloud, local_cloud
from torchjoint.config import Config
from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.scene import Cloud, Frame, Hierarchy
from torchjoint.views.frame_evidence import FrameEvidence, observe
from torchjoint.views.state import JointState


class Method(ABC):
    """A way of step 6. A subclass says what differs; what it leaves out is done as in the paper.

    Args:
        config: all parameters.
    """

    name: ClassVar[str]  #: as in ``point_segments.method``
    uses_images: ClassVar[bool] = True  #: whether frames have a say in the segments of the points
    #: names (stage.parameter) of the handful that somebody turns who looks at the result
    turned: ClassVar[tuple[str, ...]] = ("refinement.color_weight",)

    def __init__(self, config: Config) -> None:
        self.config = config

    @abstractmethod
    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, Tensor | None]:
        """Step 3: the graph of a cloud.

        Args:
            cloud: [N, 3] distinct points in coordinates of their own.

        Returns:
            the graph, and the graph's point of each of the N points, [N] int64; None = itself.
        """

    def prepare(self, cloud: Cloud, merge_within: float) -> PreparedCloud:
        """Step 3: centres a cloud and builds its graph.

        Args:
            cloud: [N, 3] distinct points, as given.
            merge_within: metres; the points in a cube with this side count as one; 0: only copies.
        """
        frame = LocalFrame.of(cloud.points)
        local, of_point = local_cloud(cloud, frame, merge_within)
        graph, of_local = self.build_graph(local)
        return PreparedCloud(graph, frame, of_local).of_given(of_point)

    def observe(
        self, frame: Frame, segments: ImageSegments, cloud: PreparedCloud, stopwatch: Stopwatch
    ) -> FrameEvidence:
        """Steps 4 and 5: the evidence of one frame.

        Args:
            frame: image and camera.
            segments: what steps 1 and 2 gave of the frame.
            cloud: what :meth:`prepare` returned.
            stopwatch: gets the seconds of both steps.
        """
        return observe(frame, segments, cloud, self.config, stopwatch)

    @abstractmethod
    def segment(self, graph: PointGraph, state: JointState) -> Tensor | Hierarchy:
        """Step 6: the segments of the graph's points.

        Args:
            graph: what :meth:`build_graph` returned.
            state: the evidence of all frames.

        Returns:
            [N] int64 labels 0, 1, ...; or all levels, if the method has more than one.
        """

    def measured(self, graph: PointGraph) -> str:
        """What the method measured of a cloud, for the log, as the continuation of "points: 1000"; may be empty."""
        return ""
