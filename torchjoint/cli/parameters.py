"""torchjoint parameters: prints all parameters as tables."""

from __future__ import annotations

from torchjoint.config import parameter_table, superpoint_table


def parameters(superpoints: bool = False) -> None:
    """Prints all parameters of the method with default, unit, sensible range and effect (Markdown).

    Args:
        superpoints: print the parameters of `torchjoint superpoints` instead, with their values in each preset.
    """
    print(superpoint_table() if superpoints else parameter_table())
