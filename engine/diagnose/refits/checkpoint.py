"""Finished parts of a diagnosis, kept so that an interrupted one goes on with the same numbers.

The parts that take the time are fits and screens. Each has a name by which the same diagnosis meets it
again: the round and the extended model. What is kept of it are its numbers, bit for bit, as JSON
values; models and effects are functions and made anew. A part that failed is not kept, but fails again.
"""

from __future__ import annotations

import base64
import hashlib
import json
import time
from collections.abc import Callable, Generator, Mapping, MutableMapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from functools import partial
from importlib.metadata import version
from typing import Any, TypeVar

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import effect_kinds
from engine.diagnose.effects.effect import Effect
from engine.diagnose.records import Records
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.screen import Score, Screen
from engine.errors import OptionError
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_filter
from engine.forked import Copies
from engine.statespace.model import Array, MixedModel, Theta

Part = TypeVar("Part")
Parts = MutableMapping[str, Any]

ASKED = "asked"  # the part that says which diagnosis the others belong to


def _nobody(*_told: Any) -> None:
    """Hears of seconds and parts, and does nothing."""


@dataclass(frozen=True)
class Kept:
    """Parts by name, of which those of a round begin with ``where``; without ``parts`` nothing is kept.

    ``of`` begins the names of one search, where there are several.
    ``spent`` is told the seconds that an earlier run spent on a part which need not be computed again; ``told``
    every part by its name, as soon as it is there; ``ours`` are the names of what this run has computed.
    """

    parts: Parts | None = None
    spent: Callable[[float], Any] = _nobody
    where: str = ""
    of: str = ""
    told: Callable[[str, Any], Any] = _nobody
    ours: set[str] = field(default_factory=set)

    def apart(self, what: str) -> Kept:
        """The same parts, for a search beside the first, whose names may be the same."""
        return replace(self, where=f"{self.of}{what}: ", of=f"{self.of}{what}: ")

    def within(self, where: str) -> Kept:
        """The same parts, named by where in the diagnosis they belong."""
        return replace(self, where=f"{self.of}{where}: ")

    def further(self, what: str) -> Kept:
        """The same parts, for what is done with a part that was kept before."""
        return replace(self, where=f"{self.where}{what}: ")

    def fit(self, model: MixedModel, compute: Callable[[], QuasiFit]) -> QuasiFit:
        """A fit of ``model``."""
        return self._part(f"fit {model.name}", compute, _of_fit, lambda kept: _fit(kept, model))

    def refit(self, model: MixedModel, effect: Effect, compute: Callable[[], Refit]) -> Refit:
        """A refit of an effect of ``model``."""

        def made(kept: Any) -> Refit:
            own = effect.with_free_zero() if effect.zero in kept["free"] else effect
            return Refit(own, _fit(kept, effect.apply(model)), kept["gain"], kept["score"])

        return self._part(_refit_of(effect), compute, _of_refit, made)

    def refits(
        self, model: MixedModel, tasks: Sequence[tuple[Effect, Callable[[], Refit]]]
    ) -> Generator[Callable[[], Refit], None, None]:
        """Refits of effects of ``model`` that do not depend on each other, each to be asked for in its turn.

        Those that were not kept are shared with copies of this process. To be closed.
        """
        new = (
            [] if self.parts is None else [i for i in range(len(tasks)) if not self._has(tasks[i])]
        )
        with Copies([partial(_timed, tasks[i][1], _of_refit) for i in new]) as copies:
            for i, (effect, compute) in enumerate(tasks):
                found = copies.take(new.index(i)) if i in new else None
                if self.parts is not None and found is not None:
                    name = self.where + _refit_of(effect)
                    self.ours.add(name)
                    self.parts[name] = found
                yield partial(self.refit, model, effect, compute)

    def _has(self, task: tuple[Effect, Any]) -> bool:
        return self.parts is not None and self.where + _refit_of(task[0]) in self.parts

    def screen(self, effects: Sequence[Effect], compute: Callable[[], Screen]) -> Screen:
        """A screen of some or all of ``effects``."""
        return self._part("screen", compute, _of_screen, lambda kept: _screen(kept, effects))

    def numbers(self, name: str, compute: Callable[[], Part]) -> Part:
        """A number or an array, or that there is none."""
        found: Part = self._part(name, compute, _packed, _unpacked)
        return found

    def _part(
        self,
        name: str,
        compute: Callable[[], Part],
        numbers_of: Callable[[Part], Any],
        made_of: Callable[[Any], Part],
    ) -> Part:
        """What was kept under a name, or else computed, and kept then."""
        known = None if self.parts is None else self.parts.get(self.where + name)
        if known is not None:
            if self.where + name not in self.ours:  # else they are on this run's clock already
                self.spent(known["seconds"])
            found = made_of(known["numbers"])
        else:
            since = time.perf_counter()
            found = compute()
            seconds = time.perf_counter() - since
            if self.parts is not None:
                kept = {"seconds": seconds, "numbers": numbers_of(found)}
                self.ours.add(self.where + name)
                self.parts[self.where + name] = kept
        self.told(self.where + name, found)
        return found


NOTHING = Kept()  # nothing was kept, and nothing is to be


