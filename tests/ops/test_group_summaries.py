"""ascending_order and group_summaries: against their slow twins, to the last bit."""

import torch
from hypothesis import example, given
from hypothesis import strategies as st
from reference.ascending_order import ascending_order_reference
from reference.group_summaries import group_summaries_reference

from torchjoint.ops.internal import ascending_order, group_summaries

QUANTILES = torch.tensor([0.1, 0.5, 0.9, 0.0, 1.0])
NUMBERS = st.one_of(st.sampled_from([float("nan"), float("inf"), -float("inf"), 0.0, 0.25]), st.floats(width=32))


@given(st.lists(st.tuples(NUMBERS, st.integers(-1, 4)), max_size=60))
@example([(float("inf"), 0), (torch.finfo(torch.float32).max, 0), (float("nan"), 0), (-float("inf"), 0)])
def test_against_the_twin(pairs):
    values = torch.tensor([value for value, _ in pairs], dtype=torch.float32)
    group = torch.tensor([number for _, number in pairs], dtype=torch.int64)
    order = ascending_order(values)
    assert order.tolist() == ascending_order_reference(values).tolist()
    arguments = values, order, group, 5, QUANTILES
    torch.testing.assert_close(
        group_summaries(*arguments), group_summaries_reference(*arguments), rtol=0, atol=0, equal_nan=True
    )
