"""Checks that several commands share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from torchjoint.runtime.outputs import Output


def check_max_frames(max_frames: int | None) -> None:
    """Raises ValueError if `max_frames` is negative."""
    if max_frames is not None and max_frames < 0:
        raise ValueError(f"--max-frames: expected >= 0, got {max_frames}")


def check_output(
    out: Path, names: Iterable[str], overwrite: bool, inputs: Sequence[Path | None] = ()
) -> dict[str, Output]:
    """Checks that files with these names may be written into folder `out`; returns what writes each of them."""
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"-o: {out} exists and is not a folder")
    files = [path for path in inputs if path is not None and path.is_file()]  # scores may lie in a result's folder
    return {name: Output(out / name, overwrite=overwrite, inputs=files) for name in names}
