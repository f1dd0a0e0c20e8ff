"""Seeded synthetic indoor scenes with exact instance truth for every point and every pixel.

:func:`make_scene` furnishes a room (:mod:`~torchjoint.synthetic.room`, of :mod:`~torchjoint.synthetic.furniture` and
:mod:`~torchjoint.synthetic.clutter`), walks through it (:mod:`~torchjoint.synthetic.trajectory`), casts rays
(:mod:`~torchjoint.synthetic.render`), spoils what they return as a Kinect-like camera would
(:mod:`~torchjoint.synthetic.sensor`), and fuses a cloud of it (:mod:`~torchjoint.synthetic.cloud`).

What makes joint segmentation hard is there on purpose: prints and grain inside objects, neighbours of one colour, flat
things on flat things, doors and posters flush with walls, slatted chairs before cupboards, hollow bowls, cast shadows,
changing exposure, motion blur, depth noise, holes, pose errors, uneven clouds. Optional, for they came later: depth
errors that neighbours share, and harder rooms (:mod:`~torchjoint.synthetic.hard`) with more flat things
(:mod:`~torchjoint.synthetic.flats`), more that cuts what is behind it in two (:mod:`~torchjoint.synthetic.occluders`)
and more that is hollow (:mod:`~torchjoint.synthetic.vessels`).
"""

from torchjoint.synthetic.scene import SyntheticScene, make_scene

__all__ = ["SyntheticScene", "make_scene"]
