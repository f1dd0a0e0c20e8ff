"""Saves corrections by hand (output after step 8) that several programs may make at once, such as two viewers."""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile
from pathlib import Path

from torchjoint.results.edits import FILE, Edit, Edits, read_edits, write_edits
from torchjoint.results.parts import Parts
from torchjoint.runtime.locks import lock

Steps = tuple[Edit, ...]


def save_edits(folder: Path, edits: Edits, before: Edits, parts: Parts) -> Edits:
    """Saves corrections together with those that others have saved meanwhile.

    Args:
        folder: the result.
        edits: the corrections.
        before: those that were read, or saved last, before they became `edits`.
        parts: of the result.

    Returns:
        what edits.json now holds: the corrections of the others, then the own ones.

    Raises:
        ValueError: the folder holds another result now, or the corrections of both are not possible together; nothing
            is written.
        BusyError: another program is saving at this moment.
    """
    with lock(folder / f".{FILE}.lock", f"{folder / FILE}: another program is saving; save again"):
        saved = read_edits(folder, edits.num_pieces)
        theirs = saved.steps if (folder / FILE).exists() else before.steps  # who has moved the file, has undone nothing
        if saved.of != edits.of:
            raise ValueError(f"{folder}: expected the result that was opened, got another; not saved, open it again")
        merged = replace(edits, steps=merged_steps(before.steps, theirs, edits.steps))
        try:
            parts.table(merged)
            parts.names(merged)
        except ValueError as error:
            expected = "expected corrections that go with those that others have saved meanwhile"
            raise ValueError(f"{folder / FILE}: {expected}: {error}; undo some, and save again") from error
        write_edits(folder, merged)
    return merged


def merged_steps(before: Steps, theirs: Steps, own: Steps) -> Steps:
    """What two made of the same corrections, in one: what either has undone is undone; then theirs, then the own.

    What both have added first counts once.

    Example:
        >>> a, b, c = (Edit("join", (0, piece)) for piece in (1, 2, 3))
        >>> merged_steps((a,), (a, b), (c,)) == (b, c)
        True
    """
    of_theirs, of_own = _common(before, theirs), _common(before, own)
    added, own_added = theirs[of_theirs:], own[of_own:]
    return (*before[: min(of_theirs, of_own)], *added, *own_added[_common(added, own_added) :])


def _common(one: Steps, other: Steps) -> int:
    """The number of steps with which both begin."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))
