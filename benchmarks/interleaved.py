"""Times of rival functions: taken turn by turn, so that whatever else the machine does falls on all of them alike."""

import gc
import statistics
import time
from collections.abc import Callable


def medians(functions: dict[str, Callable[[], object]], seconds: float = 3.0, least: int = 3) -> dict[str, float]:
    """Median milliseconds of each function: one call of each in turn, for about so many seconds."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():  # the first call pays for what is set up once
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
