"""The tests of the lab."""


def pytest_itemcollected(item):
    """Gives a test the mark by which `make slow` finds it."""
    item.add_marker("lab")
