"""Segments one long recording on many workers: each handles chunks of frames, and their evidence is added."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from torchjoint.engine import Engine
from torchjoint.joint import JointSegmenter, Watch
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.views.state import JointState

#: Chunks for each worker, so that all workers finish at about the same time; and most frames in a chunk.
CHUNKS, LARGEST = 4, 64

#: Frames that a worker holds at a time.
BATCH = 8


def segment_over(
    engine: Engine,
    segmenter: JointSegmenter,
    scene: Scene,
    *,
    progress: bool = False,
    checkpoint: Checkpoint | None = None,
    on_frames: Watch | None = None,
) -> Segmentation:
    """Segments a scene as ``segmenter(scene)`` does, with the same labels; workers do steps 1, 2, 4 and 5.

    The cloud and its graph are sent once to each worker. The workers read those frames that are on disk.

    Args:
        engine: the workers.
        segmenter: gives the parameters; it has all the evidence afterwards.
        scene: the cloud and its frames.
        progress: show progress bars.
        checkpoint: saves the state from time to time; an interrupted run resumes from it.
        on_frames: is called when evidence was added, see :meth:`torchjoint.JointSegmenter.forward`.

    Raises:
        WorkerDied: two workers died with the same chunk.
        ConnectionError: the engine cannot be reached any more.
        ValueError, TypeError, OSError: as from the segmenter, or from reading frames.
    """
    segmenter.begin(scene, checkpoint)
    steps = _add_chunks(engine, segmenter, scene.frames)
    return segmenter.finish(scene, steps, progress=progress, checkpoint=checkpoint, on_frames=on_frames)


def _add_chunks(engine: Engine, segmenter: JointSegmenter, frames: Sequence[Frame]) -> Iterator[int]:
    """Adds the evidence of the frames that the segmenter's state lacks, when it arrives from the workers."""
    for evidence, seconds in _in_order(engine, segmenter, frames, len(segmenter.state.observations)):
        segmenter.state = segmenter.state + evidence
        segmenter.stopwatch.add(seconds)
        yield len(evidence.observations)


def _in_order(
    engine: Engine, segmenter: JointSegmenter, frames: Sequence[Frame], done: int
) -> Iterator[tuple[JointState, dict[str, float]]]:
    """Yields the evidence of the chunks of frames from index `done` on, in the order of the frames."""
    if done == len(frames):
        return
    size = min(LARGEST, math.ceil((len(frames) - done) / (CHUNKS * max(1, engine.slots()))))
    chunks = [range(len(frames))[start : start + size] for start in range(done, len(frames), size)]
    ready: dict[int, tuple[JointState, dict[str, float]]] = {}
    following = 0
    for outcome in engine.run(_evidence, chunks, (segmenter.without_evidence(), frames)):
        if outcome.error is not None:
            raise outcome.error
        assert outcome.value is not None
        ready[outcome.index] = outcome.value
        while following in ready:
            yield ready.pop(following)
            following += 1


def _evidence(shared: tuple[JointSegmenter, Sequence[Frame]], chunk: range) -> tuple[JointState, dict[str, float]]:
    """The task of a worker: computes the evidence of a chunk, and the seconds by stage."""
    segmenter, frames = shared
    own = segmenter.without_evidence()  # a copy, because other tasks of this worker use the shared segmenter
    for start in range(0, len(chunk), BATCH):
        with own.stopwatch("load frames"):
            batch = [frames[index] for index in chunk[start : start + BATCH]]
        own.add(batch)
    return own.state, own.stopwatch.seconds
