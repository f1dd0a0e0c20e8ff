"""Data that do not fit into memory: packed without loss, in a temporary file; and states of runs in files."""

from __future__ import annotations

import io
import math
import mmap
import os
import pickletools
import re
import tempfile
import weakref
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.files import read_checked, write_checked
from torchjoint.runtime.foreign_files import damage_is, inflate

_LEVEL, _WINDOW_BITS, _MEMORY = 1, 15, 9
_TYPES = {str(dtype).removeprefix("torch."): dtype for dtype in (torch.uint8, torch.int32, torch.int64, torch.float32)}


#: How numbers are stored, and a limit of what was subtracted from them.
_STORED, _FAR = ("u1", "<u2", "<i4", "<i8"), 1 << 62
#: What the pickle of a state may name.
_CALLED = re.compile(
    r"torch\._utils _rebuild_tensor_v[23]|torch(\.storage)? \w+Storage|torch [a-z]+[0-9]*|collections OrderedDict"
)


@dataclass(frozen=True)
class Packed:
    """A packed tensor; :func:`pack` makes it."""

    content: bytes | Span  #: the compressed bytes, or their place in a file
    dtype: str  #: the tensor's type: uint8, int32, int64 or float32
    shape: tuple[int, ...]  #: the tensor's shape
    stored: str  #: the type of the compressed numbers, as NumPy writes it
    low: int = 0  #: the number that was subtracted from whole numbers before compression

    def data(self) -> bytes:
        """The compressed bytes."""
        return self.content if isinstance(self.content, bytes) else self.content.read()

    def unpack(self) -> Tensor:
        """Returns the original tensor, bit for bit."""
        size = math.prod(self.shape) * (4 if self.dtype == "float32" else np.dtype(self.stored).itemsize)
        data = inflate(self.data(), size, f"packed {self.dtype} of shape {list(self.shape)}")
        flat: npt.NDArray[Any] = np.frombuffer(data, dtype=self.stored)
        if self.dtype == "float32":
            flat = np.ascontiguousarray(flat.reshape(4, -1).T).view(np.float32)
        numbers = flat.reshape(self.shape)
        if _is_image(self.dtype, self.shape):
            numbers = np.add.accumulate(numbers, axis=-1, dtype=np.uint8)
        tensor = torch.from_numpy(numbers if numbers.flags.writeable else numbers.copy()).to(_TYPES[self.dtype])
        return tensor + self.low if self.low else tensor

    def to_dict(self) -> dict[str, Any]:
        """A dict of a tensor, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        return {**vars(self), "content": torch.frombuffer(bytearray(self.data()), dtype=torch.uint8)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Packed:
        """The inverse of :meth:`to_dict`, for values of a file."""
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

    def at(self, content: Span) -> Packed:
        """The same tensor, with its bytes at another place."""
        return replace(self, content=content)


def pack(tensor: Tensor) -> Packed:
    """Packs a tensor of type uint8, int32, int64 or float32; uint8 of three dimensions are images, [C, H, W]."""
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


#: Bytes of zeros that are written at once.
ZEROS = 1 << 20


class Span:
    """A range of bytes in a :class:`OffloadFile`, which exists as long as its spans. Pickling makes it plain bytes."""

    def __init__(self, file: OffloadFile, start: int, size: int) -> None:
        self._file, self._start, self._size = file, start, size

    def read(self) -> bytes:
        """The bytes."""
        return self._file.read(self._start, self._size)

    def __reduce__(self) -> tuple[type[bytes], tuple[bytes]]:
        return bytes, (self.read(),)


class OffloadFile:
    """Keeps bytes on disk until their last span is deleted. Several threads may read.

    Args:
        folder: a folder on the disk to use; default: the variable TMPDIR, or /var/tmp (/tmp is often in memory).
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = _default_folder() if folder is None else folder
        try:
            self._file = tempfile.TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115 (it is closed below)
        except OSError as error:
            raise self._error(error) from error
        weakref.finalize(self, self._file.close)  # with the last span
        self._end, self.process = 0, os.getpid()  # a forked one would write to the same place of the same file
        self._lock = Lock()

    def write(self, parts: Sequence[bytes]) -> list[Span]:
        """Writes all parts, or none."""
        with self._lock:
            start, spans = self._end, []
            try:
                for part in parts:
                    self._write(part, start)
                    spans.append(Span(self, start, len(part)))
                    start += len(part)
            except OSError as error:
                os.ftruncate(self._file.fileno(), self._end)
                raise self._error(error) from error
            self._end = start
        return spans

    def mapped(self, size: int) -> mmap.mmap:
        """The first `size` bytes of the file as memory, whose pages the system may drop; bytes beyond its end are 0."""
        # Written, because a full disk would otherwise end the process where the memory is used first.
        full, rest = divmod(max(0, size - self._end), ZEROS)
        self.write([bytes(ZEROS)] * full + [bytes(rest)])
        return mmap.mmap(self._file.fileno(), size)

    def _write(self, part: bytes, start: int) -> None:
        rest = memoryview(part)
        while rest:
            written = os.pwrite(self._file.fileno(), rest, start)
            rest, start = rest[written:], start + written

    def read(self, start: int, size: int) -> bytes:
        """Bytes that were written."""
        parts = []
        while size > 0:
            part = os.pread(self._file.fileno(), size, start)
            if not part:
                raise OSError(f"memory: the temporary file in {self.folder} has become shorter")
            parts.append(part)
            start, size = start + len(part), size - len(part)
        return b"".join(parts)

    def _error(self, error: OSError) -> OSError:
        told = f"data beyond this limit go to a temporary file, which cannot be written ({error.strerror})"
        hint = "free disk space, or give another folder (offload=, or the variable TMPDIR) or more memory (memory=)"
        return OSError(error.errno, f"memory: {told}; {hint}", str(self.folder))


