"""How many examples Hypothesis tries: a few in every run of the tests, many among the slow ones."""

from __future__ import annotations

import functools
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis.strategies import SearchStrategy


def few_and_many(
    few: int, many: int, **strategies: SearchStrategy
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """In the place of `@settings(max_examples=...)` and `@given(...)`: two tests of the same check."""

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        @pytest.mark.parametrize("examples", [few, pytest.param(many, marks=pytest.mark.slow)])
        @functools.wraps(check)
        def test(examples: int) -> None:
            settings(max_examples=examples)(given(**strategies)(check))()

        del test.__wrapped__  # pytest would read the check's arguments there, and look for fixtures of their names
        return test

    return decorate
