"""LZF, M. Lehmann's fast compression (https://oldhome.schmorp.de/marc/liblzf.html), as in PCD files."""

from __future__ import annotations


def decompress(data: bytes, size: int, name: str = "data") -> bytearray:
    """Decompresses what has `size` bytes; damaged data never make more than that and one run of 264.

    Args:
        data: a control byte c below 32 stands before c + 1 bytes to be taken as they are. Any other is a copy, of
            (c >> 5) + 2 bytes, plus the next byte if c >> 5 is 7, from ((c & 31) << 8) + the next byte + 1 before the
            end of what there is; it may reach into itself.
        size: bytes.
        name: for messages.

    Raises:
        ValueError: the data are damaged, or give another size.
    """
    out, place, end = bytearray(), 0, len(data)
    try:
        while place < end and len(out) <= size:
            control = data[place]
            place += 1
            if control < 32:  # so many bytes, and one, as they are
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
            else:  # the copy overlaps what it makes: a pattern, repeated
                pattern = out[start:]
                out += (pattern * ((length + 2) // len(pattern) + 1))[: length + 2]
    except IndexError:
        raise ValueError(f"{name}: damaged: not whole LZF data") from None
    if len(out) != size or place != end:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZF data, got {len(out)}")
    return out
