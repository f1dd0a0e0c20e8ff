"""torchjoint parameters: prints all parameters as tables."""

from __future__ import annotations

from torchjoint.config import marked_table, parameter_table, superpoint_table


def parameters(superpoints: bool = False) -> None:
    """Prints all parameters of the method with default, unit, sensible range and effect (Markdown).

    The first table has the few parameters that a user turns, and what a value that is too low or too high looks like.

    Args:
        superpoints: print the parameters of `torchjoint superpoints` instead, with their values in each preset.
    """
    print(superpoint_table() if superpoints else f"{marked_table()}\n\n{parameter_table()}")
