"""agreement_sums: against its slow twin, to the last bit, and the same in any order and on any number of threads."""

from __future__ import annotations

import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.agreement_sums import agreement_sums_reference

from torchjoint.ops.internal import agreement_sums


@few_and_many(
    20,
    500,
    seed=st.integers(0, 2**32 - 1),
    num_rows=st.integers(0, 60),
    num_segments=st.integers(1, 40),
    num_regions=st.integers(1, 8),
    min_points=st.integers(1, 6),
)
def test_against_the_twin(seed, num_rows, num_segments, num_regions, min_points):
    generator = torch.Generator().manual_seed(seed)

    def numbers(top, *shape):
        return torch.randint(top, shape, generator=generator)

    # Region 0 often has many more rows than the others.
    region = (numbers(num_regions, num_rows) * numbers(2, num_rows)).int()
    segment, points = numbers(num_segments, num_rows).int(), numbers(5, num_rows).int()
    size = torch.zeros(num_segments, dtype=torch.int64).index_add_(0, segment, points.long())
    size += numbers(4, num_segments)
    frame = numbers(6, num_segments).sort().values
    pairs = numbers(num_regions, 2, 20)

    def of_rows(order):
        return agreement_sums(
            region[order], segment[order], points[order], size, frame, num_regions, pairs, min_points, 2.0**-24
        )

    expected = agreement_sums_reference(region, segment, points, size, frame, num_regions, pairs, min_points, 2.0**-24)
    for order in (torch.arange(num_rows), torch.randperm(num_rows, generator=generator)):
        assert all(map(torch.equal, of_rows(order), expected))
