"""A graph of points by hand."""

import torch

from torchjoint.cloud.graph import PointGraph


def graph_of(points, edges, normals, colors=None):
    """Points a metre apart with edges [[i, j], ...], normals of known sign, and no neighbours to fit planes to."""
    edge_index = torch.tensor(edges).t()
    return PointGraph(
        points=points,
        colors=colors,
        normals=normals,
        has_given_normals=True,
        known_spacing=torch.ones(len(points)),
        edge_index=edge_index,
        neighbors=torch.empty(len(points), 0).int(),
    )
