"""Step 6, method scan: which nodes of a scan's tree are whole, and which fall into their parts."""

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.runtime.groups import numbers_by_first_place
from torchjoint.scene import Hierarchy
from torchjoint.segments.learned.boundary_model import BoundaryModel, load_boundary_model
from torchjoint.segments.scan.gaps import LEVELS
from torchjoint.segments.scan.tree import FEATURE_NAMES, Tree, summed_up

#: The model that comes with the package, in torchjoint/models/.
PACKAGED = "scan.npz"
#: Log odds below which a node stays whole. Of -.5 to 1.5 the best one on real scans, but .25 to 1 are nearly equal.
MARGIN = 0.5
#: Height of the cut; what a node that is whole merges is below it, what is above such nodes is above it.
DEFAULT = 0.5


def load_scan_model(path: str | Path | None = None) -> BoundaryModel:
    """The model that says whether a node of a tree is less of a thing than its parts are; None: the packaged one."""
    return load_boundary_model(path, FEATURE_NAMES, PACKAGED)


def gain_of_parts(tree: Tree, model: BoundaryModel) -> Tensor:
    """[I] float64, the log odds that the parts of each inner node are better segments than the node, less MARGIN."""
    return torch.stack([member.rounds[0].score(tree.features) for member in model.members]).mean(0) - MARGIN


def falls_apart(tree: Tree, gain: Tensor) -> Tensor:
    """[M] bool, whether a node is no thing, but its parts are, or theirs.

    The sum of the gains of all nodes that fall apart is the largest possible one. A node can only fall apart if all
    above it do.

    Args:
        tree: of the scan.
        gain: [I] float64, of each inner node, if it falls apart.
    """
    best = torch.zeros(len(tree.parent), dtype=torch.float64)
    best[tree.inner] = gain
    levels = [((tree.level == number) & (tree.parent >= 0)).nonzero().squeeze(1) for number in range(len(LEVELS))]
    for nodes in levels:  # parts before what they make
        best.index_add_(0, tree.parent[nodes], best[nodes].clamp(min=0))
    apart = best > 0
    for nodes in reversed(levels):
        apart[nodes] &= apart[tree.parent[nodes]]
    return apart


def levels_of(tree: Tree, apart: Tensor, count: int) -> Hierarchy:
    """All levels of `count` points; those that are in no superpoint of the tree are one segment, the ground."""
    superpoint = torch.zeros(count, dtype=torch.int64)
    superpoint[tree.which] = tree.superpoint + 1
    number = numbers_by_first_place(superpoint, len(tree.parent) - len(tree.inner) + 1)
    first = torch.arange(len(tree.parent)).where(tree.level == 0, len(tree.parent))[:, None]
    first = summed_up(first, tree.parent, tree.level, "amin").squeeze(1)  # a superpoint of each node
    parts = torch.nonzero(tree.parent >= 0).squeeze(1)
    whole = tree.parent[parts]
    share = tree.level[whole].double() / len(LEVELS)
    heights = torch.where(apart[whole], DEFAULT + (1 - DEFAULT) * share, DEFAULT * share)
    merges = torch.stack([first[whole], first[parts]], dim=1)
    differ = merges[:, 0] != merges[:, 1]
    return Hierarchy(number[superpoint], number[merges[differ] + 1], heights[differ], DEFAULT)
