"""A vector for each thing, by an encoder of images that the caller brings: things by words (output after step 8)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from torchjoint.images.segmenter import eval_mode
from torchjoint.results.objects import add_to_segments, image_views, read_segments, segment_records
from torchjoint.runtime.archives import read_archive, write_archive
from torchjoint.runtime.files import no_link
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.groups import counted_pairs
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.views.visibility import project


@dataclass(frozen=True)
class Crop:
    """A segment as one frame sees it.

    Attributes:
        image: [3, h, w] RGB in [0, 1], the part of the frame around the segment.
        mask: [h, w] bool, the segment's pixels in it.
        box: x, y, width w and height h of the part, pixels of the frame.
        frame: index of the frame.
        name: of the frame.
        pixels: number of the segment's pixels.
        whole: share of the segment's points that lie inside the image, 0 to 1.
    """

    image: Tensor
    mask: Tensor
    box: tuple[int, int, int, int]
    frame: int
    name: str
    pixels: int
    whole: float

    def __repr__(self) -> str:
        _, _, width, height = self.box
        return f"Crop({self.name!r}: {width} x {height} pixels, {self.pixels} of the segment, {self.whole:.0%} whole)"


#: The camera of a frame: intrinsics, world-to-camera, (H, W).
Camera = tuple[Tensor, Tensor, tuple[int, int]]


def _camera(frame: Frame) -> Camera:
    return frame.intrinsics, frame.world_to_camera, frame.size


def best_crops(scene: Scene, result: Segmentation, segment: int, k: int = 1, margin: float = 0.1) -> list[Crop]:
    """Crops the frames that show a segment best, best first.

    The score of a frame is the number of the segment's pixels, times the square of the share of its points that lie
    inside the image: half an object at the border scores less than the whole object from farther away. Of frames with
    equal scores, the first comes first.

    Args:
        scene: the frames and the cloud.
        result: the labels.
        segment: id of a segment of the cloud.
        k: largest number of crops.
        margin: added around the segment's box, as a share of the box's longer side.

    Returns:
        at most `k` crops; fewer if fewer frames see the segment.
    """
    segment = check_segment(segment, result.points)
    if k < 1 or not margin >= 0:
        raise ValueError(f"k and margin: expected k >= 1 and margin >= 0, got {k} and {margin}")
    if len(result.images) != len(scene.frames):
        raise ValueError(f"scene: expected the {len(result.images)} frames of the result, got {len(scene.frames)}")
    counts = parallel_map(lambda index: int((result.images[index] == segment).sum()), range(len(result.images)))
    seen = {index: count for index, count in enumerate(counts) if count}
    return crops_of(scene, result, segment, seen, {index: _camera(scene.frames[index]) for index in seen}, k, margin)


def crops_of(
    scene: Scene,
    result: Segmentation,
    segment: int,
    pixels: Mapping[int, int],
    cameras: Mapping[int, Camera],
    k: int,
    margin: float,
) -> list[Crop]:
    """As :func:`best_crops`, for the frames in `pixels`, which has the number of the segment's pixels in each."""
    points = scene.points[result.points == segment]
    share = {index: len(project(points, *cameras[index]).point) / max(len(points), 1) for index in pixels}
    best = sorted(pixels, key=lambda index: (-pixels[index] * share[index] ** 2, index))
    return [_crop(scene, result, segment, index, share[index], margin) for index in best[:k]]


def check_segment(segment: int, labels: Tensor) -> int:
    """Returns the id of a segment as int, if one of the points [N] has it; corrections by hand may leave gaps."""
    try:
        number = operator.index(segment)
    except TypeError:
        raise TypeError(f"segment: expected an id, an integer, got {segment!r}") from None
    if number < 0 or number not in labels.numpy():
        raise ValueError(f"segment: expected an id of a segment with points, got {number}: no point has it")
    return number


def _crop(scene: Scene, result: Segmentation, segment: int, index: int, whole: float, margin: float) -> Crop:
    frame, mask = scene.frames[index], result.images[index] == segment
    ((_, pixels, (x, y, width, height)),) = image_views(torch.where(mask, 0, -1), 1)
    around = round(margin * max(width, height))
    left, top = max(0, x - around), max(0, y - around)
    right, bottom = min(frame.size[1], x + width + around), min(frame.size[0], y + height + around)
    box, name = (left, top, right - left, bottom - top), result.names[index] or f"{index:06d}"
    image, mask = frame.image[:, top:bottom, left:right], mask[top:bottom, left:right]
    return Crop(image, mask, box, index, name, pixels, whole)


