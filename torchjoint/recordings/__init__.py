"""Segments recordings on disk into result folders: one recording, or any number of them on many workers."""

from torchjoint.recordings.batch import BatchReport, batch
from torchjoint.recordings.scene_list import find_recordings
from torchjoint.recordings.segment import RecordingOptions, segment_recording

__all__ = ["BatchReport", "RecordingOptions", "batch", "find_recordings", "segment_recording"]