def _default_folder() -> Path:
    is_other = os.environ.get("TMPDIR") or not os.access("/var/tmp", os.W_OK | os.X_OK)
    return Path(tempfile.gettempdir() if is_other else "/var/tmp")


def write_values(path: Path, values: Mapping[str, Any]) -> None:
    """Writes a dict of tensors, numbers and texts, atomically."""
    content = io.BytesIO()
    torch.save(values, content)
    write_checked(path, content.getvalue())


def read_values(path: Path) -> dict[str, Any]:
    """Reads what :func:`write_values` wrote. No code in it is run, and it is not larger than its file."""
    content = read_checked(path)
    with damage_is(f"{path}: not a saved state", Exception):  # torch raises errors of many types
        return load_values(content)


def load_values(content: bytes) -> dict[str, Any]:
    """Reads a dict that `torch.save` wrote; errors of many types. No code in it is run."""
    _check_pickle(content)
    values = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    if not isinstance(values, dict):
        raise TypeError(f"expected a dict, got {type(values).__name__}")
    _check_size(values, len(content))
    return values


def _check_pickle(content: bytes) -> None:
    """Checks that nothing is packed, and that the pickle calls for tensors only: torch also makes large bytearrays."""
    if not content.startswith(b"PK"):  # torch would read an older format
        raise ValueError("expected an archive")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        stored = sum(entry.file_size for entry in archive.infolist())
        bounds.check(stored, len(content), "bytes, for torch packs nothing,")
        for entry in archive.infolist():
            for code, argument, _ in pickletools.genops(archive.read(entry)) if entry.filename.endswith(".pkl") else ():
                is_known = code.name == "GLOBAL" and _CALLED.fullmatch(str(argument))
                if code.name in ("STACK_GLOBAL", "INST", "GLOBAL") and not is_known:
                    raise ValueError(f"expected tensors, numbers and texts, got {argument or code.name}")


def _check_size(values: dict[str, Any], most: int) -> None:
    """Checks how large values are together: a list or a tensor may hold the same bytes many times."""
    left: list[Any] = [values]
    count = size = 0
    while left:
        one, count = left.pop(), count + 1
        bounds.check(count, most, "values")
        if isinstance(one, Tensor):
            if one.layout != torch.strided or one.is_quantized:
                raise TypeError(f"expected plain tensors, got {one.layout}")
            size += one.numel() * one.element_size()
            bounds.check(size, 4 * most, "bytes of tensors")  # three times is a grey image
        elif isinstance(one, dict):
            left += one.values()
        elif isinstance(one, (list, tuple)):
            left += one
