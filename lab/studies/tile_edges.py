"""Are superpoints near the edges of tiles as good as elsewhere, and which buffer does it take?

    python lab/studies/tile_edges.py WORK --seeds 0 1 2 --buffers 2 3

makes a city (`tiles.py`) for each seed, and segments it in one piece, and in tiles of two sizes with each buffer. What
is in the folder WORK is not made again.

Two questions, both against the labels in one piece:

Cuts: of the neighbouring points that one superpoint of the one piece holds, the share that has different labels in the
tiles: across an edge, at the same pairs in the other tiling, where no edge is within 4 m, and elsewhere. Cuts come
together, so the standard errors are those of tile edges: each edge between two tiles is one draw.

Borders: each place within 1 m of an edge of one tiling is compared with itself in the other tiling, where no edge is
within 4 m: of the borders of the one piece there, the share that is found. The standard errors are those of cities.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np
import report
import torch
from torch import Tensor

import torchjoint as tj
from torchjoint import ops
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.datasets.files.las import read_las
from torchjoint.metrics import boundary_recall, segmentation_covering
from torchjoint.tiles import superpoints_of_files

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))  # behind this folder: both have a report

#: Metres: what is near an edge, and what is far from any.
NEAR, FAR = 1.0, 4.0


class City(NamedTuple):
    """A cloud, its labels in one piece, and pairs of neighbouring points."""

    file: Path
    points: Tensor
    whole: Tensor
    edges: Tensor
    work: float  #: processor seconds in one piece


class Tiling:
    """The labels of tiles, and where their edges are: at multiples of the side."""

    def __init__(self, city: City, side: float, buffer: float) -> None:
        path = city.file.with_name(f"{city.file.stem}-{side:g}-{buffer:g}.laz")
        self.work = _worked(
            path, lambda: superpoints_of_files(city.file, path, tile=side, buffer=buffer, engine="loky:1")
        )
        self.labels = torch.from_numpy(laspy.read(path)["superpoint"].astype(np.int64))
        places = city.points[:, :2] / side
        self.to_edge = ((places - places.round()).abs() * side).amin(1)
        tile = places.floor().long()
        tile -= tile.amin(0)
        self.tile = tile[:, 0] * (int(tile[:, 1].max()) + 1) + tile[:, 1]


class Share(NamedTuple):
    """Of how many pairs how many are cut, in each of several groups."""

    cut: Tensor
    pairs: Tensor

    @classmethod
    def of(cls, cut: Tensor, group: Tensor, num_groups: int) -> Share:
        return cls(*(torch.bincount(group, one, num_groups).double() for one in (cut.double(), torch.ones(len(cut)))))

    def rate(self) -> float:
        return float(self.cut.sum() / self.pairs.sum())

    def residual(self) -> Tensor:
        """What each group adds to the error of the rate."""
        return (self.cut - self.rate() * self.pairs) / self.pairs.sum()

    def joined(self, other: Share) -> Share:
        return Share(*(torch.cat(pair) for pair in zip(self, other, strict=True)))


class Cuts(NamedTuple):
    across: Share
    same_pairs: tuple[Share, Share]  #: across edges, far from edges of the other tiling: in this, and in the other
    elsewhere: Share

    @classmethod
    def of(cls, city: City, near: Tiling, far: Tiling) -> Cuts:
        edges = city.edges[:, city.whole[city.edges[0]] == city.whole[city.edges[1]]]
        (first, second), count = near.tile[edges], int(near.tile.max()) + 1
        across = first != second
        cut, cut_there = (one.labels[edges[0]] != one.labels[edges[1]] for one in (near, far))
        group = (torch.minimum(first, second) * count + torch.maximum(first, second))[across].unique(
            return_inverse=True
        )[1]
        num_groups = int(group.max()) + 1
        free = (far.to_edge[edges[0]] > FAR)[across]
        here, there = (Share.of(one[across][free], group[free], num_groups) for one in (cut, cut_there))
        return cls(
            Share.of(cut[across], group, num_groups), (here, there), Share.of(cut[~across], first[~across], count)
        )

    def joined(self, other: Cuts) -> Cuts:
        pairs = tuple(a.joined(b) for a, b in zip(self.same_pairs, other.same_pairs, strict=True))
        return Cuts(self.across.joined(other.across), pairs, self.elsewhere.joined(other.elsewhere))

    def row(self) -> list[str]:
        """Rates, and how far that across an edge is above the other two."""
        here, there = self.same_pairs
        against_rest = float((self.across.residual().square().sum() + self.elsewhere.residual().square().sum()).sqrt())
        against_same = float((here.residual() - there.residual()).square().sum().sqrt())
        return [
            *(f"{share.rate():.5f}" for share in (self.across, self.elsewhere)),
            f"{self.across.rate() - self.elsewhere.rate():+.5f} ± {against_rest:.5f}",
            f"{there.rate():.5f}",
            f"{here.rate() - there.rate():+.5f} ± {against_same:.5f}",
        ]


def borders(city: City, near: Tiling, far: Tiling) -> tuple[float, float]:
    """Shares of the borders that are found near edges of one tiling, in it and in the other."""
    chosen = (near.to_edge < NEAR) & (far.to_edge > FAR)
    some = city.edges[:, chosen[city.edges].all(0)]
    return boundary_recall(near.labels, city.whole, some), boundary_recall(far.labels, city.whole, some)


def _worked(path: Path, make) -> float:
    """Processor seconds of making a file, now or earlier."""
    record = path.with_suffix(".json")
    if not (path.is_file() and record.is_file()):
        start = time.process_time()
        make()
        record.write_text(json.dumps(time.process_time() - start))
    return json.loads(record.read_text())


def make_city(folder: Path, num_points: int, seed: int) -> City:
    file, one = folder / f"city-{num_points}-{seed}.laz", folder / f"city-{num_points}-{seed}.npy"
    if not file.is_file():
        from tiles import generate

        generate(file, num_points, seed)
    points, colors = read_las(file)[:2]
    work = _worked(one, lambda: np.save(one, tj.superpoints(points, colors).to(torch.int32).numpy()))
    whole = torch.from_numpy(np.load(one).astype(np.int64))
    edges = ops.neighbor_edges(nearest_neighbors((points - points[0]).float(), 10).indices)
    return City(file, points, whole, edges, work)


def mean(values: list[float]) -> str:
    some = np.array(values)
    return f"{some.mean():.4f}" + (f" ± {some.std(ddof=1) / len(some) ** 0.5:.4f}" if len(some) > 1 else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="a folder; 5 million points take 2 GB and some minutes for each city")
    parser.add_argument("--points", type=int, default=5_000_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--buffers", type=float, nargs="+", default=[2.0, 3.0])
    parser.add_argument("--sides", type=float, nargs=2, default=[25.0, 31.0])
    arguments = parser.parse_args()
    arguments.work.mkdir(exist_ok=True)
    found: dict[tuple[float, float], list] = {}
    for seed in arguments.seeds:
        city = make_city(arguments.work, arguments.points, seed)
        for buffer in arguments.buffers:
            tilings = [Tiling(city, side, buffer) for side in arguments.sides]
            for near, far, side in zip(tilings, tilings[::-1], arguments.sides, strict=True):
                covering = segmentation_covering(near.labels, city.whole).symmetric
                one = (Cuts.of(city, near, far), covering, borders(city, near, far), near.work / city.work)
                found.setdefault((side, buffer), []).append(one)
                print(seed, side, buffer, *one[0].row(), *one[1:], flush=True)
    rows = []
    for (side, buffer), ones in found.items():
        cuts, covering, both, work = zip(*ones, strict=True)
        total = cuts[0]
        for other in cuts[1:]:
            total = total.joined(other)
        near, far = zip(*both, strict=True)
        rows.append(
            [f"{side:g}, {buffer:g}", mean(covering), *total.row(), mean(near), mean(far), f"{np.mean(work):.2f}"]
        )
    columns = ["tiles, buffer, m", "covering", "cut across an edge", "cut elsewhere", "difference"]
    columns += ["same pairs in the other tiling", "difference", "borders found near an edge", "in the other tiling"]
    print(report.table([*columns, "processor time / in one piece"], rows))


if __name__ == "__main__":
    main()
