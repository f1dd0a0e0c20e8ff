"""The server of the viewer's page."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime.extras import needed_for
from torchjoint.scene import Scene
from torchjoint.viewer.cameras import start


def import_viser() -> Any:
    """Returns the module viser.

    Raises:
        ModuleNotFoundError: it is not installed; the message gives the command.
    """
    with needed_for("the viewer", "viser", "torchjoint[viewer]"):
        import viser
    return viser


def start_server(scene: Scene, up: npt.NDArray[np.float64], host: str, port: int) -> tuple[Any, float]:
    """Starts a server of an empty page whose first view is of a scene.

    Args:
        scene: the scene that will be shown.
        up: [3] upward direction, unit length.
        host, port: of the page; if the port is in use, the next free one is used.

    Returns:
        a viser.ViserServer, and the distance between the viewer and the scene's centre, metres.

    Raises:
        ModuleNotFoundError: viser is not installed.
    """
    server = import_viser().ViserServer(host=host, port=port, label="torchjoint", verbose=False)
    server.scene.set_up_direction(tuple(up))
    position, target = start(scene, up)
    server.initial_camera.position, server.initial_camera.look_at = position, target
    return server, float(np.linalg.norm(position - target))
