"""Materials: small textures that repeat over a surface, and their response to light and the depth sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Color, Rng

WOODS: tuple[Color, ...] = (
    (0.72, 0.53, 0.33),
    (0.55, 0.36, 0.2),
    (0.36, 0.22, 0.13),
    (0.82, 0.68, 0.48),
    (0.47, 0.3, 0.2),
)
WALLS: tuple[Color, ...] = (
    (0.88, 0.87, 0.83),
    (0.8, 0.83, 0.85),
    (0.85, 0.8, 0.7),
    (0.72, 0.8, 0.75),
    (0.78, 0.75, 0.76),
)
VIVID: tuple[Color, ...] = (
    (0.7, 0.1, 0.12),
    (0.15, 0.3, 0.6),
    (0.12, 0.45, 0.3),
    (0.85, 0.65, 0.15),
    (0.4, 0.2, 0.5),
    (0.85, 0.4, 0.15),
    (0.15, 0.55, 0.6),
)
SOBER: tuple[Color, ...] = (
    (0.93, 0.93, 0.91),
    (0.75, 0.75, 0.75),
    (0.5, 0.5, 0.52),
    (0.25, 0.26, 0.28),
    (0.12, 0.12, 0.13),
    (0.8, 0.74, 0.62),
)


@dataclass(frozen=True, eq=False)
class Material:
    """The appearance of a surface."""

    tile: Array  #: [h, w, 3] uint8 sRGB, row 0 at v = 0; repeats
    size: tuple[float, float]  #: (width, height) of the tile on the surface, metres
    gloss: float = 0.0  #: strength of the specular highlight, 0 (chalk) to 1
    absorbs: float = 0.0  #: share of the surface that returns no depth (dark or mirror-like to the sensor), 0 to 1


def pick(rng: Rng, colors: tuple[Color, ...]) -> Array:
    """Returns a random colour of ``colors``, slightly varied: [3], sRGB."""
    color = np.asarray(colors[rng.integers(len(colors))])
    color = color + rng.uniform(0.0, 0.25) * (color.mean() - color)  # few objects are as vivid as their paint
    return np.clip(color * rng.uniform(0.85, 1.1) + rng.normal(0, 0.015, 3), 0.03, 0.97)


def plain(rng: Rng, color: Array, gloss: float = 0.1, absorbs: float = 0.0) -> Material:
    """Paint or plastic: one colour with very weak mottling."""
    mottle = 1 + 0.006 * _noise(rng, (64, 64), 2, 2)
    return Material(_bytes(color * mottle[..., None]), (0.4, 0.4), gloss, absorbs)


def wood(rng: Rng, color: Array, upright: bool = False, planks: int = 0) -> Material:
    """Wood grain along u (along v if ``upright``), with joints between ``planks`` across the grain, if any."""
    grain = 0.05 * _noise(rng, (256, 192), 1.0, 22) + 0.04 * _noise(rng, (256, 192), 7, 60)
    if planks:
        width = 256 // planks
        grain += np.repeat(rng.normal(0, 0.06, planks), width)[:256, None]
        grain[::width] -= 0.3
    tone = color * (1 + grain[..., None] * [0.9, 1.0, 1.15])
    tile = _bytes(tone.swapaxes(0, 1) if upright else tone)
    size = (0.5, 0.6) if upright else (0.6, 0.5)
    return Material(tile, size, gloss=rng.uniform(0.05, 0.35))


def stripes(rng: Rng, first: Array, second: Array, pitch: float, upright: bool = False) -> Material:
    """Stripes of two colours, ``pitch`` metres per pair, along lines of constant v (of constant u if ``upright``)."""
    share = rng.uniform(0.35, 0.65)
    tile = np.where(np.arange(64)[:, None, None] < 64 * share, first, second) * np.ones((64, 64, 1))
    tile = tile * (1 + 0.02 * _noise(rng, (64, 64), 1, 1))[..., None]
    return Material(_bytes(tile.swapaxes(0, 1) if upright else tile), (pitch, pitch), 0.05)


def checker(rng: Rng, first: Array, second: Array, pitch: float) -> Material:
    """A checkerboard; a square is half a ``pitch`` (metres) wide."""
    odd = (np.arange(64)[:, None] < 32) ^ (np.arange(64)[None] < 32)
    tile = np.where(odd[..., None], first, second) * (1 + 0.02 * _noise(rng, (64, 64), 1, 1))[..., None]
    return Material(_bytes(tile), (pitch, pitch), 0.1)


def tiles(rng: Rng, color: Array, pitch: float) -> Material:
    """4 x 4 ceramic tiles of ``pitch`` metres with joints; each tile has a slightly different tone."""
    tone = np.kron(1 + rng.normal(0, 0.04, (4, 4)), np.ones((48, 48)))[..., None] * color
    joint = (np.arange(192) % 48 < 3)[:, None] | (np.arange(192) % 48 < 3)[None]
    return Material(_bytes(np.where(joint[..., None], np.array([0.7, 0.69, 0.66]), tone)), (4 * pitch, 4 * pitch), 0.4)


def speckle(rng: Rng, color: Array, contrast: float = 0.2, gloss: float = 0.5, absorbs: float = 0.0) -> Material:
    """Granite, terrazzo or coarse fabric: isotropic noise at two scales."""
    noise = 0.6 * _noise(rng, (192, 192), 0.8, 0.8) + 0.5 * _noise(rng, (192, 192), 5, 5)
    return Material(_bytes(color * (1 + contrast * noise)[..., None]), (0.4, 0.4), gloss, absorbs)


def carpet(rng: Rng, color: Array) -> Material:
    """Office carpet: thin broken streaks of dark and light yarn."""
    streaks = 0.15 * _noise(rng, (256, 256), 1.2, 18) + 0.08 * _noise(rng, (256, 256), 0.5, 0.5)
    bands = np.repeat(rng.normal(0, 0.1, 32), 8)[:, None]
    return Material(_bytes(color * (1 + streaks + bands)[..., None]), (0.8, 0.8))


def printed(rng: Rng, size: tuple[float, float], ground: Array | None = None, pictures: float = 0.6) -> Material:
    """A page, cover, poster or label: title, text-like lines, picture blocks.

    Args:
        rng: source of all random choices.
        size: (width, height), metres.
        ground: [3] colour of the paper; None: white or vivid.
        pictures: probability of a picture block.
    """
    long = max(size)
    w, h = (max(round(176 * side / long), 8) for side in size)
    paper = ground if ground is not None else pick(rng, SOBER[:1] if rng.random() < 0.55 else VIVID)
    ink = np.array([0.08, 0.08, 0.1]) if paper.mean() > 0.45 else np.array([0.93, 0.92, 0.88])
    page = np.ones((h, w, 3)) * paper
    left, right = int(0.08 * w), int(0.92 * w)
    top = int(rng.uniform(0.1, 0.25) * h)
    if rng.random() < 0.7:  # a title band
        page[int(0.04 * h) : top, left if rng.random() < 0.5 else 0 : right] = pick(rng, VIVID)
    _letters(rng, page[int(0.06 * h) : max(top - 2, 1), left:right], ink, line=max(h // 14, 3), letter=max(w // 24, 2))
    middle = int(rng.uniform(0.35, 0.7) * h)
    if rng.random() < pictures:
        blob = _noise(rng, (h, w), h / 12, w / 12)[..., None]
        a, b = pick(rng, VIVID), pick(rng, VIVID + SOBER)
        page[top + 3 : middle, left:right] = np.where(blob > 0, a, b * (1 + 0.1 * blob))[top + 3 : middle, left:right]
    else:
        middle = top
    _letters(rng, page[middle + 4 : int(0.94 * h), left:right], ink, line=4, letter=1)
    return Material(_bytes(page[::-1]), size, gloss=rng.choice([0.0, 0.15, 0.4]))


def labelled(rng: Rng, color: Array, size: tuple[float, float]) -> Material:
    """Cardboard or plastic of one ``color`` with a white label on each area of ``size`` (width, height) metres."""
    tile = np.ones((96, 96, 3)) * color * (1 + 0.02 * _noise(rng, (96, 96), 3, 3))[..., None]
    x, y = rng.integers(8, 40, 2)
    w, h = rng.integers(25, 48, 2)
    tile[y : y + h, x : x + w] = [0.92, 0.91, 0.88]
    _letters(rng, tile[y + 3 : y + h - 3, x + 3 : x + w - 3], np.array([0.1, 0.1, 0.12]), line=5, letter=2)
    if rng.random() < 0.4:
        tile[46:50] = color * 0.7 + 0.2  # adhesive tape
    return Material(_bytes(tile), size, 0.05)


def _letters(rng: Rng, area: Array, ink: Array, line: int, letter: int) -> None:
    """Writes rows of word-like runs, ``line`` texels apart, into ``area`` in place."""
    h, w = area.shape[:2]
    if h < line or w < 4:
        return
    rows, columns = -(-h // line), -(-w // letter)
    written = rng.random((rows, columns)) > 0.28
    written &= np.arange(columns)[None] < columns * rng.uniform(0.6, 1.0, rows)[:, None]
    mask = np.repeat(np.repeat(written, line, 0), letter, 1)[:h, :w]
    mask &= (np.arange(h) % line < max(line * 0.55, 1))[:, None]
    area[mask] = 0.2 * area[mask] + 0.8 * ink


def _noise(rng: Rng, shape: tuple[int, int], sigma_v: float, sigma_u: float) -> Array:
    """Periodic Gaussian noise of unit variance, smoothed by the two sigmas (texels)."""
    frequency_v = np.fft.fftfreq(shape[0])[:, None]
    frequency_u = np.fft.rfftfreq(shape[1])[None]
    low_pass = np.exp(-2 * np.pi**2 * ((sigma_v * frequency_v) ** 2 + (sigma_u * frequency_u) ** 2))
    low_pass[0, 0] = 0
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * low_pass, s=shape)
    return np.asarray(noise / (noise.std() + 1e-9))


def _bytes(color: Array) -> Array:
    return np.asarray(np.clip(color * 255 + 0.5, 0, 255).astype(np.uint8))
