"""A recording is played as its camera took it: frames wait for their time, and late ones are dropped."""

from __future__ import annotations

from torchjoint.recordings.playing import Clock, Played, play


class Segmenter:
    """Stands for a LiveSegmenter: each frame takes its number of seconds; every second frame is a keyframe."""

    def __init__(self) -> None:
        self.time, self.names, self.begun = 0.0, [], []

    def update(self, frame: tuple[int, float]) -> None:
        number, seconds = frame
        self.begun.append((number, self.time))
        self.time += seconds
        if number % 2 == 0:
            self.names.append(str(number))

    def clock(self) -> Clock:
        def wait(seconds: float) -> None:
            self.time += seconds

        return Clock(lambda: self.time, wait)


def test_frames_wait_for_their_time():
    segmenter = Segmenter()
    played = play([(number, 0.5) for number in range(4)], segmenter, 1.0, clock=segmenter.clock())
    assert segmenter.begun == [(0, 0.0), (1, 1.0), (2, 2.0), (3, 3.0)]
    assert played == ([0, 2], [], [0.5] * 4)


def test_what_comes_too_late_is_dropped():
    segmenter = Segmenter()
    frames = [(number, 2.5 if number == 0 else 0.1) for number in range(5)]
    told = []
    played = play(frames, segmenter, 1.0, lambda *values: told.append(values), segmenter.clock())
    # At 2.5 s, frame 1 has been replaced by frame 2, which came at 2 s.
    assert segmenter.begun == [(0, 0.0), (2, 2.5), (3, 3.0), (4, 4.0)]
    assert played.dropped == [1]
    assert played.told_dropped() == "1 dropped (1)"
    assert told == [(1, frames[0]), (2, None), (3, frames[2]), (4, frames[3]), (5, frames[4])]


def test_dropped_frames_are_told_in_ranges():
    assert Played([], [2, 3, 4, 9], []).told_dropped() == "4 dropped (2-4, 9)"
    assert Played([], [], []).told_dropped() == "0 dropped"


def test_without_a_rate_no_frame_waits_or_is_dropped():
    segmenter = Segmenter()
    play([(number, 9.0) for number in range(3)], segmenter, clock=segmenter.clock())
    assert [begun for _, begun in segmenter.begun] == [0.0, 9.0, 18.0]
