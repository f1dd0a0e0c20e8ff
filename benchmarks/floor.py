"""A lower bound for the time of graph segmentation with given edges: floor.cpp, compiled with the system's compiler."""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor


def argsort_floor(weight: Tensor) -> Callable[[], None]:
    """Returns a function that argsorts float32 weights [E] by a plain radix sort, in preallocated memory."""
    first, second = torch.ones(2, len(weight), 2, dtype=torch.int32)

    def run() -> None:
        _library().radix_argsort(
            ctypes.c_void_p(weight.data_ptr()), ctypes.c_int64(len(weight)),
            ctypes.c_void_p(first.data_ptr()), ctypes.c_void_p(second.data_ptr()),
        )  # fmt: skip

    run()
    order = second[:, 1].long()
    if not torch.equal(weight[order], weight.sort().values):
        raise AssertionError("the floor does not sort")
    return run


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_name("floor.cpp")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "floor.so"
        subprocess.run(["c++", "-O3", "-std=c++20", "-shared", "-fPIC", source, "-o", library], check=True)
        return ctypes.CDLL(str(library))
