"""The naming part of a diagnosis: fit the model, search for effects, come to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting, setting_for
from engine.diagnose.screening.noise_parameters import noise_left_to_states
from engine.diagnose.screening.tails import OUTLYING
from engine.diagnose.search.at_inputs import outliers_at_inputs
from engine.diagnose.search.between_samples import read_otherwise, read_with
from engine.diagnose.search.checkpoint import NOTHING, Kept
from engine.diagnose.search.contradictions import already_there, folded, undetermined
from engine.diagnose.search.event_time import times_as_likely
from engine.diagnose.search.feedback import answering, of_own_row, told
from engine.diagnose.search.findings import Verdict
from engine.diagnose.search.found import Search
from engine.diagnose.search.lack_of_fit import LEVEL, lack_of_fit
from engine.diagnose.search.rounds import settle
from engine.diagnose.search.search import LATER, search
from engine.diagnose.search.step_error import decides, steps_for_sizes
from engine.diagnose.search.verdict import doubts, verdict_of
from engine.errors import EngineError
from engine.estimation.particle_likelihood import in_noise_only
from engine.estimation.quasi_ml import QuasiFit, quasi_ml, share_done, whitening
from engine.estimation.start import WarmStart
from engine.filters.sigma_point import moment_path
from engine.statespace.model import MixedModel, Theta, ThetaLike
from engine.ties import flat_directions, ties_in_words
from engine.words import enumerated

# nats below the highest maximum, another one is kept for what an effect may make of it
RIVALS = 20.0
MANY = 1000.0  # times the model's noise: beyond it a number says nothing more
MISFIT = 2.0  # mean squared standardised innovation from which no name can be trusted
# For progress: of the fits of a continuous model, the first; of a fit, the search for its start.
FIRST_FIT_SHARE, START_SHARE = 0.5, 0.6

# Steps a sample, with which names that they decide between are left as a set, and sizes as they are; but not
# those of a first round, where no search has to be made anew for it.
ENOUGH, AT_FIRST = 4, 8

NAMES = (Verdict.NAMED, Verdict.SET)

Callback = Callable[[str, float], Any]


@dataclass(frozen=True, eq=False)
class Causes:
    """The fitted base model, what was searched and found beyond it, and the verdict.

    The sizes of what was named need so many ``steps`` a sample. ``coarse`` where the error of the steps may
    decide between names; ``kinds`` of effects that were looked for, None for all. ``another_shape`` where names
    were found whose shape is not what the states show; ``refuted`` names that something else contradicts.
    """

    base: QuasiFit
    setting: Setting
    search: Search
    verdict: Verdict
    notes: tuple[str, ...]
    steps: int = 1
    coarse: bool = False
    kinds: Sequence[str] | None = None
    another_shape: bool = False
    refuted: tuple[str, ...] = ()


def find_causes(  # noqa: PLR0913
    model: MixedModel,
    series: Series,
    theta: ThetaLike = None,
    *,
    free: Sequence[str] | None = None,
    alpha: float = 0.05,
    max_effects: int = 3,
    effects: Sequence[str] | None = None,
    seed: int = 0,
    clock: Clock | None = None,
    kept: Kept = NOTHING,
    finer: bool = False,
) -> Causes:
    """Name what ``series`` shows beyond ``model``; arguments as in :func:`engine.diagnose.diagnose`.

    Where it may be made ``finer``, and the error of its steps may decide the first round, nothing is named yet.
    """
    clock = clock or Clock()
    notes = []
    clock.start("fit")
    # a continuous model has been fitted once before, to find its steps
    begun = FIRST_FIT_SHARE if model.continuous else 0.0

    def tell(share: float) -> None:
        clock.progress("fit", begun + (1.0 - begun) * share)

    base = kept.fit(model, partial(fit_base, model, series, theta, free, tell))
    if not base.converged:
        notes.append(
            "The estimation of the base model did not settle; its parameters may be far off. "
            "Give start values (theta=)."
        )
    notes.extend(told_together(base))
    held = tuple(name for name in model.parameter_names if name not in base.free)
    setting = replace(setting_for(model, series, base.theta), held=held)
    notes.extend(_not_seen(model, base.theta, series))
    clock.start("search")
    look = partial(
        search,
        model,
        max_effects=max_effects,
        kinds=effects,
        seed=seed,
        progress=clock.progress,
    )
    found = look(series, base, setting, alpha=alpha, kept=kept, enough=AT_FIRST if finer else 0)
    if found.by_the_steps:
        clock.stop()
        return Causes(base, setting, found, Verdict.UNKNOWN, tuple(notes), coarse=True)
    aside = _seen_by_a_controller(found, series, setting, effects)
    if aside is not None:
        notes.append(aside.note)
        if aside.others:
            look = partial(look, kinds=aside.others)
            found = look(series, base, setting, alpha=alpha, kept=kept.apart("closed loop"))
    apart = kept.apart("read otherwise")

    def look_later(fit: QuasiFit, read: Series) -> Search:
        known = replace(setting_for(model, read, fit.theta), held=held)
        return look(read, fit, known, alpha=LATER * alpha, kept=apart)

    other = read_otherwise(found, series, look_later)
    settled = other is not None and other.search is not found  # the record says it all
    if other is not None:
        found = other.search
        notes.append(other.note)
    clock.progress("contradictions", 0.0)
    found, worth = _widened(found, series, setting, kept)
    if worth:
        notes.append(
            "What the steps of the model get wrong is worth as much as the lead of a name over others "
            f"(2 x log-likelihood {worth:.0f}): those within it are not told apart."
        )
    verdict = verdict_of(found, alpha)
    if aside is not None and not aside.others and verdict in NAMES:
        verdict = Verdict.UNKNOWN
    notes.extend(doubts(found, alpha))
    if found.of_the_steps:
        notes.append(
            f"Beside what was found, {found.of_the_steps} seemed to be seen. Most of it is gone with steps of "
            "the model half as long: it is what the steps get wrong, and no effect of its own. "
            "Likelihoods gained are those of the shorter steps, sizes those of the longer."
        )
    if found.unweighed:
        notes.append(
            f"Not compared with rivals beside all that was found: {', '.join(found.unweighed)}. Fits of "
            "several effects at once took too many iterations; the rivals are those of the round that found it."
        )
    if found.as_well:
        notes.append(
            f"{enumerated(list(found.as_well))} together explain the data as well as what was found, and are "
            "other causes: these data do not tell which it is."
        )
        verdict = Verdict.UNKNOWN
    named = [r for r in found.rounds if r.equivalent]
    own_terms = already_there(named)
    against = [
        *undetermined(named),
        *own_terms.values(),
        *folded(named, series, setting),
        *outliers_at_inputs(named, base, series, seed),
    ]
    if against:
        notes.extend(against)
        verdict = Verdict.UNKNOWN
    # beside an error of the steps every shape is in doubt
    doubted = verdict not in NAMES or settled or bool(found.of_the_steps)
    shape = None if doubted else _shape_left(found, series, setting, seed)
    if shape is not None:
        notes.append(shape)
        verdict = Verdict.UNKNOWN
    level = misfit(found.final, series, outliers=has_tails(found))
    if level > MISFIT:
        notes.append(
            f"One-step errors are {_times(np.sqrt(level))} what the model's noise allows, after "
            "everything that was found: the model is far from these data, or badly started (theta=)."
        )
        verdict = Verdict.UNKNOWN
    if verdict not in NAMES:
        left = noise_left_to_states(base, series)
        notes.extend([left] if left else [])
    else:
        notes.extend(times_as_likely(found, series))
    kinds = effects if aside is None else aside.others
    # what steps get wrong has a shape of its own
    sized = verdict in NAMES or shape is not None
    steps = _steps(found, series, setting, kept) if sized else series.substeps
    clock.stop()
    coarse, another = worth > 0.0, shape is not None
    # what shows only beside a term of the model acts elsewhere than its name says
    refuted = tuple(r.refits[0].effect.name for r in named) if own_terms else ()
    return Causes(
        base, setting, found, verdict, tuple(notes), steps, coarse, kinds, another, refuted
    )


def told_together(base: QuasiFit) -> list[str]:
    """A sentence on parameters that only together say anything, as masses and springs without a force."""
    known = np.diag(base.information) > 0.0  # a noise at its bound is no tie
    names = [name for name, yes in zip(base.free, known, strict=True) if yes]
    ties = ties_in_words(names, flat_directions(base.information[np.ix_(known, known)]))
    if not ties:
        return []
    return [f"{ties} Others of their values predict the same: hold them with free= or --fix."]


def _not_seen(model: MixedModel, theta: Theta, series: Series) -> list[str]:
    """A sentence on states of the user's own that show in noise alone, where the moment filter is blind."""
    blind = zip(model.nonlinear, in_noise_only(model, theta, series), strict=True)
    names = [name for name, yes in blind if yes and name not in model.scale_states]
    if not names:
        return []
    return [
        f"{enumerated(names)} shows in the noise alone: the search takes that noise for Gaussian, of one size, "
        "and what it finds of outliers, pulses or noise that varies may be nothing but this."
    ]


