"""ascending_order: against its slow twin, to the last bit."""

import torch
from hypothesis import example, given
from hypothesis import strategies as st
from reference.ascending_order import ascending_order_reference

from torchjoint.ops.internal import ascending_order

NUMBERS = st.one_of(st.sampled_from([float("nan"), float("inf"), -float("inf"), 0.0, 0.25]), st.floats(width=32))


@given(st.lists(NUMBERS, max_size=60))
@example([float("inf"), torch.finfo(torch.float32).max, float("nan"), -float("inf")])
def test_against_the_twin(numbers):
    values = torch.tensor(numbers, dtype=torch.float32)
    assert ascending_order(values).tolist() == ascending_order_reference(values).tolist()
