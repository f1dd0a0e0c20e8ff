"""Segments a scene while its cloud grows."""

from torchjoint.live.rerun_log import RerunLog
from torchjoint.live.segmenter import LiveResult, LiveSegmenter

__all__ = ["LiveResult", "LiveSegmenter", "RerunLog"]