@dataclass(frozen=True)
class _Aside:
    """What is asked where some effects cannot be told from a controller: the ``others``, and a sentence."""

    others: list[str]
    note: str


def _seen_by_a_controller(
    found: Search, series: Series, setting: Setting, effects: Sequence[str] | None
) -> _Aside | None:
    """None where no leading effect compares a reading with an input that answers the readings."""
    leading = [r.refits[0].effect for r in found.rounds if r.equivalent]
    inputs = list(setting.model.inputs)
    if not any(of_own_row(effect, setting, inputs) for effect in leading):
        return None
    inputs = answering(*_as_said(leading[0], found, series))
    if not any(of_own_row(effect, setting, inputs) for effect in leading):
        return None
    every = all_effects(setting, effects)
    names = [effect.name for effect in every if of_own_row(effect, setting, inputs)]
    others = [effect.name for effect in every if effect.name not in names]
    return _Aside(others, told(names, inputs))


def _as_said(first: Effect, found: Search, series: Series) -> tuple[QuasiFit, Series]:
    """The fit whose errors of prediction are asked, and its record: read as the first effect says, if it does.

    Within a model it says so only nearly, and what is left over depends on the inputs.
    """
    if first.traits.says_hold:
        with suppress(EngineError, np.linalg.LinAlgError):
            return read_with(first.traits.says_hold, found.base, series)
    return found.final, series


