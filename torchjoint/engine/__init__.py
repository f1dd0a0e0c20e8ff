"""Runs independent tasks on the workers of an engine: loky on this machine, dask or ray on a cluster.

::

    with open_engine("loky:2") as engine:
        for outcome in engine.run(divmod, [5, 0], shared=7):
            print(outcome.index, outcome.value, outcome.error)
    # 0 (1, 2) None
    # 1 None integer division or modulo by zero
"""

from torchjoint.engine.engine import Engine, Outcome, WorkerDied
from torchjoint.engine.opening import open_engine
from torchjoint.engine.worker import tasks_on_machine

__all__ = ["Engine", "Outcome", "WorkerDied", "open_engine", "tasks_on_machine"]
