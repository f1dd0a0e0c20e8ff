"""A caller's network in evaluation mode, for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch import nn


@contextmanager
def eval_mode(module: nn.Module) -> Iterator[None]:
    """Within, the module and all its parts are in evaluation mode; afterwards each is in the mode that it was in.

    A network's batch statistics must not depend on how frames are batched, and the module is its owner's.
    """
    before = [(part, part.training) for part in module.modules()]
    module.eval()
    try:
        yield
    finally:
        for part, training in before:
            part.training = training
