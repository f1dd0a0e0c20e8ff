"""Step 3: what a segmenter makes of a given cloud before the first frame: distinct points, centred, and their graph."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_edgeless_graph, build_point_graph
from torchjoint.cloud.local import (
    LocalFrame,
    composed,
    merged_points,
    points_within,
    warn_of_rounding,
    without_copies,
)
from torchjoint.cloud.working_cloud import working_cloud
from torchjoint.config import Config, evidence_differences
from torchjoint.scene import Scene
from torchjoint.segments.method import with_method


class PreparedCloud(NamedTuple):
    """A cloud that is ready for frames."""

    graph: PointGraph
    local: LocalFrame  #: of the graph's points
    of_point: Tensor | None  #: [N] int64, the graph's point of each given point; None = itself
    given: Tensor  #: [M, 3] the given points without copies
    definite: Config  #: the config without method auto

    @property
    def method(self) -> str:
        """Method of step 6: the config's, or, if that is auto, the one chosen for this cloud."""
        return self.definite.point_segments.method

    def is_same(self, other: PreparedCloud) -> bool:
        """Whether frames can be seen with one of both clouds, and their evidence be used with the other."""
        return self.graph.is_same(other.graph) and self.local.is_same(other.local)

    def with_config(self, before: Config, config: Config) -> PreparedCloud:
        """The same cloud and graph with other parameters.

        Args:
            before: the parameters that the cloud was prepared with.
            config: the other ones.

        Raises:
            ValueError: what frames say of this cloud depends on a parameter that differs; the message names it.
        """
        definite = config.replace({"point_segments": {"method": self.method}})
        if before.point_segments.method != config.point_segments.method:
            definite = with_method(config, self.given.float())  # from all points, if it is auto now
        if different := evidence_differences(self.definite, definite):
            raise ValueError(f"config: what was seen depends on {', '.join(different)}; see the frames again")
        return self._replace(definite=definite)


def prepare_cloud(cloud: Scene, config: Config, merge_within: float) -> PreparedCloud:
    """Leaves copies out, chooses the method of step 6 if it is auto, centres and thins the cloud, and builds its graph.

    Methods learned and scan leave colours out, too, if they are all the same.

    Args:
        cloud: the given points, with colours and normals if there are any.
        config: all parameters.
        merge_within: metres; the points in a cube with this side count as one (not with method scan). 0: only copies.

    Warns:
        UserWarning: the coordinates are float32 and so large that rounding disturbs the surface.
    """
    distinct, of_point = without_copies(cloud)
    definite = with_method(config, distinct.points.float())
    method = definite.point_segments.method
    if method in ("learned", "scan"):
        distinct = _without_empty_colors(distinct)
    # A scan's sensor is at the origin, so its coordinates stay.
    frame = LocalFrame.of_world() if method == "scan" else LocalFrame.of(distinct.points)
    local, rounded = without_copies(frame.cloud(distinct))
    merged = thinned = None
    if method != "scan" and merge_within > 0:
        merged = points_within(local.points, merge_within)
        local = merged_points(local, merged, int(merged.max()) + 1)
    if method == "scan":
        graph = build_edgeless_graph(local)
    elif method == "learned":
        local, scales, thinned = working_cloud(local)
        graph = build_point_graph(local, config.point_graph, scales)
    else:
        graph = build_point_graph(local, config.point_graph)
    warn_of_rounding(cloud.points, graph.spacing)
    return PreparedCloud(graph, frame, composed(of_point, rounded, merged, thinned), distinct.points, definite)


def _without_empty_colors(cloud: Scene) -> Scene:
    """The cloud without colours, if they are all the same, as many programs write them for a cloud that has none.

    To the model they would say that no boundary has a step of colour, and to the check of poses that none fits.
    """
    if cloud.colors is None or not (cloud.colors == cloud.colors[0]).all():
        return cloud
    return replace(cloud, colors=None)
