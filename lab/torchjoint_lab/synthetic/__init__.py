"""Synthetic scenes of many domains, with exact labels, for training and checking.

:func:`make_domain_scene` makes a scene of a domain (:data:`DOMAINS`: tables, shelves, bins, desks, kitchens, rooms,
workshops, LiDAR streets); :func:`domain_settings` returns the difficulties that are drawn for a scene. Rooms of
:mod:`~torchjoint_lab.synthetic.furnished` lie below; :func:`make_scene` makes them, or harder ones, with more flat
things (:mod:`~torchjoint_lab.synthetic.flats`), more slender things that split the object behind them
(:mod:`~torchjoint_lab.synthetic.occluders`), and more hollow things (:mod:`~torchjoint_lab.synthetic.vessels`).
"""

from torchjoint.synthetic import SyntheticScene
from torchjoint_lab.synthetic.domains import make_domain_scene
from torchjoint_lab.synthetic.hard_rooms import make_scene
from torchjoint_lab.synthetic.lidar_scan import LIDARS
from torchjoint_lab.synthetic.network_masks import MASK_LEVELS, known_things, make_network_masks, with_network_masks
from torchjoint_lab.synthetic.settings import DOMAINS, DomainSettings, domain_settings

__all__ = [
    "DOMAINS",
    "LIDARS",
    "MASK_LEVELS",
    "DomainSettings",
    "SyntheticScene",
    "domain_settings",
    "known_things",
    "make_domain_scene",
    "make_network_masks",
    "make_scene",
    "with_network_masks",
]
