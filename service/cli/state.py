"""The state file of an estimation: what was asked, and every iteration that is done.

An .npz archive of one table and one JSON text; nothing is pickled. It is written beside itself and
moved into place, so a file that is there is whole.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import signal
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from engine.model import Array, Theta
from service.cli.ending import Interrupt, wrong
from service.cli.meter import Meter

FORMAT = 1
SAVE_SECONDS = (
    1.0  # at most so much work is lost to a kill; Ctrl-C loses the running iteration only
)


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

    def __init__(self, path: Path, asked: Asked, meter: Meter, rows: Array | None = None) -> None:
        self.path, self.asked, self.meter = path, asked, meter
        self.done: list[Array] = [] if rows is None else list(rows)
        self._saved = time.monotonic()
        self.interrupt = Interrupt()

    @property
    def k(self) -> int:
        """Iterations done."""
        return max(len(self.done) - 1, 0)

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
        if time.monotonic() - self._saved > SAVE_SECONDS:
            self.save()
        self.meter.at(it.k, f"log-likelihood {it.log_likelihood:.2f}")
        self.interrupt.check()

    def step(self, k: int, message: str = "") -> None:
        """What follows the iterations."""
        self.meter.say(message)

    def left(self, task: int) -> Any:
        """What other tasks left: the command line runs a single one."""
        raise LookupError(f"task {task}")

    def save(self) -> None:
        """Write the state; Ctrl-C waits meanwhile."""
        with _undisturbed():
            write(self.path, self.asked, np.array(self.done))
        self._saved = time.monotonic()


def write(path: Path, asked: Asked, rows: Array) -> None:
    """Write a state file in one move."""
    text = json.dumps({"rbps_state": FORMAT} | asdict(asked))
    packed = io.BytesIO()
    np.savez_compressed(packed, asked=np.array(text), rows=rows)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(packed.getvalue())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def read(path: Path) -> tuple[Asked, Array]:
    """What was asked, and its rows (k + 1, n_theta + 4)."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            told, rows = json.loads(str(stored["asked"])), np.asarray(stored["rows"], dtype=float)
        known = {one.name for one in fields(Asked)}
        asked = Asked(**{name: value for name, value in told.items() if name in known})
    except FileNotFoundError:
        raise wrong(f"--resume {path}: there is no such file") from None
    except (ValueError, TypeError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise wrong(f"--resume {path}: this is not a state file of 'rbps fit'") from error
    if told.get("rbps_state") != FORMAT or rows.ndim != 2:
        raise wrong(f"--resume {path}: this is not a state file of this version of rbps")
    return asked, rows


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
