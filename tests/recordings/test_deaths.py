"""Workers, heads, connections, memory and disks fail; each time the files end up those of an undisturbed run."""

import gc
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest
from deadly_batches import CONFIG, ENGINES, OPTIONS, assert_complete, make_known, undisturbed
from folder_files import write_scans
from test_batch import HereExecutor

import torchjoint as tj
from torchjoint.engine import open_engine
from torchjoint.engine.opening import _make_token

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::FutureWarning"),
]


@pytest.fixture(scope="module")
def scans(scene_of, tmp_path_factory):
    return write_scans(tmp_path_factory.mktemp("scans") / "scans", scene_of(2))


@pytest.fixture(scope="module")
def expected(scans, tmp_path_factory):
    return undisturbed(scans, tmp_path_factory.mktemp("expected"))


@pytest.fixture
def deaths(tmp_path, monkeypatch):
    """The folder of the deaths to come; workers know it, and find the detector."""
    folder = tmp_path / "deaths"
    folder.mkdir()
    make_known(folder, monkeypatch)
    return folder


@pytest.fixture(scope="session")
def watchers():
    """Processes of ray that wait a minute for a head that was killed, by a constant of theirs, before they end.

    They have this minute while other tests run; none is left when all have run.
    """
    processes = set()
    yield processes
    wait_for(lambda: not any(map(is_running, processes)), 90.0)


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.02)


def is_running(process):
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("engine", ENGINES)
def test_the_head_is_killed(engine, scans, deaths, expected, tmp_path, watchers):
    """While its workers are inside tasks: no process is left, and the same batch ends with the same files."""
    out, ab = tmp_path / "out", [str(scans / "a"), str(scans / "b")]
    script = tmp_path / "command.py"  # as pip installs it: dask imports it again in its workers
    script.write_text("from torchjoint.cli import main\n\nif __name__ == '__main__':\n    main()\n")
    options = ["--set", "boundary.detector=deadly_boundary:DeadlyBoundary", "--max-frames", "2", "--thin", "0.1"]
    command = [sys.executable, str(script), "batch", *ab, "-o", str(out), *options, "--engine", engine]
    (deaths / "wait").touch()
    with (tmp_path / "log.txt").open("w") as log:
        head = subprocess.Popen(command, stdout=log, stderr=log)
        wait_for(lambda: list(out.glob("*.partial/source.txt")) or head.poll() is not None)
        assert head.poll() is None, (tmp_path / "log.txt").read_text()
        processes = {process.pid for process in psutil.Process(head.pid).children(recursive=True)}
        assert processes
        head.send_signal(signal.SIGKILL)
        head.wait()
    wait_for(lambda: sum(map(is_running, processes)) <= (2 if engine == "ray:2" else 0))
    watchers.update(filter(is_running, processes))
    assert not (out / "a").exists()  # the workers ended inside their tasks
    (deaths / "wait").unlink()
    if engine == "loky:2":  # the same command
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert "2 segmented, 0 were done before, 0 failed" in done.stdout, done.stderr
    else:  # the same batch
        again = tj.batch(ab, out, engine=HereExecutor(), config=CONFIG, options=OPTIONS, allow_import=True)
        assert (sorted(again.reports), again.skipped, again.failures) == (["a", "b"], (), {})
    assert_complete(out, {name: expected[name] for name in "ab"})


class Wire:
    """A TCP connection between a client and a scheduler that can be cut; listens on `port`."""

    def __init__(self, target):
        self._target, self._sockets, self._lock = target, [], threading.Lock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                here, _ = self._server.accept()
            except OSError:
                return
            there = socket.create_connection(self._target)
            with self._lock:
                self._sockets += [here, there]
                if self._server.fileno() < 0:  # closed meanwhile
                    self._cut()
            for one, other in ((here, there), (there, here)):
                threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    @staticmethod
    def _pass_on(one, other):
        with suppress(OSError):
            while data := one.recv(65536):
                other.sendall(data)

    def cut(self):
        with self._lock:
            self._cut()

    def _cut(self):
        for one in self._sockets:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._sockets.clear()

    def close(self):
        self._server.close()
        self.cut()


def batch_with_a_cut(engine, target, scans, deaths, out):
    """Runs a batch on a cluster, and cuts the connection to its scheduler once, while recordings are under way."""
    (deaths / "wait").touch()
    wire, cuts = Wire(target), []

    def cut():
        wait_for(lambda: list(out.glob("*.partial/source.txt")))
        wire.cut()
        cuts.append(True)
        (deaths / "wait").unlink()

    threading.Thread(target=cut, daemon=True).start()
    try:
        report = tj.batch(
            scans, out, engine=f"{engine}://127.0.0.1:{wire.port}", config=CONFIG, options=OPTIONS, allow_import=True
        )
    finally:
        wire.close()
    for one in gc.get_objects():  # an attempt to connect that dask's client has cancelled leaves its socket open
        with suppress(OSError):  # it listens only
            if type(one) is socket.socket and one.getpeername() == ("127.0.0.1", wire.port):
                one.close()
    assert cuts
    return report


