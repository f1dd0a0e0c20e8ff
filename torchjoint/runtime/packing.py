"""Packs tensors without loss: labels, images and pixels of points, which are kept long and read seldom.

These methods measured best among those of Python and the dependencies (frames of 1296x968, one thread). Whole numbers:
the smallest type that holds them, then zlib level 1 (labels: 7 ms, 1 % of their size). Images: differences along rows,
then only Huffman codes (30 ms; as small as PNG, which takes 64 to 149 ms). Floats: byte by byte, then zlib level 1.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime import bounds

_LEVEL, _WINDOW_BITS, _MEMORY = 1, 15, 9
_TYPES = {str(dtype).removeprefix("torch."): dtype for dtype in (torch.uint8, torch.int32, torch.int64, torch.float32)}


#: How numbers are stored, and a limit of what was subtracted from them.
_STORED, _FAR = ("u1", "<u2", "<i4", "<i8"), 1 << 62


class Content(Protocol):
    """A place from which packed bytes can be read."""

    def read(self) -> bytes:
        """The bytes."""


@dataclass(frozen=True)
class Packed:
    """A packed tensor; :func:`pack` makes it."""

    content: bytes | Content  #: the compressed bytes, or an object that reads them
    dtype: str  #: the tensor's type: uint8, int32, int64 or float32
    shape: tuple[int, ...]  #: the tensor's shape
    stored: str  #: the type of the compressed numbers, as NumPy writes it
    low: int = 0  #: the number that was subtracted from whole numbers before compression

    def data(self) -> bytes:
        """The compressed bytes."""
        return self.content if isinstance(self.content, bytes) else self.content.read()

    def unpack(self) -> Tensor:
        """Returns the original tensor, bit for bit."""
        flat: npt.NDArray[Any] = np.frombuffer(self._inflated(), dtype=self.stored)
        if self.dtype == "float32":
            flat = np.ascontiguousarray(flat.reshape(4, -1).T).view(np.float32)
        numbers = flat.reshape(self.shape)
        if _is_image(self.dtype, self.shape):
            numbers = np.add.accumulate(numbers, axis=-1, dtype=np.uint8)
        tensor = torch.from_numpy(numbers if numbers.flags.writeable else numbers.copy()).to(_TYPES[self.dtype])
        return tensor + self.low if self.low else tensor

    def _inflated(self) -> bytes:
        """The stored numbers; allocates at most one byte more than they should have."""
        data, stream = self.data(), zlib.decompressobj()
        expected = math.prod(self.shape) * (4 if self.dtype == "float32" else np.dtype(self.stored).itemsize)
        unpacked = stream.decompress(data, expected + 1)
        if len(unpacked) != expected or not (stream.eof or not expected):
            raise ValueError(f"packed {self.dtype}: expected {expected} bytes of shape {list(self.shape)}, got others")
        return unpacked

    def to_dict(self) -> dict[str, Any]:
        """A dict of a tensor, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        return {**vars(self), "content": torch.frombuffer(bytearray(self.data()), dtype=torch.uint8)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Packed:
        """The inverse of :meth:`to_dict`, for values of a file.

        Raises:
            TypeError, ValueError: they are no packed tensor, or one that is too large for its bytes.
        """
        packed = cls(**{**values, "content": values["content"].numpy().tobytes(), "shape": tuple(values["shape"])})
        whole = all(type(size) is int and size >= 0 for size in packed.shape) and type(packed.low) is int
        if packed.dtype not in _TYPES or packed.stored not in _STORED or not whole or not -_FAR <= packed.low < _FAR:
            raise ValueError(f"expected a packed tensor, got {packed.dtype} as {packed.stored} of {packed.shape}")
        bounds.check_unpacked(packed.num_bytes, len(packed.data()))
        return packed

    @property
    def num_bytes(self) -> int:
        """Size of the tensor when it is unpacked."""
        return math.prod(self.shape) * _TYPES[self.dtype].itemsize

    def at(self, content: bytes | Content) -> Packed:
        """The same tensor, with its bytes at another place."""
        return replace(self, content=content)


def pack(tensor: Tensor) -> Packed:
    """Packs a tensor of type uint8, int32, int64 or float32; uint8 of three dimensions are images, [C, H, W].

    Raises:
        TypeError: another type.
    """
    dtype, shape = str(tensor.dtype).removeprefix("torch."), tuple(tensor.shape)
    if dtype not in _TYPES:
        raise TypeError(f"tensor: expected one of {', '.join(_TYPES)}, got {dtype}")
    numbers = tensor.detach().contiguous().numpy()
    if dtype == "float32":
        planes = np.ascontiguousarray(numbers.reshape(-1, 1).view(np.uint8).T)
        return Packed(zlib.compress(planes.data, _LEVEL), dtype, shape, "u1")
    if _is_image(dtype, shape):
        steps = np.diff(numbers, axis=-1, prepend=np.uint8(0))  # modulo 256
        coder = zlib.compressobj(_LEVEL, zlib.DEFLATED, _WINDOW_BITS, _MEMORY, zlib.Z_HUFFMAN_ONLY)
        return Packed(coder.compress(np.ascontiguousarray(steps).data) + coder.flush(), dtype, shape, "u1")
    low = int(numbers.min(initial=0))
    spread = int(numbers.max(initial=0)) - low
    stored = next((name for name, bits in (("u1", 8), ("<u2", 16), ("<i4", 31)) if spread < 1 << bits), "<i8")
    if stored == "<i8":
        low = 0  # the spread may exceed the type
    return Packed(zlib.compress((numbers - low).astype(stored).data, _LEVEL), dtype, shape, stored, low)


def _is_image(dtype: str, shape: tuple[int, ...]) -> bool:
    return dtype == "uint8" and len(shape) == 3 and shape[-1] > 0
