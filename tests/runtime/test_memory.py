"""Sizes as users write them, and the limits of machines and containers."""

import pytest

from torchjoint.runtime.memory import SHARE_OF_MEMORY, as_bytes, available_memory


@pytest.mark.parametrize(
    ("text", "size"), [("2GB", 2e9), ("500 MiB", 500 * 2**20), ("1.5g", 1.5e9), (".5 kB", 500), ("0", 0), (7, 7)]
)
def test_sizes(text, size):
    assert as_bytes(text) == size


@pytest.mark.parametrize("wrong", ["2XB", "-1GB", "", "GB", -1, True, 2.5])
def test_no_sizes(wrong):
    with pytest.raises(ValueError, match=r"--memory: expected a size such as '2GB' or '500MB', or bytes >= 0, got"):
        as_bytes(wrong, "--memory")


def test_the_default_is_a_share():
    assert as_bytes(None) == int(SHARE_OF_MEMORY * available_memory())


@pytest.mark.parametrize(
    ("groups", "files"),
    [
        ("0::/a/b", {"a/memory.max": "1000000", "a/b/memory.max": "max", "memory.max": "9000000"}),
        ("4:cpu,memory:/a\n0::/", {"memory/a/memory.limit_in_bytes": "1000000"}),
        ("0::/not/seen/in/the/container", {"memory.max": "1000000"}),
    ],
    ids=["a group around it", "version 1", "inside a container"],
)
def test_the_limit_of_a_container_counts(tmp_path, groups, files):
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(groups + "\n")
    assert available_memory(tmp_path) > 1_000_000
    for name, text in files.items():
        file = tmp_path / "sys/fs/cgroup" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n")
    assert available_memory(tmp_path) == 1_000_000
