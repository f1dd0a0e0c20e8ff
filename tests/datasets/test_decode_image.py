"""Decoding images: damage is an error."""

from contextlib import nullcontext

import cv2
import numpy as np
import pytest
from bombs import png
from PIL import Image

from torchjoint.datasets.files.readers import decode_image, read_depth, read_label_image


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


def test_numbers_that_the_decoder_would_change(tmp_path):
    """Pillow stretches the numbers of a PGM, or of a PNG of 4 bits: 1 m became 6.5 m; JPEG makes labels of its own."""
    path, depth, labels = tmp_path / "it.png", np.array([[1000, 2000]], ">u2"), np.array([[1, 12]], "u1")
    path.write_bytes(b"P5 2 1 65535\n" + depth.tobytes())
    assert read_depth(path).tolist() == [[1, 2]]
    for whole in (b"P5 2 1 255\n" + labels.tobytes(), b"P2 2 1 255\n1 12\n", png(2, 1, 4, b"\0\x1c")):
        path.write_bytes(whole)
        assert read_label_image(path).tolist() == [[1, 12]]
    for read, start, numbers in (
        (read_depth, b"P5 2 1 10000\n", depth.tobytes()),
        (read_label_image, b"P5 2 1 12\n", labels.tobytes()),
        (read_label_image, b"P2 2 1 12\n", b"1 12\n"),
    ):
        path.write_bytes(start + numbers)
        with pytest.raises(ValueError, match=r"it\.png: .*expected 255 or 65535 as its largest number, got (12|10000)"):
            read(path)
    image = Image.fromarray(np.kron(labels, np.ones((13, 13), np.uint8)))
    for kind, more in (("JPEG", {}), ("MPO", {"save_all": True, "append_images": [image]})):  # MPO: a phone's JPEG
        image.save(path, kind, **more)
        with pytest.raises(ValueError, match=rf"it\.png: expected a grey or palette image of labels, .* L of {kind}"):
            read_label_image(path)


def test_a_jpeg_whose_end_is_lost(tmp_path):
    """As an interrupted copy leaves it, where the system has made room for the whole file; Pillow shows grey there."""
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)).save(tmp_path / "it.jpg")
    whole = (tmp_path / "it.jpg").read_bytes()
    assert decode_image(whole + bytes(99), "it").size == (64, 64)  # some cameras fill the last sector
    with pytest.raises(ValueError, match="it: not a whole image: its end is lost, there are zeros in its place"):
        decode_image(whole[:-999] + bytes(999), "it")


@pytest.mark.parametrize("kind", [".png", ".ppm"])
@pytest.mark.parametrize("most", [255, 4095, 65535])
def test_colours_of_few_bits_in_16(tmp_path, kind, most):
    """Pillow drops the lower 8 bits: the image was black."""
    colors = np.linspace(0, most, 36).reshape(3, 4, 3).round().astype(np.uint16)
    cv2.imwrite(str(tmp_path / f"it{kind}"), colors)
    told = pytest.raises(ValueError, match="not a whole image: expected colours up to 65535, got less than")
    with nullcontext() if most == 65535 else told:
        assert decode_image((tmp_path / f"it{kind}").read_bytes(), "it").mode == "RGB"
