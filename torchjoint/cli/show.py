"""torchjoint show: a result in the browser."""

from __future__ import annotations

import atexit
import tempfile
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from html import escape
from importlib import import_module
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import torch
import tyro
from torch import Tensor

from torchjoint.cli.arguments import output_file
from torchjoint.datasets import load_scene
from torchjoint.joint import JointSegmenter
from torchjoint.results.folder import load_result, parts_of, read_origin
from torchjoint.results.result import Result
from torchjoint.runtime.foreign_files import has_file, is_there
from torchjoint.runtime.messages import say
from torchjoint.runtime.outputs import Output
from torchjoint.scene import Scene
from torchjoint.scene.checks import as_direction
from torchjoint.scene.hierarchy import check_granularity
from torchjoint.viewer.truth import KINDS, part_files, read_labelled_cloud, with_truth

if TYPE_CHECKING:
    from torchjoint.viewer.app import Viewer
    from torchjoint.viewer.live import GrowingView, LiveView
    from torchjoint.viewer.server import Page


def show(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")],
    static: Path | None = None,
    granularity: float | None = None,
    up: tuple[float, float, float] | None = None,
    truth: bool = False,
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = True,
    text_encoder: str | None = None,
    overwrite: bool = False,
) -> None:
    """Shows a result in the browser: cloud, images, a table of segments, levels, and corrections by hand.

    Needs `pip install 'torchjoint[viewer]'`. Ctrl-C ends it.

    Args:
        out: folder that `torchjoint segment` wrote; or what torchjoint wrote with labels: .ply, .las, .laz, .npz, .glb,
            text with names of columns, a folder with a .ply for each segment.
        static: write this HTML file, which can be shared, instead of opening the page.
        granularity: start with another level than RESULT has, 0 (coarse) to 1 (fine); not with method paper.
        up: upward direction x y z in the coordinates of the cloud; default: from the poses and the largest level plane.
        truth: also offer the ground truth of the recording (Colour by: truth).
        host: address of the page; 127.0.0.1: only this machine can open it; 0.0.0.0: any machine can that knows the
            printed address.
        port: of the page; if it is in use, the next free one.
        open_browser: the page is opened, unless this is given.
        text_encoder: package.module:function of yours that makes a vector of words, by the network that made the
            embeddings of RESULT; the page then finds things by words.
        overwrite: replace the file of --static.
    """
    if not is_there(out):
        raise FileNotFoundError(f"{out} does not exist; expected a result, or a cloud with labels")
    if has_file(out) and out.suffix.lower() not in KINDS:
        raise ValueError(f"{out}: expected a result's folder, or a file that ends in {', '.join(KINDS)}")
    folder = None if has_file(out) or part_files(out) else out
    inputs = (out,) if folder is None else parts_of(folder)  # raises of another folder before the page is opened
    page = None if static is None else output_file(static, overwrite, inputs, "--static")
    if static is not None and static.suffix.lower() not in (".html", ".htm"):  # such as an image of the recording
        raise ValueError(f"--static: expected a name that ends in .html, got {static}")
    if granularity is not None:
        check_granularity(granularity, "--granularity")
    if truth and folder is None:
        raise ValueError("--truth: expected a result's folder, got a cloud with labels")
    shown = None if page is not None else _page(f"reading {out} ...", host, port, open_browser)
    result = read_labelled_cloud(out) if folder is None else load_result(folder, edits=False)
    if truth:
        result = with_truth(result, _scene_of(out))
    if up is not None:
        result = replace(result, scene=replace(result.scene, up=as_direction(torch.tensor(up), "--up")))
    if granularity is not None and result.hierarchy is None:
        raise ValueError(f"--granularity: expected a result with levels, got {out} with one")
    if page is not None:
        _write_static(page, result, folder, granularity)
    else:
        from torchjoint.viewer.app import Viewer
        from torchjoint.viewer.shown import Shown

        encoder = None if text_encoder is None else _text_encoder(text_encoder, result)
        view = Shown(folder, text_encoder=encoder)
        serve_until_interrupted(Viewer(result, view, granularity=granularity, page=shown))


def live_view() -> LiveView:
    """A page that shows a run from its start."""
    from torchjoint.viewer.live import LiveView
    from torchjoint.viewer.server import import_viser

    import_viser()  # so that an error comes at once, not after an hour of fusing a cloud
    return LiveView(partial(_page, "reading ..."))


def growing_view() -> GrowingView:
    """A page for live segmentation."""
    from torchjoint.viewer.live import GrowingView

    return GrowingView(_page("the things come after the first frames ..."))


def show_result(out: Path, view: LiveView | None, segmenter: JointSegmenter, scene: Scene) -> None:
    """Shows a new result, whose parameters can be changed on the page; without a view, prints how to show it."""
    if view is None:
        say(f"torchjoint show {quote(str(out))}: look at it in the browser")
        return
    from torchjoint.viewer.shown import LiveRun

    serve_until_interrupted(view.finish(out, LiveRun(segmenter, scene)))


def _scene_of(out: Path) -> Scene:
    """Reads the scene of a result; a fused cloud is taken from the result."""
    recording = Path(read_origin(out).scene)
    if not is_there(recording):
        raise FileNotFoundError(f"--truth: expected the recording of this result, {recording}; it does not exist")
    return load_scene(recording, cloud=next(iter(sorted(out.glob("cloud-*mm.ply"))), None))


def _write_static(page: Output, result: Result, folder: Path | None, granularity: float | None) -> None:
    from torchjoint.viewer.shared_page import write_page
    from torchjoint.viewer.shown import Shown

    with page.written() as path:
        shown = write_page(path, result, Shown(folder).edits(result, granularity))
    say(page.path if shown == len(result.points) else f"{page.path}: {shown} of {len(result.points)} points")


def _page(note: str, host: str = "127.0.0.1", port: int = 8080, in_browser: bool = True) -> Page:
    """Opens a page, which says something before there is something to show."""
    from torchjoint.viewer.server import Page, is_loopback

    if not is_loopback(host):
        say(f"--host {host}: whoever has the address below in this network sees this result, and may change it")
    return Page(partial(_open_page, in_browser=in_browser), host=host, port=port, note=note)


def _text_encoder(name: str, result: Result) -> Callable[[str], Tensor]:
    if result.embeddings is None:
        raise ValueError("--text-encoder: expected a result with embeddings; result.embed(...).save(OUT) saves them")
    module, _, function = name.partition(":")
    try:
        found: Callable[[str], Tensor] = getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"--text-encoder: {name} cannot be imported: {error}") from error
    return found


def serve_until_interrupted(viewer: Viewer) -> None:
    """Serves a page until the program is interrupted."""
    with suppress(KeyboardInterrupt):  # Ctrl-C is the normal end
        viewer.server.sleep_forever()


def _open_page(url: str, in_browser: bool) -> None:
    say(f"{url}\nCtrl-C ends it", flush=True)
    if in_browser:
        webbrowser.open(_redirect(url).as_uri())


def _redirect(url: str) -> Path:
    """Writes a page that leads to an address and that only this user can read, until the program ends.

    The list of processes, which everybody can read, shows what the browser was called with.
    """
    with tempfile.NamedTemporaryFile("w", prefix="torchjoint-", suffix=".html", delete=False, encoding="utf-8") as file:
        file.write(f'<meta charset="utf-8"><meta http-equiv="refresh" content="0; url={escape(url)}">\n')
    atexit.register(Path(file.name).unlink, missing_ok=True)
    return Path(file.name)
