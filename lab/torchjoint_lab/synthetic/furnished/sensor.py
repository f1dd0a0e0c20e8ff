"""Simulates a cheap RGB-D camera: exposure, blur and image noise; noisy and quantised depth with holes."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.render import View

#: Nearest and farthest depth of a Kinect, metres.
DEPTH_RANGE = (0.4, 5.0)
#: Baseline between the depth sensor's projector and its camera, metres.
_BASELINE = 0.075
#: Quantisation step of inverse depth, in standard deviations of the noise.
_QUANTISATION = 1.8
#: Ripple: weight of each scale (the squares add up to 1), and image height divided by wavelength.
_RIPPLES = ((0.8, 5.0), (0.5, 30.0), (0.33, 100.0))
#: Quantisation step of inverse depth, in standard deviations of the ripple; a Kinect's eighth of a pixel is 0.0028.
_RIPPLE_STEP = 1.4


def photograph(rng: Rng, view: View, exposure: float, motion_blur: float, image_noise: float) -> Array:
    """Renders a view's light to an image [H, W, 3] float32 in [0, 1], in steps of 1/255.

    Args:
        rng: source of exposure, blur and noise.
        view: the image without noise.
        exposure: standard deviation of the logarithm of the exposure over the views; the white balance varies by a
            fifth of it. The automatic exposure, which every camera has, is not affected.
        motion_blur: typical length of the blur, pixels in an image 480 high (scaled for other heights).
        image_noise: standard deviation of the pixel values in [0, 1].
    """
    height, width = view.labels.shape
    length = motion_blur * height / 480 * abs(rng.standard_normal())
    light = _smear(view.light, length, rng.uniform(0, np.pi))
    brightness = float(np.mean(light, dtype=np.float64))
    gain = 0.42 / max(brightness, 1e-3) ** 0.8 * np.exp(exposure * rng.standard_normal())
    balance = np.exp(exposure / 5 * rng.standard_normal(3))
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    vignette = 1 - 0.12 * (x**2 + y**2)
    film = 1 - np.exp(-light * (gain * balance * vignette[..., None]).astype(np.float32))
    image = film ** np.float32(1 / 2.2)
    noise = rng.standard_normal((height + 1, width + 1, 3), dtype=np.float32)
    # Interpolation of a colour filter array correlates the noise of neighbours. Its variance is 0.36 + 4 * 0.16.
    noise = 0.6 * noise[1:, 1:] + 0.4 * (noise[:-1, 1:] + noise[1:, :-1] + noise[:-1, :-1])
    image = image + np.float32(image_noise / np.sqrt(0.84)) * noise
    return np.asarray(np.round(np.clip(image, 0, 1) * 255).astype(np.float32) / np.float32(255))


def rippled(rng: Rng, depth: Array, depth_ripple: float) -> Array:
    """Adds a spatially correlated error, like a structured-light sensor's, to depth: fused walls ripple and double.

    Smooth noise at three scales (a fifth, a thirtieth and a hundredth of the image) is added to the inverse depth. The
    sum is quantised before any noise of single pixels: whole patches are rounded in the same direction.

    Args:
        rng: source of the noise.
        depth: [H, W] metres; 0 = none, stays 0.
        depth_ripple: standard deviation at 1 m, metres; grows with the square of the depth.
    """
    height = depth.shape[0]
    waves = np.zeros(depth.shape)
    for share, scale in _RIPPLES:
        waves += share * _waves(rng, depth.shape, height / scale)
    seen = depth > 0
    step = _RIPPLE_STEP * depth_ripple
    inverse = 1 / depth[seen].astype(np.float64) + depth_ripple * waves[seen]
    result = depth.copy()
    result[seen] = 1 / np.maximum(np.round(inverse / step) * step, step)
    return result


def measure_depth(rng: Rng, view: View, focal: float, depth_noise: float, depth_holes: float) -> Array:
    """Simulates the [H, W] float32 depth image of a structured-light sensor, metres, 0 = no return.

    Args:
        rng: source of noise and holes.
        view: the image without noise.
        focal: focal length, pixels.
        depth_noise: standard deviation at 1 m, metres; grows with the square of the depth. Half of the variance is
            correlated between neighbours. Values are quantised in inverse depth.
        depth_holes: scale of the probability of every kind of hole (grazing angles, dark and shiny materials, the
            projector's shadow at depth edges, out of range), 0 to 1.
    """
    depth = view.depth.astype(np.float64)
    shape = depth.shape
    noise = 0.7 * blobs(rng, shape, 2) + 0.714 * rng.standard_normal(shape)
    gone = rng.random(shape)
    patchy = 1 / (1 + np.exp(-1.7 * blobs(rng, shape, max(shape[0] / 120, 1))))  # uniform in [0, 1], in patches
    measured = depth.copy()
    seen = depth > 0
    if depth_noise > 0:
        inverse = 1 / depth[seen] + depth_noise * noise[seen]
        step = _QUANTISATION * depth_noise
        measured[seen] = 1 / np.maximum(np.round(inverse / step) * step, step)
    if depth_holes > 0:
        grazing = np.clip((0.22 - view.facing) / 0.16, 0, 1)
        holes = patchy < depth_holes * (1 - (1 - grazing) * (1 - view.absorbs))
        shadowed = _projector_shadow(depth, focal) | (depth < DEPTH_RANGE[0]) | (depth > DEPTH_RANGE[1])
        measured[holes | (shadowed & (gone < depth_holes))] = 0
    return measured.astype(np.float32)


def _projector_shadow(depth: Array, focal: float) -> Array:
    """Pixels that the projector, beside the camera, cannot reach, since a nearer surface is in the way."""
    disparity = focal * _BASELINE / np.where(depth > 0, depth, np.inf)
    reach = np.arange(depth.shape[1]) + disparity
    return np.asarray(np.maximum.accumulate(reach, axis=1) > reach + 0.75)


def blobs(rng: Rng, shape: tuple[int, int], radius: float) -> Array:
    """[H, W] Gaussian noise of unit variance, correlated over about ``radius`` pixels."""
    noise = _smooth(rng, shape, max(round(radius), 1))
    return np.asarray(noise / (noise.std() + 1e-12))


def _waves(rng: Rng, shape: tuple[int, int], radius: float) -> Array:
    """As :func:`blobs`, but with unit variance over all images: for large blobs, the mean of one image is not 0."""
    reach = max(round(radius), 1)
    window = 2 * reach + 1
    # Along each axis, the squared weights of two box filters add up to this.
    return _smooth(rng, shape, reach) / ((2 * window**2 + 1) / (3 * window**3))


def _smooth(rng: Rng, shape: tuple[int, int], reach: int) -> Array:
    noise = rng.standard_normal(shape)
    for axis in (0, 1):
        for _ in range(2):  # two box filters: nearly a Gaussian
            noise = _box_filter(noise, reach, axis)
    return noise


def _box_filter(values: Array, reach: int, axis: int) -> Array:
    pad = [(0, 0), (0, 0)]
    pad[axis] = (reach + 1, reach)
    total = np.cumsum(np.pad(values, pad, mode="wrap"), axis=axis)
    window = 2 * reach + 1
    ends = np.take(total, range(window, total.shape[axis]), axis=axis)
    return np.asarray((ends - np.take(total, range(total.shape[axis] - window), axis=axis)) / window)


def _smear(light: Array, length: float, angle: float) -> Array:
    """Blurs along a line of ``length`` pixels. Sums shifted copies, so the result does not depend on thread counts."""
    if length < 0.3:
        return light
    steps = np.linspace(-length / 2, length / 2, 2 * int(np.ceil(length)) + 1)
    taps: dict[tuple[int, int], float] = {}
    for step in steps:
        x, y = step * np.cos(angle), step * np.sin(angle)
        left, top = int(np.floor(x)), int(np.floor(y))
        for dx in (0, 1):
            for dy in (0, 1):
                weight = (1 - abs(x - left - dx)) * (1 - abs(y - top - dy))
                taps[top + dy, left + dx] = taps.get((top + dy, left + dx), 0.0) + weight / len(steps)
    pad = int(np.ceil(length / 2)) + 1
    height, width = light.shape[:2]
    padded = np.pad(light, [(pad, pad), (pad, pad), (0, 0)], mode="edge")
    result = np.zeros_like(light)
    for (dy, dx), weight in taps.items():
        if weight > 1e-6:
            result += np.float32(weight) * padded[pad + dy : pad + dy + height, pad + dx : pad + dx + width]
    return result
