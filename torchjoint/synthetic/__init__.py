"""Seeded synthetic indoor scenes with exact ground-truth instances for every point and every pixel.

:func:`make_scene` furnishes a room (:mod:`~torchjoint.synthetic.room`, with :mod:`~torchjoint.synthetic.furniture` and
:mod:`~torchjoint.synthetic.clutter`), moves a camera through it (:mod:`~torchjoint.synthetic.trajectory`), casts rays
(:mod:`~torchjoint.synthetic.render`), adds the errors of a Kinect-like camera (:mod:`~torchjoint.synthetic.sensor`),
and fuses a point cloud (:mod:`~torchjoint.synthetic.cloud`).

The scenes contain the difficulties of joint segmentation on purpose: prints and grain inside objects, neighbours of one
colour, flat things on flat things, doors and posters flush with walls, slatted chairs in front of cupboards, hollow
bowls, cast shadows, changing exposure, motion blur, depth noise, holes, pose errors, clouds of uneven density.
Optional: depth errors that are correlated between neighbours.
"""

from torchjoint.synthetic.scene import SyntheticScene, make_scene

__all__ = ["SyntheticScene", "make_scene"]
