"""Options to read a recording, and to select its frames and points before segmentation."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config import Config
from torchjoint.scene import Scene
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.scene.scene import voxel_subsample
from torchjoint.views.visibility import in_any_view


@dataclass(frozen=True)
class RecordingOptions:
    """Options of a recording, as in `torchjoint segment` and `torchjoint batch`.

    Attributes:
        voxel_size: metres, for fusing a cloud from depth if the recording has no cloud.
        max_frames: number of frames to use, evenly spread over the recording; None: all.
        in_view: leave out the points that no frame has in its view (a LiDAR sees all around, a camera does not).
        thin: keep one point per voxel of this size, metres, of clouds that are denser than their noise, or too large;
            None: all points.
        merge_within: metres; all points in a cube with this side are treated as one point and get the same label.
        granularity: level of the labels, 0 (coarse) to 1 (fine); None: the default, 0.5. All levels are always saved.
            Only point_segments.method learned has levels; auto chooses it unless the cloud is a scan.
        topics: for a ROS recording: pairs of a role and its topic, for roles that several topics fit.
        time_limit: for a ROS recording: largest time from an image to its depth image and its pose, seconds.
        ignore_poses: go on if the poses look wrong; else this is an error.
        drop_invalid: leave out the points that are NaN or infinite, and tell their number; else they are an error.
        least_opacity: of Gaussian splats (a .ply), 0 to 1: fainter ones are no part of the cloud. `torchjoint label`
            gives them labels.
        format: of `torchjoint formats`, if the one that is detected is not the right one: cloud_alone.
    """

    voxel_size: float = 0.02
    max_frames: int | None = None
    in_view: bool = False
    thin: float | None = None
    merge_within: float = 0.0
    granularity: float | None = None
    topics: tuple[tuple[str, str], ...] = ()
    time_limit: float = 0.02
    ignore_poses: bool = False
    drop_invalid: bool = False
    least_opacity: float = 0.1
    format: str | None = None

    def check(self, config: Config) -> None:
        """Raises ValueError if an option is out of range, or does not fit the parameters."""
        if self.max_frames is not None and self.max_frames < 0:
            raise ValueError(f"--max-frames: expected >= 0, got {self.max_frames}")
        if self.thin is not None and not 0 < self.thin < float("inf"):
            raise ValueError(f"--thin: expected more than 0 metres, got {self.thin}")
        if self.granularity is None:
            return
        check_granularity(self.granularity, "--granularity")
        if (method := config.point_segments.method) in ("scan", "paper"):
            raise ValueError(f"--granularity: expected a method with levels, as in --preset default, got {method}")

    def source(self) -> str:
        """The options that change a fused cloud, as text."""
        return f"{self.voxel_size} {sorted(self.topics)} {self.time_limit}{f' {self.format}' if self.format else ''}"

    def key(self) -> str:
        """The options that change the state of a run, as text."""
        return (
            f"{self.max_frames} {self.in_view} {self.thin} {self.merge_within} {self.drop_invalid} {self.least_opacity}"
        )

    def cut_down(self, scene: Scene) -> Scene:
        """Selects the frames and points of a recording that are used."""
        if self.max_frames is not None:
            scene = scene.sample_frames(self.max_frames)
        if self.in_view:
            scene = scene.select_points(in_any_view(scene.points, scene.frames))
        return scene if self.thin is None else scene.select_points(voxel_subsample(scene.points, self.thin))
