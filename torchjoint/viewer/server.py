"""The server of the viewer's page. It answers only those who know its address, which has a random part."""

import io
import logging
import secrets
import signal
import socket
import threading
import weakref
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from html import escape
from ipaddress import ip_address
from typing import Any, NamedTuple
from unittest.mock import patch
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps
from scipy.spatial.transform import Rotation

from torchjoint.results.upright import fitted
from torchjoint.runtime.messages import needed_for, say
from torchjoint.scene import Frame, Scene
from torchjoint.scene.frame import camera_center
from torchjoint.scene.scene import evenly_spaced_indices
from torchjoint.viewer.model import Bytes

#: Largest number of cameras that are drawn; more would hide the cloud.
MAX_CAMERAS = 60
#: Of the server. Programs that look for open ports, and speak no HTTP 1.1, are no error of it.
_LOGGER = logging.getLogger("websockets.server.torchjoint")
_LOGGER.addFilter(lambda record: record.msg != "opening handshake failed")


class Viewpoint(NamedTuple):
    """Position and orientation of a camera."""

    position: npt.NDArray[np.float64]  #: [3] metres
    wxyz: npt.NDArray[np.float64]  #: [4] quaternion, camera to world, OpenCV axes
    fov: float  #: vertical field of view, radians
    aspect: float  #: width / height


def viewpoint(frame: Frame) -> Viewpoint:
    """The viewpoint of a frame."""
    height, width = frame.size
    fov = 2 * np.arctan2(height / 2, float(frame.intrinsics[1, 1]))
    wxyz = Rotation.from_matrix(frame.world_to_camera[:3, :3].T.numpy()).as_quat(scalar_first=True)
    return Viewpoint(camera_center(frame.world_to_camera).numpy(), wxyz, float(fov), width / height)


