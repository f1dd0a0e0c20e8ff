"""The result of step 8: labels of points and pixels in one id space, at any level."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import torch
from torch import Tensor

from torchjoint.runtime.groups import with_none
from torchjoint.runtime.messages import counted
from torchjoint.runtime.store import Packed, pack
from torchjoint.runtime.threads import LazySequence, on_cpu, one_thread_per_operation
from torchjoint.scene.hierarchy import Confidence, Hierarchy
from torchjoint.scene.scene import Scene


def level_images(
    images: Sequence[Tensor], before: int, table: Tensor, after: int, superpoints: Sequence[Tensor] | None = None
) -> LazySequence[Tensor]:
    """Label images with the labels of another level, or with other numbers: [H, W] int64, computed at each access.

    Args:
        images: [H, W] int64 per frame, -1 = none. Segments with ids from `before` on have no points; they stay.
        before: number of 3D segments in `images`.
        table: [K] int64, the new label of each 3D segment, or of each superpoint.
        after: number of 3D segments after the change; the ids of segments without points follow.
        superpoints: for a table of superpoints: [H, W] int64 per frame, the superpoint of each pixel in a 3D segment,
            else -1.
    """
    known = torch.cat([table.new_full((1,), -1), table])  # -1 stays -1

    def read(index: int) -> Tensor:
        labels = images[index]
        private = labels >= before
        of_table = labels.masked_fill(private, -1) if superpoints is None else superpoints[index]
        if of_table.shape != labels.shape:
            raise ValueError(f"superpoints of image {index}: expected {list(labels.shape)}, got {list(of_table.shape)}")
        with one_thread_per_operation():  # no decorator, which cannot be pickled
            found = known.index_select(0, of_table.reshape(-1) + 1).view(labels.shape)
            return torch.where(private, labels + (after - before), found)

    return LazySequence(len(images), read)


class LabelImages(LazySequence[Tensor]):
    """Label images of one segmentation: a sequence of [H, W] int64. They are packed; each access unpacks one.

    Args:
        images: [H, W] integers, as tensors or packed.
        first_private: ids from this one on occur in one image only.
        offsets: optional, for each image the number that is added to such ids.
    """

    def __init__(
        self, images: Sequence[Tensor | Packed], first_private: int = 0, offsets: Sequence[int] | None = None
    ) -> None:
        packed = [pack(image.to(torch.int64)) if isinstance(image, Tensor) else image for image in images]

        def read(index: int) -> Tensor:
            labels = packed[index].unpack().to(torch.int64)
            if offsets is not None:
                labels[labels >= first_private] += offsets[index]
            return labels

        super().__init__(len(packed), read)


@dataclass(frozen=True)
class Segmentation:
    """Labels of points and pixels in one id space: the same id means the same object everywhere.

    Attributes:
        points: [N] int64. Ids 0 ... num_point_segments - 1, numbered by first appearance in the cloud, but for
            corrections by hand; -1 = none: beams without return (many points at (0, 0, 0)).
        images: a sequence of [H, W] int64, one per frame; -1 = none. An id >= num_point_segments is an image segment
            without visible points; such an id occurs in one image only.
        initial_images: the initial image segmentations, [H, W] int64 (each frame has its own ids).
        names: the frames' names, in order.
        seconds: seconds per stage, added up over threads.
        hierarchy: all levels of the segmentation, from which :meth:`at` chooses; None if the method makes none, as
            method paper.
        superpoint_images: with a hierarchy, a sequence of [H, W] int64, one per frame: the superpoint of the hierarchy
            in each pixel of a 3D segment, else -1. Each image is computed at its first use, so the segmentation keeps
            the frames' observations.
        cloud_checksum: CRC-32 of the cloud's points, all of them in their order; None: unknown.
    """

    points: Tensor
    images: Sequence[Tensor]
    initial_images: Sequence[Tensor] = ()
    names: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    hierarchy: Hierarchy | None = None
    superpoint_images: Sequence[Tensor] = ()
    cloud_checksum: int | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        levels = ", all levels" if self.hierarchy is not None else ""
        count = int((torch.bincount(self.points.clamp(min=-1) + 1)[1:] > 0).sum())  # after corrections less than ids
        told = f"{counted(count, 'segment')}, {counted(len(self.images), 'image')}"
        return f"{type(self).__name__}({len(self.points)} points in {told}{levels})"

    @property
    def num_point_segments(self) -> int:
        """Number of segments of the cloud: the largest id + 1. After corrections, some ids may have no point."""
        return int(self.points.max()) + 1 if self.points.numel() else 0

    @property
    def confidence(self) -> Tensor | None:
        """How sure each segment of the cloud is: [num_point_segments] float64 in [0, 1].

        It is the probability that the segment has an IoU of at least .5 with an object. It follows from how far the
        members of method learned agree; with masks there are three, and it is not calibrated. None: no ensemble.
        """
        return None if self._confidence is None else self._confidence.of_segment

    @property
    def point_confidence(self) -> Tensor | None:
        """How sure the label of each point is, [N] float64 in [0, 1]; None: as :attr:`confidence`.

        It is the probability that the point's segment is an object, times the share of the members that put the point
        there; 0 of points without a label.
        """
        if self._confidence is None or self.hierarchy is None:
            return None
        return with_none(self._confidence.of_superpoint)[self.hierarchy.superpoint].clamp(min=0)

    @cached_property
    @on_cpu()
    def _confidence(self) -> Confidence | None:
        if self.hierarchy is None or self.hierarchy.votes is None:
            return None
        of_superpoint = torch.zeros(self.hierarchy.num_superpoints + 1, dtype=torch.int64)  # the last one: -1
        of_superpoint[self.hierarchy.superpoint] = self.points
        return self.hierarchy.votes.confidence(of_superpoint[:-1])

    def labelled(self, scene: Scene) -> tuple[Self, Scene]:
        """The same of the points that have a label, and the scene with only these."""
        if bool((keep := self.points >= 0).all()):
            return self, scene
        levels = self.hierarchy and replace(self.hierarchy, superpoint=self.hierarchy.superpoint[keep])
        return replace(self, points=self.points[keep], hierarchy=levels, cloud_checksum=None), scene.select_points(keep)

    @one_thread_per_operation()
    def at(self, granularity: float = 0.5) -> Self:
        """The segmentation at another level, for example with drawers as parts of their cabinet or as own objects.

        Levels are nested: every segment lies inside one segment of each coarser level, in the cloud and in the images.
        Image segments without points are the same in all levels.

        Args:
            granularity: from 0 (coarse: each connected part is one segment) to 1 (fine: each superpoint is one). 0.5 is
                the default level, the labels of :meth:`torchjoint.JointSegmenter.compute`.

        Returns:
            labels of points and images. The images are computed when they are used.

        Raises:
            ValueError: there is no hierarchy; or `granularity` is outside [0, 1].
            TypeError: `granularity` is not a number.
        """
        if self.hierarchy is None:
            told = "expected a segmentation with levels, got one level, as of point_segments.method paper"
            raise ValueError(f"hierarchy: {told}")
        of_superpoint = self.hierarchy.segments_of_superpoints(self.hierarchy.height_of(granularity))
        points = with_none(of_superpoint)[self.hierarchy.superpoint]
        images = self._images_at(of_superpoint, points) if len(self.images) else ()
        return replace(self, points=points, images=images)

    def _images_at(self, of_superpoint: Tensor, points: Tensor) -> Sequence[Tensor]:
        num_before, num_after = self.num_point_segments, int(of_superpoint.max()) + 1
        of_segment = torch.zeros(num_before + 1, dtype=torch.int64)  # the last one: -1
        of_segment[self.points] = points
        if torch.equal(of_segment[self.points], points):  # not finer: each segment lies inside one new segment
            return level_images(self.images, num_before, of_segment[:-1], num_after)
        if len(self.superpoint_images) != len(self.images):
            told = f"superpoint_images: expected one for each of {len(self.images)} images (finer levels need them)"
            raise ValueError(f"{told}, got {len(self.superpoint_images)}")
        return level_images(self.images, num_before, of_superpoint, num_after, self.superpoint_images)
