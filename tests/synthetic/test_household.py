"""Things of a household: cups and bowls with an inside of their own colour."""

from __future__ import annotations

import numpy as np
import pytest

from torchjoint.synthetic.household import bowl, mug
from torchjoint.synthetic.mesh import Part, cup, cup_sides
from torchjoint.synthetic.settings import domain_settings
from torchjoint.synthetic.style import Style


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
    lined, after = 0, []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        item = make(rng, Style(rng, similar=0.1, printed=0.5, difficult=0.1))
        lined += item.parts[0][1] is not item.parts[1][1]
        after.append(rng.random())
    assert 18 <= lined <= 42
    assert len(set(after)) == 60


@pytest.mark.parametrize(("domain", "least"), [("room", 90), ("kitchen", 90), ("desk", 50)])
def test_some_scenes_have_many_views(domain, least):
    views = [domain_settings(domain, seed).num_views for seed in range(120)]
    assert least < max(views) <= {"desk": 60}.get(domain, 100)
    assert min(views) < 12
