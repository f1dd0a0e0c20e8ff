"""Results that are computed ahead of their use."""

from __future__ import annotations

import threading

import pytest

from torchjoint.runtime.threads import ahead


def test_the_next_is_computed_meanwhile_and_not_more() -> None:
    begun, second = [], threading.Event()

    def compute(item: int) -> int:
        begun.append(item)
        if item == 1:
            second.set()
        return -item

    results = ahead(compute, range(4))
    assert next(results) == 0
    assert second.wait(10)  # while the caller has the first
    assert begun == [0, 1]
    assert list(results) == [-1, -2, -3]


def test_an_error_comes_in_its_place() -> None:
    results = ahead(lambda item: 1 // item, [2, 1, 0, 1])
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)
    assert list(results) == []


def test_nothing() -> None:
    assert list(ahead(str, [])) == []
