"""Things of desks; each function draws one as one instance."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic import prints
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.mesh import Part, ball, box, cup, cylinder, tube
from torchjoint_lab.synthetic.furnished.world import Item
from torchjoint_lab.synthetic.household import THINGS, book, bowl, mug, packet, vessel
from torchjoint_lab.synthetic.making import Maker, made
from torchjoint_lab.synthetic.solids import blob, euler, ring, rod, rounded_box, turned
from torchjoint_lab.synthetic.style import Style


def monitor(rng: Rng, style: Style) -> Item:
    """A monitor on a stand: dark or showing a picture; its glass seldom returns depth."""
    w, t = rng.uniform(0.4, 0.7), rng.uniform(0.015, 0.05)
    h, foot = w * rng.uniform(0.56, 0.75), rng.uniform(0.08, 0.16)
    case = paint.plain(rng, paint.pick(rng, paint.SOBER[:5]), 0.3)
    dark = paint.plain(rng, np.array([0.05, 0.055, 0.06]), 0.8, rng.uniform(0.3, 0.9))
    page = dark if rng.random() < 0.5 else (prints.photo if rng.random() < 0.5 else prints.text_page)(rng, (w, h))
    parts = [(box((w, t, h), (0, 0, foot)), case)]
    parts.append((box((w - 0.025, 0.002, h - 0.03), (0, -t / 2 - 0.001, foot + 0.018)), page))
    parts.append((box((0.06, 0.03, foot + 0.1), (0, t / 2 + 0.015, 0)), case))
    plate: Part = cylinder(0.13, 0.012, (0, 0.03, 0)) if rng.random() < 0.5 else box((0.25, 0.18, 0.012), (0, 0.03, 0))
    return made("monitor", [*parts, (plate, case)])


def keyboard(rng: Rng, style: Style) -> Item:
    """A keyboard with raised keys."""
    w, d = rng.uniform(0.28, 0.46), rng.uniform(0.11, 0.17)
    case = paint.plain(rng, paint.pick(rng, paint.SOBER), 0.2)
    tone = paint.pick(rng, paint.SOBER)
    caps, parts = paint.checker(rng, tone, tone * rng.uniform(0.8, 1.1), 0.03), [(box((w, d, 0.014)), case)]
    pitch = 0.0192
    for row in range(int((d - 0.02) / pitch)):
        y = d / 2 - 0.018 - row * pitch
        for x in np.arange(-w / 2 + 0.016, w / 2 - 0.012, pitch):
            parts.append((box((0.015, 0.015, 0.006), (x, y, 0.014)), caps))
    return made("keyboard", parts)


def mouse(rng: Rng, style: Style) -> Item:
    """A mouse with a bit of cable now and then."""
    coat = paint.plain(rng, paint.pick(rng, paint.SOBER), 0.3)
    parts = [(blob(rng, (0.06, 0.11, 0.036), 0.01, 0.8), coat)]
    if rng.random() < 0.5:
        y = np.linspace(0.05, 0.3, 12)
        sway = 0.03 * np.sin(9 * y + rng.uniform(0, 6))
        parts.append((tube(np.stack([sway, y, 0 * y + 0.003], axis=1), 0.002), coat))
    return made("mouse", parts)


def laptop(rng: Rng, style: Style) -> Item:
    """A laptop, open at any angle, or closed."""
    w, d = rng.uniform(0.28, 0.38), rng.uniform(0.2, 0.26)
    case = paint.plain(rng, paint.pick(rng, paint.SOBER), rng.uniform(0.1, 0.7))
    keys = paint.checker(rng, np.array([0.15, 0.15, 0.16]), np.array([0.1, 0.1, 0.11]), 0.036)
    if rng.random() < 0.2:
        return made("laptop", [(rounded_box((w, d, 0.02), 0.006), case)])
    dark = paint.plain(rng, np.array([0.06, 0.07, 0.09]), 0.8, rng.uniform(0.2, 0.8))
    page = dark if rng.random() < 0.6 else prints.photo(rng, (w, d))
    turn, hinge = euler(0, -rng.uniform(0.1, 0.6)), (0, d / 2, 0.014)
    parts = [(box((w, d, 0.016)), case), (box((0.88 * w, 0.5 * d, 0.001), (0, 0.12 * d, 0.016)), keys)]
    parts.append((turned(box((w, 0.006, 0.9 * d)), turn, hinge), case))
    parts.append((turned(box((w - 0.02, 0.001, 0.85 * d), (0, -0.0037, 0.02)), turn, hinge), page))
    return made("laptop", parts)


def phone(rng: Rng, style: Style) -> Item:
    """A telephone, a tablet, a calculator or a remote control."""
    w, d = rng.uniform(0.04, 0.18), rng.uniform(0.12, 0.25)
    glass = paint.plain(rng, np.array([0.05, 0.05, 0.06]), 0.9, 0.4)
    parts = [(rounded_box((w, d, 0.012), 0.004), style.body(0.4))]
    if rng.random() < 0.6:
        return made("phone", [*parts, (box((0.9 * w, 0.88 * d, 0.0008), (0, 0, 0.012)), glass)])
    keys = paint.checker(rng, np.array([0.8, 0.8, 0.8]), style.color(), 0.02)
    return made("phone", [*parts, (box((0.8 * w, 0.6 * d, 0.004), (0, -0.1 * d, 0.01)), keys)])


def pen(rng: Rng, style: Style) -> Item:
    """A pen or pencil."""
    length, r = rng.uniform(0.11, 0.19), rng.uniform(0.003, 0.007)
    parts = [(rod((0, 0, r), (0.85 * length, 0, r), r), style.body(0.4))]
    return made("pen", [*parts, (rod((0.85 * length, 0, r), (length, 0, r), r, 0.2 * r), style.body(0.2))])


def pen_pot(rng: Rng, style: Style) -> Item:
    """A pot with pens in it: one instance, as it is grasped."""
    r, h = rng.uniform(0.03, 0.05), rng.uniform(0.08, 0.12)
    parts = [(cup(r, h, 0.003), style.package((6.28 * r, h)))]
    for _ in range(rng.integers(2, 8)):
        x, y, u, v = rng.uniform(-0.5, 0.5, 4) * r
        parts.append((rod((x, y, 0.005), (1.6 * u, 1.6 * v, h + rng.uniform(0.02, 0.08)), 0.004), style.body(0.3)))
    return made("pen pot", parts, hollow=True)


def desk_lamp(rng: Rng, style: Style) -> Item:
    """A lamp with a jointed arm."""
    coat = style.body(0.4) if rng.random() < 0.6 else style.metal()
    elbow, head = (
        np.array([rng.uniform(-0.1, 0.1), 0, rng.uniform(0.15, 0.3)]),
        rng.uniform([0.08, 0, 0.25], [0.22, 0.02, 0.42]),
    )
    shade = blob(rng, (0.13, 0.13, 0.09), 0.0, 0.9)
    parts = [(cylinder(rng.uniform(0.06, 0.1), 0.02), coat), (rod((0, 0, 0.02), elbow, 0.007), coat)]
    return made(
        "lamp", [*parts, (rod(elbow, head, 0.006), coat), (turned(shade, np.eye(3), head - [0, 0, 0.05]), coat)]
    )


def binder(rng: Rng, style: Style) -> Item:
    """A ring binder, standing."""
    t, h, d = rng.uniform(0.04, 0.085), 0.32, 0.285
    coat = style.body(0.1)
    parts = [
        (box((t, d, h)), coat),
        (box((0.7 * t, 0.001, 0.19), (0, -d / 2 - 0.0005, 0.07)), style.package((0.7 * t, 0.19))),
    ]
    hole = paint.plain(rng, np.array([0.08, 0.08, 0.08]))
    disc = turned(cylinder(0.012, 0.001), euler(0, np.pi / 2), (0, -d / 2, 0.045))
    return made("binder", [*parts, (disc, hole)])


def papers(rng: Rng, style: Style) -> Item:
    """A stack of paper, a notebook or a folder, thicker than a sheet."""
    w, d, h = 0.21, 0.297, rng.uniform(0.004, 0.05)
    page = prints.text_page(rng, (w, d)) if rng.random() < 0.6 else style.package((w, d))
    return made("papers", [(box((w, d, h)), page)])


def headphones(rng: Rng, style: Style) -> Item:
    """Headphones, lying."""
    coat, pad = style.body(0.3), paint.plain(rng, np.array([0.1, 0.1, 0.1]))
    angle = np.linspace(0, np.pi, 16)
    path = np.stack([0.085 * np.cos(angle), 0.09 * np.sin(angle), 0 * angle + 0.03], axis=1)
    parts = [(tube(path, 0.009), coat)]
    parts += [(blob(rng, (0.05, 0.08, 0.06), 0.0, 0.8, (x * 0.08, -0.01, 0)), pad) for x in (-1, 1)]
    return made("headphones", parts)


def speaker(rng: Rng, style: Style) -> Item:
    """A loudspeaker, clock or small device: a box with round parts in front."""
    w, d, h = rng.uniform(0.07, 0.2, 3)
    front = turned(cylinder(0.38 * min(w, h), 0.006), euler(0, np.pi / 2), (0, -d / 2, h / 2))
    parts = [(rounded_box((w, d, h), 0.008), style.wood() if rng.random() < 0.3 else style.body(0.2))]
    return made(
        "speaker", [*parts, (front, style.body(0.1)), (ball(0.012, (0, -d / 2 - 0.006, h / 2 - 0.012)), style.body())]
    )


def stapler(rng: Rng, style: Style) -> Item:
    """A stapler or punch."""
    length = rng.uniform(0.09, 0.16)
    parts = [(rounded_box((length, 0.035, 0.012), 0.004), style.body(0.2))]
    arm = turned(rounded_box((length, 0.03, 0.025), 0.008), euler(0, 0, -0.16), (0.0, 0, 0.022))
    return made("stapler", [*parts, (arm, style.body(0.3))])


def tape_ring(rng: Rng, style: Style) -> Item:
    """A roll of adhesive tape."""
    r = rng.uniform(0.03, 0.06)
    return made("tape", [(ring(r, 0.3 * r, (0, 0, 0.3 * r)), style.body(0.5))], hollow=True)


def cable(rng: Rng, style: Style, path: Array) -> Item:
    """A cable along a path [P, 3]; plugs at its ends."""
    r = rng.uniform(0.002, 0.005)
    coat = paint.plain(rng, paint.pick(rng, paint.SOBER), 0.2)
    ends = [(rounded_box((0.02, 0.02, 0.014), 0.004, path[i]), coat) for i in (0, -1)]
    return made("cable", [(tube(path + np.array([0, 0, r]), r), coat), *ends])


#: What lies on desks beside household things, and how often.
DESK: tuple[tuple[Maker, float], ...] = (
    (phone, 1.2),
    (pen, 1.2),
    (pen_pot, 0.8),
    (desk_lamp, 0.6),
    (papers, 1.5),
    (headphones, 0.6),
    (speaker, 1.0),
    (stapler, 0.7),
    (tape_ring, 0.5),
    (laptop, 0.6),
    (book, 1.5),
    (mug, 1.8),
    (packet, 1.5),
    (vessel, 1.0),
    (bowl, 0.5),
)
#: Everything small.
SMALL = (*DESK, *THINGS)
