"""Photographs as real recordings have them: the camera's errors, then those of JPEG."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.render import View
from torchjoint_lab.synthetic.furnished.sensor import photograph
from torchjoint_lab.synthetic.settings import DomainSettings


def shot_of(rng: Rng, view: View, settings: DomainSettings) -> Array:
    """The [H, W, 3] float32 image in [0, 1] that a camera keeps of a view."""
    import cv2

    image = photograph(rng, view, settings.exposure, settings.motion_blur, settings.image_noise)
    if settings.jpeg >= 100:
        return image
    pixels = np.ascontiguousarray(np.round(image[..., ::-1] * 255).astype(np.uint8))
    _, packed = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg])
    kept: Array = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))
    return np.asarray(np.ascontiguousarray(kept[..., ::-1]).astype(np.float32) / np.float32(255))
