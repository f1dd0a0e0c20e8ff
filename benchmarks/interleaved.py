"""Times several functions in turn, so that other load on the machine affects all of them equally."""

import gc
import statistics
import time
from collections.abc import Callable


def medians(functions: dict[str, Callable[[], object]], seconds: float = 3.0, least: int = 3) -> dict[str, float]:
    """Returns median milliseconds of each function: one call of each in turn, for about `seconds` seconds."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():  # the first call includes one-time setup
        function()
    gc.collect()
    gc.disable()
    try:
        start = time.perf_counter()
        while len(next(iter(times.values()), [0] * least)) < least or time.perf_counter() - start < seconds:
            for name, function in functions.items():
                before = time.perf_counter()
                function()
                times[name].append(time.perf_counter() - before)
    finally:
        gc.enable()
    return {name: statistics.median(taken) * 1e3 for name, taken in times.items()}
