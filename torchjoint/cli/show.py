"""torchjoint show: makes a web page of a result's cloud."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import tyro

from torchjoint.results.folder import read_points
from torchjoint.results.hierarchy_files import read_hierarchy
from torchjoint.scene.hierarchy import check_granularity


def show(out: tyro.conf.Positional[Path], open_browser: bool = True, granularity: float | None = None) -> None:
    """Makes a web page of a result's cloud (viewer.html) and opens it in the browser.

    Args:
        out: folder that `torchjoint segment` wrote.
        open_browser: open the page; otherwise only write it.
        granularity: show another level than OUT holds, 0 (coarse) to 1 (fine); needs a result of method learned.
    """
    from torchjoint.results.page import write_viewer

    result = read_points(out)
    labels = result.labels
    if granularity is not None:
        check_granularity(granularity, "--granularity")
        labels = read_hierarchy(out, len(labels)).at(granularity)
    page = out / "viewer.html"
    write_viewer(page, result.points, labels, result.colors)
    print(f"{page}\n{out / 'overview.png'}")
    if open_browser:
        webbrowser.open(page.resolve().as_uri())
