"""Furnished rooms with the exact instance of every point and every pixel; embreex casts their rays.

:func:`make_scene` furnishes a room (`room`, with `furniture` and `clutter`), moves a camera through it (`trajectory`),
casts rays (`render`), adds the errors of a Kinect-like camera (`sensor`), and fuses a point cloud (`cloud`).

The scenes contain the difficulties of joint segmentation on purpose: prints and grain inside objects, neighbours of one
colour, flat things on flat things, doors and posters flush with walls, slatted chairs in front of cupboards, hollow
bowls, cast shadows, changing exposure, motion blur, depth noise, holes, pose errors, clouds of uneven density.
Optional: depth errors that are correlated between neighbours.
"""

from torchjoint_lab.synthetic.furnished.scene import make_scene

__all__ = ["make_scene"]
