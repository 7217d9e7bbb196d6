"""The leading candidates beside each other, over the horizon of their predictions and over budgets of noise.

A cause explains what a model gets wrong one step ahead and in a long run alike. A patch on the noise explains
it one step ahead only, and nothing once process noise is scarce.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.noise_parameters import noise_only
from engine.diagnose.symptoms.compare import settled_from
from engine.diagnose.symptoms.runs import noise_free, start_state
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods
from engine.filters.sigma_point import MomentPath, moment_path
from engine.simulation.free_run import output_scale
from engine.statespace.model import Array, MixedModel
from engine.words import enumerated, number, percent

HORIZONS = (1, 10, 100)  # samples; and the whole record
BUDGETS = (1.0, 0.1, 0.01)  # of the process noise of the model as given
OTHERS = 4  # candidates beside the answer
WINDOWS = 100  # of each horizon at most
TIE = 0.02  # of an error: closer ones share a rank
LEAD = 2.0  # of 2 x log-likelihood: likewise
CANNOT = (EngineError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Candidate:
    """Effects added to the model; none: the model as given.

    ``errors`` of its predictions at each horizon, as a share of those of the model as given; ``gains``, 2 x
    log-likelihood over the model as given at each budget. NaN where they cannot be had, as of one that changes
    the noise of a reading, which no other can share.
    """

    effects: tuple[str, ...]
    errors: tuple[float, ...]
    gains: tuple[float, ...]


@dataclass(frozen=True)
class OverHorizon:
    """The model as given, the answer, and the best others, on the rows that were searched.

    ``horizons`` in samples, the last one the whole record; ``budgets`` of the process noise of the model as
    given, which all candidates share, with its measurement noise.
    """

    horizons: tuple[int, ...]
    budgets: tuple[float, ...]
    candidates: tuple[Candidate, ...]

    @property
    def sentence(self) -> str:
        """Which candidate leads where."""
        places = [
            *(_ahead(h) for h in self.horizons[:-1]),
            "over the whole record",
            *(_budget(b) for b in self.budgets),
        ]
        leads: dict[tuple[str, ...], list[str]] = {}
        for place, leader in zip(places, self.leaders(), strict=True):
            if leader is not None:
                leads.setdefault(leader, []).append(place)
        if len(leads) == 1:
            ((effects, where),) = leads.items()
            further = " and with every budget of process noise" if where[-1] == places[-1] else ""
            return f"{_named(effects)} leads at every horizon{further}."
        parts = [f"{_named(effects)} leads {enumerated(where)}" for effects, where in leads.items()]
        return "; ".join(parts) + "." if parts else ""

    @property
    def instead(self) -> str:
        """What predicts better than the answer everywhere, in a sentence; "" where nothing does.

        At every horizon, and with every budget of process noise as far as that may be shared.
        """
        first, *others = self.leaders()
        if not first or first == self.candidates[1].effects or {*others} - {first, None}:
            return ""
        best = next(c for c in self.candidates if c.effects == first)
        if any(gain <= 0.0 for gain in best.gains):  # others may not be compared there
            return ""
        return (
            f"{_named(first)} predicts better at every horizon: over the whole record it is wrong by "
            f"{percent(best.errors[-1])} of what the model as given is."
        )

    def leaders(self) -> Iterator[tuple[str, ...] | None]:
        """The candidate that leads at each horizon, then at each budget; the answer where it is as good.

        The model as given where none is better.
        """
        given, *added = self.candidates
        for k in range(len(self.horizons)):
            better = [c for c in added if not c.errors[k] >= given.errors[k]] or [given]
            yield _first(better, [c.errors[k] for c in better], lambda best: best * (1.0 + TIE))
        for k in range(len(self.budgets)):
            better = [c for c in added if not c.gains[k] <= given.gains[k]] or [given]
            yield _first(better, [-c.gains[k] for c in better], lambda best: best + LEAD)

    def overtakes(self, names: Collection[str]) -> tuple[str, ...]:
        """A candidate of these ``names`` that does better than the answer everywhere; empty without one.

        At every horizon, and with every budget of process noise as far as that may be shared.
        """
        answer = self.candidates[1]
        errors, gains = np.array(answer.errors), np.array(answer.gains)
        for other in self.candidates[2:]:
            ahead = np.array(other.errors) * (1.0 + TIE) < errors
            gained = np.array(other.gains) > gains + LEAD
            gained |= np.isnan(gains) & np.isnan(other.gains)
            if ahead.all() and gained.all() and set(other.effects) <= set(names):
                return other.effects
        return ()

    def as_good(self, names: Collection[str], instead: str) -> tuple[str, ...]:
        """Those of ``names`` that predict better than the answer at every horizon ``instead`` of its effect."""
        answer = self.candidates[1]
        rest = set(answer.effects) - {instead}
        out = []
        for other in self.candidates[2:]:
            (own, *further) = set(other.effects) - rest or {instead}
            ahead = np.array(other.errors) * (1.0 + TIE) < np.array(answer.errors)
            if ahead.all() and own in names and not further and rest <= set(other.effects):
                out.append(own)
        return tuple(out)


def over_horizon(
    before: QuasiFit, after: QuasiFit, names: tuple[str, ...], found: Search, series: Series
) -> OverHorizon | None:
    """Beside each other: ``before`` and ``after`` adding ``names``, and the others of the first round.

    ``series`` are the rows that were searched. None where nothing was named, the model as given is lost, or
    outliers are part of the answer, which this filter does not see.
    """
    first = [found_in.equivalent[0].effect for found_in in found.rounds if found_in.equivalent]
    if not names or any(effect.traits.outliers for effect in first):
        return None
    fits: dict[tuple[str, ...], QuasiFit] = {(): before, names: after}
    effects_of = {effect.name: effect for effect in first}
    for refit in found.rounds[0].refits[: OTHERS + 1]:
        if len(fits) < OTHERS + 2 and not refit.effect.traits.outliers:
            there = names_in(refit, first)
            effects_of.setdefault(refit.effect.name, refit.effect)
            if set(there) != set(names):
                fits.setdefault(there, refit.fit)
    T = len(series.samples)
    horizons = (*(h for h in HORIZONS if h < T // 2), T)
    scale = output_scale([series])
    paths: dict[tuple[str, ...], MomentPath] = {}
    for effects, fit in fits.items():
        with suppress(*CANNOT):
            paths[effects] = moment_path(fit.model, np.asarray(fit.theta), series)
    begin = max(1, *map(settled_from, paths.values())) if paths else 1
    try:
        base = _errors(before, paths[()], series, horizons, scale, begin)
        told = _likelihoods(before, np.asarray(before.theta), series)
        noise = _noise(before, paths[()], series)
    except (KeyError, *CANNOT):
        return None
    shared = _usable_noise(before, noise)
    told_of = np.isfinite(base) & (base > 0.0)  # of a run that is lost there is no share
    as_given = tuple(np.where(told_of, 1.0, np.nan).tolist())
    candidates = [Candidate((), as_given, (0.0,) * len(BUDGETS))]
    for effects, fit in list(fits.items())[1:]:
        errors: Array = np.full(len(horizons), np.nan)
        gains: Array = np.full(len(BUDGETS), np.nan)
        with suppress(KeyError, *CANNOT):
            theta = np.asarray(fit.theta).copy()
            own = _errors(fit, paths[effects], series, horizons, scale, begin)
            errors[told_of] = own[told_of] / base[told_of]
            theta[noise] = np.asarray(before.theta)[noise]
            own_noise = any(_is_of_readings(effects_of.get(name), before.model) for name in effects)
            if shared and not own_noise:
                gains = 2.0 * (_likelihoods(fit, theta, series) - told)
        candidates.append(Candidate(effects, tuple(errors.tolist()), tuple(gains.tolist())))
    return OverHorizon(horizons, BUDGETS, tuple(candidates))


def names_in(refit: Refit, found: Sequence[Effect]) -> tuple[str, ...]:
    """Effects in a refit's model, its own first: of those ``found`` in several rounds it may hold others."""
    effects = {one.name: one for one in (refit.effect, *found)}.values()
    return tuple(e.name for e in effects if e.size.name in refit.fit.model.parameter_names)


