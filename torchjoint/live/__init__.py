"""Segments a scene while its cloud grows."""

from torchjoint.live.segmenter import LiveResult, LiveSegmenter

__all__ = ["LiveResult", "LiveSegmenter"]