def test_the_connection_to_a_scheduler_of_dask_is_cut(scans, deaths, expected, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        host, port = cluster.scheduler_address.removeprefix("tcp://").split(":")
        report = batch_with_a_cut("dask", (host, int(port)), scans, deaths, tmp_path / "out")
    assert report.failures == {}
    assert_complete(tmp_path / "out", expected)


@contextmanager
def ray_cluster(folder):
    """The port for clients of a cluster of ray, and none of its processes afterwards.

    They all have TORCHJOINT_TEST_DEATHS, which is the folder, in their environments.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    options = [f"--ray-client-server-port={port}", "--port=0", "--num-cpus=2", "--include-dashboard=false", "--block"]
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--node-ip-address=127.0.0.1", *options]
    with (folder.parent / "ray.txt").open("w") as log:
        head = subprocess.Popen(command, start_new_session=True, stdout=log, stderr=log)
    try:
        wait_for(lambda: takes_clients(port) or head.poll() is not None, 300)
        assert head.poll() is None, (folder.parent / "ray.txt").read_text()
        yield port
    finally:
        wait_for(lambda: not killed(folder))
        head.wait()


def takes_clients(port):
    """Whether a client can connect; the port is open some time before."""
    try:
        with socket.create_connection(("127.0.0.1", port)), open_engine(f"ray://127.0.0.1:{port}"):
            return True
    except (OSError, RuntimeError):
        return False


def killed(folder):
    """Kills all processes that were started with this folder of deaths, and returns them."""
    found, mark = [], b"TORCHJOINT_TEST_DEATHS=" + os.fsencode(folder)
    for process in psutil.process_iter():
        with suppress(psutil.Error, OSError):  # psutil reads no environment of a process that has changed its title
            if process.pid != os.getpid() and mark in Path(f"/proc/{process.pid}/environ").read_bytes():
                process.kill()
                found.append(process)
    return found


def test_the_connection_to_a_ray_cluster_is_cut(scans, deaths, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # as for a cluster on this machine; else both need a token
    # Each client gets a server of its own, which on a busy machine takes more than ray's 30 s to start. One that never
    # does is tried again after this time.
    monkeypatch.setenv("RAY_CLIENT_SERVER_CHECK_CHANNEL_TIMEOUT_S", "60")
    with ray_cluster(deaths) as port:
        report = batch_with_a_cut("ray", ("127.0.0.1", port), scans, deaths, tmp_path / "out")
    assert report.failures == {}
    assert_complete(tmp_path / "out", expected)


@pytest.fixture
def ray(monkeypatch):
    """As the engine imports it: other tests of this process may open ray on this machine."""
    monkeypatch.setenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    return pytest.importorskip("ray")


@pytest.mark.filterwarnings("ignore:Ray Client connection timed out")
def test_ray_here_after_a_cluster_that_does_not_answer(ray, monkeypatch):
    """Ray would send the calls to the cluster that it has not."""
    for timeout in ("INITIAL", "MAX"):
        monkeypatch.setattr(f"ray.util.client.worker.{timeout}_TIMEOUT_SEC", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as closed:
        address = f"ray://127.0.0.1:{closed.getsockname()[1]}"
    with pytest.raises(ConnectionError, match=f"engine {address}: ray does not answer"), open_engine(address):
        pass
    with open_engine("ray:1") as engine:
        assert engine.slots() == 1


@pytest.mark.parametrize("failures", [2, 3])
@pytest.mark.parametrize(
    ("engine", "error"),
    [
        ("ray://127.0.0.1:9", ConnectionAbortedError("Starting Ray client server failed")),
        ("ray:1", RuntimeError("Timed out waiting for file gcs_server_port")),
        ("ray:1", Exception("The current node timed out during startup.")),
    ],
)
def test_ray_fails_to_start_its_processes(engine, error, failures, ray, monkeypatch):
    """On a busy machine; it is tried three times."""
    monkeypatch.setattr(ray, "init", Mock(side_effect=[error] * failures + [None]))
    monkeypatch.setattr(ray.util, "get_node_ip_address", lambda: "127.0.0.1")
    fails = pytest.raises(ConnectionError, match=str(error)) if failures == 3 else nullcontext()
    with fails, open_engine(engine):
        pass
    assert ray.init.call_count == 3


def test_programs_that_start_ray_at_once_have_one_token(monkeypatch, tmp_path):
    """Which other users of the machine cannot read."""
    path, together = tmp_path / ".ray" / "auth_token", threading.Barrier(8, timeout=60)
    monkeypatch.setenv("HOME", str(tmp_path))

    def program(_):
        together.wait()
        _make_token()
        return path.read_text()

    with ThreadPoolExecutor(8) as programs:
        (token,) = set(programs.map(program, range(8)))
    assert len(token) == 64
    assert list(path.parent.iterdir()) == [path]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_ray_without_a_home_folder(monkeypatch):
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory.")))
    _make_token()
    assert Path.home.call_count == 1


def test_ray_that_the_caller_has_started_stays(ray, monkeypatch):
    monkeypatch.setattr(ray, "init", Mock(side_effect=RuntimeError("Maybe you called ray.init twice by accident?")))
    monkeypatch.setattr(ray, "shutdown", Mock())
    with pytest.raises(RuntimeError, match="by accident"), open_engine("ray:1"):
        pass
    assert ray.shutdown.call_count == 0
