"""Tasks shared with copies of this process: the same answers, whatever becomes of the copies."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from contextlib import closing
from functools import partial

import pytest

from engine import forked
from engine.forked import each, in_processes

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="processes are copied on Linux only"
)
HERE = os.getpid()


@pytest.fixture(autouse=True)
def few_are_many(monkeypatch):
    monkeypatch.setattr(forked, "MANY", 2)


def where(i):
    return i, os.getpid()


@pytest.mark.parametrize("n", [1, 2, 3, 20])
def test_all_are_done_in_their_order_by_so_many_processes(n):
    with in_processes(n):
        found = list(each([partial(where, i) for i in range(7)]))
    assert [i for i, _ in found] == list(range(7))
    assert len({copy for _, copy in found}) == min(n, 7)
    assert found[0][1] == os.getpid()


def test_without_being_told_nothing_is_copied():
    assert {copy for _, copy in each([partial(where, i) for i in range(3)])} == {os.getpid()}


def only_here(i, how):
    if os.getpid() != HERE:
        how()
    return i


def fail():
    raise ValueError("not here either")


def end():
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("how", [fail, end])
def test_what_a_copy_does_not_find_is_found_here(how):
    with in_processes(2):
        assert list(each([partial(only_here, i, how) for i in range(5)])) == list(range(5))


def test_where_there_is_no_room_for_another_process_all_is_done_here(monkeypatch):
    def full():
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", full)
    with in_processes(3):
        found = list(each([partial(where, i) for i in range(4)]))
    assert found == [(i, HERE) for i in range(4)]


def test_an_error_is_raised_where_it_would_be_without_copies():
    with in_processes(2), closing(each([partial(where, 0), fail])) as found:
        next(found)
        with pytest.raises(ValueError, match="not here"):
            next(found)


def test_copies_end_with_who_asked(monkeypatch):
    """As where somebody stops it half-way."""
    waits, copies, fork = threading.Event(), [], os.fork

    def noted():
        copies.append(fork())
        return copies[-1]

    monkeypatch.setattr(os, "fork", noted)
    with in_processes(3), closing(each([partial(where, 0), waits.wait, waits.wait])) as found:
        next(found)
    assert len(copies) == 2
    for copy in copies:
        with pytest.raises(ChildProcessError):  # it is there no more
            os.waitpid(copy, os.WNOHANG)


def test_a_process_with_threads_is_not_copied_unless_it_is_asked_for():
    release = threading.Event()
    other = threading.Thread(target=release.wait)
    other.start()
    try:
        with in_processes(None):
            assert {copy for _, copy in each([partial(where, i) for i in range(3)])} == {HERE}
    finally:
        release.set()
        other.join()


def test_a_few_short_ones_are_not_worth_a_copy(monkeypatch):
    monkeypatch.setattr(forked, "MANY", 4)
    with in_processes(2):
        assert len({copy for _, copy in each([partial(where, i) for i in range(3)])}) == 1
        assert len({copy for _, copy in each([partial(where, i) for i in range(4)])}) == 2


def test_a_process_of_a_pool_is_not_copied_unless_it_is_asked_for(monkeypatch):
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: "the pool's")
    monkeypatch.setattr(threading, "active_count", lambda: 1)  # whatever runs these tests
    with in_processes(None):
        assert {copy for _, copy in each([partial(where, i) for i in range(3)])} == {HERE}


def test_copies_make_no_copies():
    def inner():
        return {copy for _, copy in each([partial(where, i) for i in range(3)])}

    with in_processes(2):
        _, in_copy = each([partial(where, 0), inner])
    assert len(in_copy) == 1
