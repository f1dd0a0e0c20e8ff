"""Names of files, the cache, and atomic writes: a file is written under a temporary name, then renamed."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

#: Most bytes of a name: file systems allow 255, and a suffix may follow.
LONGEST = 240
#: How the names of temporary files begin; a random part follows, so that two writers of a file do not meet.
PARTIAL = ".partial-"
#: Environment variable with the cache's folder; empty: no cache. Default: torchjoint/ in the user's XDG_CACHE_HOME.
CACHE = "TORCHJOINT_CACHE"


def cache_folder() -> Path | None:
    """The folder of what is kept for later runs; None: nothing is kept."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = os.environ.get(CACHE, os.path.join(home, "torchjoint"))
    return Path(folder) if folder else None


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
    if is_free and is_text and raw.strip(b".") and len(raw) <= LONGEST and not {"/", "\0"} & set(name):
        return name
    return f"{re.sub(r'[^A-Za-z0-9-]+', '_', name)[:100]}-{hashlib.sha256(raw).hexdigest()[:12]}"


def frame_files(names: Sequence[str]) -> list[str]:
    """The file names of frames, without suffix; a frame without a name has its number."""
    return [file_name(name or f"{index:06d}") for index, name in enumerate(names)]


def no_link(path: Path) -> Path:
    """Returns a path below which a file will be written.

    Raises:
        FileExistsError: it is a link, which leads elsewhere: a result may come from a stranger.
    """
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
