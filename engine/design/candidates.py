"""The causes that an experiment shall tell apart, each as a model with its estimates.

Of a diagnosis they are what it refitted; before any experiment they are named with their sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.design.bounds import finite, refused
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.likeness import rank
from engine.diagnose.refits.refitted import further_parameters
from engine.errors import OptionError
from engine.statespace.model import Array, MixedModel, ThetaLike

NOTHING = "nothing"  # the name of the model without a cause
TOGETHER = " + "  # between the names of effects that are one cause
INFORMATION = "information"  # among a cause's values: what a record told of them
ALARM = 12.0  # the statistic from which a diagnosis sees something, where none tells
LEAST_ALARM = 1.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause as a model.

    ``theta`` its estimates; ``free`` the parameters that a new diagnosis estimates; ``information``
    (n_free, n_free) what a record told of them, zeros where there was none; ``further`` parameters beside the
    size, which must earn their place; ``lead`` its score in that record. ``effects`` are what it adds, and
    ``rank`` is lower the more readily it is said of causes that say the same.
    """

    name: str
    title: str
    model: MixedModel
    theta: Array
    free: tuple[str, ...]
    information: Array
    further: int = 0
    lead: float = 0.0
    effects: tuple[Effect, ...] = ()
    rank: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, effects: tuple[Effect, ...], setting: Setting, **known: Any) -> Candidate:
        """The cause that these effects are together; ``known`` is the rest of it."""
        return cls(
            title=" and ".join(effect.title for effect in effects),
            further=sum(map(further_parameters, effects)) + len(effects) - 1,
            effects=effects,
            rank=rank(effects, setting),
            **known,
        )

    @property
    def indices(self) -> list[int]:
        """Positions of the free parameters in theta."""
        return [self.model.index(name) for name in self.free]

    @property
    def covariance(self) -> Array:
        """Of the free parameters (n, n), as far as a record told; zeros where it told nothing."""
        H = self.information
        d = np.asarray(np.sqrt(np.maximum(np.diag(H), 0.0)))
        inverse = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0.0)
        scaled = H * inverse[:, None] * inverse
        P = np.linalg.pinv(scaled, rcond=1e-8, hermitian=True)
        return np.asarray(P * inverse[:, None] * inverse)


@dataclass(frozen=True, eq=False)
class Question:
    """What shall be told apart.

    ``base`` is the model without any of the causes, the rival of all; ``alarm`` the statistic from which a
    diagnosis sees something; ``measured`` the outputs that are, all where None; ``notes`` what was left out and
    why.
    """

    candidates: tuple[Candidate, ...]
    base: Candidate
    alarm: float = ALARM
    measured: tuple[str, ...] | None = None
    notes: tuple[str, ...] = ()


def alarm_of(threshold: float) -> float:
    """The statistic that counts as an alarm, from a screen's threshold."""
    return max(float(threshold), LEAST_ALARM)


def before_any(
    model: MixedModel,
    causes: Mapping[str, Any],
    theta: ThetaLike,
    dt: float,
    free: Sequence[str] | None,
    alarm: float | None = None,
    measured: Sequence[str] | None = None,
) -> Question:
    """Causes by their names with sizes, or mappings of their own parameters, without a diagnosis at hand.

    ``alarm`` and ``measured`` as of :class:`Question`, where an earlier diagnosis told them.
    """
    values = np.asarray(model.theta(theta))
    setting = Setting(model, dt=dt)
    out, notes = [], []
    for name, given in causes.items():
        effects = tuple(_effect(part, given, setting) for part in name.split(TOGETHER))
        reason = next((text for effect in effects if (text := unsuited(effect))), "")
        if reason:
            notes.append(f"{name} was left out: {reason}.")
            continue
        extended = model
        for effect in effects:
            extended = effect.apply(extended)
        theta_ = np.asarray(extended.theta(_values(name, effects, given, values, model)))
        names = [*(model.parameter_names if free is None else free)]
        own = [p.name for e in effects for p in e.parameters if p.name not in (*e.held, *e.sought)]
        names += [one for one in own if one not in names]
        for one in names:
            extended.index(one)
        told = _information(f"causes.{name}.information", given, names)
        out.append(
            Candidate.of(
                effects,
                setting,
                name=name,
                model=extended,
                theta=theta_,
                free=tuple(names),
                information=told,
            )
        )
    check_number([one.name for one in out], notes)
    names = list(model.parameter_names if free is None else free)
    base = Candidate(
        NOTHING, "none of them", model, values, tuple(names), np.zeros((len(names),) * 2)
    )
    seen = None if measured is None else tuple(measured)
    for name in seen or ():
        if name not in model.outputs:
            there = ", ".join(model.outputs)
            raise refused("measured", f": there is no output '{name}'; there are {there}")
    return Question(
        tuple(out), base, ALARM if alarm is None else alarm_of(alarm), seen, tuple(notes)
    )


