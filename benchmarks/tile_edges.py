"""Are superpoints near the edges of tiles as good as elsewhere? Against those of the cloud in one piece.

    python benchmarks/tiles.py one city.laz city.npy
    python benchmarks/tiles.py tiles city.laz tiles25.laz --tile 25 --buffer 2
    python benchmarks/tiles.py tiles city.laz tiles31.laz --tile 31 --buffer 2
    python benchmarks/tile_edges.py city.laz city.npy tiles25.laz 25 tiles31.laz 31

Cuts: of the neighbouring points that one superpoint of the one piece holds, the share that has different labels in the
tiles, across an edge and elsewhere. Borders: places differ, so each place within 1 m of an edge of one tiling is
compared with itself in the other tiling, where no edge is within 4 m.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import laspy
import numpy as np
import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.datasets.las import read_las
from torchjoint.metrics import boundary_recall, segmentation_covering
from torchjoint.points.neighbors import nearest_neighbors

#: Metres: what is near an edge, and what is far from any.
NEAR, FAR = 1.0, 4.0


class Tiling:
    """The labels of tiles, and where their edges are: at multiples of the side."""

    def __init__(self, path: Path, side: float, points: Tensor) -> None:
        self.side = side
        self.labels = torch.from_numpy(laspy.read(path)["superpoint"].astype(np.int64))
        places = points[:, :2] / side
        self.to_edge = ((places - places.round()).abs() * side).amin(1)
        self.tile = places.floor().long()

    def cuts(self, whole: Tensor, edges: Tensor) -> tuple[float, float]:
        """Shares of edges inside the superpoints of one piece that are cut: across an edge of tiles, and elsewhere."""
        edges = edges[:, whole[edges[0]] == whole[edges[1]]]
        across = (self.tile[edges[0]] != self.tile[edges[1]]).any(1)
        cut = self.labels[edges[0]] != self.labels[edges[1]]
        return float(cut[across].double().mean()), float(cut[~across].double().mean())


def compare(near: Tiling, far: Tiling, whole: Tensor, edges: Tensor) -> None:
    """Prints cuts of one tiling, and borders near its edges in both tilings."""
    across, elsewhere = near.cuts(whole, edges)
    print(f"tiles of {near.side:g} m: cut across an edge {across:.4f}, elsewhere {elsewhere:.4f}", end="; ")
    print(f"covering {segmentation_covering(near.labels, whole).symmetric:.4f}")
    chosen = (near.to_edge < NEAR) & (far.to_edge > FAR)
    some = edges[:, chosen[edges].all(0)]
    for name, tiling in (("near an edge", near), (f"same places, tiles of {far.side:g} m", far)):
        recall, precision = (boundary_recall(*pair, some) for pair in ((tiling.labels, whole), (whole, tiling.labels)))
        print(f"  {name}: {some.shape[1]} edges, boundary recall {recall:.4f}, precision {precision:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("one", type=Path, help="labels in one piece, .npy")
    parser.add_argument("tilings", nargs=4, help="labels and side of the tiles, twice")
    arguments = parser.parse_args()
    points = read_las(arguments.cloud)[0]
    whole = torch.from_numpy(np.load(arguments.one).astype(np.int64))
    edges = ops.neighbor_edges(nearest_neighbors((points - points[0]).float(), 10).indices)
    files, sides = arguments.tilings[::2], map(float, arguments.tilings[1::2])
    first, second = (Tiling(Path(file), side, points) for file, side in zip(files, sides, strict=True))
    compare(first, second, whole, edges)
    compare(second, first, whole, edges)


if __name__ == "__main__":
    main()
