"""Registered models by name: those of ``engine.models`` and those of users' packages.

A package offers models through the entry-point group ``engine.models``; an entry point is a
MixedModel, or a function that returns one or several. A broken one is reported by
``plugin_errors()`` and stops nothing. Models of files (:func:`register_files`) are read again when their
files change.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from threading import RLock
from typing import TypeAlias

from engine.errors import EngineError, ModelError, OptionError
from engine.models.files import files_of, in_file, read_models, stamps_of
from engine.statespace.checks import check_model
from engine.statespace.model import MixedModel

GROUP = "engine.models"
OF_A_FOLDER = (
    "*"  # in place of a model's name: all there are, which may be none in a file of helpers
)


@dataclass(frozen=True)
class Read:
    """The checked models of a file, or why it cannot be used.

    ``stamps`` are those of ``files`` when they were read, ``digest`` is their SHA-256.
    """

    models: Sequence[MixedModel]
    files: tuple[Path, ...]
    stamps: tuple[object, ...]
    digest: str = ""
    error: str = ""

    @property
    def changed(self) -> bool:
        """Whether a file is not what it was."""
        return stamps_of(self.files) != self.stamps


# What reads the models of a file that have certain names; "" is the only one, OF_A_FOLDER all there are.
Reader: TypeAlias = Callable[[Path, Collection[str]], Read]


def read_here(path: Path, names: Collection[str]) -> Read:
    """Import a file in this process and check its models."""
    cannot = not_read(path)
    try:
        found = read_models(path)
        every = [*found.models] if {"", OF_A_FOLDER}.intersection(names) else []
        named = sorted({*names}.difference(every, {OF_A_FOLDER}, {""} if every else ()))
        models = [found.model(name) for name in [*every, *named]]
        return Read(models, found.files, found.stamps, found.digest)
    except EngineError as error:
        return replace(cannot, error=str(error))


def not_read(path: Path, error: str = "") -> Read:
    """A file that cannot be used, until it or something beside it changes: what it imports is not known."""
    files = (path, path.parent, *sorted(path.parent.glob("*.py")))
    return Read((), files, stamps_of(files), error=error)


@dataclass
class Own:
    """What :func:`register_files` was given, and what was read of it."""

    references: dict[str, Reader] = field(default_factory=dict)
    read: dict[Path, Read] = field(default_factory=dict)
    names: dict[Path, list[str]] = field(default_factory=dict)  # of the models of each usable file
    errors: dict[Path, str] = field(default_factory=dict)  # why a file cannot be used


_models: dict[str, MixedModel] = {}
_plugin_errors: dict[str, str] = {}
_own = Own()
_lock = RLock()
_loaded = False


def register(model: MixedModel, replace: bool = False) -> MixedModel:
    """Check a model and make it known by its name.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    replace : bool
        Whether a model of that name may be replaced.

    Returns
    -------
    MixedModel
        The model as it was given, now found by :func:`get_model`.

    Raises
    ------
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    """
    with _lock:
        _load()
        check_model(model)
        return _register(model, replace)


def get_model(name: str) -> MixedModel:
    """The registered model of that name. Raises OptionError naming those there are."""
    with _lock:
        _load()
        _read_files()
        if name not in _models:
            broken = "".join(f". {text}" for text in _file_errors().values())
            raise OptionError(
                f"no model is registered as '{name}'; there are {', '.join(sorted(_models))}{broken}",
                "model",
            )
        return _models[name]


def model_names() -> list[str]:
    """The names of all registered models, sorted.

    Returns
    -------
    list of str
        What :func:`get_model` takes.
    """
    with _lock:
        _load()
        _read_files()
        return sorted(_models)


def plugin_errors() -> dict[str, str]:
    """Entry points, and files of a registered folder, that could not be used.

    Returns
    -------
    dict
        {name: reason}.
    """
    with _lock:
        _load()
        _read_files()
        return {**_plugin_errors, **_file_errors()}


def _file_errors() -> dict[str, str]:
    """Why files cannot be used, by their names: their places are nobody's business but the operator's."""
    return {path.name: text.replace(f"{path.parent}/", "") for path, text in _own.errors.items()}


def register_files(references: Sequence[str], reader: Reader = read_here) -> list[str]:
    """Make models of Python files known by their names, and read the files again where they change.

    Parameters
    ----------
    references : sequence of str
        Each ``path/to/file.py:name``, a file with all its models, or a folder with all its files.
    reader : callable
        What reads a file that is new or has changed; by default it is imported in this process.

    Returns
    -------
    list of str
        The models' names.

    Raises
    ------
    OptionError
        There is no such file or folder, or no such model in it.
    ModelError
        A file that was named cannot be used. One of a folder is told by :func:`plugin_errors`.
    """
    with _lock:
        _load()
        before = dict(_own.references)
        try:
            _own.references |= {one: reader for one in references if files_of(one)}
            _read_files()
            for reference in references:
                parts = in_file(reference)
                if parts is not None and (error := _own.errors.get(parts[0].absolute())):
                    raise ModelError(error)
        except EngineError:
            _own.references = before
            _read_files()
            raise
        return [name for names in _own.names.values() for name in names]


def source_of(name: str) -> str | None:
    """SHA-256 of the file that a registered model comes from; None for one of an installed package.

    Parameters
    ----------
    name : str
        The model's name.

    Returns
    -------
    str or None
        The digest.
    """
    with _lock:
        for path, names in _own.names.items():
            if name in names:
                return _own.read[path].digest
    return None


def _read_files() -> None:
    """Read the files that are new or not what they were, and forget those that have gone."""
    wanted: dict[Path, tuple[set[str], Reader]] = {}
    _own.errors.clear()  # those of files that are still as they were are told again below
    for reference, reader in _own.references.items():
        parts = in_file(reference)
        try:
            for file in files_of(reference):
                wanted.setdefault(file, (set(), reader))[0].add(parts[1] if parts else OF_A_FOLDER)
        except OptionError as error:  # it has been there
            _own.errors[(parts[0] if parts else Path(reference)).absolute()] = str(error)
    for path in [*_own.read]:
        if path not in wanted or _own.read[path].changed:
            _unregister(path)
            del _own.read[path]
    for path, (names, reader) in wanted.items():
        if path not in _own.read:
            _own.read[path] = reader(path, names)
        if path not in _own.names:
            _register_file(path)


def _register_file(path: Path) -> None:
    """Register the models that were read of a file; why that cannot be is kept."""
    found, _own.names[path] = _own.read[path], []
    try:
        if found.error:
            raise ModelError(found.error)
        for model in found.models:
            _own.names[path].append(_register(model, replace=False).name)
    except EngineError as error:
        _unregister(path)
        _own.errors[path] = str(error)


def _unregister(path: Path) -> None:
    for name in _own.names.pop(path, ()):
        _models.pop(name, None)


def _register(model: MixedModel, replace: bool) -> MixedModel:
    if model.name in _models and not replace:
        raise ModelError(
            f"a model named '{model.name}' is already registered; choose another name or "
            "pass replace=True"
        )
    _models[model.name] = model
    return model


def _load() -> None:
    """Register the shipped models once, then those of installed packages."""
    global _loaded
    if _loaded:
        return
    _loaded = True
    from engine.models import SHIPPED

    for model in SHIPPED:
        _register(model, replace=True)
    for point in entry_points(group=GROUP):
        try:
            offered = point.load()
            if callable(offered) and not isinstance(offered, MixedModel):
                offered = offered()
            for model in _several(offered):
                check_model(model)
                _register(model, replace=False)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's package may do anything
            _plugin_errors[point.name] = f"{type(error).__name__}: {error}"


def _several(offered: MixedModel | Iterable[MixedModel]) -> Sequence[MixedModel]:
    return [offered] if isinstance(offered, MixedModel) else list(offered)
