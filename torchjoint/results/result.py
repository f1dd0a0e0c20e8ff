"""A segmentation together with its scene and parameters (output after step 8): what `tj.load_result` gives."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from torchjoint.config import Config
from torchjoint.masks.folder import frame_names
from torchjoint.results.embeddings import Crop, Embeddings, Encoder, best_crops, check_segment, embed, shared_points
from torchjoint.results.objects import SegmentRecord, segment_records
from torchjoint.results.picking import Pick, Pixels, Prompts, pick
from torchjoint.results.relations import Relations, relations
from torchjoint.results.render import label_colors
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene, Segmentation


@dataclass(frozen=True, repr=False)
class Result(Segmentation):
    """A :class:`~torchjoint.Segmentation` with its scene: its segments can be measured, cut out and cropped.

    Attributes:
        scene: the cloud, and the frames in the order of the images. Frames are read when they are used.
        config: the parameters of the run; None if unknown.
        segment_names: names that were given by hand, or that most masks of a segment have, by id, also of an image's.
        saved_embeddings: the vectors that were saved with the result, of the segments at that time.
        manifest: checksum of the manifest of the folder that it was read from; None: of none.
    """

    scene: Scene = field(kw_only=True)
    config: Config | None = field(default=None, kw_only=True)
    segment_names: Mapping[int, str] = field(default_factory=dict, kw_only=True)
    saved_embeddings: Embeddings | None = field(default=None, kw_only=True)
    manifest: str | None = field(default=None, kw_only=True)

    @classmethod
    def of(cls, segmentation: Segmentation, scene: Scene, config: Config | None = None) -> Result:
        """The result of a run in memory: ``Result.of(segmenter(scene), scene)``.

        Points that have no level, beams without return, are left out.

        Raises:
            ValueError: the scene has other points or frames, or in another order, as far as their names tell.
        """
        got = len(scene.points), len(scene.frames)
        own = len(segmentation.points), len(segmentation.images)
        if got[0] != own[0] or (own[1] and got[1] != own[1]):
            raise ValueError(f"scene: expected {own[0]} points and {own[1]} frames, got {got[0]} and {got[1]}")
        if segmentation.cloud_checksum not in (None, zlib.crc32(scene.points.contiguous().numpy().data)):
            told = "in their order and dtype, got others; replace(segmentation, cloud_checksum=None) if they were moved"
            raise ValueError(f"scene: expected the points that were segmented, {told}")
        frames = frame_names(scene.frames) if own[1] else []
        for name, came in zip(segmentation.names, frames, strict=False):
            if name and came and name != came:
                raise ValueError(f"scene: expected frame {name!r}, got {came!r}; of another order or scene?")
        if segmentation.hierarchy is not None:
            segmentation, scene = segmentation.labelled(scene)
        values = {one.name: getattr(segmentation, one.name) for one in fields(Segmentation)}
        return cls(**values | {"names": segmentation.names or tuple(frames)}, scene=scene, config=config)

    def at(self, granularity: float = 0.5) -> Self:
        """As :meth:`torchjoint.Segmentation.at`; a segment has the name, if it is one, that most of its points had.

        Segments are numbered anew, by their first points. At another level, the viewer, and a result that it has saved
        there, keep the ids of the result on disk, and number other segments after those.
        """
        found = super().at(granularity)
        if not self.segment_names:
            return found
        count = self.num_point_segments
        new, old, shared = shared_points(found.points, self.points)
        has_name = torch.isin(old, torch.tensor(list(self.segment_names)))
        most = 2 * torch.bincount(new, shared * has_name) > torch.bincount(new, shared)
        more = found.num_point_segments - count
        names = {one + more: {name} for one, name in self.segment_names.items() if one >= count}
        for one, of in zip(new[has_name & most[new]].tolist(), old[has_name & most[new]].tolist(), strict=True):
            names.setdefault(one, set()).add(self.segment_names[of])
        return replace(found, segment_names={one: name for one, (name, *others) in names.items() if not others})

    @cached_property
    def embeddings(self) -> Embeddings | None:
        """The saved vectors, for the segments of this level, with their corrections; None: none were saved."""
        return None if self.saved_embeddings is None else self.saved_embeddings.of(self.points)

    @on_cpu()
    def records(self) -> list[SegmentRecord]:
        """Describes each segment: name, points, centre, box, colour, and the frames that see it."""
        return [replace(one, name=self.segment_names.get(one.id, "")) for one in segment_records(self.scene, self)]

    def cloud(self, segment: int) -> Scene:
        """The segment's own points, with their colours; a scene without frames.

        Raises:
            TypeError: the id is no integer.
            ValueError: an unknown id.
        """
        segment = check_segment(segment, self.points)
        name = f"{self.scene.name} {segment}".strip()
        return replace(self.scene, frames=(), normals=None, truth=None, name=name).select_points(self.points == segment)

    def crops(self, segment: int, k: int = 3, margin: float = 0.1) -> list[Crop]:
        """Crops the frames that show a segment best, best first; see :func:`~torchjoint.results.embeddings.best_crops`.

        Args:
            segment: id of a segment of the cloud.
            k: largest number of views.
            margin: added around the segment, as a share of its longer side in the image.

        Raises:
            TypeError: the id is no integer.
            ValueError: the id is unknown, k < 1, the margin is negative, or the result has no frames.
        """
        return best_crops(self.scene, self, segment, k, margin)

    @on_cpu()
    def embed(self, encoder: Encoder, k: int = 3, size: int = 224, margin: float = 0.1) -> Embeddings:
        """Embeds each segment of the cloud by its best views; then words find things: ``embeddings.find(text)``.

        ``embeddings.save(folder)`` saves them with a result on disk; :attr:`embeddings` are those that were saved.

        A view gives two images: the thing on grey, and the thing with what is around it. The vector of a segment is the
        mean of the unit vectors of all its images, of unit length.

        Args:
            encoder: a module or function that makes vectors [B, D] of images [B, 3, size, size], RGB in [0, 1], such as
                ``lambda images: model.encode_image(normalize(images))`` with a model of open_clip. A module runs in
                evaluation mode.
            k: number of views of a segment.
            size: of the images, pixels; what is not square has grey bars.
            margin: around the thing, as a share of its longer side in the image.

        Raises:
            ValueError: a wrong argument, a result without frames, or an encoder that gives something else.
            TypeError: the encoder is neither a module nor a function.
        """
        return embed(self.scene, self, encoder, k, size, margin)

    def find(self, query: Tensor, k: int = 5) -> list[tuple[int, float]]:
        """The `k` segments that are most like `query` [D], a text's or an image's vector, among the saved vectors.

        Returns:
            (segment, cosine of the angle), most alike first.

        Raises:
            ValueError: no vectors were saved with the result; or as :meth:`Embeddings.find`.
        """
        if self.embeddings is None:
            raise ValueError("embeddings: none were saved with this result; result.embed(encoder).save(folder) does it")
        return self.embeddings.find(query, k)

    @on_cpu()
    def graph(self) -> Relations:
        """Which segments of the cloud stand on, hang on, contain and touch which, from geometry alone.

        What is up, the scene says: :class:`torchjoint.Scene`.

        Returns:
            the relations; ``graph.of(segment)``.
        """
        return relations(self.scene, self)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Writes a folder as ``torchjoint segment`` does, for the other commands and :func:`torchjoint.load_result`.

        Vectors and names are written, too, but no names of segments without points, and no points without a label. The
        folder does not know the file of the cloud: `torchjoint label` puts the labels into a survey with its fields.

        Args:
            folder: becomes the result, as a whole; an error leaves nothing there.
            overwrite: replace an earlier result.

        Raises:
            FileExistsError, OSError: the folder is there, or has corrections by hand, or cannot be written.
            TypeError: a name is no text, or its id no integer.
        """
        from torchjoint.results.output_folder import save_result

        save_result(Path(folder), self, overwrite)

    def to_open3d(self) -> Any:
        """The cloud as ``open3d.t.geometry.PointCloud``: in the colours of its segments, which "labels" [N, 1] tells.

        Raises:
            ModuleNotFoundError: Open3D is not installed.
        """
        with needed_for("Result.to_open3d", "Open3D", "torchjoint[open3d]"):
            import open3d
        cloud = open3d.t.geometry.PointCloud(self.scene.points.numpy().copy())  # which transform() changes
        cloud.point.colors = label_colors(self.points).numpy()
        cloud.point.labels = self.points[:, None].to(torch.int32).numpy()  # Open3D writes no int64 into files
        return cloud

    @on_cpu()
    def pick(
        self,
        points: Tensor | None = None,
        *,
        pixels: Pixels = (),
        negative: Tensor | None = None,
        negative_pixels: Pixels = (),
    ) -> Pick:
        """Picks the segment that contains some points and pixels, and none of others.

        Without a negative, it is their segment in :attr:`points`, with corrections, or, if they lie in several, the
        smallest one of the hierarchy that contains all. With negatives, each chosen point gives the largest segment of
        the hierarchy that contains no negative, up to the default level, or up to that where the chosen points are in
        one; the pick is all of these together.

        Args:
            points: [K] int64 indices of points, or [K, 3] float positions, metres; a position stands for the nearest
                point.
            pixels: (frame, column, row) of pixels.
            negative: as `points`, where the segment must not be.
            negative_pixels: as `pixels`.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came; or nothing was chosen, or a
                chosen point and a negative one lie in one superpoint.
        """
        return pick(self, self.scene.points, Prompts(points, pixels), Prompts(negative, negative_pixels))
