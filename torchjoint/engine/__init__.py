"""Runs independent tasks on any :class:`concurrent.futures.Executor`; opens loky's, dask's and ray's by their names.

::

    with open_engine("loky:2") as engine:
        for outcome in engine.run(functools.partial(divmod, 7), [5, 0]):
            print(outcome.index, outcome.value, outcome.error)
    # 0 (1, 2) None
    # 1 None integer division or modulo by zero
"""

from torchjoint.engine.engine import Engine, Outcome, SharedFile, WorkerDied
from torchjoint.engine.opening import EngineLike, open_engine

__all__ = ["Engine", "EngineLike", "Outcome", "SharedFile", "WorkerDied", "open_engine"]
