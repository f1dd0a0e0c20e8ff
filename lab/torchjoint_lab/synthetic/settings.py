"""How hard a scene of a domain is: its sensor, its cameras, its cloud and its taste, drawn from wide distributions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.making import log_uniform

#: The names of the domains.
DOMAINS = ("table", "shelf", "bin", "desk", "kitchen", "room", "workshop", "street")
#: What measures depth.
SENSORS = ("structured light", "stereo", "time of flight", "lidar")


class DomainSettings(NamedTuple):
    """What was drawn for one scene.

    Attributes:
        domain: one of :data:`DOMAINS`.
        seed: the scene's.
        sensor: one of :data:`SENSORS`.
        num_views: images.
        height, width: of the images, pixels.
        field_of_view: of the images, degrees, horizontal.
        num_points: most points of the cloud.
        spacing: side of the cells that the cloud is thinned to, metres (of a LiDAR scan: 0).
        depth_noise: standard deviation at 1 m, metres; of a LiDAR at every range.
        depth_ripple: of the part that neighbours share (structured light), metres at 1 m.
        depth_step: rounding of depths at 1 m, metres.
        holes: scales the probability of holes in the depth, 0 to 1.
        registration: pixels by which depth images are shifted against the colour, (rows, columns).
        keeps_depth: whether the frames carry their depth images.
        pose_error: standard deviation of reported positions, metres.
        exposure: standard deviation of the logarithm of the exposure, from view to view.
        image_noise: standard deviation, of [0, 1].
        motion_blur: typical length, pixels of an image 480 high.
        jpeg: quality, 100 = none.
        similar: probability that a thing takes one of the scene's own colours.
        printed: probability that a package or cloth has a print.
        difficult: probability that a thing is glossy, black or half transparent to the sensor.
        clutter: scales the number of things.
        cropped: whether the cloud holds only the surroundings of the things.
        beams: of the LiDAR; 0 for cameras.
    """

    domain: str
    seed: int
    sensor: str
    num_views: int
    height: int
    width: int
    field_of_view: float
    num_points: int
    spacing: float
    depth_noise: float
    depth_ripple: float
    depth_step: float
    holes: float
    registration: tuple[int, int]
    keeps_depth: bool
    pose_error: float
    exposure: float
    image_noise: float
    motion_blur: float
    jpeg: int
    similar: float
    printed: float
    difficult: float
    clutter: float
    cropped: bool
    beams: int


class _Range(NamedTuple):
    """Least and greatest of what depends on the domain, drawn log-uniformly."""

    views: tuple[int, int]
    single: float
    spacing: tuple[float, float]
    points: tuple[int, int]


_RANGES = {
    "table": _Range((2, 12), 0.5, (0.0015, 0.008), (8_000, 200_000)),
    "shelf": _Range((2, 20), 0.15, (0.0015, 0.01), (10_000, 250_000)),
    "bin": _Range((2, 15), 0.35, (0.001, 0.007), (8_000, 200_000)),
    "desk": _Range((5, 60), 0.0, (0.002, 0.012), (12_000, 250_000)),
    "kitchen": _Range((8, 100), 0.0, (0.005, 0.03), (15_000, 250_000)),
    "room": _Range((6, 100), 0.0, (0.008, 0.03), (15_000, 250_000)),
    "workshop": _Range((3, 25), 0.05, (0.003, 0.02), (12_000, 250_000)),
    "street": _Range((2, 6), 0.4, (0.01, 0.02), (120_000, 150_000)),
}


def domain_settings(domain: str, seed: int = 0) -> DomainSettings:
    """What :func:`~torchjoint_lab.synthetic.make_domain_scene` draws for ``domain`` and ``seed``.

    Raises:
        ValueError: the message names the argument.
    """
    if domain not in DOMAINS:
        raise ValueError(f"domain: expected one of {', '.join(map(repr, DOMAINS))}, got {domain!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ValueError(f"seed: expected an integer of at least 0, got {seed!r}")
    rng = np.random.default_rng(np.random.SeedSequence([DOMAINS.index(domain), int(seed)], spawn_key=(0,)))
    limits, street = _RANGES[domain], domain == "street"
    views = 1 if rng.random() < limits.single else round(log_uniform(rng, *limits.views))
    scale = 1.5 if views == 1 and not street else 1.0 if views > 6 else float(rng.choice([1.0, 1.25]))
    noise = rng.uniform(0.01, 0.03) if street else log_uniform(rng, 0.0002, 0.005)
    sensor = "lidar" if street else SENSORS[int(rng.choice(3, p=[0.5, 0.25, 0.25]))]
    return DomainSettings(
        domain=domain,
        seed=int(seed),
        sensor=sensor,
        num_views=views,
        height=round(240 * scale),
        width=round(320 * scale),
        field_of_view=float(rng.uniform(50, 90) if street else rng.uniform(48, 68)),
        num_points=round(log_uniform(rng, *limits.points)),
        spacing=0.0 if street else log_uniform(rng, *limits.spacing),
        depth_noise=noise,
        depth_ripple=noise * rng.uniform(0.3, 1.5) if sensor == "structured light" and rng.random() < 0.5 else 0.0,
        depth_step=noise * log_uniform(rng, 0.2, 2.0),
        holes=float(rng.uniform(0.2, 1.0)),
        registration=(int(rng.choice([-1, 0, 0, 0, 1])), int(rng.choice([-1, 0, 0, 0, 1]))),
        keeps_depth=street or bool(rng.random() < 0.85),
        pose_error=_pose_error(rng, views),
        exposure=float(rng.uniform(0, 0.3)),
        image_noise=log_uniform(rng, 0.003, 0.04),
        motion_blur=float(rng.uniform(0, 6) * rng.integers(2)),
        jpeg=int(rng.choice(np.array([100, rng.integers(40, 96), rng.integers(75, 96)]))),
        similar=float(rng.uniform(0.1, 0.8)) if rng.random() < 0.5 else 0.05,
        printed=float(rng.uniform(0.3, 1.0)),
        difficult=float(rng.uniform(0.0, 0.25)),
        clutter=log_uniform(rng, 0.5, 2.0),
        cropped=bool(rng.random() < 0.35),
        beams=int(rng.choice([16, 32, 64], p=[0.2, 0.3, 0.5])) if street else 0,
    )


def _pose_error(rng: Rng, views: int) -> float:
    """None for single views and for a sixth of the others; 1 to 5 mm mostly, up to 2 cm."""
    value = float(np.clip(np.exp(rng.normal(np.log(0.0025), 0.7)), 0.0005, 0.02))
    exact = bool(rng.random() < 1 / 6)
    return 0.0 if views == 1 or exact else value
