"""Tasks on workers: every task has one outcome, whatever happens to workers, and no process is left."""

import multiprocessing
import operator
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import joblib
import psutil
import pytest
import torch

from torchjoint.engine import Engine, WorkerDied, open_engine, opening
from torchjoint.engine.engine import Answer, SharedFile

# Two workers each, whatever the number of cores: a warning is all.
ENGINES = ["loky:2", "dask:2", "ray:2"]

#: Third parties on their own way: sockets that are closed late, versions of protocols.
QUIET = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::FutureWarning")


def task(folder, number):
    """Every fifth ends its worker each time, every seventh once, every third has an error."""
    marks = Path(folder)
    (marks / f"worker-{os.getpid()}").touch()
    if number and number % 5 == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if number and number % 7 == 0 and not (marks / f"once-{number}").exists():
        (marks / f"once-{number}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number and number % 3 == 0:
        raise ValueError(f"task {number}")
    return number**2, torch.get_num_threads()


def processes_below(process):
    """All that descend from a process, without Python's that removes semaphores: it ends with its head."""
    found = set()
    for one in psutil.Process(process).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            if "resource_tracker" not in " ".join(one.cmdline()):
                found.add(one.pid)
    return found


def still_running(processes, seconds=20.0):
    """Those of the processes that still run some seconds later."""
    end = time.monotonic() + seconds
    while processes and time.monotonic() < end:
        processes = {one for one in processes if psutil.pid_exists(one) and not is_zombie(one)}
        time.sleep(0.1)
    return processes


def is_zombie(process):
    try:
        return psutil.Process(process).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def listening(process):
    """The addresses at which a process and its descendants can be reached."""
    found = set()
    for one in [psutil.Process(process), *psutil.Process(process).children(recursive=True)]:
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            found |= {place.laddr.ip for place in one.net_connections("inet") if place.status == psutil.CONN_LISTEN}
    return found


class Ran(NamedTuple):
    """What an engine did, and what it left."""

    name: str
    outcomes: dict
    workers: set  # their processes
    started: set  # all processes that it started
    reached: set  # addresses
    authentication: str | None  # of ray


@pytest.fixture(scope="module", params=ENGINES)
def ran(request, tmp_path_factory):
    marks = tmp_path_factory.mktemp("marks")
    with open_engine(request.param) as engine:
        outcomes = {outcome.index: outcome for outcome in engine.run(partial(task, str(marks)), range(9))}
        started, reached = processes_below(os.getpid()), listening(os.getpid())
        authentication = os.environ.get("RAY_AUTH_MODE")
    workers = {int(file.name.removeprefix("worker-")) for file in marks.glob("worker-*")}
    return Ran(request.param, outcomes, workers, started, reached, authentication)


@QUIET
@pytest.mark.slow
def test_every_task_has_one_outcome(ran):
    outcomes = ran.outcomes
    assert sorted(outcomes) == list(range(9))
    for number in (0, 1, 2, 4, 7, 8):
        assert outcomes[number].error is None
        assert outcomes[number].value == (number**2, 1)
    for number in (3, 6):
        assert isinstance(outcomes[number].error, ValueError)
        assert str(outcomes[number].error) == f"task {number}"
    assert isinstance(outcomes[5].error, WorkerDied)
    assert "died 2 times" in str(outcomes[5].error)


@QUIET
@pytest.mark.slow
def test_no_process_is_left(ran):
    assert ran.workers
    assert os.getpid() not in ran.workers
    assert still_running(ran.workers | ran.started) == set()


@QUIET
@pytest.mark.slow
def test_no_other_machine_reaches_the_workers(ran):
    """On this machine, another user needs the token of ray."""
    assert all(place.removeprefix("::ffff:").startswith("127.") or place == "::1" for place in ran.reached)
    if ran.name == "ray:2":
        assert ran.reached
        assert ran.authentication == "token"


class Counted:
    """Leaves a mark each time that it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return _unpickled, (self.folder,)


def _unpickled(folder):
    (Path(folder) / str(time.monotonic_ns())).touch()
    return folder


class OddError(Exception):
    """Cannot be unpickled."""

    def __init__(self, one, two):
        super().__init__(one)


@pytest.mark.slow
def test_what_travels(tmp_path):
    """A shared value is read once by a worker; what cannot travel is told, and stops nothing."""

    def local(file, number):
        file.load()
        if number == 1:
            raise OddError("this", "that")
        return (part for part in "ab") if number == 2 else number

    (tmp_path / "marks").mkdir()
    with open_engine("loky:1") as engine, closing(SharedFile(Counted(str(tmp_path / "marks")), tmp_path)) as file:
        assert engine.executor.submit(operator.methodcaller("load"), file).result() == str(tmp_path / "marks")
        outcomes = list(engine.run(partial(local, file), range(5)))
    assert [outcome.value for outcome in outcomes] == [0, None, None, 3, 4]
    assert str(outcomes[1].error) == "OddError: this"
    assert "pickle" in str(outcomes[2].error)
    assert len(list((tmp_path / "marks").iterdir())) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["marks"]


def test_a_shared_file_that_others_changed_is_not_unpickled(tmp_path):
    with closing(SharedFile("mine", tmp_path)) as file:
        (path,) = tmp_path.iterdir()
        path.write_bytes(b"yours")
        with pytest.raises(ValueError, match="is not what the first process wrote"):
            file.load()


class Answering(ThreadPoolExecutor):
    """A thread; some calls, by their number, get an error of the executor instead."""

    def __init__(self, errors=()):
        super().__init__(1)
        self.errors, self.calls = dict(errors), 0

    def submit(self, function, /, *arguments):
        self.calls += 1
        if (error := self.errors.get(self.calls)) is None:
            return super().submit(function, *arguments)
        future = Future()
        future.set_exception(error)
        return future


class KilledWorker(Exception):  # noqa: N818
    """As dask's."""


def test_an_executor_of_any_kind():
    with ThreadPoolExecutor(2) as threads, open_engine(threads, torch.get_num_threads()) as engine:
        assert (engine.slots(), engine.on_machine) == (2, 2)
        outcomes = sorted(engine.run(partial(divmod, 7), [5, 0]), key=lambda outcome: outcome.index)
    assert outcomes[0].value == (1, 2)
    assert isinstance(outcomes[1].error, ZeroDivisionError)


def test_a_worker_of_another_version_gives_no_value(monkeypatch):
    """Its results were those of its version, and counted as those of the first process's."""
    asked = iter(["1.0", "0.9"])  # here, and in the worker
    monkeypatch.setattr("torchjoint.engine.engine.version", lambda _: next(asked))
    with Answering({}) as executor, open_engine(executor, torch.get_num_threads()) as engine:
        (outcome,) = engine.run(partial(divmod, 7), [5])
    assert str(outcome.error) == "engine: expected a worker with torchjoint 1.0, got 0.9"


def test_a_cut_connection_and_a_worker_that_dies():
    errors = {1: ConnectionError(), 2: KilledWorker("one"), 4: KilledWorker("two"), 5: KilledWorker("three")}
    with Answering(errors) as executor, open_engine(executor, torch.get_num_threads()) as engine:
        outcomes = list(engine.run(partial(divmod, 7), [5, 3], in_order=True))
        assert outcomes[0].value == (1, 2)
        assert str(outcomes[1].error) == "its worker died 2 times: KilledWorker (killed, out of memory, or a crash)"
        executor.errors = dict.fromkeys(range(20), ConnectionError())
        with pytest.raises(ConnectionError, match="engine Answering: the connection was cut 3 times"):
            list(engine.run(partial(divmod, 7), [5, 3]))


def test_at_most_so_many_tasks_are_taken():
    """In order, tasks that ended early wait for the first one, and no further ones are taken."""
    taken, first = [], Future()

    class Waiting(Answering):
        def submit(self, function, /, *arguments):
            return first if arguments[1] == 0 else super().submit(function, *arguments)

    def tasks():
        for number in range(9):
            taken.append(number)
            yield number

    with Waiting() as executor:
        engine = Engine("waiting", executor, lambda: 2, torch.get_num_threads())
        threading.Timer(0.5, lambda: first.set_result(Answer(value="first"))).start()
        outcomes = engine.run(float, tasks(), in_order=True)
        assert next(outcomes).value == "first"
        assert taken == [0, 1, 2, 3]
        assert [outcome.value for outcome in outcomes] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]


