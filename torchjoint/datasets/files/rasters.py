"""Decodes images of files; their content does not choose the decoder."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from torchjoint.runtime import foreign_files as bounds
from torchjoint.runtime.foreign_files import read_file

#: Formats of images that are read. The content must not choose another decoder: Pillow gives EPS to Ghostscript, which
#: runs it; a TIFF file can name the same bytes 65,000 times.
RASTERS = ("PNG", "JPEG", "WEBP", "BMP", "PPM")


def read_raster(path: Path, *, header_only: bool = False) -> Image.Image:
    """Reads an image file (or only its header); errors as of :func:`decode_image`, also if it is missing."""
    return decode_image(read_file(path, "an image", bounds.IMAGE_BYTES), str(path), header_only=header_only)


def decode_image(
    data: bytes, name: str, *, header_only: bool = False, formats: tuple[str, ...] = RASTERS
) -> Image.Image:
    """Decodes an image file's bytes (or only its header); errors begin with `name`.

    Raises:
        ValueError: a damaged image, one of another format, or one that is too large.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the check below is stricter
            image = Image.open(io.BytesIO(data), formats=formats)
            bounds.check_pixels(image.height, image.width)
            bounds.check(len(image.info.get("exif", b"")), bounds.EXIF_BYTES, "bytes of EXIF")
            if not header_only:
                if image.format == "PNG":  # Pillow compares the checksums of pixels only if it is asked to
                    Image.open(io.BytesIO(data), formats=("PNG",)).verify()
                image.load()
    except (OSError, SyntaxError, ValueError, TypeError, EOFError, OverflowError, MemoryError, struct.error,
            Image.DecompressionBombError, zlib.error) as error:  # fmt: skip
        # Pillow's own message names the buffer in memory.
        reason = f"expected one of {', '.join(formats)}" if isinstance(error, UnidentifiedImageError) else error
        raise ValueError(f"{name}: not a whole image: {reason}") from error
    return image