def _widened(found: Search, series: Series, setting: Setting, kept: Kept) -> tuple[Search, float]:
    """The search with a first round that names all between which the error of the steps may decide.

    And what that error is worth, 0 where it decides nothing.
    """
    named = [r for r in found.rounds if r.equivalent]
    if not named or has_tails(found) or found.of_the_steps:
        return found, 0.0
    first, names = named[0], [r.refits[0].effect.name for r in named]
    try:
        worth = decides(
            first, names, found.final, series, setting, kept.within("half steps"), ENOUGH
        )
    except (EngineError, np.linalg.LinAlgError):
        return found, 0.0
    if not worth:
        return found, 0.0
    refits = [*first.refits, *([] if first.generic is None else [first.generic])]
    wide = settle(first.screen, refits, series, setting, worth)
    at = found.rounds.index(first)
    return replace(found, rounds=(*found.rounds[:at], wide, *found.rounds[at + 1 :])), worth


def _steps(found: Search, series: Series, setting: Setting, kept: Kept) -> int:
    """How many steps a sample the sizes of what was named need, up to ENOUGH."""
    if has_tails(found):  # outliers are judged by a filter of their own
        return series.substeps
    names = [r.refits[0].effect.name for r in found.rounds if r.equivalent]
    try:
        return steps_for_sizes(names, found.final, series, setting, ENOUGH, kept)
    except (EngineError, np.linalg.LinAlgError):
        return series.substeps