def unsuited(effect: Effect) -> str:
    """Why an input cannot be designed for an effect; "" where it can."""
    if effect.traits.course is not None:
        return (
            "it is an event or a course of time, which no input brings about; repeat the experiment, and what "
            "does not come back was one"
        )
    if effect.family == "time":
        return "it is where one record began, which no input changes"
    if effect.traits.unnamed:
        return "a force without a name has no prediction"
    if effect.traits.outliers or effect.family == "noise":
        return "it changes the noise and not what is predicted"
    return ""


def _effect(name: str, given: Any, setting: Setting) -> Effect:
    effect = make_effect(name, setting)
    if isinstance(given, Mapping) and f"{effect.size.name}_zero" in given:
        return make_effect(name, replace(setting, zeros={}))  # it counts from there
    return effect


def _values(
    name: str, effects: Sequence[Effect], given: Any, theta: Array, model: MixedModel
) -> list[float]:
    """Values of the model's parameters and the effects'. Raises OptionError naming the field."""
    where = f"causes.{name}"
    values = dict(zip(model.parameter_names, theta.tolist(), strict=True))
    values |= {p.name: p.default for effect in effects for p in effect.parameters}
    if isinstance(given, Mapping):
        for key, value in given.items():
            if key == INFORMATION:
                continue
            if key not in values:
                there = ", ".join(values)
                raise refused(f"{where}.{key}", f": there is no such parameter; there are {there}")
            values[key] = finite(value, f"{where}.{key}")
    elif len(effects) > 1:
        sizes = ", ".join(f"'{effect.size.name}': ..." for effect in effects)
        raise refused(where, f": several effects need a size each, as {{{sizes}}}")
    else:
        values[effects[0].size.name] = finite(given, where)
    for effect in effects:
        if values[effect.size.name] == 0.0:
            raise refused(where, f": its size {effect.size.name} must not be 0")
    return list(values.values())


def _information(where: str, given: Any, names: Sequence[str]) -> Array:
    """What a record told of the parameters ``names`` (n, n); zeros where it is not given."""
    out = np.zeros((len(names), len(names)))
    told = given.get(INFORMATION) if isinstance(given, Mapping) else None
    if told is None:
        return out
    if not isinstance(told, Mapping) or {*told} != {"free", "matrix"}:
        raise refused(where, ": {free, matrix} is needed")
    free = [str(name) for name in told["free"]]
    try:
        matrix = np.asarray(told["matrix"], dtype=float)
    except (TypeError, ValueError):
        matrix = np.full(0, np.nan)
    n = len(free)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all() or len({*free}) < n:
        said = f": {n} rows of {n} finite numbers are needed, one for each of free"
        raise refused(f"{where}.matrix", said)
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-6 * np.abs(matrix).max(initial=0.0)):
        raise refused(f"{where}.matrix", " is not symmetric")
    here = [k for k, name in enumerate(free) if name in names]
    there = [names.index(free[k]) for k in here]
    out[np.ix_(there, there)] = 0.5 * (matrix + matrix.T)[np.ix_(here, here)]
    return out


def check_number(names: Sequence[str], notes: Sequence[str]) -> None:
    """Raise OptionError where fewer than two causes are left."""
    if len(names) < 2:
        left = f" ({' '.join(notes)})" if notes else ""
        raise OptionError(
            f"{len(names)} causes are left to tell apart{left}; two or more are needed", "causes"
        )
