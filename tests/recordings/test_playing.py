"""A recording is played as its camera took it: frames wait for their time, and late ones are dropped."""

from __future__ import annotations

import threading

import pytest

from torchjoint.recordings import playing
from torchjoint.recordings.playing import Played, computed_beside, play


class Segmenter:
    """Stands for a LiveSegmenter, and for the clock: each frame takes its seconds; every second one is a keyframe."""

    def __init__(self, monkeypatch) -> None:
        self.time, self.names, self.begun = 0.0, [], []
        monkeypatch.setattr(playing, "time", self)

    def update(self, frame: tuple[int, float]) -> None:
        number, seconds = frame
        self.begun.append((number, self.time))
        self.time += seconds
        if number % 2 == 0:
            self.names.append(str(number))

    def monotonic(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


def test_frames_wait_for_their_time(monkeypatch):
    segmenter = Segmenter(monkeypatch)
    played = play([(number, 0.5) for number in range(4)], segmenter, 1.0)
    assert segmenter.begun == [(0, 0.0), (1, 1.0), (2, 2.0), (3, 3.0)]
    assert played == ([0, 2], [], [0.5] * 4)


def test_what_comes_too_late_is_dropped(monkeypatch):
    segmenter = Segmenter(monkeypatch)
    frames = [(number, 2.5 if number == 0 else 0.1) for number in range(5)]
    told = []
    played = play(frames, segmenter, 1.0, lambda *values: told.append(values))
    # At 2.5 s, frame 1 has been replaced by frame 2, which came at 2 s.
    assert segmenter.begun == [(0, 0.0), (2, 2.5), (3, 3.0), (4, 4.0)]
    assert played.dropped == [1]
    assert played.told_dropped() == "1 dropped (1)"
    assert told == [(1, frames[0]), (2, None), (3, frames[2]), (4, frames[3]), (5, frames[4])]


def test_the_first_frame_is_not_dropped(monkeypatch):
    """A busy machine may begin late; a run of which all frames are dropped has nothing to tell."""
    segmenter = Segmenter(monkeypatch)

    def monotonic() -> float:
        segmenter.time += 2.5
        return segmenter.time

    monkeypatch.setattr(segmenter, "monotonic", monotonic)
    played = play([(number, 0.0) for number in range(3)], segmenter, 1.0)
    assert [number for number, _ in segmenter.begun] == [0]
    assert played.dropped == [1, 2]


def test_dropped_frames_are_told_in_ranges():
    assert Played([], [2, 3, 4, 9], [0.1] * 6).told_dropped() == "4 dropped (2-4, 9)"
    assert Played([], [], []).told_dropped() == "0 dropped"
    assert "more than half: a lower --rate, or none" in Played([], [2, 3, 4, 9], [0.1]).told_dropped()


def test_without_a_rate_no_frame_waits_or_is_dropped(monkeypatch):
    segmenter = Segmenter(monkeypatch)
    play([(number, 9.0) for number in range(3)], segmenter)
    assert [begun for _, begun in segmenter.begun] == [0.0, 9.0, 18.0]


def test_one_result_at_a_time_is_computed_beside():
    begun, may_end, ended = [], threading.Event(), threading.Semaphore(0)

    def compute(count: int) -> None:
        begun.append((count, threading.get_ident()))
        assert may_end.wait(60)
        ended.release()

    with computed_beside(compute, 2) as due:
        for count in range(1, 6):  # 2 begins; at 4 it still runs
            due(count)
        may_end.set()
        assert ended.acquire(timeout=60)
        count = 6
        while len(begun) < 2:  # the thread ends a little later
            due(count)
            count += 2
    assert begun[0][0] == 2
    assert begun[1][0] >= 6
    assert all(thread != threading.get_ident() for _, thread in begun)
    before = len(begun)
    with computed_beside(compute, 0) as due:
        due(2)
    assert len(begun) == before


def test_errors_of_a_result_are_raised():
    def fail(count: int) -> None:
        raise ValueError(f"after {count}")

    def go_on(due) -> None:
        while True:
            due(1)

    with pytest.raises(ValueError, match="after 1"), computed_beside(fail, 1) as due:
        due(1)
    with pytest.raises(ValueError, match="after 1"), computed_beside(fail, 1) as due:
        go_on(due)  # at a later frame
