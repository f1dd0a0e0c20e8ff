"""Loads the compiled extension; if this fails, the error explains what to do."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import torch  # noqa: F401  must come first: the extension links to libraries that torch loads


def _missing_extension(error: ImportError) -> str:
    """The error message if torchjoint._C does not load."""
    package = Path(__file__).parents[1]
    checkout = package.parent
    if (checkout / "pyproject.toml").is_file() and not list(package.glob("_C*")):
        return (
            f"this is the source folder of torchjoint, {package}, and it holds no compiled extension. Python finds it "
            "before an installed torchjoint because you are in its checkout. Leave the checkout (cd ..) to use the "
            f"installed one, or compile here: pip install -e '{checkout}'"
        )
    return (
        "the compiled extension torchjoint._C is missing or does not load: install the package again with "
        f"`pip install torchjoint`, with torch >= 2.10. The cause: {error}"
    )


try:
    import_module("torchjoint._C")
except ImportError as error:
    raise ImportError(_missing_extension(error)) from error
