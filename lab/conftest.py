"""The mark by which `make slow` finds the lab's tests."""


def pytest_itemcollected(item):
    item.add_marker("lab")
