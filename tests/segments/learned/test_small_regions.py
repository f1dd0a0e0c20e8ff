"""Step 6, method learned: small regions join whom they touch most, by hand and as one region after the other."""

from collections import Counter

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint import ops
from torchjoint.segments.learned.small_regions import merges_by_contact


def groups(joined, count):
    return ops.connected_components(joined, count).tolist()


def merged(ends, size, stays=None):
    """Parallel edges are added in part before, so that counts other than one occur."""
    half = ends.shape[1] // 2
    first, count = torch.unique(ends[:, :half], dim=1, return_counts=True)
    rest = ends[:, half:]
    count = torch.cat([count, torch.ones_like(rest[0])])
    return merges_by_contact(torch.cat([first, rest], 1), count, size, stays)


def by_hand(ends, size, min_size, stays):
    """Rounds, with dicts: each small group names its favourite; then all join theirs at once."""
    group = {region: frozenset([region]) for region in range(len(size))}
    while True:
        favourite = {}
        for own in set(group.values()):
            if sum(size[one] for one in own) >= min_size or any(stays[one] for one in own):
                continue
            contact = Counter()
            for a, b in ends:
                for one, other in ((a, b), (b, a)):
                    if one in own and other not in own:
                        contact[group[other]] += 1
            if contact:
                favourite[own] = min(contact, key=lambda other: (-contact[other], min(other)))
        if not favourite:
            return set(group.values())
        for own, other in favourite.items():
            union = group[min(own)] | group[min(other)]
            for one in union:
                group[one] = union


class TestMergesByContact:
    def test_it_joins_whom_it_touches_most(self):
        ends = torch.tensor([[0, 1, 1, 1], [1, 0, 2, 2]])  # region 1 touches 0 twice and 2 twice: the lower one
        assert merged(ends, torch.tensor([90, 5, 90])).tolist() == [[1], [0]]
        more = torch.cat([ends, torch.tensor([[2], [1]])], 1)
        assert merged(more, torch.tensor([90, 5, 90])).tolist() == [[1], [2]]

    def test_large_regions_stay_apart(self):
        ends = torch.tensor([[0], [1]])
        assert merged(ends, torch.tensor([50, 50])).shape == (2, 0)

    def test_small_ones_that_join_become_large(self):
        ends = torch.tensor([[0, 0, 1], [1, 1, 2]])  # 0 and 1 name each other; together they are no longer small
        found = merged(ends, torch.tensor([30, 30, 90]))
        assert found.tolist() == [[0], [1]]

    def test_a_chain_ends_at_a_large_region(self):
        ends = torch.tensor([[0, 1, 1], [1, 2, 2]])
        found = merged(ends, torch.tensor([3, 3, 90]))
        assert groups(found, 3) == [0, 0, 0]

    def test_what_stays_is_never_small_but_takes_others(self):
        ends, size = torch.tensor([[0, 1], [1, 2]]), torch.tensor([5, 5, 90])
        found = merged(ends, size, torch.tensor([False, True, False]))
        assert groups(found, 3) == [0, 0, 1]

    def test_without_neighbours_it_stays(self):
        assert merged(torch.empty(2, 0, dtype=torch.int64), torch.tensor([1, 1])).shape == (2, 0)

    @given(st.data())
    def test_as_by_hand(self, data):
        count = data.draw(st.integers(1, 9))
        region = st.integers(0, count - 1)
        ends = [pair for pair in data.draw(st.lists(st.tuples(region, region), max_size=25)) if pair[0] != pair[1]]
        size = data.draw(st.lists(st.integers(1, 60), min_size=count, max_size=count))
        stays = data.draw(st.lists(st.booleans(), min_size=count, max_size=count))
        edges = torch.tensor(ends, dtype=torch.int64).reshape(-1, 2).T
        found = merged(edges, torch.tensor(size), torch.tensor(stays))
        number = groups(found, count)
        assert {frozenset(r for r in range(count) if number[r] == n) for n in number} == by_hand(ends, size, 50, stays)
        assert found.shape[1] == count - len(set(number))  # no merge twice: they are a forest
