"""Shows live segmentation in the viewer: the cloud grows, things keep their colours, and can be clicked."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torchjoint.live import LiveResult
from torchjoint.results.result import Result
from torchjoint.results.shading import Shading
from torchjoint.results.upright import up_direction
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.cameras import viewpoint
from torchjoint.viewer.server import import_viser
from torchjoint.viewer.shown import Shown

#: The drawn camera, as a share of the distance from which the cloud is first seen.
CAMERA = 0.04


class GrowingView:
    """A page that opens with the first result of a :class:`~torchjoint.LiveSegmenter`.

    Args:
        on_open: called with the page's address when the page is ready.
        host, port: see :class:`~torchjoint.viewer.app.Viewer`.

    Raises:
        ModuleNotFoundError: viser is not installed.
    """

    def __init__(self, on_open: Callable[[str], object] = print, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        import_viser()
        self.viewer: Viewer | None = None
        self._on_open, self._address = on_open, (host, port)

    def show(self, live: LiveResult, frames: Sequence[Frame], note: str = "") -> None:
        """Shows another result.

        Args:
            live: the result.
            frames: that have come so far; their poses tell what is up.
            note: a line at the top of the panel.
        """
        scene = Scene(live.cloud.points, colors=live.cloud.colors)
        result = Result.of(Segmentation(live.labels, ()), scene)
        if self.viewer is None:
            up = up_direction(Scene(scene.points, frames))
            host, port = self._address
            self.viewer = Viewer(result, Shown(is_running=True), up=up, host=host, port=port)
            self._on_open(self.viewer.url)
        else:
            self.viewer.grow(result, Shading(scene.points, self.viewer.model.up))
        self.viewer.tell(note)

    def camera(self, frame: Frame) -> None:
        """Draws the camera where it is now."""
        if self.viewer is not None:
            self.viewer.draw_camera(viewpoint(frame), CAMERA)
