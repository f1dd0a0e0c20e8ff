"""One recording over many workers: the same labels as in one process."""

from dataclasses import replace

import pytest
import torch
from test_batch import HereEngine

import torchjoint as tj
from torchjoint.recordings.segment import evidence_of_chunks, run
from torchjoint.results.checkpoint import Checkpoint

QUICK = tj.Config().set(["boundary.detector=gradient"])


def assert_same(one, other):
    assert torch.equal(one.points, other.points)
    assert one.names == other.names
    for labels, others in zip(one.images, other.images, strict=True):
        assert torch.equal(labels, others)


class BackwardEngine(HereEngine):
    """Its tasks end in the reverse order; with a limit, it breaks after some."""

    def __init__(self, limit=None):
        super().__init__()
        self.limit = limit

    def run(self, function, tasks, shared):
        outcomes = list(super().run(function, tasks, shared))
        assert len(outcomes) > 2
        yield from outcomes[: self.limit] if self.limit else reversed(outcomes)
        if self.limit:
            raise ConnectionError("cut")


@pytest.fixture(scope="module")
def whole(scene_of):
    return tj.JointSegmenter(QUICK)(scene_of(2).scene)


def test_any_order(whole, scene_of, tmp_path):
    scene, segmenter = scene_of(2).scene, tj.JointSegmenter(QUICK)
    checkpoint = Checkpoint(tmp_path / "state", "key")
    with pytest.raises(ConnectionError):
        run(segmenter, scene, checkpoint, engine=BackwardEngine(limit=2))
    again = Checkpoint(tmp_path / "state", "key")
    segmenter = tj.JointSegmenter(QUICK)
    assert_same(run(segmenter, scene, again, engine=BackwardEngine()), whole)
    assert segmenter.stopwatch.seconds["boundaries"] > 0


def test_an_error_of_a_frame_is_raised(scene_of):
    scene = scene_of(2).scene

    class Damaged(tuple):
        def __getitem__(self, index):
            raise OSError("frame.png: damaged")

    segmenter = tj.JointSegmenter(QUICK)
    segmenter.reset(scene.points)
    damaged = replace(scene, frames=Damaged(scene.frames))
    with pytest.raises(OSError, match=r"frame.png: damaged"):
        list(evidence_of_chunks(HereEngine())(segmenter, damaged))
