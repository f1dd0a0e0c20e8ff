"""Things of a household: cups and bowls with an inside of their own colour."""

from __future__ import annotations

import numpy as np
import pytest
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.mesh import Part, cup
from torchjoint_lab.synthetic.household import _lined, bowl, cup_sides, mug
from torchjoint_lab.synthetic.style import Style


def area(part: Part) -> float:
    a, b, c = part.positions.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("shape", [{"flare": 1.3}, {"rounded": True}])
def test_both_sides_of_a_cup_are_the_cup(shape):
    whole = cup(0.04, 0.1, 0.004, **shape)
    outside, inside = cup_sides(0.04, 0.1, 0.004, **shape)
    assert area(whole) == pytest.approx(area(outside) + area(inside))
    assert len(whole.positions) == len(outside.positions) + len(inside.positions)
    away = [(part.normals[..., :2] * part.positions[..., :2]).sum(-1) for part in (outside, inside)]
    assert away[0].min() >= -1e-9  # normals of the outside point away from the axis, of the inside towards it
    assert away[1].max() <= 1e-9
    assert outside.positions[..., 2].max() == pytest.approx(0.1)
    assert inside.positions[..., 2].min() == pytest.approx(0.004)


@pytest.mark.parametrize("make", [mug, bowl])
def test_insides_have_another_colour_in_half_of_the_cases(make):
    lined = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        parts = make(rng, Style(rng, similar=0.1, printed=0.5, difficult=0.1)).parts
        lined += parts[0][1] is not parts[1][1]
    assert 18 <= lined <= 42


def test_the_lining_takes_no_number_from_the_scene():
    rng = np.random.default_rng(0)
    coat = paint.plain(rng, np.full(3, 0.5))
    before = rng.bit_generator.state
    for _ in range(10):
        _lined(rng, coat, 0.04, 0.1, 0.004, flare=1.2, rounded=False)
    assert rng.bit_generator.state == before
