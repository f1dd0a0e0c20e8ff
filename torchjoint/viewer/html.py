"""Elements of the viewer's panel that viser lacks: a photo and a table that can be clicked; page.js sends clicks."""

from collections.abc import Sequence
from html import escape

import torch
from PIL import Image

from torchjoint.results.render import label_colors
from torchjoint.runtime.messages import counted, printable
from torchjoint.viewer.measures import Row
from torchjoint.viewer.model import Bytes
from torchjoint.viewer.shared_page import encoded_image, own_file

PREFIX = "torchjoint:"
NOTHING = "Click or tap a segment; with shift: several."
LEGEND = '<div class="tj tj-legend">0 %<span class="tj-scale"></span>100 % sure to be one whole thing</div>'
COLUMNS = ("id", "name", "points", "size", "frames", "sure")


def page_html(name: str) -> str:
    """The style and the script of the page; `name`: of the scene, for the tab's title."""
    style, *scripts = map(own_file, ("page.css", "page.js", "depth_shading.js"))
    data = f'data-name="{escape(printable(name))}" data-script="{escape("".join(scripts))}"'
    data += f' data-eye-dome="{escape(own_file("eye_dome.glsl"))}"'
    return f'<style id="tj-page" {data} onload="(0,eval)(dataset.script)">{style}</style>'


def image_html(image: Bytes, caption: str) -> str:
    """An image that sends `image COLUMN ROW SHIFT` where it is clicked, in pixels of the image."""
    caption, data = escape(printable(caption)), encoded_image(Image.fromarray(image), "jpeg", quality=88)
    return (
        f'<div class="tj">{caption}</div>'  # a tooltip would cover what is aimed at
        f'<img id="tj-image" alt="{caption}" src="data:image/jpeg;base64,{data}">'
    )


def table_html(rows: Sequence[Row], count: int, order: str, selected: Sequence[int]) -> str:
    """The table of segments; a click on a row sends `row HUE SHIFT`, on a column's head `sort COLUMN`."""
    hidden = {name for name in ("frames", "sure") if all(getattr(row, name) is None for row in rows)}
    columns = [column for column in COLUMNS if column not in hidden]
    heads = "".join(f'<th data-sort="{name}">{name}{" ▾" if name == order else ""}</th>' for name in columns)
    colors = (label_colors(torch.tensor([row.hue for row in rows], dtype=torch.int64)) * 255).int().tolist()
    lines = []
    for row, color in zip(rows, colors, strict=True):
        lit = ' class="tj-lit"' if row.key in selected else ""
        chip = f'<span class="tj-chip" style="--hue:rgb({",".join(map(str, color))});--sure:{row.sure}"></span>'
        told = {"id": f"{chip}{row.key}", "name": escape(row.name), "points": row.points, "size": _size(row)}
        told |= {"frames": row.frames, "sure": _percent(row.sure)}
        lines.append(f'<tr data-hue="{row.hue}"{lit}>{"".join(f"<td>{told[name]}</td>" for name in columns)}</tr>')
    note = counted(count, "segment")
    note = f"{len(rows)} of {note}; search finds the others" if len(rows) < count else note
    return (
        f'<div class="tj">{note}; sizes in units of the cloud</div>'
        '<div class="tj-list">'
        f'<table id="tj-table"><thead><tr>{heads}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'
    )


def _size(row: Row) -> str:
    return " × ".join(f"{value:.2f}" for value in row.size)


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.0f}\N{NO-BREAK SPACE}%"


def note_html(note: str) -> str:
    """A line about a run that is not finished."""
    return f'<div id="tj-note" class="tj">{escape(note)}</div>'


def found_html(found: Sequence[tuple[Row, float]]) -> str:
    """The things that words found, and how well they fit, best first; a click on a line sends `row HUE SHIFT`."""
    lines = (
        f'<div data-found="{row.key}" data-hue="{row.hue}">'
        f"{cosine:.2f} segment <b>{row.key}</b> {escape(row.name)}</div>"
        for row, cosine in found
    )
    return f'<div id="tj-found" class="tj">{"".join(lines)}</div>'


def panel_html(rows: Sequence[Row], frames: Sequence[tuple[str, int]]) -> str:
    """Describes the selected segments; `frames`: name and number of pixels of each frame that sees the first one."""
    if not rows:
        return f'<div id="tj-panel" class="tj">{NOTHING}</div>'
    parts = []
    for row in rows:
        name = f" <b>{escape(row.name)}</b>" if row.name else ""
        seen = "" if row.frames is None or len(rows) == 1 else f", seen in {counted(row.frames, 'frame')}"
        sure = "" if row.sure is None else f", one whole thing: {_percent(row.sure)}"
        parts.append(f"<div>segment <b>{row.key}</b>{name}: {row.points} points, {_size(row)}{seen}{sure}</div>")
    if len(rows) == 1 and frames:
        listed = ", ".join(f"{escape(printable(name))} ({pixels} px)" for name, pixels in frames)
        parts.append(
            f"<details{' open' if len(frames) < 3 else ''}><summary>seen in {counted(len(frames), 'frame')}</summary>"
            f'<div style="max-height:120px;overflow-y:auto">{listed}</div></details>'
        )
    return f'<div id="tj-panel" class="tj">{"".join(parts)}</div>'