#: In a result's folder.
FILE = "embeddings.npz"
#: Images [B, 3, size, size] in [0, 1] to vectors [B, D].
Encoder = Callable[[Tensor], Tensor]
#: Of the frames that see a thing, so many with the most pixels are compared.
CANDIDATES = 20
#: Colour of what is not the thing, and beside an image that is not square.
GREY = 0.5


@dataclass(frozen=True, eq=False)
class Embeddings:
    """Vectors of the segments of a cloud.

    Attributes:
        vectors: [S, D] float32 of unit length; zeros for a segment that no frame sees.
        labels: [N] int64, the segment of each point.
    """

    vectors: Tensor
    labels: Tensor

    @property
    def seen(self) -> Tensor:
        """[S] bool: the segments that have a vector."""
        return (self.vectors != 0).any(1)

    def find(self, query: Tensor, k: int = 5) -> list[tuple[int, float]]:
        """The segments that are most similar to a query, such as the embedding of a text.

        Args:
            query: [D], of any length.
            k: largest number of segments.

        Returns:
            (segment, cosine of the angle between the vectors), best first.

        Raises:
            ValueError: the query has another dimension, is zero or not finite, or k < 1.
        """
        wanted = torch.as_tensor(query).detach().flatten().to("cpu", torch.float32)
        if wanted.shape != self.vectors.shape[1:] or not bool(wanted.isfinite().all()) or not bool(wanted.any()):
            told = f"query: expected {self.vectors.shape[1]} finite numbers, not all 0"
            raise ValueError(f"{told}, got {list(query.shape)}")
        if k < 1:
            raise ValueError(f"k: expected at least 1, got {k}")
        cosine = (self.vectors @ functional.normalize(wanted, dim=0)).where(self.seen, -torch.inf)
        best = torch.sort(cosine, descending=True, stable=True).indices[: min(k, int(self.seen.sum()))]
        return [(int(segment), float(cosine[segment])) for segment in best]

    def of(self, labels: Tensor) -> Embeddings:
        """The vectors of other segments of the same points, such as those of another level, or after corrections.

        A segment gets the mean direction of the vectors that its points have here.

        Args:
            labels: [N] int64; -1 = none.
        """
        if torch.equal(labels, self.labels):
            return self
        segment, row, points = shared_points(labels, self.labels)
        sums = self.vectors.new_zeros(int(labels.max()) + 1, self.vectors.shape[1])
        sums.index_add_(0, segment, self.vectors[row] * points[:, None])
        return Embeddings(functional.normalize(sums, dim=1), labels)

    def save(self, path: str | Path) -> None:
        """Writes an .npz archive with the arrays `vectors` and `labels`. An earlier file is replaced, as NumPy does.

        Args:
            path: the file; or a result's folder: then :func:`torchjoint.load_result` finds the vectors again, and
                segments.json has the row of embeddings.npz of each segment (of most of its points, after corrections).

        Raises:
            FileNotFoundError, ValueError: the folder is no result, or one of another number of points.
        """
        path = Path(path)
        rows = self._rows(path) if has_folder(path) else None
        file = path if rows is None else path / FILE
        write_archive(no_link(file), {"vectors": self.vectors.numpy(), "labels": self.labels.to(torch.int32).numpy()})
        if rows is not None:
            add_to_segments(path, {"embeddings": FILE}, embedding=rows)

    def _rows(self, path: Path) -> dict[int, int]:
        """For each segment of a result's folder the row of its vector."""
        _, stored = read_segments(path)
        if len(stored) != len(self.labels):
            raise ValueError(f"{path}: expected a result of {len(self.labels)} points, got {len(stored)}")
        segment, row, points = shared_points(stored, self.labels)
        order = torch.argsort(points, stable=True)  # of several rows of a segment, the last one is kept
        return dict(zip(segment[order].tolist(), row[order].tolist(), strict=True))

    @classmethod
    def load(cls, path: str | Path) -> Embeddings:
        """Reads what :meth:`save` wrote.

        Raises:
            FileNotFoundError, ValueError: the message names the file and its error.
        """
        arrays = read_archive(Path(path), ("vectors", "labels"))
        vectors, labels = arrays.get("vectors"), arrays.get("labels")
        if vectors is None or vectors.ndim != 2 or vectors.dtype != np.float32 or not np.isfinite(vectors).all():
            raise ValueError(f"{path}: expected finite vectors [S, D] of float32")
        if labels is None or labels.ndim != 1 or labels.dtype != np.int32 or not labels.size:
            raise ValueError(f"{path}: expected labels [N] of int32")
        if not -1 <= labels.min() <= labels.max() < len(vectors):
            raise ValueError(f"{path}: expected labels below {len(vectors)}, got {labels.min()} to {labels.max()}")
        return cls(torch.from_numpy(vectors), torch.from_numpy(labels).long())


