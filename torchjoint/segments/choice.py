"""Step 6: chooses the method that segments a cloud, and describes the choice in one line for the log."""

from __future__ import annotations

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.scene import Cloud
from torchjoint.segments.learned.method import Learned
from torchjoint.segments.method import Method
from torchjoint.segments.paper import Paper
from torchjoint.segments.scan.method import Scan
from torchjoint.segments.scan.one_view import look_for_scan

METHODS: dict[str, type[Method]] = {method.name: method for method in (Learned, Scan, Paper)}


def choose_method(config: Config, points: Tensor) -> Method:
    """Makes the method that the config names. "auto" is scan for a scan of a LiDAR, else learned.

    A model's file is method learned with this model.

    Args:
        config: all parameters.
        points: [N, 3] metres; for method scan: z up, the sensor at the origin.
    """
    name = config.point_segments.method
    if name == "auto":
        evidence = look_for_scan(points.float())
        return Scan(config, evidence) if evidence.is_scan else Learned(config)
    return METHODS.get(name, Learned)(config)


def describe(given: Cloud, graph: PointGraph, method: Method) -> str:
    """One line that says what was measured of a cloud, and which method segments it.

    Args:
        given: the cloud as it was given.
        graph: the graph of the cloud.
        method: the method of step 6.
    """
    what = f"points: {len(given.points)}"
    if graph.num_points < len(given.points):
        what += f", much denser than their noise: thinned to {graph.num_points}"
    what += method.measured(graph)
    if method.name == "learned" and graph.colors is None:
        what += f", {'no colours' if given.colors is None else 'all of one colour'} (those of images are used, if any)"
    return f"{what}; step 6 by method {method.name}"
