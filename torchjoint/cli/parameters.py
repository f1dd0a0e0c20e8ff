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

    The first table lists the few parameters that users change, and the effect of values that are too low or too high.

    Args:
        stage: print only the parameters of this stage, such as paper.
        superpoints: print the parameters of `torchjoint superpoints` instead, with their values in each preset.
    """
    if superpoints and stage is not None:
        raise ValueError(f"parameters: expected no stage with --superpoints, which have one table, got {stage!r}")
    if superpoints:
        print(superpoint_table())
    elif stage is not None:
        print(parameter_table(stage))
    else:
        print(f"{marked_table()}\n\n{parameter_table()}")
