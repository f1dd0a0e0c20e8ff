"""Limits of threads hold for the caller alone. Events and barriers decide who is where; nothing waits for a clock."""

import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest
import torch

from torchjoint.runtime import threads
from torchjoint.runtime.threads import (
    LazySequence,
    all_threads,
    num_threads,
    one_thread_per_operation,
    parallel_map,
)

COUNT = 3
#: Seconds after which a barrier that nobody else comes to breaks, so that a failure is no endless wait.
PATIENCE = 600


@pytest.fixture(autouse=True)
def three_threads(set_threads):
    set_threads(COUNT)


@pytest.fixture
def without_openmp(monkeypatch):
    monkeypatch.setattr(threads, "_openmp_limit", lambda: None)


def in_a_fresh_thread(function):
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(function).result()


def fresh_count():
    """What a thread sees at its first torch operation."""
    return in_a_fresh_thread(torch.get_num_threads)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_one_thread():  # with more, it would wait for threads of the process before
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        assert pool.submit(torch.get_num_threads).result() == 1
    assert torch.get_num_threads() == COUNT


def can_take_it():
    return threads.one_at_a_time.acquire(timeout=1) and threads.one_mode_at_a_time.acquire(timeout=1)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_process_forked_while_a_thread_has_its_turn():
    inside, end = threading.Event(), threading.Event()

    def segment():
        with threads.one_at_a_time, threads.one_mode_at_a_time:
            inside.set()
            end.wait(PATIENCE)

    with ThreadPoolExecutor(1) as others, ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        others.submit(segment)
        inside.wait(PATIENCE)
        taken = pool.submit(can_take_it).result()
        end.set()
    assert taken


def overlapping(leaves_first):
    """Two callers: 0 enters, 1 enters, one of them leaves, the other one leaves. What each sees before each step."""
    steps = [threading.Barrier(2) for _ in range(5)]
    seen = [[], []]

    def caller(number):
        def step(index):
            seen[number].append(torch.get_num_threads())
            steps[index].wait(PATIENCE)

        step(0)
        if number == 1:
            step(1)
        with one_thread_per_operation():
            if number == 0:
                step(1)
            step(2)
            if leaves_first != number:
                step(3)
        if leaves_first == number:
            step(3)
        step(4)
        return torch.get_num_threads(), num_threads()

    with ThreadPoolExecutor(2) as pool:
        after = list(pool.map(caller, range(2)))
    return seen, after


@pytest.mark.parametrize("leaves_first", [0, 1])
def test_overlapping_callers_see_and_get_back_their_own(leaves_first):
    seen, after = overlapping(leaves_first)
    for number, counts in enumerate(seen):
        at_entry = COUNT if number == 1 else 1  # at step 1 only caller 0 is inside
        at_exit = COUNT if leaves_first == number else 1
        assert counts == [COUNT, at_entry, 1, at_exit, COUNT]
    assert after == [(COUNT, COUNT)] * 2
    assert torch.get_num_threads() == fresh_count() == COUNT


@pytest.mark.usefixtures("without_openmp")
@pytest.mark.parametrize("leaves_first", [0, 1])
def test_without_openmp_overlapping_callers_get_theirs_back(leaves_first):
    seen, after = overlapping(leaves_first)
    assert [counts[2] for counts in seen] == [1, 1]
    assert after == [(COUNT, COUNT)] * 2
    assert torch.get_num_threads() == fresh_count() == COUNT


@pytest.mark.parametrize("in_the_middle", [False, True])
def test_who_only_watches_sees_no_limit(in_the_middle):
    """Also with all threads on again in the middle of it."""
    with one_thread_per_operation():
        assert torch.get_num_threads() == 1
        if in_the_middle:
            with all_threads():
                assert torch.get_num_threads() == COUNT
                assert fresh_count() == COUNT
        assert fresh_count() == COUNT
        assert in_a_fresh_thread(num_threads) == COUNT
    assert torch.get_num_threads() == fresh_count() == COUNT


