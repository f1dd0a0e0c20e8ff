"""The most frequent value of each group, against a slow twin."""

from collections import Counter

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.runtime.groups import most_frequent

ROWS = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 3), st.integers(1, 4)), min_size=1)


@given(ROWS)
def test_as_counted_by_hand(rows):
    groups = sorted({group for _, group, _ in rows})
    totals = [Counter() for _ in groups]
    for value, group, count in rows:
        totals[groups.index(group)][value] += count
    expected = [min(total, key=lambda value: (-total[value], value)) for total in totals]
    value, group, count = (torch.tensor(column) for column in zip(*rows, strict=True))
    assert most_frequent(value, torch.unique(group, return_inverse=True)[1], count).tolist() == expected
