"""A service may end while its first process still starts: nothing waits for that, nothing is said."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from service import processes, runner
from service.app import create_app
from service.lasting import Lasting
from service.settings import Settings
from service.supervisor import Supervisor


def test_calls_are_made_in_one_thread_whoever_asks():
    lasting, found = Lasting("one"), []

    def ask():
        found.append(lasting(threading.current_thread))

    threads = [threading.Thread(target=ask) for _ in range(5)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert {thread.name for thread in found} == {"one"}
    assert len({id(thread) for thread in found}) == 1
    with pytest.raises(KeyError):
        lasting({}.__getitem__, 1)
    assert lasting(divmod, 7, 3) == (2, 1)


def test_a_runner_that_is_warm_before_there_is_a_supervisor(tmp_path, monkeypatch):
    """Its thread wakes the supervisor, which was not always made by then."""
    failed = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    monkeypatch.setattr("service.runner.warm_up", lambda: None)
    usual = Supervisor.__init__

    def late(self, *args):
        for thread in threading.enumerate():
            if thread.name == "warm-up":
                thread.join()
        usual(self, *args)

    monkeypatch.setattr(Supervisor, "__init__", late)
    app = create_app(Settings(state_dir=tmp_path))
    app.state.supervisor.stop()
    assert failed == []


@pytest.mark.long
@pytest.mark.parametrize("times", [1, processes.START_TRIES])
def test_a_forkserver_that_is_killed_while_it_loads(store, monkeypatch, times):
    """It is replaced; where its successors die as well, the task goes back and nothing is lost."""
    failed, tries = [], []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    begin = processes._begin

    def killed(*arguments):
        tries.append(arguments)
        if len(tries) <= times:
            raise ConnectionRefusedError(111, "Connection refused")
        return begin(*arguments)

    def sleep(_):
        raise OSError(22, "Invalid argument")  # as under a faked clock

    store.create("simulate", "m", {}, 1)
    attempt = store.claim("x")
    with monkeypatch.context() as patched:
        patched.setattr(processes, "_begin", killed)
        patched.setattr("time.sleep", sleep)
        runner.watch(store, attempt, Settings(losses_allowed=0), threading.Event())
    ((task, _),) = store.tasks(attempt.job)
    assert (failed, task.losses) == ([], 0)
    found = store.job(attempt.job_id).status, task.state
    assert found == (("failed", "stopped") if times == 1 else ("running", "queued"))
    assert len(tries) == times + (times == 1)


ENDS_WHILE_IT_STARTS = """
import concurrent.futures.thread, threading, time
from service import processes, runner
from service.settings import Settings

begun = threading.Event()

def begin(*_):
    begun.set()
    while not threading._SHUTTING_DOWN:
        time.sleep(0.01)
    raise EOFError("the forkserver was killed")

processes._begin = begin
runner.LocalRunner(None, Settings(workers=1))
assert begun.wait(60)
"""


@pytest.mark.long
def test_a_process_that_ends_meanwhile_says_nothing():
    command = [sys.executable, "-c", ENDS_WHILE_IT_STARTS]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.fixture
def of_a_terminal():
    """Programs heed SIGINT; those of a shell's background, as these tests may be, are made to ignore it."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.slow
@pytest.mark.usefixtures("of_a_terminal")
@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_while_the_engine_loads(spawn, children_of, dead, eventually, times):
    """From a terminal it reaches all processes of the service, whatever they are at."""
    service = spawn(new_session=True)
    below = eventually(lambda: children_of(service.process.pid))
    for _ in range(times):
        os.killpg(service.process.pid, signal.SIGINT)
    assert service.process.wait(120) == 130
    eventually(lambda: all(dead(pid) for pid in below))
    log = (service.state / "log").read_text()
    assert "Traceback" not in log, log
    assert "no job will be computed" not in log
