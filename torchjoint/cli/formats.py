"""torchjoint formats: lists what can be read."""

from __future__ import annotations

from torchjoint.datasets.formats import FORMATS


def formats() -> None:
    """Lists the formats of recordings, and the files that each one needs; docs/your_data.md says more."""
    print("\n".join(f"{name:13} {module.WHAT}" for name, module in FORMATS.items()))
