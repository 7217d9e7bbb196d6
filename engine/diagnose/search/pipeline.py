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
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging.feedback import answering, of_own_row, told
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.judgement import ENOUGH, NAMES, has_tails, judged
from engine.diagnose.judging.small_rest import main_alone
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.likeness import as_foreseen
from engine.diagnose.screening.noise_parameters import noise_left_to_states
from engine.diagnose.search.begun_elsewhere import begun_elsewhere
from engine.diagnose.search.between_samples import read_otherwise, read_with, read_wrongly
from engine.diagnose.search.event_time import times_as_likely
from engine.diagnose.search.search import LATER, search
from engine.diagnose.steps.step_error import steps_for_sizes
from engine.errors import EngineError
from engine.estimation.particle_likelihood import in_noise_only
from engine.estimation.quasi_ml import QuasiFit, quasi_ml, share_done
from engine.estimation.start import WarmStart
from engine.estimation.tied_edges import off_tied_edges
from engine.estimation.vanished import revived
from engine.statespace.model import MixedModel, Theta, ThetaLike
from engine.ties import flat_directions, ties_in_words
from engine.words import enumerated

# nats below the highest maximum, another one is kept for what an effect may make of it
RIVALS = 20.0
# For progress: of the fits of a continuous model, the first; of a fit, the search for its start.
FIRST_FIT_SHARE, START_SHARE = 0.5, 0.6

AT_FIRST = 8  # steps a sample to which a first round is left: no search has to be made anew for it

Callback = Callable[[str, float], Any]


@dataclass(frozen=True, eq=False)
class Causes:
    """The fitted base model, what was searched and found beyond it, and the verdict.

    The sizes of what was named need so many ``steps`` a sample. ``coarse`` where the error of the steps may
    decide between names; ``kinds`` of effects that were looked for, None for all. ``another_shape`` where names
    were found whose shape is not what the states show; ``misread`` where the record read otherwise explains
    more; ``refuted`` names that something else contradicts; ``why`` no name is trusted, in sentences.
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
    misread: bool = False
    refuted: tuple[str, ...] = ()
    why: tuple[str, ...] = ()


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
    seen = partial(_seen_by_a_controller, series=series, setting=setting, effects=effects)
    found = look(
        series,
        base,
        setting,
        alpha=alpha,
        kept=kept,
        enough=AT_FIRST if finer else 0,
        ends=lambda so_far: seen(so_far) is not None,  # what follows would be found beside it
    )
    if found.by_the_steps:
        clock.stop()
        return Causes(base, setting, found, Verdict.UNKNOWN, tuple(notes), coarse=True)
    aside = seen(found)
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
    kinds = effects if aside is None else aside.others
    holds = [h for e in all_effects(setting, kinds) for h in e.traits.says_hold]
    told = ""
    if not settled and (kinds is None or holds):
        told = read_wrongly(found, series, list(dict.fromkeys(holds)), look_later)
    told = told or begun_elsewhere(found, series)
    notes.extend(filter(None, [told]))
    clock.progress("contradictions", 0.0)
    # only a controller may have been seen, or how the record is read
    unnamed = (aside is not None and not aside.others) or bool(told)
    judge = partial(
        judged, base, series, setting, alpha=alpha, seed=seed, unnamed=unnamed, read=settled
    )
    said = judge(found, kept=kept)
    by_steps = any(as_foreseen(one.effect, one.fit) for one in found.named)
    if (said.verdict is Verdict.UNKNOWN or by_steps) and not settled:
        alone = None
        with suppress(EngineError, np.linalg.LinAlgError):
            alone = main_alone(found, series)
        if alone is not None:
            instead = judge(alone, kept=kept.apart("main alone"))
            said = instead if instead.verdict in NAMES else said
    found, verdict = said.search, said.verdict
    notes.extend(said.notes)
    if verdict not in NAMES:
        left = noise_left_to_states(base, series)
        notes.extend([left] if left else [])
    else:
        notes.extend(times_as_likely(found, series))
    # what steps get wrong has a shape of its own
    sized = verdict in NAMES or said.another_shape
    steps = _steps(found, series, setting, kept) if sized else series.substeps
    clock.stop()
    return Causes(
        base,
        setting,
        found,
        verdict,
        tuple(notes),
        steps,
        said.coarse,
        kinds,
        said.another_shape,
        bool(told),
        said.refuted,
        (
            *([aside.note] if aside is not None and unnamed else []),
            *filter(None, [told]),
            *said.why,
        ),
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
    answer = {*answering(*_as_said(leading[0], found, series))}
    # beside a path that undoes the controller nothing is left of the errors that it answers
    if found.final is not found.base and not leading[0].traits.says_hold:
        answer |= {*answering(found.base, series)}
    inputs = [name for name in inputs if name in answer]
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


def _steps(found: Search, series: Series, setting: Setting, kept: Kept) -> int:
    """How many steps a sample the sizes of what was named need, up to ENOUGH."""
    if has_tails(found):  # outliers are judged by a filter of their own
        return series.substeps
    names = [r.refits[0].effect.name for r in found.rounds if r.equivalent]
    try:
        return steps_for_sizes(names, found.final, series, setting, ENOUGH, kept)
    except (EngineError, np.linalg.LinAlgError):
        return series.substeps


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

    fit = revived(quasi_ml(model, series, start, free, callback=tell), [series])
    fit = off_tied_edges(fit, series, model.theta(theta))
    return replace(fit, rivals=tuple(tuple(map(float, other)) for other in others))


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
