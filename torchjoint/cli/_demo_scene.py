"""The scene of `torchjoint demo`. It is not saved to disk: `torchjoint show --truth` makes it again."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torchjoint.synthetic import SyntheticScene

from torchjoint.runtime.messages import say

#: The name of the scene in run.yaml.
SOURCE = "synthetic, seed 0"


def demo_scene() -> SyntheticScene:
    """Makes the scene, with its ground truth.

    Raises:
        ModuleNotFoundError: embreex, which casts the rays, is not installed.
    """
    from torchjoint.synthetic import make_scene

    say("making a synthetic scene ...", flush=True)
    return make_scene(seed=0, size="medium", height=360, width=480, num_points=150_000)
