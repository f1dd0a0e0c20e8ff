"""Errors for optional packages that are not installed: the message names what to install."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needed_for(purpose: str, package: str, requirement: str) -> Iterator[None]:
    """Wraps the import of a package that may be missing.

    Args:
        purpose: what needs the package; the message begins with it.
        package: name of the package, such as "Open3D".
        requirement: the argument of `pip install`, such as "torchjoint[open3d]".

    Raises:
        ModuleNotFoundError: the package is not installed or does not load; the message gives the command.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{purpose} needs {package}: pip install '{requirement}'") from error
    except (ImportError, OSError) as error:
        raise ModuleNotFoundError(
            f"{purpose} needs {package}, which is installed, but does not load: {error}"
        ) from error
