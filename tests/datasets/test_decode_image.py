"""Decoding images: damage is an error."""

import numpy as np
import pytest
from PIL import Image

from torchjoint.datasets.files.readers import decode_image


def test_a_flipped_bit_in_a_png_is_an_error(tmp_path):
    """Pillow itself reads other labels from some of these files without a word."""
    labels = np.repeat(np.repeat(np.arange(20, dtype=np.uint16).reshape(4, 5), 8, 0), 8, 1)
    Image.fromarray(labels).save(tmp_path / "labels.png")
    whole = (tmp_path / "labels.png").read_bytes()
    for place in range(len(whole) - 12):  # the last chunk, which ends the file, is not read
        spoiled = bytearray(whole)
        spoiled[place] ^= 1 << place % 8
        with pytest.raises(ValueError, match=r"^it: not a whole image"):
            decode_image(bytes(spoiled), "it")