def _shape_left(found: Search, series: Series, setting: Setting, seed: int) -> str | None:
    """A sentence where what is left beside the named effects depends on the states.

    On the states that they push, where they do: it is their shape that is in doubt.
    """
    if has_tails(found):  # the moment filter does not see outliers
        return None
    named = [r.refits[0].effect for r in found.rounds if r.equivalent]
    pushed = {e.channel.rpartition("->")[2] for e in named if e.family == "state"}
    targets = [name for name in setting.targets if name in pushed] or setting.targets
    states = [name for name in setting.states if name not in setting.model.scale_states]
    lacks = lack_of_fit(found.final, series, targets, states, seed)
    return lacks.sentence if lacks is not None and lacks.p_value <= LEVEL else None


def fit_base(
    model: MixedModel,
    series: Series,
    theta: ThetaLike,
    free: Sequence[str] | None,
    progress: Callable[[float], object] = lambda share: None,
) -> QuasiFit:
    """The model's own parameters: from the given start, or searched for where none is given.

    ``progress`` is told which share of it is done.
    """
    start, begun = model.theta(theta), 0.0
    others: list[Theta] = []
    if theta is None:
        begun = START_SHARE
        indices = model.free_indices(free)
        ahead = WarmStart(
            model,
            [series],
            indices,
            rivals=RIVALS,
            progress=lambda share: progress(begun * share),
            once=True,
            by_height=True,
        )
        start, *others = ahead(start) or [start]

    def tell(k: int) -> None:
        progress(begun + (1.0 - begun) * share_done(k))

    fit = quasi_ml(model, series, start, free, callback=tell)
    return replace(fit, rivals=tuple(tuple(map(float, other)) for other in others))


def has_tails(found: Search) -> bool:
    """Whether outliers are among what was found."""
    return any(r.refits[0].effect.traits.outliers for r in found.rounds if r.equivalent)


def misfit(fit: QuasiFit, series: Series, outliers: bool = False) -> float:
    """Mean squared standardised innovation: about 1 where the model's noise explains the data.

    With ``outliers`` the values that only they explain are left out.
    """
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    root = whitening(path.S, series.observed)
    z = np.einsum("tij,tj->ti", root, np.nan_to_num(path.innovations))
    usual = np.abs(z) < OUTLYING if outliers else np.ones_like(z, dtype=bool)
    return float((z[usual] ** 2).sum() / max(int((series.observed & usual).sum()), 1))


class Clock:
    """Seconds per stage, and progress for the caller."""

    def __init__(self, callback: Callback | None = None) -> None:
        self.callback = callback
        self.seconds: dict[str, float] = {}
        self.stage, self.since, self._runs = "", 0.0, False

    def start(self, stage: str) -> None:
        """End the last stage and begin another."""
        self.stop()
        self.stage, self.since, self._runs = stage, time.perf_counter(), True
        self.progress(stage, 0.0)

    def stop(self) -> None:
        """End the last stage."""
        if self._runs:
            self.spent(time.perf_counter() - self.since)
            self._runs = False

    def spent(self, seconds: float) -> None:
        """More seconds for this stage, or for the last one where it has ended."""
        self.seconds[self.stage] = self.seconds.get(self.stage, 0.0) + seconds

    def progress(self, stage: str, fraction: float) -> None:
        """Tell the caller, who may stop the run by raising StopIteration."""
        if self.callback is not None:
            self.callback(stage, fraction)


def _times(factor: float) -> str:
    """A ratio as one says it."""
    return f"{factor:.1f} times" if factor < MANY else f"more than {MANY:.0f} times"
