"""Decompresses LZFSE, Apple's compression (github.com/lzfse/lzfse), used by Record3D; with the package lzfse."""

from __future__ import annotations

from torchjoint.runtime.messages import needed_for

#: A packed block starts so. It holds at most 10,000 matches of 2,359 bytes, whatever size its header declares.
_BLOCKS = (b"bvx1", b"bvx2")
#: Apple's encoder begins a new block after so many bytes or more: 10,000 matches of at least 4, or 40,000 literals.
_BLOCK_BYTES = 40_000


def decompress(data: bytes, size: int, name: str = "data") -> bytes:
    """Decompresses data to `size` bytes; `name` is for messages.

    Data that have too many blocks for this size are not unpacked: a few bytes can become gigabytes.
    """
    with needed_for("reading depth of Record3D", "lzfse", "torchjoint[record3d]"):
        import lzfse
    # The library allocates the size that the first block declares, and then as much as the blocks give.
    declared = int.from_bytes(data[4:8], "little")
    blocks = sum(data.count(magic) for magic in _BLOCKS)
    if len(data) < 12 or len(data) > 2 * size + 64 or declared > size or blocks > 4 + size // _BLOCK_BYTES:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZFSE data, got {len(data)} packed bytes")
    try:
        out: bytes = lzfse.decompress(data)
    except (lzfse.error, MemoryError):
        raise ValueError(f"{name}: damaged: not whole LZFSE data") from None
    if len(out) != size:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZFSE data, got {len(out)}")
    return out
