"""Types of this package's NumPy code: arrays, random generators, colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Rng = np.random.Generator
Color = tuple[float, float, float]
