"""Ctrl-C is an interruption, whatever the code that it reaches makes of it."""

import contextlib
import signal

import pytest

from service.cli.ending import Interrupt


def run(work):
    """A task of a command: work(interrupt)."""
    interrupt = Interrupt()
    with interrupt.held():
        work(interrupt)


def press():
    signal.raise_signal(signal.SIGINT)


def interrupted(work):
    with pytest.raises(KeyboardInterrupt):
        run(work)


def test_it_is_held_until_a_step_ends():
    done = []

    def work(interrupt):
        press()
        done.append("the step")
        interrupt.check()
        done.append("the next step")

    interrupted(work)
    assert done == ["the step"]


def test_a_second_one_is_not_held():
    done = []

    def work(interrupt):
        press()
        press()
        done.append("the step")

    interrupted(work)
    assert not done


@pytest.mark.parametrize("let_go", [False, True])
def test_compiled_code_makes_another_error_of_it(let_go):
    def work(interrupt):
        if let_go:
            interrupt.let_go()
        with contextlib.suppress(KeyboardInterrupt):
            press()
        raise SystemError("returned a result with an exception set")

    interrupted(work)


def test_compiled_code_swallows_it():
    def work(interrupt):
        interrupt.let_go()
        with contextlib.suppress(KeyboardInterrupt):
            press()

    interrupted(work)


def test_another_error_is_what_it_is():
    def work(interrupt):
        raise ValueError("no interruption")

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="no interruption"):
        run(work)
    assert signal.getsignal(signal.SIGINT) is before
