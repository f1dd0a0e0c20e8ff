"""What the tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real data and checked values, which is no part of the checkout: without it, tests skip."""
    folder = Path(os.environ.get("TORCHJOINT_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder}: set TORCHJOINT_SHARED to the folder that holds metrics/ and data/")
    return folder
