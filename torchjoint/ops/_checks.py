"""Checks of the operators' arguments that do not read tensor values: types, dtypes, shapes, devices.

They take almost no time and also work under :func:`torch.compile`. The compiled kernels check the values (node numbers,
NaN, signs) when they read them, and also raise :class:`ValueError`.
"""

import torch
from torch import Tensor

from torchjoint.runtime.groups import check_dense

FLOATING = (torch.float32, torch.float64)
MAX_NODES = 2**31 - 1
Dtypes = torch.dtype | tuple[torch.dtype, ...]


def check_tensor(name: str, value: object, dtypes: tuple[torch.dtype, ...]) -> Tensor:
    """Return ``value``, which must be a dense CPU tensor of one of the dtypes."""
    tensor = check_dense(value, name)
    if tensor.dtype not in dtypes:
        raise TypeError(f"{name}: expected dtype {' or '.join(map(str, dtypes))}, got {tensor.dtype}")
    return tensor


def check_array(name: str, value: object, dtype: Dtypes, shape: tuple[int | None, ...], shape_name: str) -> None:
    """Raise unless ``value`` is a dense CPU tensor of the dtype, or one of them, and of the shape; None: any length."""
    got = check_tensor(name, value, dtype if isinstance(dtype, tuple) else (dtype,)).shape
    lengths_fit = all(want is None or have == want for have, want in zip(got, shape, strict=False))
    if len(got) != len(shape) or not lengths_fit:  # only here: the text of a length would fix it in compiled code
        letters = shape_name.strip("[]").split(", ")
        known = [letter if want is None else str(want) for letter, want in zip(letters, shape, strict=True)]
        expected = shape_name if known == letters else f"{shape_name} = [{', '.join(known)}]"
        raise ValueError(f"{name}: expected shape {expected}, got {list(got)}")


def check_edge_index(edge_index: object) -> None:
    """Raise unless ``edge_index`` is an int64 CPU tensor ``[2, E]``."""
    check_array("edge_index", edge_index, torch.int64, (2, None), "[2, E]")


def check_number(name: str, value: object, kinds: tuple[type, ...]) -> None:
    """Raise unless ``value`` is a number of the given kinds, not negative and not NaN."""
    if isinstance(value, bool) or not isinstance(value, kinds):
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise TypeError(f"{name}: expected {expected}, got {type(value).__name__}")
    if torch.compiler.is_compiling():
        return  # a traced number has no value yet; the kernel checks it
    if not value >= 0:  # type: ignore[operator]  # also refuses NaN
        raise ValueError(f"{name}: expected a number >= 0, got {value}")


def check_num_nodes(num_nodes: int) -> None:
    """Raise unless ``num_nodes`` is an integer in [0, 2^31), which the kernels can store."""
    check_number("num_nodes", num_nodes, (int,))
    if not torch.compiler.is_compiling() and num_nodes > MAX_NODES:
        raise ValueError(f"num_nodes: expected less than 2^31, got {num_nodes}")


def check_neighbors(neighbors: object, length: int | None) -> None:
    """Raise unless ``neighbors`` is an int32 or int64 CPU tensor ``[length, K]``; None allows any length."""
    check_array("neighbors", neighbors, (torch.int32, torch.int64), (length, None), "[N, K]")


def check_order(order: Tensor | None, length: int) -> None:
    """Raise unless ``order`` is an int32 CPU tensor ``[length]``, or None."""
    if order is not None:
        check_array("order", order, torch.int32, (length,), "[N]")