def read_embeddings(folder: Path, num_points: int) -> Embeddings | None:
    """The vectors that were saved with a result; None if there are none."""
    if not has_file(folder / FILE):
        return None
    found = Embeddings.load(folder / FILE)
    if len(found.labels) != num_points:
        got = f"{len(found.labels)}; of another result?"
        raise ValueError(f"{folder / FILE}: expected labels of {num_points} points, got {got}")
    return found


def shared_points(labels: Tensor, others: Tensor) -> Tensor:
    """[3, K]: the pairs of a label and another one that have common points, and their number; -1 is in no pair."""
    both = (labels >= 0) & (others >= 0)
    return counted_pairs(labels[both], others[both])


def embed(
    scene: Scene, result: Segmentation, encoder: Encoder, k: int = 3, size: int = 224, margin: float = 0.1
) -> Embeddings:
    """Embeds each segment; see :meth:`torchjoint.results.result.Result.embed`."""
    if k < 1 or size < 1 or not margin >= 0:
        raise ValueError(f"k, size and margin: expected >= 1, >= 1 and >= 0, got {k}, {size} and {margin}")
    if not callable(encoder):
        raise TypeError(f"encoder: expected a module or a function, got {type(encoder).__name__}")
    if not len(result.images) or len(result.images) != len(scene.frames):
        raise ValueError(f"result: expected frames, to see the segments, got {len(scene.frames)}")
    cameras = dict(enumerate(parallel_map(lambda index: _camera(scene.frames[index]), range(len(scene.frames)))))
    vectors: dict[int, Tensor] = {}
    for record in segment_records(scene, result):
        views = sorted(record.views, key=lambda view: (-view.pixels, view.frame))[:CANDIDATES]
        crops = crops_of(scene, result, record.id, {view.frame: view.pixels for view in views}, cameras, k, margin)
        if crops:
            # The thing alone, and with what is around it.
            inputs = [one for crop in crops for one in (torch.where(crop.mask, crop.image, GREY), crop.image)]
            vectors[record.id] = _mean_vector(encoder, torch.stack([_square(one, size) for one in inputs]))
    zeros = torch.zeros(next((len(vector) for vector in vectors.values()), 0), dtype=torch.float32)
    found = [vectors.get(segment, zeros) for segment in range(result.num_point_segments)]
    return Embeddings(torch.stack(found), result.points)


def _square(image: Tensor, size: int) -> Tensor:
    height, width = image.shape[1:]
    side = max(height, width)
    left, top = (side - width) // 2, (side - height) // 2
    padded = functional.pad(image, (left, side - width - left, top, side - height - top), value=GREY)
    resized = functional.interpolate(padded[None], (size, size), mode="bilinear", antialias=True, align_corners=False)
    return resized[0].clamp(0, 1)


def _mean_vector(encoder: Encoder, images: Tensor) -> Tensor:
    """The mean direction of the vectors of some images, unit length."""
    with torch.no_grad(), eval_mode(encoder) if isinstance(encoder, nn.Module) else nullcontext():
        found = encoder(images)
    if not isinstance(found, Tensor) or found.dim() != 2 or len(found) != len(images):
        got = list(found.shape) if isinstance(found, Tensor) else type(found).__name__
        raise ValueError(f"encoder: expected vectors of shape [{len(images)}, D], got {got}")
    found = found.detach().to("cpu", torch.float32)
    if not bool(found.isfinite().all()):
        raise ValueError("encoder: expected finite vectors, got NaN or infinity")
    return functional.normalize(functional.normalize(found, dim=1).mean(0), dim=0)
