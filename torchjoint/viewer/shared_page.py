"""Writes a result as one HTML file to share: the cloud, its levels, and a row of its images (output after step 8)."""

import io
import json
from base64 import b64encode
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from torchjoint.results.edits import Edits
from torchjoint.results.objects import level_axes
from torchjoint.results.parts import Parts
from torchjoint.results.render import Shading, label_colors
from torchjoint.results.result import Result
from torchjoint.results.upright import fitted, up_direction
from torchjoint.runtime.files import write_text
from torchjoint.runtime.messages import counted, printable
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene
from torchjoint.scene.scene import evenly_spaced_indices
from torchjoint.viewer.cloud import block_radii, blocks_of

#: Largest number of points and of images in the page, and height of an image in pixels.
MOST_POINTS, MOST_IMAGES, HEIGHT = 100_000, 8, 150
#: Granularities that the page offers beside the shown level.
LEVELS = [step / 10 for step in range(11)]


def own_file(name: str) -> str:
    """The text of a style, a script or a shader that stands beside this file."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


@on_cpu()
def write_page(path: Path, result: Result, edits: Edits | None = None) -> int:
    """Writes a page that works in any browser, without a network; an earlier file is replaced atomically.

    Args:
        path: file to write.
        result: the labels, and the scene; its truth, if it has one, can be shown in place of the labels.
        edits: corrections of the result, and the level that is shown first.

    Returns:
        the number of points that it shows: all, or an even selection of them; the page shows this number.
    """
    scene, parts = result.scene, Parts(result)
    upward = up_direction(scene).numpy()
    upright = np.concatenate([level_axes(upward), upward[None]])  # turns `upward` to +z, which the page keeps upright
    keep = torch.arange(0, len(scene.points), max(1, -(-len(scene.points) // MOST_POINTS)))
    levels, first = _levels(parts, edits or Edits(parts.count))
    points = f"{len(keep)} of {len(scene.points)} points" if len(keep) < len(scene.points) else f"{len(keep)} points"
    own = _own_colors(scene, keep)
    data = _drawn(scene.points[keep].double().numpy() @ upright.T, thinned=len(keep) < len(scene.points)) | {
        "views": [(fitted(scene, upward, 0.8, aspect).axes @ upright.T).tolist() for aspect in (1.5, 0.5)],
        "eyeDome": own_file("eye_dome.glsl"),
        "pieces": _packed(parts.of_point[keep.numpy()].astype(np.uint32)),
        "light": _packed(_bytes(Shading(scene.points[keep], upward).light)),
        "palette": _packed(_bytes(label_colors(torch.arange(int(parts.keys.max()) + 1)).numpy())),
        "own": {name: _packed(rgb) for name, rgb in own.items()},
        "levels": levels,
    }
    strip = "".join(_picture(parts, i) for i in evenly_spaced_indices(len(result.images), MOST_IMAGES))
    modes = "".join(f"<option>{name}</option>" for name in ("segments", *own))
    name, count = escape(printable(f"{scene.name}: " if scene.name else "")), counted(levels[first]["count"], "segment")
    text = json.dumps(data).replace("<", "\\u003c")  # no name ends the script
    write_text(
        path,
        f'<!DOCTYPE html><html><head><meta charset="utf-8"><title>{name}{count}, {points}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{own_file("shared_page.css")}</style></head>'
        f'<body><header><span>{name}<span id="count">{count}</span>, {points}</span>'
        f'<label>Colour by <select id="mode">{modes}</select></label><button id="reset">Reset view</button>'
        f'<label{" hidden" if len(levels) == 1 else ""}>coarse <input id="level" type="range" min="0" '
        f'max="{len(levels) - 1}" value="{first}" autocomplete="off"> fine</label><b id="told"></b>'
        f'<button id="clear" hidden>Clear selection</button></header>'
        f'<canvas id="cloud"></canvas><div id="tip" hidden></div><footer>{strip}</footer>'
        f'<script id="data" type="application/json">{text}</script>'
        f"<script>{own_file('shared_cloud.js')}{own_file('shared_page.js')}</script></body></html>\n",
    )
    return len(keep)


def _levels(parts: Parts, edits: Edits) -> tuple[list[dict[str, Any]], int]:
    """The levels from coarse to fine (ids and hues of superpoints, number and names), and the shown one."""
    found = {(shown := parts.table(edits)).tobytes(): (shown, edits)}
    for granularity in LEVELS if parts.result.hierarchy is not None else ():
        other = replace(edits, granularity=granularity)
        found.setdefault((table := parts.table(other)).tobytes(), (table, other))
    ordered = sorted(found.values(), key=lambda one: len(np.unique(one[0])))
    levels = []
    for table, of_level in ordered:
        own = parts.ids(of_level)
        names = {int(own[segment]): name for segment, name in parts.names(of_level).items()}
        hues = _packed(parts.keys[table].astype(np.uint32))  # the same at all levels
        ids, count = _packed(own.astype(np.uint32)), len(np.unique(table))
        levels.append({"ids": ids, "hues": hues, "count": count, "names": names})
    return levels, next(i for i, one in enumerate(ordered) if one[0] is shown)


def _drawn(points: npt.NDArray[np.float64], thinned: bool) -> dict[str, Any]:
    """Points as shares of the cloud's size, in any unit, and the radii with which they cover their surface."""
    shown = points - points.mean(0)
    shown /= max(float(np.abs(shown).max()), 1e-9)
    blocks, radii = blocks_of(shown, max(len(shown) // 16, 1000)), np.zeros(len(shown))
    for block, radius in zip(blocks, block_radii(shown, blocks), strict=True):
        radii[block] = radius
    largest = float(radii.max())
    places = _packed((shown * 32767).round().astype(np.int16))
    shares = _packed((radii / largest * 65535).astype(np.uint32))
    # The distances of a selection are as those of points spread at random: larger, against gaps.
    return {"points": places, "radii": shares, "largest": largest * (1.3 if thinned else 1.0)}


def _own_colors(scene: Scene, keep: Tensor) -> dict[str, npt.NDArray[np.uint8]]:
    """The colours of the points that are not those of segments, by name."""
    own = {}
    if scene.colors is not None:
        own["colours"] = _bytes(scene.colors[keep].numpy())
    if scene.truth is not None and scene.truth.points is not None:
        own["truth"] = _bytes(label_colors(scene.truth.points[keep]).numpy())
    return own


def _bytes(values: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    return (values * 255).round().astype(np.uint8)


def _packed(values: npt.NDArray[Any]) -> tuple[str, str]:
    """The name of the array's kind in JavaScript, and its bytes in base64; whole numbers take as few as they need."""
    if values.dtype == np.uint32 and values.max(initial=0) < 1 << 16:
        values = values.astype(np.uint16)
    content = values.astype(values.dtype.newbyteorder("<")).tobytes()
    return f"{values.dtype.name.capitalize()}Array", b64encode(content).decode()


def _picture(parts: Parts, index: int) -> str:
    """A small photo, and its superpoints as an image: their number + 1 in red, green and blue, lowest first."""
    result, superpoints = parts.result, parts.image(index)
    photo = Image.new("RGB", superpoints.shape[::-1], (128, 128, 128))
    if len(result.scene.frames):
        photo = Image.fromarray(_bytes(result.scene.frames[index].image.permute(1, 2, 0).numpy()))
    photo.thumbnail((4 * HEIGHT, HEIGHT))
    (height, width), (columns, rows) = superpoints.shape, map(np.arange, photo.size)
    small = superpoints[rows[:, None] * height // len(rows), columns * width // len(columns)] + 1
    code = Image.fromarray(np.stack([small >> shift & 255 for shift in (0, 8, 16)], axis=2).astype(np.uint8))
    name = escape(printable(result.names[index]))
    sources = "".join(f'<img src="data:image/{kind};base64,{data}">' for kind, data in (
        ("jpeg", encoded_image(photo, "jpeg", quality=80)), ("png", encoded_image(code, "png", optimize=True)),
    ))  # fmt: skip
    return f'<canvas class="picture" title="{name}">{sources}</canvas>'


def encoded_image(image: Image.Image, kind: str, **options: Any) -> str:
    """The bytes of an image as text, for an address in a page."""
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return b64encode(stream.getvalue()).decode()