def test_a_thread_that_began_to_watch_keeps_its_count():
    """Its first torch operation falls into another thread's limit, its second one comes after it."""
    first, left = threading.Event(), threading.Event()

    def watch():
        counts = [torch.get_num_threads()]
        first.set()
        assert left.wait(PATIENCE)
        return [*counts, torch.get_num_threads()]

    with ThreadPoolExecutor(1) as pool:
        with one_thread_per_operation():
            watching = pool.submit(watch)
            assert first.wait(PATIENCE)
        left.set()
        assert watching.result() == [COUNT, COUNT]


def test_inside_the_package_may_use_as_many_as_before():
    with one_thread_per_operation():
        assert num_threads() == COUNT
        with one_thread_per_operation():
            assert num_threads() == COUNT
        assert torch.get_num_threads() == 1


class TestParallelMap:
    def test_parallel_items_keep_their_order_with_one_thread_each(self):
        together = threading.Barrier(COUNT)

        def work(item):
            together.wait(PATIENCE)  # which nobody passes alone
            return item, threading.get_ident(), torch.get_num_threads(), num_threads()

        found = parallel_map(work, range(2 * COUNT))
        assert [item for item, *_ in found] == list(range(2 * COUNT))
        assert len({thread for _, thread, *_ in found}) == COUNT
        assert {tuple(counts) for _, _, *counts in found} == {(1, 1)}
        assert torch.get_num_threads() == num_threads() == COUNT

    def test_nested_calls_do_not_spread(self):
        def outer(_):
            inner = parallel_map(lambda _: (threading.get_ident(), torch.get_num_threads()), range(4))
            return threading.get_ident(), inner

        for thread, inner in parallel_map(outer, range(COUNT)):
            assert set(inner) == {(thread, 1)}

    def test_on_one_thread(self, set_threads):
        set_threads(1)
        assert set(parallel_map(lambda _: threading.get_ident(), range(4))) == {threading.get_ident()}
        assert parallel_map(str, []) == []

    def test_gradients_stay_off(self):
        with torch.no_grad():
            assert parallel_map(lambda _: torch.is_grad_enabled(), range(4)) == [False] * 4

    @pytest.mark.parametrize("items", [1, 4])
    def test_an_error_comes_out_and_all_is_as_before(self, items):
        def fails(_):
            raise KeyError("this one")

        with pytest.raises(KeyError, match="this one"):
            parallel_map(fails, range(items))
        assert torch.get_num_threads() == num_threads() == fresh_count() == COUNT

    def test_of_several_errors_that_of_the_first_item_comes_out(self):
        later, begun = threading.Event(), []

        def fails(item):
            begun.append(item)
            later.set() if item else later.wait(PATIENCE)
            raise KeyError(f"item {item}")

        with pytest.raises(KeyError, match="item 0"):
            parallel_map(fails, range(100))
        assert len(begun) <= COUNT  # after an error nobody begins another item


def leave_by_an_error(manager):
    with manager():
        raise KeyError("inside")


@pytest.mark.parametrize("openmp", [True, False])
@pytest.mark.parametrize("manager", [one_thread_per_operation, all_threads])
def test_errors_restore(request, manager, openmp):
    if not openmp:
        request.getfixturevalue("without_openmp")
    with pytest.raises(KeyError, match="inside"):
        leave_by_an_error(manager)
    assert torch.get_num_threads() == num_threads() == fresh_count() == COUNT
    with one_thread_per_operation():
        with pytest.raises(KeyError, match="inside"):
            leave_by_an_error(manager)
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == num_threads() == fresh_count() == COUNT


def test_an_item_that_cannot_be_read_ends_no_loop() -> None:
    """Python takes an IndexError for the end of a sequence: a loop over the frames would miss the rest."""
    items = LazySequence(4, lambda index: [0, 1][index])
    with pytest.raises(RuntimeError, match="item 2 of 4 cannot be read: list index out of range"):
        list(items)
    assert list(LazySequence(2, lambda index: index)) == [0, 1]
    with pytest.raises(IndexError):
        items[4]
