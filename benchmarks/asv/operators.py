"""Speed of the operators and of superpoints, for asv."""

import torch

import torchjoint as tj

from .inputs import grid_with_seeds, room


class Superpoints:
    """Points to labels, 150,000 points of a generated room."""

    def setup(self) -> None:
        self.points = room(150_000)

    def time_superpoints(self) -> None:
        tj.superpoints(self.points)

    def peakmem_superpoints(self) -> None:
        tj.superpoints(self.points)

    def time_nearest_neighbors(self) -> None:
        tj.ops.nearest_neighbors(self.points, 30)


class Graphs:
    """Segmentation and minimum cut of the grid of an image of 480 x 640 pixels."""

    def setup(self) -> None:
        self.edges, self.weight, self.source, self.sink = grid_with_seeds(480, 640)

    def time_felzenszwalb(self) -> None:
        tj.ops.felzenszwalb(self.edges, self.weight, len(self.source), scale=1.0, min_size=100)

    def time_min_cut(self) -> None:
        tj.ops.min_cut(self.edges, 1 - self.weight, self.source, self.sink)


class Metrics:
    """Two segmentations of a million points with 300 and 3,000 regions."""

    def setup(self) -> None:
        generator = torch.Generator().manual_seed(0)
        self.pred, self.target = (torch.randint(count, (1_000_000,), generator=generator) for count in (3_000, 300))

    def time_segmentation_covering(self) -> None:
        tj.metrics.segmentation_covering(self.pred, self.target)

    def time_objects_and_parts(self) -> None:
        tj.metrics.objects_and_parts(self.pred, self.target)
