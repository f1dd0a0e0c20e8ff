"""Prints what the package logs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from torchjoint.runtime.messages import on_terminal


class _Formatter(logging.Formatter):
    """Messages may have names of others."""

    def format(self, record: logging.LogRecord) -> str:
        return on_terminal(super().format(record))


@contextmanager
def printed_log() -> Iterator[None]:
    """Inside the block, log messages of the package are printed to stderr as ``torchjoint: ...``."""
    logger, handler = logging.getLogger("torchjoint"), logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter("torchjoint: %(message)s"))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
