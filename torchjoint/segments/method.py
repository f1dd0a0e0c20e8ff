"""Step 6: the base class of the methods. A method builds the graph, observes frames, and segments the points."""

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
    """A method of step 6. A subclass builds the graph and segments it; it may override the other steps.

    Args:
        config: all parameters.
    """

    name: ClassVar[str]  #: as in ``point_segments.method``
    uses_images: ClassVar[bool] = True  #: whether frames affect the segments of the points
    #: names (stage.parameter) of the few parameters that a user changes while looking at the result
    turned: ClassVar[tuple[str, ...]] = ("refinement.color_weight",)

    def __init__(self, config: Config) -> None:
        self.config = config

    @abstractmethod
    def build_graph(self, cloud: Cloud) -> tuple[PointGraph, Tensor | None]:
        """Step 3: the graph of a cloud.

        Args:
            cloud: N distinct points, in the coordinates in which the method works.

        Returns:
            the graph; and [N] int64, the graph's point for each point of the cloud. None: both have the same points.
        """

    def prepare(self, cloud: Cloud, merge_within: float) -> PreparedCloud:
        """Step 3: centres a cloud and builds its graph.

        Args:
            cloud: N distinct points, in the coordinates in which they were given.
            merge_within: metres; points in one cube with this side are merged; 0: only copies are merged.
        """
        frame = LocalFrame.of(cloud.points)
        local, of_point = local_cloud(cloud, frame, merge_within)
        graph, of_local = self.build_graph(local)
        return PreparedCloud(graph, frame, of_point if of_local is None else of_local[of_point])

    def developed(self, frame: Frame) -> Frame:
        """The frame as steps 1 to 8 see it. By default it is the given frame."""
        return frame

    def observe(
        self, frame: Frame, segments: ImageSegments, cloud: PreparedCloud, stopwatch: Stopwatch
    ) -> FrameEvidence:
        """Steps 4 and 5: the evidence of one frame.

        Args:
            frame: image and camera.
            segments: the result of steps 1 and 2 for the frame.
            cloud: what :meth:`prepare` returned.
            stopwatch: records the seconds of both steps.
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
        """What the method measured of a cloud: a text for the log that continues "points: 1000". It may be empty."""
        return ""
