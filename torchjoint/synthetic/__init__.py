"""Seeded rooms for tests and examples, cast by rays: the instance of every point and pixel is exact."""

from torchjoint.synthetic.scene import SyntheticScene, make_scene

__all__ = ["SyntheticScene", "make_scene"]
