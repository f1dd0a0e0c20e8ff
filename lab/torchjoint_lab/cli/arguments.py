"""Checks that several commands share."""

from __future__ import annotations


def check_max_frames(max_frames: int | None) -> None:
    """Raises ValueError if `max_frames` is negative."""
    if max_frames is not None and max_frames < 0:
        raise ValueError(f"--max-frames: expected >= 0, got {max_frames}")
