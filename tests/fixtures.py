"""What the tests share. torch is imported where it is used: xdist's first process, which runs no test, needs none."""

import functools
import gc
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# How fast a machine is says nothing about the code: no test fails because an example takes long to make or to run.
settings.register_profile("torchjoint", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("torchjoint")


if "PYTEST_XDIST_WORKER" in os.environ:
    import torch

    torch.set_num_threads(1)  # each processor has a worker
    gc.disable()  # till all tests are collected


def pytest_collection_finish() -> None:
    """What was collected stays to the end: no search for garbage walks through it again and again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def no_cache() -> Iterator[None]:
    """Tests leave nothing in the user's cache, and find nothing there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHJOINT_CACHE", "")
        yield


@pytest.fixture(scope="session", autouse=True)
def small_overviews() -> Iterator[None]:
    """Results have an overview of one inch: a whole one takes a second, and what looks at it draws it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchjoint.results.folder.overview", _small_overview)
        yield


#: Folders and files of :func:`one_copy`: none whose worker processes' results are compared, which know no such patch.
ONE_COPY = {"cli", "labels", "masks", "results", "viewer", "test_batch.py", "test_live.py", "test_segment.py"}


@pytest.fixture(scope="module", autouse=True)
def one_copy(request: pytest.FixtureRequest) -> Iterator[None]:
    """Step 6 judges one copy of the surface, which takes half as long, where no test is about the segments it finds."""
    with pytest.MonkeyPatch.context() as patch:
        if ONE_COPY & set(request.path.parts[len(Path(__file__).parts) - 1 :]):  # below tests/
            patch.setattr("torchjoint.segments.learned.method.COPIES", 1)
        yield


def _small_overview(*_: Any, **__: Any) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(1, 1))


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real data and checked values, which is no part of the checkout: without it, tests skip."""
    folder = Path(os.environ.get("TORCHJOINT_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder}: set TORCHJOINT_SHARED to the folder that holds metrics/ and data/")
    return folder


@pytest.fixture(scope="session")
def scene_of() -> Callable[..., Any]:
    """`make_scene` with 3,000 points, each scene made once. Tests leave what they get as it is."""
    from torchjoint.synthetic import make_scene

    return functools.cache(functools.partial(make_scene, num_points=3000))


@pytest.fixture(scope="session")
def run() -> Callable[..., None]:
    """The command line: `run("segment", folder, "-o", out)`."""
    from torchjoint.cli.main import main

    def command(*arguments: object) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["torchjoint", *map(str, arguments)])
            patch.setattr(warnings, "formatwarning", warnings.formatwarning)  # `main` sets its own
            main()

    return command


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    """`torch.set_num_threads`; after the test torch has as many threads as before."""
    import torch

    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def seen() -> Callable[..., Any]:
    """An observation of a strip of pixels, one for each of the points; the labels are those of the image there."""
    import torch

    from torchjoint.views.observations import Observation
    from torchjoint.views.visibility import Visible

    def observation(points: list[int], image_labels: list[int]) -> Any:
        point = torch.tensor(points, dtype=torch.int64)
        column = torch.arange(len(point))
        labels = torch.full((1, max(len(point), 1)), -1, dtype=torch.int32)  # an image has at least one pixel
        labels[0, : len(point)] = torch.tensor(image_labels, dtype=torch.int32)
        row, depth = torch.zeros_like(column), column + 1.0
        visible = Visible(point, row, column, column.float(), row.float(), depth)
        return Observation(
            "",
            labels,
            visible,
            torch.eye(3),
            torch.eye(4),
            torch.zeros(3, *labels.shape).byte(),
            torch.zeros(labels.shape).byte(),
        )

    return observation
