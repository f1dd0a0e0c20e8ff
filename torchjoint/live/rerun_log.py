"""Writes live segmentation into a recording of Rerun: things, camera, images and changes over the frames."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchjoint.live.segmenter import LiveResult
from torchjoint.results.render import label_colors
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.messages import needed_for
from torchjoint.scene import Frame
from torchjoint.scene.frame import camera_center, to_8_bits

#: Rerun's classes have 16 bits; 0 stands for no thing.
CLASSES = 2**16 - 1
#: Metres: the origin is at a multiple of this, because Rerun's coordinates are float32.
ORIGIN = 1000.0


class RerunLog:
    """Writes frames and results to a recording of Rerun, on its timeline `frame`.

    Entities: `world/things`, the points, whose class is the lasting id + 1; `world/camera`, with `image`, and `things`,
    the labels of the keyframes, if a result has them; `changes`, text. Frames are found by their names for that.
    Far from the world's origin, all places are relative to the first camera, up to a multiple of a kilometre.

    Args:
        recording: a `rerun.RecordingStream`, such as one after `spawn()`; :meth:`to_file` makes one for a file.

    Raises:
        ModuleNotFoundError: rerun is not installed.
    """

    def __init__(self, recording: Any) -> None:
        self._rerun, self._recording = _import_rerun(), recording
        self._numbers: dict[str, int] = {}
        self._origin: Tensor | None = None

    @classmethod
    @contextmanager
    def to_file(cls, path: str | Path) -> Iterator[RerunLog]:
        """A log in a file .rrd, which appears as a whole at the end of the block, unless that raises an error."""
        recording = _import_rerun().RecordingStream("torchjoint")
        with atomic_write(Path(path)) as partial:
            partial.touch()  # its errors are those of other files
            recording.save(partial)
            try:
                yield cls(recording)
            finally:
                recording.disconnect()  # writes what is left

    def camera(self, frame: Frame, number: int) -> None:
        """Writes the image and the camera of a frame, keyframe or not; `number` is its place on the timeline."""
        from scipy.spatial.transform import Rotation

        self._at(number)
        if frame.name:
            self._numbers[frame.name] = number
        pose = frame.world_to_camera.double()
        place = self._relative(camera_center(pose)[None])[0]
        # Rerun draws no camera whose matrix is a rotation up to a few digits.
        turn = Rotation.from_matrix(pose[:3, :3].T.numpy()).as_quat()
        self._recording.log("world/camera", self._rerun.Transform3D(translation=place, quaternion=turn))
        height, width = frame.image.shape[1:]
        lens = frame.intrinsics.double().clone()
        lens[:2, 2] += 0.5  # the middle of Rerun's first pixel
        camera = self._rerun.Pinhole(image_from_camera=lens.numpy(), resolution=[width, height])
        self._recording.log("world/camera", camera)
        pixels = to_8_bits(frame.image).permute(1, 2, 0).contiguous().numpy()
        self._recording.log("world/camera/image", self._rerun.Image(pixels).compress(jpeg_quality=80))

    def show(self, live: LiveResult, number: int) -> None:
        """Writes a result after the frame with this number: the things so far, and what has become of others."""
        colors = (label_colors(torch.arange(int(live.ids.max()) + 1)[:CLASSES]) * 255).byte().tolist()
        names = [(0, "none", (0, 0, 0, 0)), *((1 + index, f"{index}", color) for index, color in enumerate(colors))]
        self._recording.log("/", self._rerun.AnnotationContext(names), static=True)
        self._at(number)
        points = self._relative(live.cloud.points)
        self._recording.log("world/things", self._rerun.Points3D(points, class_ids=_classes(live.labels)))
        said = [f"{what} {str(which).strip('(){,}')}" for what, which in live.changes._asdict().items() if which]
        self._recording.log("changes", self._rerun.TextLog("; ".join(said)))
        images = zip(live.segmentation.names, live.segmentation.images, strict=True)
        labelled = {self._numbers[name]: labels for name, labels in images if name in self._numbers}
        of_thing = torch.cat([live.ids, torch.tensor([-1])])
        for at, labels in labelled.items():
            self._at(at)
            classes = _classes(of_thing[torch.where(labels < len(live.ids), labels, -1)])
            self._recording.log("world/camera/things", self._rerun.SegmentationImage(classes, opacity=0.5))
            if at + 1 not in labelled:  # they are those of this frame alone
                self._at(at + 1)
                self._recording.log("world/camera/things", self._rerun.Clear(recursive=False))

    def _at(self, number: int) -> None:
        self._recording.set_time("frame", sequence=number)

    def _relative(self, points: Tensor) -> Any:
        if self._origin is None:
            self._origin = (points[0].double() / ORIGIN).round() * ORIGIN
        return (points.double() - self._origin).float().numpy()


def _classes(ids: Tensor) -> Any:
    """Rerun's classes of lasting ids; after the last class, the first one comes again."""
    return torch.where(ids < 0, 0, ids % CLASSES + 1).to(torch.uint16).numpy()


def _import_rerun() -> Any:
    with needed_for("a recording of Rerun", "rerun", "torchjoint[rerun]"):
        import rerun
    return rerun