def ray_of(camera: Any, column: float, row: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Origin and direction of the ray through a place of a page's canvas, in shares of its width and height."""
    slope = np.tan(camera.fov / 2) * np.array([(2 * column - 1) * camera.aspect, 2 * row - 1])
    rotation = Rotation.from_quat(np.asarray(camera.wxyz), scalar_first=True)
    return np.asarray(camera.position), rotation.apply([*slope, 1.0])


def behind(photo: Bytes, aspect: float, is_dark: bool) -> Bytes:
    """A photo in the midst of an empty canvas of another aspect: what fills the page behind the cloud."""
    height, width = photo.shape[:2]
    size = max(width, round(height * aspect)), max(height, round(width / aspect))
    return np.asarray(ImageOps.pad(Image.fromarray(photo), size, color="#141414" if is_dark else "white"))


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
        shown = evenly_spaced_indices(len(scene.frames), MAX_CAMERAS)
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
    looks = {"scale": size, "thickness": 1.5, "thickness_units": "screen", "color": color, "visible": is_visible}
    return server.scene.add_camera_frustum(name, **looks, **view._asdict())


class Eyes:
    """From where the pages look: at the whole cloud, or at a camera, before its photo.

    Args:
        server: viser.ViserServer.
        scene: the shown scene.
        up: [3] upward direction, unit length.

    Attributes:
        distance: between the viewer and the scene's centre in the first view, metres.
        standing: orientations of the pages that stand at a camera.
    """

    def __init__(self, server: Any, scene: Scene, up: npt.NDArray[np.float64]) -> None:
        self._server, self._up, first = server, up, server.initial_camera
        server.scene.set_up_direction(tuple(up))
        first.position, first.look_at, _ = fitted(scene, up, first.fov, 1.5)
        self.distance = float(np.linalg.norm(first.position - first.look_at))
        first.near = max(0.01, self.distance / 5000)  # depths have few bits, and are shaded by their differences
        self._near = first.near
        self._fitted: dict[int, tuple[Any, float]] = {}  # where a page saw the whole cloud, and its aspect
        self.standing: dict[int, Any] = {}
        self._arrived: set[int] = set()  # those of them that have it

    def show_all(self, client: Any, scene: Scene) -> None:
        """Shows the whole cloud on a page, as large as the canvas allows."""
        fov = self._server.initial_camera.fov
        position, target, _ = fitted(scene, self._up, fov, client.camera.aspect)
        self._fitted[client.client_id] = position, client.camera.aspect
        with client.atomic():
            client.camera.up_direction, client.camera.fov, client.camera.near = self._up, fov, self._near
            client.camera.position, client.camera.look_at = position, target

    def show_more(self, scene: Scene) -> None:
        """Shows the whole of a cloud that has grown on the pages that nobody has turned."""
        for client in self._server.get_clients().values():
            fitted_at, _ = self._fitted.get(client.client_id, (np.inf, 0.0))
            if np.abs(fitted_at - client.camera.position).max() < 1e-3 * self.distance:
                self.show_all(client, scene)

    def stand_at(self, client: Any, view: Viewpoint, photo: Bytes, is_dark: bool) -> None:
        """Lets a page, which may be dark, look from a viewpoint, with the photo behind the cloud."""
        aspect = client.camera.aspect
        fov = 2 * np.arctan(np.tan(view.fov / 2) * max(1, view.aspect / aspect))  # the whole photo fits
        with client.atomic():
            client.camera.wxyz, client.camera.position, client.camera.fov = view.wxyz, view.position, fov
        client.scene.set_background_image(behind(photo, aspect, is_dark))
        self.standing[client.client_id] = view.wxyz
        self._arrived.discard(client.client_id)

    def forget(self, client: Any) -> bool:
        """Forgets a page that was closed; whether it stood at a camera."""
        self._fitted.pop(client.client_id, None)
        self._arrived.discard(client.client_id)
        return self.standing.pop(client.client_id, None) is not None

    def follow(self, client: Any, scene: Scene) -> bool:
        """Takes note of where a page looks from now; whether it has left the photo at which it stood."""
        fitted_at, aspect = self._fitted.get(client.client_id, (client.camera.position, 0.0))
        places = np.stack([fitted_at, self._server.initial_camera.position])
        is_fitted, is_new = np.abs(places - client.camera.position).max(1) < 1e-3 * self.distance
        stands = self.standing.get(client.client_id)
        # Nobody has turned it; a page may go to the first view of all pages after it was told its own.
        if stands is None and (is_new or (is_fitted and aspect != client.camera.aspect)):
            self.show_all(client, scene)
        if stands is not None and abs(stands @ client.camera.wxyz) > 0.9999:
            self._arrived.add(client.client_id)  # before that, a page may still tell where it was
        elif stands is not None and client.client_id in self._arrived:
            del self.standing[client.client_id]
            client.scene.set_background_image(None)
            return True
        return False

    def cut_front(self, share: float) -> None:
        """Hides what is nearer than a share of the distance to the far side."""
        self._near = max(self._server.initial_camera.near, 2 * share * self.distance)
        for client in self._server.get_clients().values():
            client.camera.near = self._near


class FairLock:
    """A reentrant lock that threads get in the order in which they asked for it.

    Others get a lock in any order: what was typed while an action worked went to what was clicked before or after it.
    """

    def __init__(self) -> None:
        self._changed, self._asked = threading.Condition(), list[int]()  # threads; the first one has the lock

    def __enter__(self) -> None:
        own = threading.get_ident()
        with self._changed:
            self._asked.insert(0 if self._asked[:1] == [own] else len(self._asked), own)
            try:
                self._changed.wait_for(lambda: self._asked[0] == own)
            except BaseException:  # Ctrl-C
                self._asked.remove(own)
                raise

    def __exit__(self, *_: object) -> None:
        with self._changed:
            del self._asked[0]
            self._changed.notify_all()


def import_viser() -> Any:
    """Returns the module viser."""
    with needed_for("the viewer", "viser", "torchjoint[viewer]"):
        import viser
    return viser


class Page:
    """An empty page, which is served until :meth:`stop` is called or the program ends.

    Args:
        on_open: called with the url as soon as the page answers.
        host, port: of the page. With the default host only this machine can open it. If the port is in use, the next
            free one is used.
        note: what the page says before it shows something.

    Attributes:
        server: the viser.ViserServer.
        url: its address. Who knows it can see and correct what is shown.
        not_kept: says what would be lost if the program ended now; "": nothing.

    Raises:
        ModuleNotFoundError: viser is not installed.
    """

    def __init__(
        self, on_open: Callable[[str], object] = str, *, host: str = "127.0.0.1", port: int = 8080, note: str = ""
    ) -> None:
        self.server, self.url = _start_server(host, port)
        self._workers: list[threading.Thread] = []
        self.has_stopped = False
        self.not_kept: Callable[[], str] = str
        # Not atexit, which comes when Python has waited for all threads of pools, and no pool can begin another item.
        # Later, viser fails to tell that the pages have left.
        threading._register_atexit(_end, weakref.ref(self))  # type: ignore[attr-defined]
        title = "<style onload=\"document.title = 'torchjoint'\"></style>"
        self.server.gui.add_html(f'{title}<div style="padding: 0.5em 1em">{escape(note)}</div>')
        on_open(self.url)

    def work(self, action: Callable[[], object]) -> None:
        """Does something on a thread of its own, for which the end of the page waits."""
        self._workers = [worker for worker in self._workers if worker.is_alive()]
        self._workers.append(threading.Thread(target=action, daemon=True))
        self._workers[-1].start()

    def stop(self) -> None:
        """Ends the page, after what works behind it."""
        if not self.has_stopped:
            self.has_stopped = True
            for worker in self._workers:  # a thread that is in compiled code when Python ends aborts the program
                worker.join()
            with redirect_stdout(io.StringIO()):  # viser says that it stops
                self.server.stop()


def _end(page: weakref.ref[Page]) -> None:
    if (alive := page()) is not None and not alive.has_stopped:
        with suppress(ValueError):  # another thread than the main one ends the program
            # An exception would end the wait for the workers, so that Python ends before them, and aborts.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        if lost := alive.not_kept():
            say(f"not kept: {lost}")
        alive.stop()


def _start_server(host: str, port: int) -> tuple[Any, str]:
    """Starts a viser.ViserServer; its address has a random part."""
    if not 0 < port < 1 << 16:
        raise ValueError(f"port: expected 1 to 65535, got {port}")
    viser, token = import_viser(), secrets.token_urlsafe(24)
    from websockets.asyncio import server as sockets

    serve, guards = sockets.serve, []

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        guards.append(_guard(process_request, token, host))
        return serve(*arguments, process_request=guards[-1], logger=_LOGGER, **options)

    # Viser has no argument for it, and prints an address without the random part.
    with patch.object(sockets, "serve", guarded), redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="torchjoint", verbose=False)
    if not guards:
        server.stop()
        raise RuntimeError(f"the viewer: expected viser 1.1, got {viser.__version__}, whose page is open to all")
    shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
    return server, f"http://{shown}:{server.get_port()}/{token}/"


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    return host == "localhost" or (_is_number(host) and ip_address(host).is_loopback)


