"""Distributes work over threads so that results never depend on the number of threads.

A torch operation splits its tensor over threads. Vector instructions handle the middle of each part, and scalar code
handles its end. The two may round differently: `atan2` of one element can change with the number of threads. Therefore,
inside this package, one operation always runs on one thread. Instead, whole items (frames, clouds, blocks of edges) are
processed in parallel: each item on one Python thread, several threads at once, because torch releases the GIL.

The limit of one thread applies only to the calling thread. ``torch.set_num_threads`` is not suitable: it also changes
the setting that every *other* Python thread gets at its first torch operation. So the limit is set directly in OpenMP
and MKL, which store it per thread. Callers may overlap in any way, and the setting of other threads never changes. If
torch does not use OpenMP, ``torch.set_num_threads`` is used as long as any caller is inside.

A forked process has OpenMP's pool, but not its threads, and would wait for them for ever: torch has one thread there.
"""

import ctypes
import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar, copy_context
from functools import lru_cache
from pathlib import Path
from threading import Lock, RLock
from typing import Any, TypeVar, overload

import torch

T = TypeVar("T")
R = TypeVar("R")

#: Held while the warnings of a recording are caught or are errors, because that counts for all threads of a process.
one_at_a_time = RLock()
#: Held while modules are in evaluation mode: threads may share parts of them, whose modes would mix.
one_mode_at_a_time = RLock()
_workers: ContextVar[int | None] = ContextVar("torchjoint_workers", default=None)
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))
    for lock in (one_at_a_time, one_mode_at_a_time):
        os.register_at_fork(after_in_child=lock._at_fork_reinit)  # type: ignore[attr-defined]  # as in logging


@contextmanager
def one_thread_per_operation() -> Iterator[None]:
    """Inside the block, a torch operation runs on one thread; :func:`parallel_map` uses as many as torch had before."""
    token = _workers.set(num_threads())
    try:
        with _thread_limit(1), on_cpu():
            yield
    finally:
        _workers.reset(token)


@contextmanager
def on_cpu() -> Iterator[None]:
    """Inside the block, or a function that it decorates, new tensors are on the CPU, whatever the default device.

    Nor are they tensors of an inference mode around it, which nobody could change after it; and an autocast around it
    rounds nothing.
    """
    with ExitStack() as stack:
        if torch.is_autocast_enabled("cpu"):
            stack.enter_context(torch.autocast("cpu", enabled=False))
        if torch.is_inference_mode_enabled():
            stack.enter_context(torch.inference_mode(False))
            stack.enter_context(torch.no_grad())
        if torch.get_default_device().type != "cpu":  # not always, because it makes each operation slower
            stack.enter_context(torch.device("cpu"))
        yield


@contextmanager
def all_threads() -> Iterator[None]:
    """Inside the block, compiled operators use all threads again.

    Use it only for operators whose result does not depend on the number of threads.
    """
    with _thread_limit(num_threads()):
        yield


def num_threads() -> int:
    """Number of threads that the package may use here: as many as torch may use; one inside :func:`parallel_map`."""
    return _workers.get() or torch.get_num_threads()


