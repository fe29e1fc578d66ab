"""Threads that share a kernel process every item exactly once."""

import multiprocessing
import os
import threading
import time

import numpy as np
import pytest

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.threads import cores, pool
from slgaussian.kernels.work_sharing import share, share_items, take
from tests.kernel_threads import kernels_on


@kernel
def _count(counter, items):
    portion = take(counter)
    while portion < len(items):
        items[portion] += 1
        portion = take(counter)


@pytest.mark.parametrize("portions", [0, 1, 7, 100_000])
@pytest.mark.parametrize("threads", [1, 2, 50])
def test_share_takes_every_portion_once(portions, threads):
    items = np.zeros(portions, np.int64)
    with kernels_on(threads):
        share(_count, portions, items)
    assert (items == 1).all()


@pytest.mark.parametrize("threads", [1, 2, 50])
def test_share_items_keeps_the_order_of_nested_work(threads):
    def count_items(size, plus):
        items = np.full(size, plus)
        share(_count, size, items)
        return items.sum()

    with kernels_on(threads):
        sums = share_items(count_items, range(40), range(40))
    assert sums == [size * (size + 1) for size in range(40)]
    with pytest.raises(ZeroDivisionError), kernels_on(threads):
        share_items(lambda number: 1 // number, range(3))


def test_share_runs_threads_at_once():
    """Each thread waits for the other: with Python's lock held, one would wait forever."""
    met, both = [], threading.Barrier(2, timeout=60)

    def meet(counter):
        both.wait()
        met.append(threading.get_ident())

    with kernels_on(2):
        share(meet, 2)
    assert len(set(met)) == 2


MANY = 200_000_000
"""Portions that take a second or more."""


@kernel
def _go_on(counter):
    items = 0
    while take(counter) < MANY:
        items += 1
    return items


def test_kernel_releases_the_lock_of_python():
    _go_on(np.full(1, MANY))  # compiled
    counter, items = np.zeros(1, np.int64), []
    runs = threading.Thread(target=lambda: items.append(_go_on(counter)))
    runs.start()
    while counter[0] == 0:
        time.sleep(0)
    counter[0] = MANY  # no more portions
    runs.join()
    assert items[0] < MANY


def test_share_raises_the_error_of_a_helper():
    both = threading.Barrier(2, timeout=60)
    caller = threading.get_ident()

    def fail(counter):
        both.wait()
        if threading.get_ident() != caller:
            raise MemoryError("in a helper")

    with kernels_on(2), pytest.raises(MemoryError, match="in a helper"):
        share(fail, 2)


def test_allotted_threads_are_of_the_calling_thread_alone():
    before = pool.size
    with kernels_on(before + 3):
        view = []
        second = threading.Thread(target=lambda: view.append(pool.size))
        second.start()
        second.join()
        assert view == [cores()]
        assert pool.size == before + 3
    assert pool.size == before


def _share_in_fork(connection) -> None:
    both = threading.Barrier(2, timeout=20)
    with kernels_on(2):
        share(lambda counter: both.wait(), 2)
    connection.send("met")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_share_starts_own_threads_after_a_fork():
    with kernels_on(2):
        share(_count, 100, np.zeros(100, np.int64))  # the pool has begun
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_share_in_fork, args=(theirs,))
    child.start()
    assert ours.poll(60) and ours.recv() == "met"
    child.join()
