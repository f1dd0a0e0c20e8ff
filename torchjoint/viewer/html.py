"""Elements of the viewer's panel that viser lacks: an image and a table that can be clicked.

A click writes a line, such as ``torchjoint:image 12 80 0``, into a hidden text field. Viser sends the text to the
server.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape

from PIL import Image

from torchjoint.runtime.messages import printable
from torchjoint.viewer.measures import Row
from torchjoint.viewer.model import Bytes

PREFIX = "torchjoint:"
#: JavaScript that finds the text field in any layout and writes into it with the events of a typing user.
_SEND = (
    "const i=[...document.querySelectorAll('input')].find(e=>e.value.startsWith('" + PREFIX + "'));"
    "Object.getOwnPropertyDescriptor(HTMLInputElement.prototype,'value').set.call("
    "i,'" + PREFIX + "'+line+' '+Date.now());"
    "i.dispatchEvent(new Event('input',{bubbles:true}));"
)
#: It hides the text field and the ends of sliders, over which their handles lie, and moves tooltips beside the panel.
STYLE = (
    f"<style>.mantine-Flex-root:has(input[value^='{PREFIX}']),.mantine-Slider-markWrapper,.mantine-Tooltip-arrow"
    "{display:none}.mantine-Tooltip-tooltip{translate:-22rem 2rem}"
    ".mantine-Notification-description{white-space:normal;overflow-wrap:anywhere}</style>"
)
#: Style of text, with the margin of viser's own elements.
_TEXT = "font-size:12px;padding:0 8px"
NOTHING = "Click a segment in the cloud or in the image; hold shift to select several."
COLUMNS = ("id", "name", "points", "size", "frames")


def image_html(image: Bytes, caption: str) -> str:
    """An image that sends `image COLUMN ROW SHIFT` where it is clicked, in pixels of the image."""
    stream, caption = io.BytesIO(), escape(printable(caption))
    Image.fromarray(image).save(stream, "jpeg", quality=88)
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    position = (
        "const r=this.getBoundingClientRect();"
        f"const line='image '+Math.floor((event.clientX-r.left)/r.width*{image.shape[1]})+' '"
        f"+Math.floor((event.clientY-r.top)/r.height*{image.shape[0]})+' '+(event.shiftKey?1:0);"
    )
    return (
        f'<div style="{_TEXT}">{caption}</div>'  # a tooltip would cover what is aimed at
        f'<img id="tj-image" alt="{caption}" src="data:image/jpeg;base64,{data}" '
        f'style="width:100%;cursor:crosshair;display:block;margin-bottom:8px" onclick="{position}{_SEND}">'
    )


def table_html(rows: Sequence[Row], count: int, order: str, selected: Sequence[int]) -> str:
    """The table of segments; a click on a row sends `row KEY SHIFT`, on a column's head `sort COLUMN`."""
    has_frames = any(row.frames is not None for row in rows)  # False without images, and before they were counted
    heads = "".join(
        f'<th style="text-align:left;cursor:pointer" onclick="const line=\'sort {column}\';{_SEND}">'
        f"{column}{' ▾' if column == order else ''}</th>"
        for column in COLUMNS[: None if has_frames else -1]
    )
    lines = []
    for row in rows:
        # Where it would be scrolled away, a selected row stays at the edge of the list.
        style = "background:#ffe08a;color:#000;position:sticky;top:0;bottom:0;" if row.key in selected else ""
        size = " × ".join(f"{value:.2f}" for value in row.size)
        cells = "".join(
            f"<td>{cell}</td>"
            for cell in (row.key, escape(row.name), row.points, size, *([row.frames] if has_frames else []))
        )
        send = f"const line='row {row.key} '+(event.shiftKey?1:0);{_SEND}"
        lines.append(f'<tr data-key="{row.key}" style="cursor:pointer;{style}" onclick="{send}">{cells}</tr>')
    note = f"{len(rows)} of {count} segments" if len(rows) < count else f"{count} segments"
    return (
        f'<div style="{_TEXT}">{note}; sizes in metres</div>'
        '<div style="max-height:200px;overflow-y:auto;padding:0 5px">'
        '<table id="tj-table" style="font-size:12px;width:100%">'
        f"<thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def note_html(note: str) -> str:
    """A line about a run that is not finished."""
    return f'<div id="tj-note" style="{_TEXT}">{escape(note)}</div>'


def found_html(found: Sequence[tuple[Row, float]]) -> str:
    """The things that words found, and how well they fit, best first; a click on a line sends `row KEY SHIFT`."""
    lines = []
    for row, cosine in found:
        send = f"const line='row {row.key} '+(event.shiftKey?1:0);{_SEND}"
        told = f"{cosine:.2f} segment <b>{row.key}</b> {escape(row.name)}"
        lines.append(f'<div data-found="{row.key}" style="cursor:pointer" onclick="{send}">{told}</div>')
    return f'<div id="tj-found" style="{_TEXT}">{"".join(lines)}</div>'


def panel_html(rows: Sequence[Row], frames: Sequence[tuple[str, int]]) -> str:
    """Describes the selected segments; `frames`: name and number of pixels of each frame that sees the first one."""
    if not rows:
        return f'<div id="tj-panel" style="{_TEXT}">{NOTHING}</div>'
    parts = []
    for row in rows:
        size = " × ".join(f"{value:.2f}" for value in row.size)
        name = f" <b>{escape(row.name)}</b>" if row.name else ""
        seen = "" if row.frames is None or len(rows) == 1 else f", seen in {row.frames} frames"
        parts.append(f"<div>segment <b>{row.key}</b>{name}: {row.points} points, {size} m{seen}</div>")
    if len(rows) == 1 and frames:
        listed = ", ".join(f"{escape(printable(name))} ({pixels} px)" for name, pixels in frames)
        parts.append(
            f"<details{' open' if len(frames) < 3 else ''}><summary>seen in {len(frames)} frames</summary>"
            f'<div style="max-height:120px;overflow-y:auto">{listed}</div></details>'
        )
    return f'<div id="tj-panel" style="{_TEXT}">{"".join(parts)}</div>'
