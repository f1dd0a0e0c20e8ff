"""Limits how much memory the compressed parts of a ROS recording may take; rosbags itself has no limit."""

from __future__ import annotations

import bz2
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from torchjoint.runtime import foreign_files as bounds

#: Bytes that are unpacked at a time: lz4 allocates so many in advance.
STEP = 1 << 24


def unpack(make: Callable[[], Any], packed: bytes) -> bytes:
    """Decompresses bytes.

    Args:
        make: makes a decompressor, such as bz2.BZ2Decompressor; each stream in the bytes gets a new one.
        packed: a chunk of a recording, or a message.

    Raises:
        ValueError: the bytes are truncated, or their decompressed size exceeds the limit.
    """
    most = bounds.RATIO * len(packed) + bounds.FREE
    parts, count, left = [], 0, packed
    while left:
        unpacker = make()
        while not unpacker.eof:
            parts.append(unpacker.decompress(left, max_length=min(STEP, most + 1 - count)))
            count, left = count + len(parts[-1]), b""
            if count > most:
                raise ValueError(f"{len(packed)} packed bytes have more than {most} when they are unpacked")
            if unpacker.needs_input and not unpacker.eof:
                raise ValueError("packed bytes are truncated")
        left = unpacker.unused_data or b""
    return b"".join(parts)


def bound_unpacking() -> None:
    """Makes rosbags use :func:`unpack` for chunks (ROS 1, MCAP) and messages (ROS 2)."""
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as ros_1
    from rosbags.rosbag2 import reader as ros_2
    from rosbags.rosbag2 import storage_mcap as mcap

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    ros_1.decompressors["bz2"] = lambda packed: unpack(bz2.BZ2Decompressor, packed)
    ros_1.decompressors["lz4"] = lambda packed: unpack(LZ4FrameDecompressor, packed)
    mcap.DECOMPRESSORS["lz4"] = lambda packed, _: unpack(LZ4FrameDecompressor, packed)
    mcap.DECOMPRESSORS["zstd"] = lambda packed, _: unpack(zstd.ZstdDecompressor, packed)
    messages: Any = SimpleNamespace(open=zstd.open, decompress=lambda packed: unpack(zstd.ZstdDecompressor, packed))
    ros_2.zstd = messages
