"""Decompresses LZF, M. Lehmann's fast compression (https://oldhome.schmorp.de/marc/liblzf.html), used in PCD files."""

from __future__ import annotations


def decompress(data: bytes, size: int, name: str = "data") -> bytearray:
    """Decompresses data to `size` bytes. Damaged data make at most one run of 264 bytes more before the error.

    Args:
        data: a sequence of runs. A control byte c below 32 starts a literal run: the next c + 1 bytes are copied
            as they are. Any other control byte starts a back reference of length (c >> 5) + 2, plus the next byte
            if c >> 5 is 7. The copy starts ((c & 31) << 8) + the next byte + 1 bytes before the end of the output,
            and may overlap itself.
        size: of the output, bytes.
        name: for messages.

    Raises:
        ValueError: the data are damaged, or give another size.
    """
    out, place, end = bytearray(), 0, len(data)
    try:
        while place < end and len(out) <= size:
            control = data[place]
            place += 1
            if control < 32:  # literal run: control + 1 bytes are copied
                out += data[place : place + control + 1]
                place += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[place]
                place += 1
            start = len(out) - ((control & 31) << 8) - data[place] - 1
            place += 1
            if start < 0:
                raise IndexError
            stop = start + length + 2
            if stop <= len(out):
                out += out[start:stop]
            else:  # the copy overlaps its own output: it repeats a pattern
                pattern = out[start:]
                out += (pattern * ((length + 2) // len(pattern) + 1))[: length + 2]
    except IndexError:
        raise ValueError(f"{name}: damaged: not whole LZF data") from None
    if len(out) != size or place != end:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZF data, got {len(out)}")
    return out