def _is_of_readings(effect: Effect | None, model: MixedModel) -> bool:
    """Whether an effect changes the noise of a reading, whose level alone says little beside it."""
    if effect is None or effect.family != "noise":
        return False
    return effect.channel.partition("->")[0] in model.outputs


def _usable_noise(fit: QuasiFit, noise: Array) -> bool:
    """Whether other models may have its ``noise``: not where a level ended at a bound that is not zero.

    Such a level is next to nothing, as of readings that the model's own noise follows one by one.
    """
    levels = [fit.theta.names[k] for k in noise]
    try:
        return not any(fit.theta[name] != 0.0 for name in fit.model.at_bounds(fit.theta, levels))
    except EngineError:  # beyond its bounds
        return False


def _noise(fit: QuasiFit, path: MomentPath, series: Series) -> Array:
    """Indices of the free parameters that are of the noise alone."""
    indices = fit.model.free_indices(fit.free)
    return np.asarray(indices[noise_only(fit.model, np.asarray(fit.theta), indices, series, path)])


@np.errstate(over="ignore", invalid="ignore")  # of a run that runs away
def _errors(
    fit: QuasiFit,
    path: MomentPath,
    series: Series,
    horizons: tuple[int, ...],
    scale: Array,
    begin: int,
) -> Array:
    """Rms of errors at each horizon, outputs weighed, from row ``begin`` on; runs start at filtered means."""
    model, theta = fit.model, np.asarray(fit.theta)
    out = []
    for horizon in horizons:
        if horizon == 1:
            seen = ~np.isnan(series.y[begin:])
            e = (path.innovations[begin:] / scale)[seen]
        elif horizon == len(series.samples):
            y, _ = noise_free(model, theta, series, start_state(model, theta, series)[0])
            e = _missed(series.y, y, scale)
        else:
            e = np.concatenate(list(_windows(model, theta, path, series, horizon, scale, begin)))
        out.append(np.sqrt(np.mean(e**2)))
    return np.asarray(out)


