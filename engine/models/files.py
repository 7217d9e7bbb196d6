"""Models from Python files of a user's own: ``path/to/file.py:name``, a file, or a folder of files.

A file may import others beside it. They belong to it: :attr:`ModelFile.digest` is of all of them, and
where one changes all are imported again.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType

from engine.errors import EngineError, ModelError, OptionError
from engine.statespace.checks import check_model
from engine.statespace.model import MixedModel

_neighbours: dict[
    Path, set[str]
] = {}  # names of modules that files of a folder have imported from it
_running: set[Path] = set()  # files that are being imported


@dataclass(frozen=True)
class ModelFile:
    """A Python file with models.

    Attributes
    ----------
    path : Path
        The file, absolute.
    module : module
        What importing it gave.
    files : tuple of Path
        The file and those beside it that it imports.
    stamps : tuple
        When each was changed last, and its size.
    """

    path: Path
    module: ModuleType
    files: tuple[Path, ...]
    stamps: tuple[object, ...]

    @property
    def models(self) -> dict[str, MixedModel]:
        """{name of the variable: model}; one that has several names by the first of them."""
        first: dict[int, tuple[str, MixedModel]] = {}
        for key, one in vars(self.module).items():
            if isinstance(one, MixedModel):
                first.setdefault(id(one), (key, one))
        return dict(first.values())

    @property
    def changed(self) -> bool:
        """Whether a file is not what it was."""
        return stamps_of(self.files) != self.stamps

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all the files."""
        out = hashlib.sha256()
        for file in self.files:
            out.update(file.read_bytes())
        return out.hexdigest()

    def model(self, name: str = "") -> MixedModel:
        """The checked model of that name; the only one where none is given. Raises OptionError, ModelError."""
        where = f"{self.path}{':' if name else ''}{name}"
        models = self.models
        there = f"its models are {', '.join(models)}" if models else "it holds no MixedModel"
        if not name and len(models) != 1:
            raise OptionError(f"{where}: name one, as in {self.path}:NAME; {there}", "model")
        if name and not hasattr(self.module, name):
            raise OptionError(f"{where}: the file has no '{name}'; {there}", "model")
        found = getattr(self.module, name) if name else next(iter(models.values()))
        if not isinstance(found, MixedModel):
            kind = type(found).__name__
            raise OptionError(f"{where}: '{name}' is a {kind}; a MixedModel is needed", "model")
        try:
            check_model(found)
        except EngineError as error:
            raise ModelError(f"{where}: {error}") from error
        return found


def model_from(reference: str) -> MixedModel:
    """The checked model that ``path/to/file.py:name`` names.

    Parameters
    ----------
    reference : str
        The file, and the name of a variable in it where it holds several models.

    Returns
    -------
    MixedModel
        The model of the file, its functions checked.

    Raises
    ------
    OptionError
        There is no such file or no such model in it.
    ModelError
        The file cannot be imported, or the model cannot be used.
    """
    parts = in_file(reference)
    if parts is None:
        raise OptionError(f"{reference}: path/to/file.py:name is needed", "model")
    path, name = parts
    return read_models(path).model(name)


def in_file(reference: str) -> tuple[Path, str] | None:
    """File and name of a model that comes from a file; the name may be empty. None for other references."""
    path, colon, name = reference.rpartition(":")
    path, name = (path, name) if colon else (reference, "")
    return (Path(path), name) if path.endswith(".py") else None


def files_of(reference: str) -> list[Path]:
    """The Python files that ``path/to/file.py:name``, a file or a folder stands for. Raises OptionError."""
    parts = in_file(reference)
    path = Path(reference) if parts is None else parts[0]
    if parts is None and path.is_dir():
        return sorted(file.absolute() for file in path.glob("*.py") if file.name[0] not in "._")
    if parts is None or not path.is_file():
        what = "there is no such file" if parts else "neither a .py file nor a folder of them"
        raise OptionError(f"{path}: {what}", "model")
    return [path.absolute()]


def read_models(path: str | Path) -> ModelFile:
    """Import a file anew. Raises OptionError where there is none, ModelError with the line that failed."""
    (path,) = files_of(f"{path}:")
    stamps = stamps_of([path])
    known = _neighbours.setdefault(path.parent, set())
    for name in known:
        sys.modules.pop(name, None)
    before = set(sys.modules)
    module = _imported(path)
    known |= {name for name in set(sys.modules) - before if _beside(sys.modules.get(name), path)}
    files = [path, *sorted({Path(str(sys.modules[name].__file__)) for name in known
                            if name in sys.modules} - {path})]  # fmt: skip
    return ModelFile(path, module, tuple(files), (*stamps, *stamps_of(files[1:])))


def _imported(path: Path) -> ModuleType:
    if path in _running:  # else without end
        raise ModelError(
            f"{path}: the file asks for its own models while it is imported, as engine.load does; put what "
            'computes under: if __name__ == "__main__":'
        )
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))  # the file may import its neighbours
    own = sys.modules.get(path.stem)
    if own is None or getattr(own, "__file__", None) == str(path):  # never another's module
        sys.modules[path.stem] = module
    _running.add(path)
    try:
        # not by its loader, whose __pycache__ takes two versions of one second for the same
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        if sys.modules.get(path.stem) is module:
            del sys.modules[path.stem]
        raise ModelError(
            f"{path}: {type(error).__name__}: {error}{_line_in(error, path)}"
        ) from error
    finally:
        _running.discard(path)
    return module


def _line_in(error: BaseException, path: Path) -> str:
    trace, line = error.__traceback__, None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return "" if line is None else f" (line {line})"


def _beside(module: ModuleType | None, path: Path) -> bool:
    """Whether a module lies in the file's folder, and is neither the engine's nor an installed one."""
    file = getattr(module, "__file__", None)
    if not file or "site-packages" in Path(file).parts:
        return False
    own = str(getattr(module, "__name__", "")).partition(".")[0] in ("engine", "service")
    return not own and Path(file).is_relative_to(path.parent)


def stamps_of(files: Iterable[Path]) -> tuple[object, ...]:
    """When each file was changed last and its size; None for one that is gone."""
    out: list[object] = []
    for file in files:
        try:
            stat = file.stat()
        except OSError:
            out.append(None)
        else:
            out.append((stat.st_mtime_ns, stat.st_size))
    return tuple(out)
