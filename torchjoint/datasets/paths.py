"""Checks file paths that a file of a data set contains."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path


def path_inside(folder: Path, name: str, source: str, *, or_inside: Sequence[Path] = ()) -> Path:
    """Resolves path `name` in file `source`, which is relative to `folder`; links within the folder are followed.

    A name with the backslashes of Windows is one with slashes, unless there is a file of that name.

    Raises:
        ValueError: `name` is not a file name, or it leads out of the folder and of `or_inside`: untrusted data must not
            read other files.
    """
    if not _is_file_name(name):
        raise ValueError(f"{source}: expected a path of a file, got {name[:100]!r}")
    if "\\" in name and not os.path.exists(os.path.join(folder, name)):
        name = name.replace("\\", "/")
    target = os.path.normpath(os.path.join(os.path.abspath(folder), name))
    for root in (folder, *or_inside):
        relative = os.path.relpath(target, os.path.abspath(root))
        if relative != os.curdir and relative.split(os.sep)[0] != os.pardir:
            return root / relative
    raise ValueError(f"{source}: expected a file inside {folder}, got {name!r}; give a relative path, without `..`")


def frame_names(files: Sequence[str]) -> list[str]:
    """Returns frame names that are valid file names: paths below the common folder, without suffix, `_` for `/`.

    Suffixes are kept if two names would otherwise be equal.

    Example:
        >>> frame_names(["./images/left/1.jpg", "images/right/1.jpg"])
        ['left_1', 'right_1']
    """
    paths = [os.path.normpath(file.replace("\\", "/")) for file in files]
    common = os.path.commonpath([os.path.dirname(path) for path in paths]) if paths else ""
    below = [os.path.relpath(path, common or ".").replace(os.sep, "_") for path in paths]
    stems = [os.path.splitext(name)[0] for name in below]
    return stems if len(set(stems)) == len(stems) else below


def _is_file_name(name: str) -> bool:
    try:
        raw = os.fsencode(name)
    except UnicodeEncodeError:
        return False
    # File systems allow 255 bytes per name and 4096 per path; a suffix and a folder may be added to this name.
    return bool(raw) and b"\0" not in raw and len(raw) < 2048 and max(map(len, raw.split(b"/"))) < 250
