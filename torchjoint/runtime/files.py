"""Files that are written as a whole or not at all, and files with a checksum."""

import errno
import hashlib
import os
import re
import secrets
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from torchjoint.runtime.foreign_files import open_file, read_file

#: Most bytes of a name: file systems allow 255, and a suffix may follow.
LONGEST = 240
#: Slashes, the colon behind a drive of Windows, ._ of macOS; what controls a terminal that lists them, or turns text.
_NOT_IN_NAMES = re.compile(r"[/\\:\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]|^\._")
#: How the names of temporary files begin; a random part follows, so that two writers of a file do not meet.
PARTIAL = ".partial-"
#: Errors of a disk without room.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: Environment variable with the cache's folder; empty: no cache. Default: torchjoint/ in the user's XDG_CACHE_HOME.
CACHE = "TORCHJOINT_CACHE"


def cache_folder() -> Path | None:
    """The folder of what is kept for later runs; None: nothing is kept."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(folder) if (folder := os.environ.get(CACHE, os.path.join(home, "torchjoint"))) else None


def file_name(name: str, *, is_free: bool = True) -> str:
    """The file name for something that data name: the name itself if a file can have it, else one with a checksum.

    Args:
        name: any text, also of a stranger.
        is_free: False: the name itself is in use for something else.

    Example:
        >>> file_name("frame 1"), file_name("../victim")
        ('frame 1', '_victim-18d36a5a94d8')
    """
    raw = name.encode("utf-8", "surrogatepass")
    is_text = raw == name.encode("utf-8", "ignore")
    if is_free and is_text and raw.strip(b".") and len(raw) <= LONGEST and not _NOT_IN_NAMES.search(name):
        return name
    return f"{re.sub(r'[^A-Za-z0-9-]+', '_', name)[:100]}-{hashlib.sha256(raw).hexdigest()[:12]}"


def portable_name(name: str) -> str:
    """The same where nothing else has the name: what Windows refuses becomes _, without a checksum.

    >>> portable_name('000002-Straße, "Süd"')
    '000002-Straße, _Süd_'
    """
    return file_name(re.sub(r'[<>:"/\\|?*]', "_", name))


def frame_files(names: Sequence[str]) -> list[str]:
    """The file names of frames, without suffix; a frame without a name has its number.

    Names that differ only in case get checksums: some disks would take them for one file.

    >>> frame_files(["a", "", "b", "B"])
    ['a', '000001', 'b-3e23e8160039', 'B-df7e70e50215']
    """
    names = [name or f"{index:06d}" for index, name in enumerate(names)]
    same = Counter(name.casefold() for name in set(names))
    return [file_name(name, is_free=same[name.casefold()] == 1) for name in names]


def no_link(path: Path) -> Path:
    """Returns a path below which a file will be written."""
    if path.is_symlink():
        raise FileExistsError(f"{path}: expected a file or folder, got a link; nothing is written through it")
    return path


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`. It replaces `path` on success, and is removed after an error.

    The temporary path has the suffix of `path`, because libraries choose the format by the suffix. Of several
    writers of a file, the last one counts.
    """
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(8)}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        if error.errno in FULL and str(error.filename or partial) == str(partial):  # such an error names no file
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Writes a text file (UTF-8) atomically."""
    with atomic_write(path) as partial:
        partial.write_text(text, encoding="utf-8")


def remove_partial_files(folder: Path) -> None:
    """Deletes the temporary files that killed writers left in a folder; only for a folder that nobody else writes."""
    for path in folder.glob(f"{PARTIAL}{'[0-9a-f]' * 16}*"):
        if path.is_file():
            path.unlink()


_MARK = b"torchjoint checked file 1\n"


def write_checked(path: Path, content: bytes) -> None:
    """Writes a file and the checksum of its content, atomically."""
    with atomic_write(path) as partial:
        partial.write_bytes(_MARK + hashlib.sha256(content).hexdigest().encode() + b"\n" + content)


def read_checked(path: Path) -> bytes:
    """Reads what :func:`write_checked` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file cannot be read, has another version, or is damaged; the message names the file.
    """
    data = read_file(path, "a checked file of torchjoint")
    if not data.startswith(_MARK):
        raise ValueError(f"{path}: expected a file of this version of torchjoint, got another, or a damaged one")
    checksum, _, content = data[len(_MARK) :].partition(b"\n")
    if checksum != hashlib.sha256(content).hexdigest().encode():
        raise ValueError(f"{path}: damaged: its checksum does not match its content")
    return content


def file_checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
