"""Packages that a plain installation does not bring: one message says what to install."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needed_for(purpose: str, package: str, requirement: str) -> Iterator[None]:
    """Around the import of a package that may be missing.

    Args:
        purpose: what needs the package; the message begins with it.
        package: its name for a reader, such as "Open3D".
        requirement: what pip shall install, such as "torchjoint[open3d]".

    Raises:
        ModuleNotFoundError: the package is not there, or does not load; the message says what to do.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{purpose} needs {package}: pip install '{requirement}'") from error
    except (ImportError, OSError) as error:
        raise ModuleNotFoundError(
            f"{purpose} needs {package}, which is installed, but does not load: {error}"
        ) from error
