"""The supervisor alone: what it does where a runner or the store is in trouble."""

import threading

import pytest
from sqlalchemy.exc import OperationalError

from service.settings import Settings
from service.store import Store
from service.supervisor import Supervisor


class Broken:
    """A runner that cannot start anything until it is mended."""

    def __init__(self):
        self.mended, self.started = threading.Event(), []

    def capacity(self):
        return 1

    def free(self):
        return 1 - len(self.started)

    def running(self):
        return len(self.started)

    def start(self, attempt):
        if not self.mended.is_set():
            raise RuntimeError("can't start new thread")
        self.started.append(attempt)

    def stop(self, drain):
        pass


@pytest.fixture
def settings(tmp_path):
    return Settings(state_dir=tmp_path, losses_allowed=0)


def test_an_attempt_that_cannot_be_started_is_no_loss(settings, eventually, caplog):
    store, runner = Store(settings.store_url), Broken()
    made = store.create("simulate", "m", {}, 1)
    supervisor = Supervisor(store, runner, settings)
    supervisor.start()
    eventually(lambda: caplog.text.count("cannot be started") >= 3)
    ((task, _),) = store.tasks(store.job(made).seq)
    assert (task.losses, store.job(made).status) == (0, "running")
    runner.mended.set()
    eventually(lambda: runner.started)
    supervisor.stop()
    store.close()


def test_asking_whether_it_is_ready_writes_little_and_waits_for_nobody(settings, monkeypatch):
    """However many ask, and while a writer keeps all others waiting."""
    store = Store(settings.store_url)
    supervisor = Supervisor(store, Broken(), settings)
    supervisor.start()
    tried, entered, leave = [], threading.Event(), threading.Event()

    def check():
        tried.append(1)
        entered.set()
        assert leave.wait(60)
        raise OperationalError("", {}, RuntimeError("disk full"))

    monkeypatch.setattr(store, "check", check)
    slow = threading.Thread(target=supervisor.trouble)
    slow.start()
    assert entered.wait(60)
    assert [supervisor.trouble() for _ in range(100)] == [""] * 100
    leave.set()
    slow.join()
    assert all("disk full" in supervisor.trouble() for _ in range(10))
    assert len(tried) == 1
    supervisor.stop()
    store.close()
