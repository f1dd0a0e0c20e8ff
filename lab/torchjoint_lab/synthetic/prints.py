"""Misleading surfaces: prints, patterns, photographs and structures within one object, as tiles that repeat."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.materials import Material

_SIDE = 128


def noise(rng: Rng, shape: tuple[int, int], scale: float) -> Array:
    """[H, W] periodic noise of unit variance, smooth over ``scale`` texels."""
    y, x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None]
    low_pass = np.exp(-2 * np.pi**2 * scale**2 * (y**2 + x**2))
    low_pass[0, 0] = 0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * low_pass, s=shape)
    return np.asarray(field / (field.std() + 1e-9))


def tile_of(color: Array, size: tuple[float, float], gloss: float = 0.1, absorbs: float = 0.0) -> Material:
    """The material of an [h, w, 3] picture in [0, 1] that covers ``size`` metres."""
    return Material(np.clip(color * 255 + 0.5, 0, 255).astype(np.uint8), size, gloss, absorbs)


def any_color(rng: Rng) -> Array:
    """[3] some colour: vivid, sober or of wood."""
    return paint.pick(rng, paint.VIVID + paint.SOBER + paint.SOBER + paint.WOODS)


def photo(rng: Rng, size: tuple[float, float]) -> Material:
    """Something like a photograph: a gradient, clouds of noise at all scales, a few round and square things."""
    h, w = _shape(size)
    top, bottom = any_color(rng), any_color(rng)
    share = np.linspace(0, 1, h)[:, None, None] + 0.25 * noise(rng, (h, w), w / 6)[..., None]
    page = bottom + np.clip(share, 0, 1) * (top - bottom)
    for _ in range(rng.integers(3, 10)):
        page = np.where(
            _figure(rng, h, w)[..., None], any_color(rng) * (1 + 0.2 * noise(rng, (h, w), 3)[..., None]), page
        )
    grain = sum(noise(rng, (h, w), scale) for scale in (1.0, 4.0, 12.0))
    return tile_of(page * (1 + 0.06 * np.asarray(grain)[..., None]), size, float(rng.choice([0.0, 0.3, 0.6])))


def package(rng: Rng, size: tuple[float, float]) -> Material:
    """A packet's print: bands of colour, a big logo, a picture, small print."""
    h, w = _shape(size)
    page = np.ones((h, w, 3)) * any_color(rng)
    for _ in range(rng.integers(1, 4)):
        low, high = np.sort(rng.uniform(-0.1, 1.1, 2))
        slope = rng.normal(0, 0.3)
        line = np.linspace(0, 1, h)[:, None] + slope * np.linspace(-0.5, 0.5, w)[None]
        page[(line > low) & (line < high)] = any_color(rng)
    for _ in range(rng.integers(1, 5)):
        page[_figure(rng, h, w)] = any_color(rng)
    for _ in range(rng.integers(1, 4)):
        _words(rng, page, int(rng.integers(3, max(h // 5, 4))))
    return tile_of(page * (1 + 0.01 * noise(rng, (h, w), 1)[..., None]), size, float(rng.choice([0.05, 0.3, 0.6])))


def text_page(rng: Rng, size: tuple[float, float]) -> Material:
    """A page of print: lines of words, a heading, a figure."""
    return paint.printed(rng, size, paint.pick(rng, paint.SOBER[:1]), pictures=0.35)


def motif(rng: Rng, pitch: float) -> Material:
    """A rug's or a cloth's pattern: a mirrored random motif that repeats every ``pitch`` metres."""
    half = _SIDE // 2
    colors = np.stack([any_color(rng) for _ in range(rng.integers(2, 5))])
    field = noise(rng, (half, half), rng.uniform(3, 12))
    field = field + field.T if rng.random() < 0.5 else field
    level = np.clip(((field - field.min()) / (np.ptp(field) + 1e-9) * len(colors)).astype(int), 0, len(colors) - 1)
    level = np.concatenate([level, level[:, ::-1]], axis=1)
    page = colors[np.concatenate([level, level[::-1]])]
    return tile_of(page * (1 + 0.05 * noise(rng, (_SIDE, _SIDE), 0.7)[..., None]), (pitch, pitch), 0.0)


def plaid(rng: Rng, pitch: float) -> Material:
    """A woven check of several stripes both ways."""
    page = np.ones((_SIDE, _SIDE, 3)) * any_color(rng)
    for axis in (0, 1):
        for _ in range(rng.integers(1, 4)):
            start, width = int(rng.integers(_SIDE)), int(rng.integers(4, _SIDE // 3))
            lines = np.arange(start, start + width) % _SIDE
            color = any_color(rng)
            if axis == 0:
                page[lines] = 0.45 * page[lines] + 0.55 * color
            else:
                page[:, lines] = 0.45 * page[:, lines] + 0.55 * color
    return tile_of(page * (1 + 0.04 * noise(rng, (_SIDE, _SIDE), 0.6)[..., None]), (pitch, pitch), 0.0)


def dots(rng: Rng, pitch: float) -> Material:
    """Dots on a ground, two for each ``pitch`` by ``pitch`` metres."""
    y, x = np.meshgrid(np.arange(_SIDE) / _SIDE, np.arange(_SIDE) / _SIDE, indexing="ij")
    radius = rng.uniform(0.1, 0.3)
    inside = ((x - 0.25) ** 2 + (y - 0.25) ** 2 < radius**2) | ((x - 0.75) ** 2 + (y - 0.75) ** 2 < radius**2)
    return tile_of(np.where(inside[..., None], any_color(rng), any_color(rng)), (pitch, pitch), 0.05)


def joints(rng: Rng, color: Array, pitch: tuple[float, float], strong: float, shift: bool = False) -> Material:
    """Tiles or bricks of ``pitch`` (width, height) metres with joints; ``shift`` sets off every second row."""
    rows, columns, side = 4, 4, 40
    tone = np.kron(1 + rng.normal(0, 0.07, (rows, columns)), np.ones((side, side)))
    tone = tone * (1 + 0.04 * noise(rng, tone.shape, 2) + 0.03 * noise(rng, tone.shape, 12))
    gap = max(int(rng.integers(1, 4)), 1)
    joint = np.arange(side * columns) % side < gap
    page = np.where((joint[None] | joint[:, None])[..., None], np.clip(color * strong, 0, 1), tone[..., None] * color)
    if shift:
        for row in range(1, rows, 2):
            page[row * side : (row + 1) * side] = np.roll(page[row * side : (row + 1) * side], side // 2, axis=1)
    return tile_of(page, (columns * pitch[0], rows * pitch[1]), float(rng.uniform(0, 0.5)))


def rough(rng: Rng, color: Array, size: float, contrast: float = 0.25) -> Material:
    """Asphalt, concrete, lawn, bark, felt: noise of many scales over ``size`` metres."""
    field = (
        0.5 * noise(rng, (_SIDE, _SIDE), 0.6) + 0.5 * noise(rng, (_SIDE, _SIDE), 3) + 0.6 * noise(rng, (_SIDE,) * 2, 14)
    )
    tint = rng.normal(0, 0.05, 3)
    return tile_of(color * (1 + contrast * field[..., None] * (1 + tint)), (size, size), 0.0)


def marble(rng: Rng, color: Array, size: float) -> Material:
    """Veins on a ground, as marble or laminate."""
    warp = noise(rng, (_SIDE, _SIDE), 10)
    vein = np.exp(-8 * np.abs(np.sin(warp * 1.7 + 0.5 * noise(rng, (_SIDE, _SIDE), 4))))
    return tile_of(color + vein[..., None] * (any_color(rng) - color) * 0.7, (size, size), 0.5)


def brushed(rng: Rng, color: Array) -> Material:
    """Metal with fine streaks: shining, poor for depth sensors."""
    streak = 0.05 * np.repeat(rng.standard_normal((_SIDE, 1)), _SIDE, axis=1) + 0.03 * noise(rng, (_SIDE, _SIDE), 2)
    return tile_of(color * (1 + streak[..., None]), (0.15, 0.15), rng.uniform(0.5, 1), rng.uniform(0, 0.5))


def worn(rng: Rng, color: Array) -> Material:
    """Paint with stains, scratches and lighter worn places."""
    stain = noise(rng, (_SIDE, _SIDE), 8)
    page = color * (1 + 0.05 * noise(rng, (_SIDE, _SIDE), 1)[..., None])
    page = np.where((stain > 1.2)[..., None], page * rng.uniform(0.5, 1.4), page)
    return tile_of(page, (rng.uniform(0.15, 0.6),) * 2, rng.uniform(0, 0.4))


def _shape(size: tuple[float, float]) -> tuple[int, int]:
    w, h = (max(round(_SIDE * side / max(size)), 12) for side in size)
    return h, w


def _figure(rng: Rng, h: int, w: int) -> Array:
    """[h, w] a random ellipse, turned box or blotch."""
    y, x = np.meshgrid(np.linspace(0, 1, h), np.linspace(0, 1, w), indexing="ij")
    cx, cy, a, b, turn = (*rng.uniform(0.05, 0.95, 2), *rng.uniform(0.05, 0.35, 2), rng.uniform(0, np.pi))
    u = ((x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)) / a
    v = ((y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)) / b
    return np.asarray((u**2 + v**2 < 1) if rng.random() < 0.6 else (np.maximum(abs(u), abs(v)) < 1))


def _words(rng: Rng, page: Array, line: int) -> None:
    """Writes a few lines of letter-like runs ``line`` texels high into ``page``, in place."""
    h, w = page.shape[:2]
    if h < 2 * line or w < 8:
        return
    ink = rng.choice([0.05, 0.95]) * np.ones(3)
    top, left = int(rng.integers(0, h - line)), int(rng.integers(0, max(w // 3, 1)))
    letter = max(line // 3, 1)
    for _ in range(rng.integers(1, 4)):
        run = np.repeat(rng.random(w // letter + 1) > 0.3, letter)[: w - left]
        area = page[top : top + max(int(0.7 * line), 1), left:]
        area[:, run[: area.shape[1]]] = ink
        top += line
