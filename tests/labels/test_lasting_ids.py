"""Ids of things last from result to result; births, merges and splits are told."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.labels.lasting_ids import LastingIds

CUBES = torch.arange(10)


def labels(text: str) -> torch.Tensor:
    return torch.tensor([int(character) for character in text])


def named(*results: str):
    """The ids of the last of some results, one digit for each cube, and what has changed."""
    lasting = LastingIds()
    for text in results:
        ids, changes = lasting.name(CUBES[: len(text)], labels(text))
    return ids.tolist(), changes


def test_things_of_the_first_result_are_born():
    ids, changes = named("0001112222")
    assert ids == [0, 1, 2]
    assert changes == ((0, 1, 2), (), {}, {})


def test_segments_with_other_numbers_keep_their_ids():
    ids, changes = named("0001112222", "2220001111")
    assert ids == [1, 2, 0]
    assert changes == ((), (), {}, {})


def test_a_thing_grows_and_a_new_one_is_born():
    ids, changes = named("000111", "0001111222")
    assert ids == [0, 1, 2]
    assert changes == ((2,), (), {}, {})


def test_the_larger_of_two_that_merge_keeps_its_id():
    ids, changes = named("0001111222", "0000000111")
    assert ids == [1, 2]
    assert changes == ((), (), {0: 1}, {})


def test_the_larger_part_of_what_is_split_keeps_the_id():
    ids, changes = named("0000000111", "0001111222")
    assert ids == [2, 0, 1]
    assert changes == ((), (), {}, {2: 0})


def test_equal_halves_keep_the_id_in_the_lower_segment():
    ids, changes = named("0000", "0011")
    assert ids == [0, 1]
    assert changes.split == {1: 0}


def test_an_id_that_is_gone_does_not_come_back():
    lasting = LastingIds()
    lasting.name(CUBES, labels("0000011111"))
    _, changes = lasting.name(CUBES[:5], labels("00000"))
    assert changes.gone == (1,)
    ids, changes = lasting.name(CUBES, labels("0000011111"))
    assert ids.tolist() == [0, 2]
    assert changes.born == (2,)


def test_what_was_merged_for_some_results_gets_its_id_back():
    for between in (["0000000111"], ["0000000111"] * 3):
        ids, changes = named("0001111222", *between, "0001111222")
        assert ids == [0, 1, 2]
        assert changes == ((), (), {}, {0: 1})


def test_a_part_that_is_not_most_of_a_former_thing_gets_a_new_id():
    ids, changes = named("0000111111", "0000000000", "0112222222")
    assert ids == [2, 3, 1]
    assert changes.split == {2: 1, 3: 1}


def test_an_id_that_lives_is_not_given_twice():
    """The left part of 0 became 1's, and is apart now; but 0 is still there."""
    ids, changes = named("0000011111", "0001111111", "0002211111")
    assert ids == [0, 1, 2]
    assert changes.split == {2: 1}


def test_a_cube_belongs_to_most_of_its_points():
    lasting = LastingIds()
    lasting.name(torch.tensor([0, 0, 0, 1, 1]), torch.tensor([0, 1, 1, 0, 0]))
    ids, _ = lasting.name(torch.tensor([0, 1]), torch.tensor([0, 1]))
    assert ids.tolist() == [1, 0]


@given(st.lists(st.lists(st.integers(0, 3), min_size=1, max_size=10), min_size=2, max_size=4))
def test_ids_are_unique_and_all_changes_are_told(results):
    lasting, alive = LastingIds(), set()
    for values in results:
        segment = torch.unique(torch.tensor(values), return_inverse=True)[1]
        ids, changes = lasting.name(CUBES[: len(segment)], segment)
        now = set(ids.tolist())
        assert len(now) == len(ids)
        assert now - alive == {*changes.born, *changes.split}
        assert alive - now == {*changes.gone, *changes.merged}
        assert set(changes.merged.values()) <= now
        assert set(changes.split.values()) <= alive
        alive = now


@given(st.lists(st.integers(0, 3), min_size=2, max_size=10), st.randoms())
def test_the_order_of_the_points_does_not_matter(values, random):
    segment = torch.unique(torch.tensor(values), return_inverse=True)[1]
    order = list(range(len(values)))
    random.shuffle(order)
    found = []
    for chosen in (torch.arange(len(values)), torch.tensor(order)):
        lasting = LastingIds()
        lasting.name(CUBES, labels("0011223344"))
        found.append(lasting.name(CUBES[: len(values)][chosen], segment[chosen]))
    assert found[0][0].tolist() == found[1][0].tolist()
    assert found[0][1] == found[1][1]
