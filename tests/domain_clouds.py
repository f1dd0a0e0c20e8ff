"""Clouds of generated scenes, each made once."""

import functools

from torchjoint_lab.synthetic import make_domain_scene


@functools.cache
def domain_cloud(domain, seed):
    """The points of a scene with two views. Tests leave them as they are."""
    return make_domain_scene(domain, seed, num_views=2).scene.points
