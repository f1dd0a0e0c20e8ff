"""Reads files that are members of a zip archive, or lie in a folder; nothing is unpacked to the disk."""

from __future__ import annotations

import zlib
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

from torchjoint.runtime.foreign_files import damage_is, dict_of, has_file, has_folder, open_file, read_file


class Members:
    """The files of a zip archive, or of a folder and the folders in it.

    Args:
        path: of the archive or folder. The directory of an archive is read once: it may have 10,000 entries.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if has_folder(path):
            files = (file for pattern in ("*", "*/*") for file in path.glob(pattern))
            self.names = {file.relative_to(path).as_posix() for file in files if has_file(file)}
            return
        with damage_is(f"{path}: not a whole archive", OSError), ZipFile(path) as archive:
            self._entries = dict_of([(entry.filename, entry) for entry in archive.infolist()], "file")
        self.names = set(self._entries)

    def read(self, name: str, most: int) -> bytes:
        """Reads a file of at most `most` bytes."""
        if name not in self.names:
            raise ValueError(f"{self.path}: {name} is missing")
        file = self.path / name
        size = file.stat().st_size if has_folder(self.path) else self._entries[name].file_size
        if size > most:
            raise ValueError(f"{self.path}: {name}: expected at most {most} bytes, got {size}")
        return read_file(file, "a part of a recording", most) if has_folder(self.path) else self._unpack(name)

    def _unpack(self, name: str) -> bytes:
        entry = self._entries[name]
        with damage_is(f"{self.path}: {name} in it is damaged", OSError):
            with open_file(self.path) as stream:
                stream.seek(entry.header_offset)
                header = stream.read(30)  # its last two numbers are the lengths of a name and of an extra field
                stream.seek(sum(int.from_bytes(header[at : at + 2], "little") for at in (26, 28)), 1)
                data = stream.read(min(entry.compress_size, self.path.stat().st_size))
            if entry.compress_type == ZIP_DEFLATED:
                data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, entry.file_size + 1)
            elif entry.compress_type != ZIP_STORED:
                raise ValueError(f"compression {entry.compress_type} is not known")
            if len(data) != entry.file_size or zlib.crc32(data) != entry.CRC:
                raise ValueError("its size or checksum is another one")
        return data
