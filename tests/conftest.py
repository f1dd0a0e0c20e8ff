"""Fixtures of all tests; those of the lab have the same."""

from fixtures import *  # noqa: F403 (pytest finds fixtures by name)
