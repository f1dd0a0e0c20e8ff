"""How structured light, stereo and time of flight measure the depth of a view, and what they get wrong."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.render import View
from torchjoint_lab.synthetic.furnished.sensor import blobs, rippled
from torchjoint_lab.synthetic.settings import DomainSettings

#: Nearest and farthest depth that is returned, metres.
_RANGE = (0.12, 6.0)
#: Metres between projector and camera, or between two cameras.
_BASELINE = 0.06


def measure(rng: Rng, view: View, image: Array, focal: float, settings: DomainSettings) -> tuple[Array, Array]:
    """Depth [H, W] float32 metres (0 = none) and the instance [H, W] that each depth was measured on.

    Args:
        rng: draws noise and holes.
        view: what there is to be seen.
        image: [H, W, 3] of it, in [0, 1]: stereo finds nothing where it has no texture.
        focal: pixels.
        settings: the sensor and its noise.
    """
    depth, labels = view.depth.astype(np.float64), view.labels
    gone = _missing(rng, view, focal, settings.holes)
    if settings.sensor == "time of flight":
        depth, labels = _flying(rng, depth, labels)
    if settings.sensor == "stereo":
        depth, labels = _fattened(depth, labels, 1)
        gone |= _untextured(rng, image, settings.holes)
    if settings.depth_ripple > 0:
        depth = rippled(rng, depth.astype(np.float32), settings.depth_ripple).astype(np.float64)
    depth = _noisy(rng, depth, settings)
    depth[gone] = 0
    shift = settings.registration
    depth, labels = _shifted(_shifted(depth, shift[0], 0), shift[1], 1), np.roll(labels, shift, (0, 1))
    return depth.astype(np.float32), np.where(depth > 0, labels, -1)


def _noisy(rng: Rng, depth: Array, settings: DomainSettings) -> Array:
    seen = depth > 0
    linear = settings.sensor == "time of flight"
    shared, own = {"stereo": (0.95, 0.31), "time of flight": (0.3, 0.95)}.get(settings.sensor, (0.7, 0.714))
    noise = shared * blobs(rng, depth.shape, 2) + own * rng.standard_normal(depth.shape)
    result = np.zeros_like(depth)
    if linear:
        z = depth[seen] + settings.depth_noise * noise[seen] * np.maximum(depth[seen], 0.3)
        result[seen] = np.maximum(np.round(z / settings.depth_step) * settings.depth_step, 1e-3)
    else:
        inverse = 1 / depth[seen] + settings.depth_noise * noise[seen]
        step = settings.depth_step
        result[seen] = 1 / np.maximum(np.round(inverse / step) * step, step)
    return result


def _missing(rng: Rng, view: View, focal: float, holes: float) -> Array:
    """Holes: at grazing angles, on absorbing materials, in the shadow beside nearer surfaces, and out of range."""
    depth = view.depth
    patchy = 1 / (1 + np.exp(-1.7 * blobs(rng, depth.shape, max(depth.shape[0] / 120, 1))))
    grazing = np.clip((0.2 - view.facing) / 0.16, 0, 1)
    gone = patchy < holes * (1 - (1 - grazing) * (1 - view.absorbs))
    disparity = focal * _BASELINE / np.where(depth > 0, depth, np.inf)
    reach = np.arange(depth.shape[1]) + disparity
    hidden = np.maximum.accumulate(reach, axis=1) > reach + 0.75
    gone |= hidden & (rng.random(depth.shape) < holes)
    return np.asarray(gone | (depth < _RANGE[0]) | (depth > _RANGE[1]))


def _flying(rng: Rng, depth: Array, labels: Array) -> tuple[Array, Array]:
    """At edges a pixel gets light from both sides: its depth is in between."""
    height, width = depth.shape
    down, right = rng.integers(-1, 2, (2, height, width))
    row = np.clip(np.arange(height)[:, None] + down, 0, height - 1)
    column = np.clip(np.arange(width)[None] + right, 0, width - 1)
    other = depth[row, column]
    edge = (other > 0) & (depth > 0) & (np.abs(other - depth) > 0.03 * depth)
    share = rng.random(depth.shape) ** 2
    return np.where(edge, (1 - share) * depth + share * other, depth), np.where(
        edge & (share > 0.5), labels[row, column], labels
    )


def _fattened(depth: Array, labels: Array, reach: int) -> tuple[Array, Array]:
    """Block matching enlarges surfaces in front by ``reach`` pixels, in patches."""
    best, source = np.where(depth > 0, depth, np.inf), labels
    for axis in (0, 1):
        for step in (-reach, reach):
            moved = _shifted(best, step, axis, np.inf)
            nearer = moved < best * 0.97
            best, source = np.where(nearer, moved, best), np.where(nearer, np.roll(source, step, axis), source)
    return np.where(np.isfinite(best), best, 0.0), source


def _shifted(values: Array, step: int, axis: int, edge: float = 0.0) -> Array:
    """[H, W] moved by ``step`` pixels; ``edge`` comes in."""
    moved = np.roll(values, step, axis)
    if step:
        fresh = [slice(None), slice(None)]
        fresh[axis] = slice(0, step) if step > 0 else slice(step, None)
        moved[tuple(fresh)] = edge
    return moved


def _untextured(rng: Rng, image: Array, holes: float) -> Array:
    """Where a window of the image has next to no contrast, matching fails in patches."""
    import cv2

    grey = image.mean(axis=2, dtype=np.float32)
    mean = cv2.blur(grey, (9, 9))
    spread = np.sqrt(np.maximum(cv2.blur(grey * grey, (9, 9)) - mean * mean, 0))
    patchy = 1 / (1 + np.exp(-1.7 * blobs(rng, grey.shape, 6)))
    return np.asarray((spread < 0.02) & (patchy < 0.6 * holes))
