"""The state file of an estimation: what was asked, what its tasks left, every iteration of the current one.

Tasks are those of ``stages.plan``, one after the other. The file is an .npz archive of one table and JSON
texts; nothing is pickled. It is written beside itself and
moved into place, so a file that is there is whole.
"""

from __future__ import annotations

import copy
import hashlib
import io
import json
import os
import signal
import time
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from engine.model import Array, Theta
from service import strict_json
from service.cli.ending import Interrupt, wrong
from service.cli.meter import Meter

FORMAT = 2
# At most so much work is lost to a kill, or so many times what it takes to save a large state; Ctrl-C
# loses the running iteration only.
SAVE_SECONDS, SAVE_TIMES = 1.0, 20.0


@dataclass
class Asked:
    """An estimation as it was asked for; paths are absolute, ``sha256`` maps files to digests."""

    data: list[str]
    model: str
    effects: list[str] = field(default_factory=list)
    start: dict[str, float] = field(default_factory=dict)
    fixed: dict[str, float] = field(default_factory=dict)
    free: list[str] = field(default_factory=list)
    columns: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    dt: float | None = None
    method: str = "rbps-em"
    particles: int = 50
    trajectories: int | None = None
    iterations: int = 100
    seed: int = 0
    standard_errors: bool = True
    starts: int = 1
    bootstrap: int = 0
    out: str | None = None
    report: str | None = None
    plot: str | None = None
    keep: bool = False  # the state file, when there is nothing to go on with any more
    sha256: dict[str, str] = field(default_factory=dict)
    version: str = ""

    def seal(self, files: list[Path]) -> None:
        """Note what the files hold now, and who computes."""
        self.sha256 = {str(file.absolute()): digest(file) for file in files}
        self.version = version("rbps")

    def check(self) -> None:
        """Refuse to go on where a file is not what it was."""
        for name, known in self.sha256.items():
            if not Path(name).is_file():
                raise wrong(f"--resume: {name} is gone; the estimation needs it")
            if digest(Path(name)) != known:
                raise wrong(
                    f"--resume: {name} has changed since the estimation began; start it anew"
                )


def digest(file: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


class Recorder:
    """``kinds.Progress`` on a state file and a meter; rows are (theta..., log-likelihood, ess, ...)."""

    def __init__(
        self,
        path: Path,
        asked: Asked,
        meter: Meter,
        rows: Array | None = None,
        finished: Sequence[Any] = (),
    ) -> None:
        self.path, self.asked, self.meter = path, asked, meter
        self.done: list[Array] = [] if rows is None else list(rows)
        self.finished = list(finished)  # what the tasks before this one left
        self.names: list[str] = []  # of the tasks, where there are several
        self._save_at = time.monotonic() + SAVE_SECONDS
        self.interrupt = Interrupt()

    @property
    def k(self) -> int:
        """Iterations done of this task."""
        return max(len(self.done) - 1, 0)

    @property
    def task(self) -> int:
        """Number of the task that is computed."""
        return len(self.finished)

    @property
    def name(self) -> str:
        """What is computed, such as ``start 2 of 8``; empty where there is nothing else."""
        return self.names[self.task] if self.names else ""

    @property
    def steps(self) -> int:
        """Iterations done in all; a task that has ended has used all that it might."""
        return self.asked.iterations * self.task + self.k

    def finish(self, result: Any) -> None:
        """Go on to the next task; ``result`` is kept as JSON, as the service keeps it."""
        self.finished.append(json.loads(strict_json.dumps(result)))
        self.done = []
        self.save()

    def rows(self) -> Array:
        """Iterations of the run that is resumed."""
        return np.array(self.done)

    def start(self, theta: Theta) -> None:
        """Row 0: where the estimation starts."""
        self.done = [np.append(theta, [np.nan] * 4)]

    def iteration(self, it: Any) -> None:
        """One more row, saved when the last saving is long enough ago."""
        numbers = [it.log_likelihood, it.ess, it.seconds, it.collapsed]
        self.done.append(np.append(it.theta, numbers))
        if time.monotonic() > self._save_at:
            self.save()
        said = f"log-likelihood {it.log_likelihood:.2f}"
        self.meter.at(self.steps, f"{self.name}, {said}" if self.names else said)
        self.interrupt.check()

    def step(self, k: int, message: str = "") -> None:
        """What follows the iterations."""
        if self.interrupt.holding:
            self.save()
            self.interrupt.let_go()
        self.meter.say(message)

    def left(self, task: int) -> Any:
        """What an earlier task left."""
        return copy.deepcopy(self.finished[task])

    def save(self) -> None:
        """Write the state; Ctrl-C waits meanwhile."""
        began = time.monotonic()
        with _undisturbed():
            write(self.path, self.asked, np.array(self.done), self.finished)
        now = time.monotonic()
        self._save_at = now + max(SAVE_SECONDS, SAVE_TIMES * (now - began))


def write(path: Path, asked: Asked, rows: Array, finished: Sequence[Any] = ()) -> None:
    """Write a state file in one move."""
    text = json.dumps({"rbps_state": FORMAT} | asdict(asked))
    left = np.frombuffer(json.dumps(list(finished)).encode(), dtype=np.uint8)
    packed = io.BytesIO()
    np.savez_compressed(packed, asked=np.array(text), rows=np.atleast_2d(rows), left=left)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(packed.getvalue())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def read(path: Path) -> tuple[Asked, Array, list[Any]]:
    """What was asked, the current task's rows (k + 1, n_theta + 4) or (0, 0), and what tasks left."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            told, rows = json.loads(str(stored["asked"])), np.asarray(stored["rows"], dtype=float)
            left = json.loads(stored["left"].tobytes())
        known = {one.name for one in fields(Asked)}
        asked = Asked(**{name: value for name, value in told.items() if name in known})
    except FileNotFoundError:
        raise wrong(f"--resume {path}: there is no such file") from None
    except (ValueError, TypeError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise wrong(f"--resume {path}: this is not a state file of 'rbps fit'") from error
    if told.get("rbps_state") != FORMAT or rows.ndim != 2 or not isinstance(left, list):
        raise wrong(f"--resume {path}: this is not a state file of this version of rbps")
    return asked, rows if rows.size else np.zeros((0, 0)), left


def keep_old(path: Path) -> Path | None:
    """Move a state file that is in the way aside; where it went."""
    if not path.exists():
        return None
    aside = path.with_name(path.name + "~")
    os.replace(path, aside)
    return aside


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold Ctrl-C back until the file is written."""
    came: list[Any] = []
    before = signal.signal(signal.SIGINT, lambda *signal_: came.append(signal_))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt
