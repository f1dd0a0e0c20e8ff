"""Files that are none: dead links, pipes that nobody fills, devices that never end; for tests and fuzz.py."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

import torchjoint as tj

#: What may stand in the place of a file, by name.
TRAPS: dict[str, Callable[[Path], None]] = {
    "dead link": lambda path: path.symlink_to(path.parent / "lost" / path.name),
    "pipe": lambda path: os.mkfifo(path),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "link to itself": lambda path: path.symlink_to(path),
}


@contextmanager
def trapped(path: Path, trap: str) -> Iterator[None]:
    """Inside the block, a trap stands in the place of a file."""
    away = path.with_name(f".{path.name}.away")
    path.rename(away)
    try:
        TRAPS[trap](path)
        yield
    finally:
        path.unlink(missing_ok=True)
        if away.exists():  # a state whose key is another one is removed
            away.rename(path)


@contextmanager
def ends(seconds: int = 120) -> Iterator[None]:
    """Raises if the block hangs."""

    def hangs(*_: object) -> None:
        raise AssertionError(f"expected an end, got none after {seconds} seconds")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def content_of(path: Path) -> dict[str, torch.Tensor]:
    """Everything that a recording has, by name."""
    scene = tj.load_scene(path)
    content = {"points": scene.points} | ({} if scene.colors is None else {"colors": scene.colors})
    for index, frame in enumerate(scene.frames):
        content |= {f"image {index}": frame.image, f"pose {index}": frame.world_to_camera}
        content |= {} if frame.depth is None else {f"depth {index}": frame.depth}
        content |= {} if frame.labels is None else {f"labels {index}": frame.labels}
    if scene.truth is not None:
        content |= {} if scene.truth.points is None else {"truth": scene.truth.points}
        content |= {f"truth {index}": labels for index, labels in enumerate(scene.truth.images)}
    return content


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    """Whether two contents are equal."""
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)
