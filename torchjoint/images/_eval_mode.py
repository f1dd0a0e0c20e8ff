"""Steps 1 and 2: runs a caller's network in evaluation mode."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from torch import nn


@contextmanager
def eval_mode(module: nn.Module) -> Iterator[None]:
    """Sets a module and all its parts to evaluation mode inside a block, and restores their modes afterwards.

    In training mode the output would depend on the batches of frames. The old modes are restored because the module
    belongs to the caller.
    """
    before = [(part, part.training) for part in module.modules()]
    module.eval()
    try:
        yield
    finally:
        for part, training in before:
            part.training = training