@pytest.mark.slow
def test_a_pool_that_breaks_ends_the_run(tmp_path):
    """Python's pool of processes takes no more tasks after a process was killed."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool, open_engine(pool) as engine:
        outcomes = engine.run(partial(task, str(tmp_path)), [1, 5])
        assert next(outcomes).value == (1, 1)
        with pytest.raises(WorkerDied, match="engine ProcessPoolExecutor: a worker died"):
            next(outcomes)


@pytest.mark.parametrize(
    ("name", "threads", "message"),
    [
        ("slurm", 1, "expected loky, dask or ray for this machine .*, got 'slurm'"),
        ("loky:0", 1, "got 'loky:0'"),
        ("dask://", 1, "got 'dask://'"),
        ("loky", 0, f"threads: expected 1 to {joblib.cpu_count()}, the number of cores, got 0"),
        ("loky", 10_000, "the number of cores, got 10000"),
    ],
)
def test_bad_engines(name, threads, message):
    with pytest.raises(ValueError, match=message), open_engine(name, threads):
        pass


def test_never_more_threads_than_cores(caplog):
    cores = joblib.cpu_count()
    with open_engine("loky:999") as engine:
        assert engine.slots() == engine.on_machine == cores
    assert "too many" in caplog.text
    with open_engine("loky", threads=cores) as engine:
        assert engine.slots() == 1


def grows(number):
    """The second task leaves a worker 400 MB larger, as a large recording may."""
    if number == 1:
        grows.kept = b"1" * 400_000_000
    time.sleep(1.1)  # loky looks once a second
    return os.getpid()


@pytest.mark.slow
def test_a_worker_that_grows_is_replaced_without_a_warning(recwarn):
    with open_engine("loky:1") as engine:
        outcomes = list(engine.run(grows, range(3)))
    assert [outcome.error for outcome in outcomes] == [None] * 3
    assert outcomes[0].value == outcomes[1].value != outcomes[2].value
    assert not recwarn.list


@QUIET
@pytest.mark.slow
def test_dask_without_a_scheduler(monkeypatch):
    monkeypatch.setattr(opening, "PATIENCE", 1.0)
    message = "engine dask://127.0.0.1:1: no scheduler answers at tcp://127.0.0.1:1"
    with pytest.raises(ConnectionError, match=message), open_engine("dask://127.0.0.1:1"):
        pass


@pytest.mark.parametrize(
    "name", ["loky:1", *(pytest.param(name, marks=(pytest.mark.slow, QUIET)) for name in ("dask:1", "ray:1"))]
)
def test_no_module_of_the_current_folder_is_imported(name, tmp_path, monkeypatch):
    """A recording may be the current folder, and a stranger's."""
    for module in ("joblib", "multiprocessing", "random", "torch", "distributed", "ray"):
        (tmp_path / f"{module}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    with open_engine(name) as engine:
        (outcome,) = engine.run(partial(divmod, 7), [5])
    assert outcome.value == (1, 2)
    assert not (tmp_path / "ran").exists()
    assert os.environ["PYTHONSAFEPATH"] == ""


@pytest.mark.slow
def test_a_killed_run_prints_nothing():
    """Loky's tracker listed the semaphores that it removed."""
    work = "e.executor.submit(print); print(flush=True); time.sleep(60)"
    program = f"import time, torchjoint.engine as t\nwith t.open_engine('loky:1') as e: {work}"
    running = subprocess.Popen([sys.executable, "-c", program], stdout=-1, stderr=-1)
    running.stdout.readline()
    time.sleep(1)
    running.terminate()
    assert running.communicate(timeout=60)[1] == b""
