"""State files: what was asked of a command, and what is done of it.

The file is an .npz archive of one table and JSON texts; nothing is pickled. It is written beside
itself and moved into place, so a file that is there is whole.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shlex
import time
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from engine.models.files import in_file
from engine.statespace.model import Array
from service.cli.ending import Interrupt, wrong
from service.cli.meter import Meter

FORMAT = 2
FOLDER = ".rbps"  # of state files that were given no name
# At most so much work is lost to a kill, or so many times what it takes to save a large state; Ctrl-C
# loses the running step only.
SAVE_SECONDS, SAVE_TIMES = 1.0, 20.0


@dataclass(kw_only=True)
class Run:
    """What can be resumed, as it was asked for; paths are absolute.

    ``sha256`` has the digests of the files that it names, by their paths.
    """

    command: ClassVar[str]
    result: ClassVar[str]  # what the command makes, for messages
    same_version: ClassVar[bool] = False  # must go on with it, as parts are kept and not iterations
    model: str
    free: list[str] = field(default_factory=list)
    dt: float | None = None
    seed: int = 0
    out: str | None = None
    report: str | None = None
    plot: str | None = None
    sha256: dict[str, str] = field(default_factory=dict)
    version: str = ""
    keep: bool = False  # the state file, when there is nothing to go on with any more

    def begin(self, path: Path, files: Sequence[str], shown: Meter) -> StateFile:
        """The state file of a new run; an earlier one of that name is moved aside."""
        model = in_file(self.model)
        named = [*map(Path, files), *([model[0]] if model else [])]
        self.sha256 = {str(file.absolute()): digest(file) for file in named}
        self.version = version("rbps")
        if path.exists():
            aside = path.with_name(path.name + "~")
            os.replace(path, aside)
            shown.note(f"an earlier {path.name} is kept as {aside.name}")
        return StateFile(path, self)

    def change(self, changes: Mapping[str, Any]) -> None:
        """Take over what a resumed run may change.

        Refuses one whose files are not what they were, or whose parts are of another version.
        """
        for name, value in changes.items():
            setattr(self, name, value)
        for name, known in self.sha256.items():
            if not Path(name).is_file():
                raise wrong(f"--resume: {name} is gone; the {self.result} needs it")
            if digest(Path(name)) != known:
                raise wrong(
                    f"--resume: {name} has changed since the {self.result} began; start it anew"
                )
        if self.same_version and self.version != version("rbps"):
            raise wrong(
                f"--resume: the {self.result} was begun by rbps {self.version}, whose numbers may differ; "
                "start it anew"
            )


Asked = TypeVar("Asked", bound=Run)


def digest(file: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


class StateFile:
    """Where a running command saves its state, now and then."""

    def __init__(self, path: Path, asked: Run) -> None:
        self.path, self.asked = path, asked
        self._save_at = time.monotonic() + SAVE_SECONDS

    @property
    def due(self) -> bool:
        """Whether the last saving is long enough ago."""
        return time.monotonic() > self._save_at

    def save(self, rows: Array, left: Sequence[Any]) -> None:
        """Write the state; Ctrl-C waits meanwhile."""
        began = time.monotonic()
        with Interrupt(patient=True).held():
            write(self.path, self.asked, rows, left)
        now = time.monotonic()
        self._save_at = now + max(SAVE_SECONDS, SAVE_TIMES * (now - began))

    def remove(self) -> None:
        """Remove a state that no run can go on with, unless it was asked for by name.

        The folder of states goes with the last of them.
        """
        if self.asked.keep:
            return
        self.path.unlink(missing_ok=True)
        if self.path.parent.name == FOLDER:
            with suppress(OSError):  # others are in it
                self.path.parent.rmdir()

    @property
    def again(self) -> str:
        """What to type to go on."""
        return f"rbps {self.asked.command} --resume {shlex.quote(os.path.relpath(self.path))}"


def write(path: Path, asked: Run, rows: Array, left: Sequence[Any] = ()) -> None:
    """Write a state file in one move."""
    text = json.dumps({"rbps_state": FORMAT, "command": asked.command} | asdict(asked))
    packed_left = np.frombuffer(json.dumps(list(left)).encode(), dtype=np.uint8)
    packed = io.BytesIO()
    np.savez_compressed(packed, asked=np.array(text), rows=np.atleast_2d(rows), left=packed_left)
    if path.parent.name == FOLDER:
        path.parent.mkdir(exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(packed.getvalue())
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def read(path: Path, kind: type[Asked]) -> tuple[Asked, Array, list[Any]]:
    """What was asked of the command, its rows (k, n) or (0, 0), and what else it left."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            stored_request = json.loads(str(stored["asked"]))
            rows = np.asarray(stored["rows"], dtype=float)
            left = json.loads(stored["left"].tobytes())
        other = stored_request.get("command", "fit")  # the first that had one, and did not say so
        if other != kind.command:
            raise wrong(
                f"--resume {path}: this is a state file of 'rbps {other}'; go on with "
                f"'rbps {other} --resume {path}'"
            )
        known = {one.name for one in fields(kind)}
        asked = kind(**{name: value for name, value in stored_request.items() if name in known})
    except FileNotFoundError:
        raise wrong(f"--resume {path}: there is no such file") from None
    except (ValueError, TypeError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise wrong(
            f"--resume {path}: this is not a state file of 'rbps {kind.command}'"
        ) from error
    if stored_request.get("rbps_state") != FORMAT or rows.ndim != 2 or not isinstance(left, list):
        raise wrong(f"--resume {path}: this is not a state file of this version of rbps")
    return asked, rows if rows.size else np.zeros((0, 0)), left


def beside(out: str | None, otherwise: str) -> Path:
    """The state file's name where none is given: in a folder of their own beside the output, or here."""
    named = Path(out).with_suffix(".state") if out else Path(f"{otherwise}.state")
    return named.parent / FOLDER / named.name