def kept_of(
    parts: Parts | None,
    model: MixedModel,
    records: Records,
    options: Mapping[str, Any],
    spent: Callable[[float], Any],
) -> Kept:
    """The parts of this very diagnosis. Raises OptionError where they are of another one."""
    if parts is None:
        return NOTHING
    asked = {
        "another model": _identity(model, records.main),
        "another series": [_data(one) for one in (records.main, *records.others)],
        "another test series": [_data(one) for one in records.tests],
        "other options": options,
    }
    return of_the_same("a diagnosis", asked, parts, spent)


def of_the_same(
    work: str, asked: Mapping[str, Any], parts: Parts, spent: Callable[[float], Any]
) -> Kept:
    """The parts of this very ``work``, once ``asked`` is what it was and so is this software.

    Raises OptionError naming the first of ``asked`` that is not.
    """
    every = {**asked, "another catalogue": effect_kinds()}
    every["another version of rbps"] = version("rbps")
    digests = {what: _digest(value) for what, value in every.items()}
    if ASKED not in parts:
        parts[ASKED] = digests
    known = parts[ASKED]
    for what, digest in digests.items():
        if known.get(what) != digest:
            raise OptionError(f"what was kept is of {work} with {what}", "kept")
    return Kept(parts, spent)


def _digest(what: Any) -> str:
    return hashlib.sha256(json.dumps(what, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(what: Any) -> Any:
    """NumPy's numbers and arrays, and other sequences, as JSON has them."""
    return what.tolist() if isinstance(what, np.generic | np.ndarray) else list(what)


def _identity(model: MixedModel, series: Series) -> list[Any]:
    """Names, parameters, and a likelihood, which tells of functions that have changed."""
    value = moment_filter(model, np.asarray(model.theta())[None], series).log_likelihood[0]
    channels = [
        list(names.items())
        for names in (model.nonlinear, model.linear, model.inputs, model.outputs)
    ]
    parameters = [astuple(p) for p in model.parameters]
    return [model.name, channels, parameters, model.equations, model.kinematic, f"{value:.9g}"]


def _data(series: Series) -> list[Any]:
    names = [series.y_names, series.u_names, series.extra_names, series.hold]
    return [names, [_of_array(np.asarray(a)) for a in (series.t, series.y, series.u)]]


def _refit_of(effect: Effect) -> str:
    return f"refit {effect.name}"


def _timed(compute: Callable[[], Part], numbers_of: Callable[[Part], Any]) -> dict[str, Any]:
    """What is kept of a part that is computed now."""
    since = time.perf_counter()
    found = compute()
    return {"seconds": time.perf_counter() - since, "numbers": numbers_of(found)}


def _of_fit(fit: QuasiFit) -> dict[str, Any]:
    return _numbers_of(fit, "model")


def _of_refit(refit: Refit) -> dict[str, Any]:
    return {**_of_fit(refit.fit), **_numbers_of(refit, "effect", "fit")}


def _of_screen(screen: Screen) -> dict[str, Any]:
    scores = [[s.effect.name, *_numbers_of(s, "effect").values()] for s in screen.scores]
    return {**_numbers_of(screen, "scores"), "scores": scores}


def _fit(kept: Mapping[str, Any], model: MixedModel) -> QuasiFit:
    return _made(QuasiFit, kept, model=model, theta=Theta(kept["theta"], model.parameter_names))


def _screen(kept: Mapping[str, Any], effects: Sequence[Effect]) -> Screen:
    named = {effect.name: effect for effect in effects}
    scores = [Score(named[name], *_unpacked(numbers)) for name, *numbers in kept["scores"]]
    return _made(Screen, kept, scores=tuple(scores))


def _numbers_of(record: Any, *without: str) -> dict[str, Any]:
    """The fields of a dataclass as JSON values, but those that are no numbers."""
    names = [field.name for field in fields(record) if field.name not in without]
    return {name: _packed(getattr(record, name)) for name in names}


def _made(cls: type[Part], kept: Mapping[str, Any], **others: Any) -> Part:
    """The dataclass with these numbers, and the ``others`` of its fields."""
    names = [field.name for field in fields(cls) if field.name not in others]  # type: ignore[arg-type]
    return cls(**{name: _unpacked(kept[name]) for name in names}, **others)


def _packed(value: Any) -> Any:
    """Numbers, arrays and tuples of them as JSON values; None and text as they are."""
    if isinstance(value, tuple):
        return [_packed(one) for one in value]
    if isinstance(value, np.ndarray) and not isinstance(value, Theta):
        return _of_array(value)
    return value.tolist() if isinstance(value, Theta | np.generic) else value


def _unpacked(kept: Any) -> Any:
    """The inverse of :func:`_packed`, but for a Theta, which needs its names."""
    if isinstance(kept, list):
        return tuple(map(_unpacked, kept))
    return _array(kept) if isinstance(kept, Mapping) else kept


def _of_array(array: Array) -> dict[str, Any]:
    """Shape and bytes of the numbers, the lowest byte first."""
    flat = np.ascontiguousarray(array, dtype="<f8")
    return {"shape": list(flat.shape), "float64": base64.b64encode(flat.tobytes()).decode()}


def _array(kept: Mapping[str, Any]) -> Array:
    flat = np.frombuffer(base64.b64decode(kept["float64"]), dtype="<f8")
    return flat.reshape(kept["shape"]).astype(float)