def _guard(answer: Any, token: str, host: str) -> Any:
    """Checks a request before viser answers it.

    Its path begins with the token, for the page as for its websocket, whose address the page takes from its own. `Host`
    is a number or a name of this machine: a name of another site may lead here, too. `Origin`, which a browser sends
    with a websocket, is the page itself.
    """
    own = {name.lower() for name in ("localhost", host, socket.gethostname(), socket.getfqdn())}  # as urlsplit does

    def checked(connection: Any, request: Any) -> Any:
        given, _, path = request.path.removeprefix("/").partition("/")
        try:
            is_allowed = _is_from_page(request.headers, own) and secrets.compare_digest(given.encode(), token.encode())
        except (ValueError, LookupError):  # no text, no host, or two hosts
            is_allowed = False
        if not is_allowed:
            return connection.respond(403, "open the address that torchjoint has printed\n")
        request.path = f"/{path}"
        return answer(connection, request)

    return checked


def _is_from_page(headers: Any, own: set[str]) -> bool:
    address = headers.get("Host", "")
    name = urlsplit(f"//{address}").hostname or ""
    is_same = all(origin.partition("://")[2] == address for origin in headers.get_all("Origin"))
    return is_same and (name in own or _is_number(name))


def _is_number(host: str) -> bool:
    with suppress(ValueError):
        return bool(ip_address(host))
    return False
