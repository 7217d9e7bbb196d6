"""Models of files of the user's own, as processes of their own find them.

A function that does not return, or ends the process that calls it, would take the service with it. So the
service has what is declared of such a model, and its functions are called elsewhere: once for each version
of a file to check it, and where a request asks for what only they can tell.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from engine.errors import EngineError, ModelError
from engine.models.registry import Read, not_read, read_here
from engine.statespace.model import MixedModel, Parameter
from service.orphans import die_with_parent
from service.problems import unexpected
from service.processes import heard, settle
from service.serializers import CHECK, EXAMPLE, check, example
from service.settings import Settings
from service.validation import ELSEWHERE

ANSWERS = 64  # to questions about models that are remembered

log = logging.getLogger("service")


class OwnModels:
    """Reads files of models, and asks them, with the settings' limits."""

    def __init__(self, settings: Settings) -> None:
        self._memory, self._seconds = settings.worker_memory, settings.model_seconds
        self._answer = lru_cache(ANSWERS)(self._ask_process)

    def read(self, path: Path, names: Collection[str]) -> Read:
        """The models of a file, without their functions, see :func:`engine.models.registry.read_here`."""
        cannot = not_read(path)
        said, cause = heard(_describe, (self._memory, path, {*names}), self._seconds)
        if cause:
            log.warning("%s: %s", path, cause)
        if not said:
            return replace(cannot, error=f"{path}: {cause}")
        found: Read = said[0]
        for model in found.models:
            for name, derived in said[1:]:
                if name == model.name:
                    model.derived.update(derived)
            if EXAMPLE not in model.derived:
                told = f"Could not be tried to the end: {cause}."
                model.derived[CHECK] = [*model.derived.get(CHECK, ()), told]
            whose = (path, frozenset(names), found.digest, model.name)
            model.derived[ELSEWHERE] = partial(self._ask, whose)
        return found

    def _ask(self, whose: Any, call: Callable[..., Any], *args: Any) -> Any:
        """``call(model, *args)``, from a process that has the model's functions. Raises EngineError."""
        answer = self._answer(whose, pickle.dumps((call, args)))
        if isinstance(answer, MixedModel):
            answer.derived[ELSEWHERE] = partial(self._ask, whose, _after, call, args)
        return answer

    def _ask_process(self, whose: Any, question: bytes) -> Any:
        path, names, _, name = whose
        said, cause = heard(_answer, (self._memory, path, names, name, question), self._seconds)
        if cause:
            raise ModelError(f"model '{name}' could not be asked: {cause}")
        ((answer, derived),) = said
        if isinstance(answer, EngineError):
            raise answer
        if isinstance(answer, MixedModel):
            answer.derived.update(derived)
        return answer


def _after(model: MixedModel, first: Callable[..., Any], args: Any, call: Any, *more: Any) -> Any:
    """A question about what the answer to another is."""
    return call(first(model, *args), *more)


def _describe(send: Connection, memory: int, path: Path, names: Collection[str]) -> None:
    """Entry point of the process that reads a file: what is declared, then what functions tell."""
    die_with_parent()
    settle(memory)
    found = read_here(path, names)
    send.send(replace(found, models=[declared(model) for model in found.models]))
    for model in found.models:
        send.send((model.name, {CHECK: check(model)}))
        send.send((model.name, {EXAMPLE: example(model)}))
    send.send(None)


def _answer(
    send: Connection, memory: int, path: Path, names: Collection[str], name: str, question: bytes
) -> None:
    """Entry point of the process that calls a model's functions."""
    die_with_parent()
    settle(memory)
    derived = {}
    try:
        found = read_here(path, names)
        model = next((one for one in found.models if one.name == name), None)
        if model is None:
            raise ModelError(f"the file of model '{name}' is not what it was; try again")
        call, args = pickle.loads(question)
        answer = call(model, *args)
        if isinstance(answer, MixedModel):
            derived = {CHECK: check(answer)}
            answer = declared(answer)
    except EngineError as error:  # of a class of the file's own the service knows nothing
        own = type(error).__module__ != EngineError.__module__
        answer = ModelError(str(error)) if own else error
    except Exception as error:  # noqa: BLE001 - a stranger's function
        answer = ModelError(unexpected(error))
    send.send((answer, derived))
    send.send(None)


def declared(model: MixedModel) -> MixedModel:
    """The model without its functions, of plain values: to read them takes nothing of its file."""

    def labels(channels: Any) -> dict[str, str]:
        return {str(name): str(unit) for name, unit in channels.items()}

    return MixedModel(
        str(model.name),
        _not_here,
        _not_here,
        _not_here,
        labels(model.outputs),
        [
            Parameter(
                str(p.name),
                float(p.default),
                str(p.unit),
                (float(p.bounds[0]), float(p.bounds[1])),
                str(p.description),
                float(p.scale),
            )
            for p in model.parameters
        ],
        labels(model.nonlinear),
        labels(model.linear),
        labels(model.inputs),
        str(model.description),
        [str(line) for line in model.equations],
        [str(name) for name in model.kinematic],
        {str(name): float(value) for name, value in model.reference.items()},
        bool(model.continuous),
        int(model.steps_counted),
    )


def _not_here(*_: Any) -> Any:
    raise ModelError("the functions of a model of your own are not called by the service itself")
