"""Observations beyond a budget of memory: the same values, and nothing lost when the disk is full."""

import dataclasses
import errno
import pickle

import pytest
import torch

from torchjoint.runtime import store as offload
from torchjoint.scene import Masks
from torchjoint.views.observations import Observation, Observations, PackedObservation
from torchjoint.views.visibility import Visible


def observation(seed, *, masks=False, size=(12, 16)):
    generator = torch.Generator().manual_seed(seed)
    count, (height, width) = 20 * seed, size
    found = Masks.from_stack(torch.rand(3, *size, generator=generator) < 0.5)
    row, column = (torch.randint(side, (count,), generator=generator) for side in size)
    point = torch.randperm(500, generator=generator)[:count].sort().values
    visible = Visible(point, row, column, *torch.randn(3, count, generator=generator))
    image = torch.randint(256, (3, height, width), dtype=torch.uint8, generator=generator)
    labels = torch.randint(-1, 9, size, dtype=torch.int32, generator=generator)
    camera = torch.randn(3, 3, generator=generator), torch.randn(4, 4, generator=generator)
    masked = found if masks else None
    lines = torch.randint(500, (2, seed), generator=generator)
    return Observation(f"{seed}", found.atom if masks else labels, visible, *camera, image, image[0], masked, lines)


def assert_same(one, other):
    assert one.name == other.name
    for field in ("labels", "image", "boundary", "intrinsics", "world_to_camera", "lines"):
        first, second = getattr(one, field), getattr(other, field)
        assert first.dtype == second.dtype
        assert torch.equal(first, second)
    assert all(a.dtype == b.dtype and torch.equal(a, b) for a, b in zip(one.visible, other.visible, strict=True))
    assert (one.masks is None) == (other.masks is None)
    if one.masks is not None:
        for field in ("atom", "pairs", "scores"):
            assert torch.equal(getattr(one.masks, field), getattr(other.masks, field))


ALL = [observation(seed, masks=seed in (1, 4)) for seed in range(6)]


@pytest.mark.parametrize("budget", [0, 3000, None], ids=["all in the file", "some", "none"])
def test_they_come_back(tmp_path, budget):
    kept = Observations(ALL[:2], budget=budget, folder=tmp_path)
    kept.extend(ALL[2:])
    again = pickle.loads(pickle.dumps(kept))
    for one, other, third in zip(ALL, kept, again, strict=True):
        assert_same(one, other)
        assert_same(one, third)
    in_memory = sum(record.num_bytes for record in kept._records if isinstance(record, Observation))
    assert in_memory <= (float("inf") if budget is None else budget)
    assert (in_memory > 0) == (budget != 0)
    assert kept.names == [one.name for one in ALL]
    assert kept.see_points
    assert not kept[:1].see_points


def test_two_sequences_share_their_files(tmp_path):
    first, second = (Observations(part, budget=0, folder=tmp_path) for part in (ALL[:3], ALL[3:]))
    both = first + second
    assert (len(first), len(second)) == (3, 3)
    assert both._records == first._records + second._records
    roomy = Observations(ALL[:3], budget=0, folder=tmp_path) + Observations(ALL[3:])
    for one, other in zip(ALL, roomy, strict=True):
        assert_same(one, other)
    assert roomy._in_memory == 0


def test_what_is_not_used_is_not_unpacked(tmp_path, monkeypatch):
    (packed,) = Observations(ALL[2:3], budget=0, folder=tmp_path)._records
    spoiled = PackedObservation(packed.name, {**packed.parts, "image": packed.parts["image"].at(b"no image")})
    assert_same(dataclasses.replace(ALL[2], image=torch.zeros(1)), Without(spoiled.open(), torch.zeros(1)))


class Without:
    """An observation with another image."""

    def __init__(self, seen, image):
        self.seen, self.image = seen, image

    def __getattr__(self, name):
        return getattr(self.seen, name)


def test_a_full_disk_adds_nothing(tmp_path, monkeypatch):
    kept = Observations(ALL[:2], budget=0, folder=tmp_path)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(offload.os, "pwrite", full)
    with pytest.raises(OSError, match="memory: data beyond this limit go to a temporary file, which cannot be written"):
        kept.extend(ALL[2:])
    monkeypatch.undo()
    assert len(kept) == 2
    kept.extend(ALL[2:])
    for one, other in zip(ALL, kept, strict=True):
        assert_same(one, other)