def parallel_map(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """``[function(item) for item in items]`` on several Python threads, in the order of the items.

    The threads also read the items of a lazy sequence, and free each item when the function has returned.
    """
    items = items if isinstance(items, Sequence) else list(items)
    workers = min(num_threads(), len(items))
    if workers <= 1:
        with one_thread_per_operation():
            return [function(item) for item in items]

    results: list[Any] = [None] * len(items)
    errors: dict[int, BaseException] = {}
    left = iter(range(len(items)))  # shared by the threads, because a task for each item would be slow

    def work() -> None:
        _workers.set(1)  # nested calls must not start more threads
        with _thread_limit(1), torch.no_grad():  # each thread also has its own gradient mode
            for index in left:
                try:
                    results[index] = function(items[index])
                except BaseException as error:
                    errors[index] = error
                    deque(left, maxlen=0)  # no thread begins another item

    with one_thread_per_operation(), ThreadPoolExecutor(workers - 1) as pool:
        for _ in range(workers - 1):
            pool.submit(work)
        copy_context().run(work)  # this thread also works
    if errors:
        try:
            raise errors[min(errors)]  # items begin in order, so this is the first item that fails
        finally:
            errors.clear()  # else a reference cycle would keep the error and all objects of its frames alive
    return results


@contextmanager
def _thread_limit(count: int) -> Iterator[None]:
    """Inside the block, torch operations of the calling thread run on `count` threads; other threads do not change."""
    before = torch.get_num_threads()  # a new thread gets torch's setting here, not later
    set_limit = _openmp_limit()
    if set_limit is None:
        with _GLOBAL_LIMIT(count):
            yield
        return
    mkl_before = set_limit(count, count)
    try:
        yield
    finally:
        set_limit(before, mkl_before)


@lru_cache(maxsize=1)
def _openmp_limit() -> Callable[[int, int], int] | None:
    """A function that sets the calling thread's OpenMP and MKL limits (MKL: 0 = none) and returns the old MKL limit.

    None if torch has no OpenMP. The handle of a library also finds symbols of the libraries that it links to. So the
    handle of torch finds the OpenMP that torch uses, even if the process has loaded several.
    """
    library = _torch_library()
    openmp = getattr(library, "omp_set_num_threads", None)
    if openmp is None:
        return None
    openmp.argtypes, openmp.restype = [ctypes.c_int], None
    mkl = getattr(library, "MKL_Set_Num_Threads_Local", None)  # exists only on x86
    if mkl is not None:
        mkl.argtypes, mkl.restype = [ctypes.c_int], ctypes.c_int

    def set_limit(openmp_count: int, mkl_count: int) -> int:
        openmp(openmp_count)
        return int(mkl(mkl_count)) if mkl is not None else 0

    return set_limit


def _torch_library() -> Any:
    name = "libtorch_cpu.dylib" if sys.platform == "darwin" else "libtorch_cpu.so"
    file = Path(torch.__file__).parent / "lib" / name
    return ctypes.CDLL(str(file)) if file.is_file() else None


class _GlobalLimit:
    """Torch's global setting: the first caller who enters changes it, the last caller who leaves restores it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._inside = 0
        self._before = 1

    @contextmanager
    def __call__(self, count: int) -> Iterator[None]:
        """Inside the block, torch's global setting is `count`, also while other callers are inside."""
        with self._lock:
            if self._inside == 0:
                self._before = torch.get_num_threads()
            self._inside += 1
            own_before = torch.get_num_threads()
            torch.set_num_threads(count)
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                torch.set_num_threads(own_before if self._inside else self._before)


_GLOBAL_LIMIT = _GlobalLimit()


def ahead(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yields ``function(item)`` for each item, in order; one thread computes the next while the caller works on one.

    At most two results exist at a time: the caller's, and the next. An error of `function` is raised where its result
    would have been yielded.

    Example:
        >>> list(ahead(lambda number: number**2, range(4)))
        [0, 1, 4, 9]
    """
    on_one_thread = one_thread_per_operation()(function)
    with ThreadPoolExecutor(1) as pool:
        pending: list[Future[R]] = []
        for item in items:
            ready = [future.result() for future in pending]
            pending = [pool.submit(copy_context().run, on_one_thread, item)]
            yield from ready
        yield from (future.result() for future in pending)


class LazySequence(Sequence[T]):
    """A sequence whose item `i` is `read(i)`, called at each access. `read` gets 0 <= i < count and must be pure.

    `names` are the names of the items, if they are known without reading the items; else empty.
    """

    def __init__(self, count: int, read: Callable[[int], T], names: Sequence[str] = ()) -> None:
        self._indices = range(count)
        self._read = read
        self.names = names

    def __getstate__(self) -> bytes:
        """For pickle, which knows no local functions: `read` goes along, and the items are read where they are used."""
        import cloudpickle

        return cloudpickle.dumps(self.__dict__)

    def __setstate__(self, state: bytes) -> None:
        self.__dict__.update(pickle.loads(state))

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: int | slice) -> T | list[T]:
        with on_cpu():
            if isinstance(index, slice):
                return [self._read(i) for i in self._indices[index]]
            place = self._indices[index]
            try:
                return self._read(place)
            except IndexError as error:  # a loop over the sequence would end there, without a word
                raise RuntimeError(f"item {place} of {len(self)} cannot be read: {error}") from error
