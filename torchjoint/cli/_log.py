"""Prints what the package logs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def printed_log() -> Iterator[None]:
    """Inside the block, log messages of the package are printed to stderr as ``torchjoint: ...``."""
    logger, handler = logging.getLogger("torchjoint"), logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("torchjoint: %(message)s"))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
