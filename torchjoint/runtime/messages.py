"""Texts of errors for users."""

from __future__ import annotations

import errno
import re

#: Parts of the messages of torch, and of the system's loader of libraries.
_OUT_OF_MEMORY = ("not enough memory", "can't allocate memory", "bad_alloc", "failed to map segment")
#: Characters that move the cursor, begin an escape sequence, or turn the direction of writing; not tab and line break.
_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether Python or torch had too little memory."""
    return isinstance(error, MemoryError) or any(part in str(error) for part in _OUT_OF_MEMORY)


def printable(name: str) -> str:
    """A name as text for a page or a picture: half characters, which have no encoding, as their numbers."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def on_terminal(text: str) -> str:
    """Text with names of others for a terminal: characters that control it are shown as their numbers."""
    return _CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode(), printable(text))


def say(text: object, *, flush: bool = False) -> None:
    """Prints text with names of others."""
    print(on_terminal(str(text)), flush=flush)


def in_one_line(error: BaseException) -> str:
    """Describes an error in one line, and how to solve it if this is known."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"the disk is full{f' ({error.filename})' if error.filename else ''}; make room and start again"
    if is_out_of_memory(error):
        return "out of memory; --thin, --max-frames and --voxel-size reduce the data"
    if isinstance(error, RecursionError):
        return f"nested too deeply: {error}"
    return on_terminal(" ".join(str(error).split()))
