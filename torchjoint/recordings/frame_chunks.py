"""Segments one long recording on many workers: each handles chunks of frames, and their evidence is added."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.engine import Engine
from torchjoint.images.segmenter import ImageSegmenter
from torchjoint.joint import JointSegmenter, observe
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.scene import Frame, Scene
from torchjoint.views.evidence import Evidence

#: Chunks for each worker, so that all workers finish at about the same time; and most frames in a chunk.
CHUNKS, LARGEST = 4, 64

#: Frames that a worker holds at a time.
BATCH = 8


def evidence_of_chunks(engine: Engine) -> Callable[[JointSegmenter, Scene], Iterator[Evidence]]:
    """The evidence of frames, by the workers of an engine: `workers` of :meth:`torchjoint.JointSegmenter.steps`."""
    return partial(_in_order, engine)


def _in_order(engine: Engine, segmenter: JointSegmenter, scene: Scene) -> Iterator[Evidence]:
    """The evidence of the frames that the segmenter's state lacks, in their order (steps 1, 2, 4 and 5).

    The cloud's graph is sent once to each worker. The workers read those frames that are on disk.

    Args:
        engine: the workers.
        segmenter: has been reset to the scene's cloud.
        scene: the cloud and its frames.

    Raises:
        WorkerDied: two workers died with the same chunk.
        ConnectionError: the engine cannot be reached any more.
        ValueError, TypeError, OSError: as from the segmenter, or from reading frames.
    """
    frames, done = scene.frames, len(segmenter.state.observations)
    if done == len(frames):
        return
    size = min(LARGEST, math.ceil((len(frames) - done) / (CHUNKS * max(1, engine.slots()))))
    chunks = [range(len(frames))[start : start + size] for start in range(done, len(frames), size)]
    ready: dict[int, tuple[Evidence, dict[str, float]]] = {}
    following = 0
    shared = (frames, segmenter.graph, segmenter.config, segmenter.image_segmenter)
    for outcome in engine.run(_evidence, chunks, shared):
        if outcome.error is not None:
            raise outcome.error
        assert outcome.value is not None
        ready[outcome.index] = outcome.value
        while following in ready:
            evidence, seconds = ready.pop(following)
            segmenter.stopwatch.add(seconds)
            yield evidence
            following += 1


def _evidence(
    shared: tuple[Sequence[Frame], PointGraph, Config, ImageSegmenter], chunk: range
) -> tuple[Evidence, dict[str, float]]:
    """The task of a worker: computes the evidence of a chunk, and the seconds by stage."""
    frames, graph, config, images = shared
    evidence, stopwatch = Evidence.empty(graph), Stopwatch()
    for start in range(0, len(chunk), BATCH):
        with stopwatch("load frames"):
            batch = [frames[index] for index in chunk[start : start + BATCH]]
        evidence += observe(batch, graph, config, images, stopwatch)
    return evidence, stopwatch.seconds