def _windows(
    model: MixedModel,
    theta: Array,
    path: MomentPath,
    series: Series,
    horizon: int,
    scale: Array,
    begin: int,
) -> Iterator[Array]:
    """Errors of runs over ``horizon`` samples from row ``begin`` on, each from what was known at its first."""
    starts = series.samples[:-horizon:horizon]
    starts = starts[starts >= begin] if (starts >= begin).any() else starts
    chosen = np.unique(np.linspace(0, len(starts) - 1, min(len(starts), WINDOWS)).round())
    for first in starts[chosen.astype(int)]:
        part = series.part(int(first), int(first) + horizon * series.substeps + 1)
        y, _ = noise_free(model, theta, part, path.filtered[first])
        yield _missed(part.y[1:], y[1:], scale)


def _missed(y: Array, run: Array, scale: Array) -> Array:
    """Errors at the readings y (n, ny) there are; infinite where the run is lost."""
    e = ((y - run) / scale)[~np.isnan(y)]
    return np.where(np.isnan(e), np.inf, e)


def _likelihoods(fit: QuasiFit, theta: Array, series: Series) -> Array:
    """Log-likelihoods with the process noise at each budget."""
    return np.array(
        [log_likelihoods(_with_budget(fit.model, b), [series], theta[None])[0] for b in BUDGETS]
    )


def _with_budget(model: MixedModel, budget: float) -> MixedModel:
    """The model with so much of its process noise."""
    split = Split(model)

    def dynamics(a: Array, u: object, t: object, dt: object, theta: object) -> tuple[Array, ...]:
        f, A, Q = model.transition(a, u, t, dt, split(theta)[0])
        return f, A, budget * Q

    return on_base(model, split, dynamics=dynamics)


def _first(
    candidates: Sequence[Candidate], losses: list[float], within: Callable[[float], float]
) -> tuple[str, ...] | None:
    finite = [x for x in losses if np.isfinite(x)]
    if not finite:
        return None
    good = within(min(finite))
    return next(c.effects for c, x in zip(candidates, losses, strict=True) if x <= good)


def _named(effects: tuple[str, ...]) -> str:
    return " with ".join(effects) or "the model as given"


def _ahead(samples: int) -> str:
    return "one sample ahead" if samples == 1 else f"over {samples} samples"


def _budget(budget: float) -> str:
    return (
        "with the process noise of the model as given"
        if budget == 1.0
        else f"with {number(budget)} of it"
    )
