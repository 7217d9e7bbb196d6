"""The causes that an experiment shall tell apart, each as a model with its estimates.

Of a diagnosis they are what it refitted; before any experiment they are named with their sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import FreeRunSearch, noise_fit
from engine.diagnose.search.findings import Verdict
from engine.diagnose.search.likeness import rank
from engine.diagnose.search.refits import further_parameters
from engine.errors import OptionError
from engine.estimation.quasi_ml import QuasiFit
from engine.statespace.model import Array, MixedModel, ThetaLike

MOST = 5  # causes at most: of more, the nearest
NEAREST = 3  # names that are nearest to an ``unknown``
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
class Rivals:
    """What a diagnosis weighed against each other.

    ``before`` is the fit without them, with what was ``taken`` in earlier rounds; ``several`` are those to tell
    apart, the best first, ``every`` are all that were refitted.
    """

    before: QuasiFit
    taken: tuple[Effect, ...]
    several: tuple[Weighed, ...]
    every: tuple[Weighed, ...]


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


@dataclass(frozen=True, eq=False)
class Weighed:
    """What a diagnosis weighed: effects that were refitted together, and their score."""

    effects: tuple[Effect, ...]
    fit: QuasiFit
    score: float

    @property
    def name(self) -> str:
        """Of its effects."""
        return TOGETHER.join(effect.name for effect in self.effects)

    @property
    def unsuited(self) -> str:
        """Why no input can be designed for it; "" where one can."""
        return next((reason for effect in self.effects if (reason := unsuited(effect))), "")

    def candidate(self, setting: Setting) -> Candidate:
        """As a cause to tell apart; times that the likelihood jumps at stay where they are."""
        fit = self.fit
        sought = {name for effect in self.effects for name in effect.sought}
        free = tuple(name for name in fit.free if name not in sought)
        keep = [fit.free.index(name) for name in free]
        return Candidate(
            self.name,
            " and ".join(effect.title for effect in self.effects),
            fit.model,
            np.asarray(fit.theta),
            free,
            np.asarray(fit.information)[np.ix_(keep, keep)],
            sum(map(further_parameters, self.effects)) + len(self.effects) - 1,
            self.score,
            self.effects,
            rank(self.effects, setting),
        )


def of_diagnosis(diagnosis: Diagnosis, causes: Sequence[str] | None) -> Question:
    """The causes that a diagnosis could not tell apart, or those named.

    Of a ``set`` the causes in it; of an ``unknown`` the nearest names too; else the cause and its nearest
    rivals. Raises OptionError where there are not two, or one was not refitted.
    """
    rivals = rivals_of(diagnosis)
    before = rivals.before
    chosen, notes = [], []
    if causes is None:
        if not rivals.several:
            raise OptionError(
                f"the diagnosis says '{diagnosis.verdict.value}': it weighed no causes that an experiment "
                "could tell apart; give a model in place of the diagnosis, and causes= with their sizes",
                "causes",
            )
        wanted = rivals.several
    else:
        known = {one.name: one for one in rivals.every}
        for name in causes:
            if name not in known:
                raise OptionError(
                    f"cause '{name}' was not refitted in the diagnosis; there are "
                    f"{', '.join(known) or 'none'}",
                    "causes",
                )
        wanted = tuple(known[name] for name in dict.fromkeys(causes))
    for one in wanted:
        if one.unsuited:
            notes.append(f"{one.name} was left out: {one.unsuited}.")
        else:
            chosen.append(one)
    if len(chosen) > MOST:
        notes.append(f"Of {len(chosen)} causes the {MOST} nearest are compared.")
    setting = Setting(before.model)
    out = [one.candidate(setting) for one in chosen[:MOST]]
    _check_number([one.name for one in out], notes)
    if diagnosis.verdict is Verdict.UNKNOWN:
        notes.append("The diagnosis ended in 'unknown': the true cause may be none of these.")
    return Question(
        tuple(out),
        Candidate(
            NOTHING,
            "none of them",
            before.model,
            np.asarray(before.theta),
            tuple(before.free),
            np.asarray(before.information),
        ),
        alarm_of(diagnosis.search.rounds[0].screen.threshold),
        diagnosis.measured,
        tuple(notes),
    )


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
        out.append(
            Candidate(
                name,
                " and ".join(effect.title for effect in effects),
                extended,
                theta_,
                tuple(names),
                _information(f"causes.{name}.information", given, names),
                sum(map(further_parameters, effects)) + len(effects) - 1,
                effects=effects,
                rank=rank(effects, setting),
            )
        )
    _check_number([one.name for one in out], notes)
    names = list(model.parameter_names if free is None else free)
    base = Candidate(
        NOTHING, "none of them", model, values, tuple(names), np.zeros((len(names),) * 2)
    )
    seen = None if measured is None else tuple(measured)
    for name in seen or ():
        if name not in model.outputs:
            there = ", ".join(model.outputs)
            raise OptionError(
                f"measured: there is no output '{name}'; there are {there}", "measured"
            )
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
                raise OptionError(
                    f"{where}.{key}: there is no such parameter; there are {', '.join(values)}",
                    f"{where}.{key}",
                )
            values[key] = _float(value, f"{where}.{key}")
    elif len(effects) > 1:
        sizes = ", ".join(f"'{effect.size.name}': ..." for effect in effects)
        raise OptionError(f"{where}: several effects need a size each, as {{{sizes}}}", where)
    else:
        values[effects[0].size.name] = _float(given, where)
    for effect in effects:
        if values[effect.size.name] == 0.0:
            raise OptionError(f"{where}: its size {effect.size.name} must not be 0", where)
    return list(values.values())


def _information(where: str, given: Any, names: Sequence[str]) -> Array:
    """What a record told of the parameters ``names`` (n, n); zeros where it is not given."""
    out = np.zeros((len(names), len(names)))
    told = given.get(INFORMATION) if isinstance(given, Mapping) else None
    if told is None:
        return out
    if not isinstance(told, Mapping) or {*told} != {"free", "matrix"}:
        raise OptionError(f"{where}: {{free, matrix}} is needed", where)
    free = [str(name) for name in told["free"]]
    try:
        matrix = np.asarray(told["matrix"], dtype=float)
    except (TypeError, ValueError):
        matrix = np.full(0, np.nan)
    n = len(free)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all() or len({*free}) < n:
        raise OptionError(
            f"{where}.matrix: {n} rows of {n} finite numbers are needed, one for each of free",
            f"{where}.matrix",
        )
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-6 * np.abs(matrix).max(initial=0.0)):
        raise OptionError(f"{where}.matrix is not symmetric", f"{where}.matrix")
    here = [k for k, name in enumerate(free) if name in names]
    there = [names.index(free[k]) for k in here]
    out[np.ix_(there, there)] = 0.5 * (matrix + matrix.T)[np.ix_(here, here)]
    return out


def _float(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise OptionError(f"{where} = {value!r}; a number is needed", where)
    if not np.isfinite(value):
        raise OptionError(f"{where} = {value!r}; a finite number is needed", where)
    return float(value)


def _check_number(names: Sequence[str], notes: Sequence[str]) -> None:
    if len(names) < 2:
        left = f" ({' '.join(notes)})" if notes else ""
        raise OptionError(
            f"{len(names)} causes are left to tell apart{left}; two or more are needed", "causes"
        )


def rivals_of(diagnosis: Diagnosis) -> Rivals:
    """By the criterion that decided: of the first round that leaves several, or of the last."""
    told = diagnosis.free_run
    if told is not None and told.decides and told.search is not None and told.search.found:
        return _by_free_run(told.search)
    rounds = [r for r in diagnosis.search.rounds if r.refits]
    if not rounds:
        return Rivals(diagnosis.search.base, (), (), ())
    chosen = next((r for r in rounds if len(r.equivalent) > 1), rounds[-1])
    k = rounds.index(chosen)
    before = diagnosis.search.base if k == 0 else rounds[k - 1].refits[0].fit
    every = [Weighed((r.effect,), r.fit, r.score) for r in chosen.refits]
    several = [Weighed((r.effect,), r.fit, r.score) for r in chosen.equivalent]
    if len(several) < 2 or diagnosis.verdict is Verdict.UNKNOWN:
        names = {one.name for one in several}
        several += [one for one in every if one.name not in names][:NEAREST]
    taken = tuple(r.refits[0].effect for r in rounds[:k])
    return Rivals(before, taken, tuple(several), tuple(every))


def _by_free_run(found: FreeRunSearch) -> Rivals:
    """The same where the free run decided: groups of refits that run alike, each by its leading name."""
    rounds = [r for r in found.rounds if r.survivors]
    chosen = next((r for r in rounds if len(r.survivors) > 1), rounds[-1])
    leading = [group[0] for group in chosen.survivors]
    if len(leading) < 2:
        alike = {c.names for c in chosen.survivors[0]}
        leading += [c for c in chosen.candidates if c.names not in alike][:NEAREST]
    several = tuple(Weighed(c.added, noise_fit(c.fit), 0.0) for c in leading)
    earlier = [r.chosen for r in rounds[: rounds.index(chosen)] if r.chosen is not None]
    taken = tuple(effect for one in earlier for effect in one.added)
    return Rivals(noise_fit(chosen.fit), taken, several, several)


def to_ask(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What a design needs to know of a diagnosis, as values for JSON; None where it weighed fewer than two.

    ``with`` are effects to add to the diagnosed model first, ``theta`` and ``free`` are of that; ``causes``,
    ``alarm`` and ``measured`` are as :func:`before_any` takes them.
    """
    rivals = rivals_of(diagnosis)
    if len(rivals.several) < 2:
        return None
    return {
        "with": [effect.name for effect in rivals.taken],
        "theta": rivals.before.theta.asdict(),
        "free": list(rivals.before.free),
        "causes": {one.name: _told(one.fit) for one in rivals.several},
        "alarm": diagnosis.search.rounds[0].screen.threshold,
        "measured": list(diagnosis.measured),
    }


def _told(fit: QuasiFit) -> dict[str, Any]:
    """What a record told of a cause: its parameters and, where it is in numbers, the information."""
    information = np.asarray(fit.information)
    if not np.isfinite(information).all():
        return fit.theta.asdict()
    return {
        **fit.theta.asdict(),
        INFORMATION: {"free": list(fit.free), "matrix": information.tolist()},
    }
