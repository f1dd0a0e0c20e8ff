"""Plays a recording as its camera took it, for live segmentation: what comes too late is dropped."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

from torchjoint.live import LiveSegmenter
from torchjoint.scene import Frame


class Played(NamedTuple):
    """What became of the frames, by their numbers."""

    keyframes: list[int]
    dropped: list[int]
    seconds: list[float]  #: of each frame that was not dropped, to read and to add it

    def told_dropped(self) -> str:
        """How many frames were dropped, and which, from 0: "4 dropped (2-4, 9)"; of many only how many."""
        if len(self.dropped) > len(self.seconds):
            return f"{len(self.dropped)} dropped, more than half: a lower --rate, or none, takes more"
        others = set(self.dropped)
        first = [one for one in self.dropped if one - 1 not in others]
        last = [one for one in self.dropped if one + 1 not in others]
        which = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in zip(first, last, strict=True))
        return f"{len(self.dropped)} dropped" + (f" ({which})" if which else "")


def play(
    frames: Sequence[Frame],
    segmenter: LiveSegmenter,
    rate: float | None = None,
    told: Callable[[int, Frame | None], None] | None = None,
) -> Played:
    """Gives frames to a segmenter, none before its time.

    Args:
        frames: of the recording.
        segmenter: gets the frames.
        rate: frames a second of the camera; a frame that could only begin when the next one is due is dropped, but
            for the first. None: no frame is dropped, and none waits.
        told: called after each frame with the number of frames so far and the frame, None if it was dropped; its time
            counts, too.
    """
    played = Played([], [], [])
    start = time.monotonic()
    for index in range(len(frames)):
        began, frame = time.monotonic(), None
        early = 0.0 if rate is None else start + index / rate - began
        if rate is not None and index and early <= -1 / rate:
            played.dropped.append(index)
        else:
            time.sleep(max(early, 0.0))
            began = time.monotonic()
            before = len(segmenter.names)
            frame = frames[index]
            segmenter.update(frame)
            if len(segmenter.names) > before:
                played.keyframes.append(index)
            played.seconds.append(time.monotonic() - began)
        if told is not None:
            told(index + 1, frame)
    return played


@contextmanager
def computed_beside(compute: Callable[[int], object], every: int) -> Iterator[Callable[[int], None]]:
    """Computes results in another thread while frames go on, for `told` of :func:`play`.

    The function of this block takes the number of frames so far. After each `every` frames it begins `compute` of this
    number, unless one still runs; 0: never. Its errors are raised at the next frame, or at the end of the block, which
    waits.
    """
    running: list[Future[object]] = []
    with ThreadPoolExecutor(1) as beside:

        def due(count: int) -> None:
            if running and running[-1].done():
                running.pop().result()  # raises its error
            if every and count % every == 0 and not running:
                running.append(beside.submit(compute, count))

        yield due
    for one in running:
        one.result()
