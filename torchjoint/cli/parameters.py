"""torchjoint parameters: prints parameters as tables."""

from __future__ import annotations

from typing import Annotated

import tyro

from torchjoint.config import marked_table, parameter_table, superpoint_table


def parameters(
    stage: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[STAGE]")] = None,
    superpoints: bool = False,
) -> None:
    """Prints the parameters of the method with default, unit, sensible range and effect (Markdown).

    The first table has the few parameters that a user turns, and what a value that is too low or too high looks like.

    Args:
        stage: print the parameters of this stage alone, such as paper.
        superpoints: print the parameters of `torchjoint superpoints` instead, with their values in each preset.
    """
    if superpoints and stage is not None:
        raise ValueError(f"parameters: superpoints have one table; leave {stage!r} out")
    if superpoints:
        print(superpoint_table())
    elif stage is not None:
        print(parameter_table(stage))
    else:
        print(f"{marked_table()}\n\n{parameter_table()}")
