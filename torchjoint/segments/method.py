"""Step 6: what a method is, which ones there are, and which one segments a cloud."""

import warnings
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.scene import Cloud, Hierarchy
from torchjoint.segments import paper
from torchjoint.segments.learned import method as learned
from torchjoint.segments.scan import method as scan
from torchjoint.segments.scan.recognition import ScanSigns, look_for_scan
from torchjoint.views.evidence import Evidence

#: A cloud is said to be thinned if less than this share of its points is left; few copies are not worth a word.
THINNED_SHARE = 0.95


class Method(NamedTuple):
    """A method of step 6: two functions of a module, and what the log says."""

    name: str  #: as in ``point_segments.method``
    #: step 3: (N distinct points; all parameters; metres: points in one cube with this side are merged, 0: only copies)
    #: -> the graph, with its `of_given` [N]
    prepare: Callable[[Cloud, Config, float], PointGraph]
    #: step 6: (what `prepare` returned; the evidence of all frames; all parameters) -> labels [num_points] int64
    #: 0, 1, ...; or all levels, if the method has more than one
    segment: Callable[[PointGraph, Evidence, Config], Tensor | Hierarchy]
    #: what was measured of a cloud: a text that continues "points: 1000"
    measured: Callable[[PointGraph], str] | None = None
    uses_images: bool = True  #: whether frames affect the segments of the points
    has_levels: bool = False  #: whether `segment` gives a hierarchy
    unread: tuple[str, ...] = ()  #: stages of the parameters that change nothing


LEARNED = Method("learned", learned.prepare, learned.segment, learned.measured, True, True, ("scan", "paper"))
PAPER = Method("paper", paper.prepare, paper.segment, unread=("scan", "refinement"))


def scan_method(signs: ScanSigns | None = None) -> Method:
    """Method scan; `signs`: what was found in the cloud, None: it is looked for when it is needed."""
    segment, measured = scan.segment, scan.measured
    if signs is not None:
        segment, measured = partial(scan.segment, rings=signs.rings), partial(_known, signs)
    return Method("scan", scan.prepare, segment, measured, False, True, ("point_graph", "propagation", "paper"))


def _known(signs: ScanSigns, _: PointGraph) -> str:
    return str(signs)


def choose_method(config: Config, points: Tensor) -> Method:
    """The method that the config names. "auto" is scan for a scan of a LiDAR, else learned.

    A model's file is method learned with this model.

    Args:
        config: all parameters.
        points: [N, 3] metres; for method scan: z up, the sensor at the origin.
    """
    name = config.point_segments.method
    if name == "auto":
        signs = look_for_scan(points.float())
        return scan_method(signs) if signs.is_scan else LEARNED
    return {"scan": scan_method(), "paper": PAPER}.get(name, LEARNED)


def tell_unread(config: Config, method: Method) -> None:
    """Warns of parameters that are not at their defaults, and that neither the method nor another choice reads."""
    given, default = config.to_dict(), type(config)().to_dict()
    unread = [(stage, name) for stage in method.unread for name in given[stage]]
    unread += [("visibility", "footprint"), ("visibility", "depth_tolerance")] * (config.visibility.method != "zbuffer")
    unread += [("boundary", "model"), ("boundary", "multi_scale")] * (config.boundary.detector != "structured_forest")
    if names := [f"{stage}.{name}" for stage, name in unread if given[stage][name] != default[stage][name]]:
        told = f"without effect here, where method {method.name} segments the points"
        warnings.warn(f"{', '.join(names)}: {told}; `torchjoint parameters` tells what reads them", stacklevel=4)


def describe(given: Cloud, graph: PointGraph, method: Method) -> str:
    """One line that says what was measured of a cloud, and which method segments it.

    Args:
        given: the cloud as it was given.
        graph: the graph of the cloud.
        method: the method of step 6.
    """
    what = f"points: {len(given.points)}"
    if graph.num_points < THINNED_SHARE * len(given.points):
        what += f", much denser than their noise, or copies: computed with {graph.num_points}"
    what += method.measured(graph) if method.measured else ""
    if method.name == "learned" and graph.colors is None:
        what += f", {'no colours' if given.colors is None else 'all of one colour'} (those of images are used, if any)"
    return f"{what}; step 6 by method {method.name}"
