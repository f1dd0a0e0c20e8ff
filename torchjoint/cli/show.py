"""torchjoint show: makes a web page of a result's cloud."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import tyro

from torchjoint.results.folder import read_points


def show(out: tyro.conf.Positional[Path], open_browser: bool = True) -> None:
    """Makes a web page of a result's cloud (viewer.html) and opens it in the browser.

    Args:
        out: folder that `torchjoint segment` wrote.
        open_browser: open the page; otherwise only write it.
    """
    from torchjoint.results.page import write_viewer

    result = read_points(out)
    page = out / "viewer.html"
    write_viewer(page, result.points, result.labels, result.colors)
    print(f"{page}\n{out / 'overview.png'}")
    if open_browser:
        webbrowser.open(page.resolve().as_uri())
