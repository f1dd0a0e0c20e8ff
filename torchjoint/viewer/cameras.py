"""The cameras that are drawn in the cloud, and the views of the cloud."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from torchjoint.results.upright import view_from_above
from torchjoint.scene import Frame, Scene
from torchjoint.scene.camera import camera_center
from torchjoint.scene.subset import evenly_spaced_indices

#: Largest number of cameras that are drawn; more would hide the cloud.
MOST = 60


class Viewpoint(NamedTuple):
    """Position and orientation of a camera."""

    position: npt.NDArray[np.float64]  #: [3] metres
    wxyz: npt.NDArray[np.float64]  #: [4] quaternion, camera to world, OpenCV axes
    fov: float  #: vertical field of view, radians
    aspect: float  #: width / height


def viewpoint(frame: Frame) -> Viewpoint:
    """The viewpoint of a frame."""
    rotation = frame.world_to_camera[:3, :3].T.numpy()
    height, width = frame.size
    fov = 2 * np.arctan2(height / 2, float(frame.intrinsics[1, 1]))
    wxyz = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    return Viewpoint(camera_center(frame.world_to_camera).numpy(), wxyz, float(fov), width / height)


def start(scene: Scene, up: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Position and target of the first view: from above, looking where the cameras look."""
    center, position = view_from_above(scene, up)
    return position, center


class Cameras:
    """The drawn cameras, hidden at first: grey ones, evenly selected from the frames, and that of the shown image.

    None of them can be clicked: a click goes through it to the segment behind.

    Args:
        server: viser.ViserServer.
        scene: the scene with the frames.
        size: of a drawn camera, metres.
    """

    def __init__(self, server: Any, scene: Scene, size: float) -> None:
        self._server, self._frames, self._size = server, scene.frames, size
        self._is_visible = False
        shown = evenly_spaced_indices(len(scene.frames), MOST)
        self._handles = [self._add(f"/cameras/{index}", index, size, (90, 90, 90)) for index in shown]

    def mark(self, index: int) -> None:
        """Marks the camera of the frame whose image is shown."""
        self._mark = self._add("/camera", index, 1.6 * self._size, (230, 90, 0))  # replaces the object of the same name

    def show(self, is_visible: bool) -> None:
        """Shows or hides all cameras."""
        self._is_visible = is_visible
        for handle in (*self._handles, self._mark):
            handle.visible = is_visible

    def _add(self, name: str, index: int, size: float, color: tuple[int, int, int]) -> Any:
        return add_camera(self._server, name, viewpoint(self._frames[index]), size, color, self._is_visible)


def add_camera(
    server: Any, name: str, view: Viewpoint, size: float, color: tuple[int, int, int], is_visible: bool = True
) -> Any:
    """Draws a camera; it replaces the object of the same name."""
    return server.scene.add_camera_frustum(
        name,
        fov=view.fov,
        aspect=view.aspect,
        scale=size,
        line_width=1.5,
        color=color,
        wxyz=view.wxyz,
        position=view.position,
        visible=is_visible,
    )
