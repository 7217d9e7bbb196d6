"""Commands in this process, and on a pseudo-terminal in their own."""

import contextlib
import fcntl
import json
import logging
import os
import pty
import re
import select
import subprocess
import sys
import termios

import pytest
from typer.testing import CliRunner

from service.cli.commands import app
from tests.patience import eventually

RBPS = [sys.executable, "-c", "from service.cli.commands import main; main()"]


@pytest.fixture
def logging_as_before():
    """A command that serves logs to the stderr it finds, which is closed when the test has read it."""
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.fixture
def rbps(tmp_path, monkeypatch, logging_as_before):
    """rbps("fit", ...) -> result with exit_code, stdout, stderr; runs in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def run(*args):
        result = CliRunner().invoke(app, [str(arg) for arg in args])
        result.json = lambda: json.loads(result.stdout)
        return result

    return run


@pytest.fixture
def terminal(tmp_path):
    """terminal("fit", ...) -> a running command whose stderr is a pseudo-terminal."""
    with contextlib.ExitStack() as stack:
        yield lambda *args: stack.enter_context(Terminal(args, tmp_path))


class Terminal:
    """A command with a controlling terminal of its own, so that Ctrl-C is typed and not signalled."""

    def __init__(self, args, folder):
        self.master, slave = pty.openpty()
        self.screen = b""
        self.process = subprocess.Popen(
            [*RBPS, *map(str, args)], cwd=folder, stdin=slave, stdout=subprocess.PIPE, stderr=slave,
            env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"},
            preexec_fn=lambda: (os.setsid(), fcntl.ioctl(0, termios.TIOCSCTTY, 0)),
        )  # fmt: skip
        os.close(slave)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        os.close(self.master)

    def read(self, seconds=0.1):
        if select.select([self.master], [], [], seconds)[0]:
            with contextlib.suppress(OSError):  # the other side has left
                self.screen += os.read(self.master, 65536)

    @property
    def shown(self):
        """All that was on the screen, without colours and movements."""
        text = self.screen.decode(errors="ignore")  # what was read may end within a character
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)

    def until(self, pattern, seconds=120.0):
        """Read until the pattern was shown."""

        def found():
            match = re.search(pattern, self.shown)
            assert match or self.process.poll() is None, self.shown[-2000:]
            return match

        return eventually(found, seconds, self.read, lambda: self.shown[-2000:])

    def type(self, keys):
        os.write(self.master, keys)

    def end(self, seconds=120.0):
        """Wait for the end: exit code, stdout."""
        eventually(
            lambda: self.process.poll() is not None, seconds, self.read, lambda: self.shown[-2000:]
        )
        for _ in range(5):
            self.read(0.02)
        return self.process.returncode, self.process.stdout.read().decode()
