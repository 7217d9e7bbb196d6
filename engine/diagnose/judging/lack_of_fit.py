"""Whether what is left beside the named effects still depends on the states: then their shape is wrong.

A name stands for a shape, and the nearest shape of a catalogue may win although it is not the one. So
every state's equation is offered a polynomial of second degree in all states and inputs, and the score test
of :mod:`engine.diagnose.screening.screen`, with all its terms at once, says whether the extended model
would gain by it.

Noise that was estimated from the same record is too small for such a test, and what its parameters have in
common with a polynomial may be chance (:mod:`engine.diagnose.screening.noise_parameters`). So what looks like a
lack is tested again with that left out, and at the noise of :mod:`engine.estimation.restricted`: a name is
rejected only where all of them say so.

States that wander, as a slope or a load does, are regressors that depend on the noise before them, and the
statistic is larger than chi-square then, as that of Dickey and Fuller (1979). So what all of them reject is
compared with records simulated by the extended model at last, until one of these lacks as much
(Besag, Clifford 1991): of SIMULATED records none may.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect, Values, add_to_state
from engine.diagnose.refits.calibration import several_drawn
from engine.diagnose.screening.noise_parameters import apart, noise_of
from engine.diagnose.screening.score_columns import (
    Column,
    Projection,
    parameter_columns,
    static_column,
)
from engine.distributions import chi2_sf
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.estimation.restricted import restricted
from engine.filters.sigma_point import MomentPath, moment_path
from engine.statespace.model import Array, MixedModel, Parameter
from engine.words import probability

DEGREE = 2
LEVEL = 0.02  # of right names, the share that this test may cost
# share of a term's information that the others do not have: below it, it says nothing new
NEW = 1e-3
DRAWS = 999  # multiplier draws
AT_ONCE = (1, 6, 14, 28)  # records that are drawn together: few where the first may end it
SIMULATED = sum(AT_ONCE)  # records; if none of them lacks as much, p = 1 / (SIMULATED + 1) = LEVEL

Term = tuple[str, ...]  # channels that are multiplied
Around = dict[str, tuple[float, float]]  # middle and spread of channels


@dataclass(frozen=True)
class LackOfFit:
    """What a polynomial on ``target`` would gain: its statistic, terms counted, p-value, largest term."""

    target: str
    statistic: float
    terms: int
    p_value: float
    largest: Term
    at_floor: bool = False  # p_value is the least that simulation can give

    @property
    def tail(self) -> float:
        """What chi-square gives the statistic: in what order lacks are."""
        return float(chi2_sf(self.statistic, self.terms))

    @property
    def sentence(self) -> str:
        """For the notes of a diagnosis."""
        return f"{self._left}: the cause has another shape than any in the catalogue."

    @property
    def of_a_rest(self) -> str:
        """The same where it is a small part of what was wrong."""
        return f"{self._left}: a small part of what was wrong, which leaves the cause its name."

    @property
    def of_a_rest_that_decides(self) -> str:
        """The same where others are behind by less."""
        return (
            f"{self._left}: a small part of what was wrong, and worth as much as the lead of a name over "
            "others. Those within it are not told apart."
        )

    @property
    def _left(self) -> str:
        product = " * ".join(self.largest)
        return (
            f"Beside what was found, something that depends on the states is left on {self.target} (a "
            f"polynomial of {self.terms} terms would gain a likelihood ratio of {self.statistic:.0f}, "
            f"{probability(self.p_value, self.at_floor)}; most of it by {product})"
        )


def lack_of_fit(
    fit: QuasiFit, series: Series, targets: Sequence[str], states: Sequence[str], seed: int = 0
) -> LackOfFit | None:
    """The equation of ``targets`` that lacks most; its p-value is Bonferroni's over all of them.

    ``states`` of the fitted model and its inputs are what polynomials are made of. None where nothing
    can be tested.
    """
    first = found = None
    for own, kind in _variants(fit, series, noise_of(fit, series)):
        found = _lacking(own, series, kind, targets, states, seed)
        if found is None or found.p_value > LEVEL:
            return found
        first = first or found
    if found is None or first is None:
        return None
    p_value = _by_simulation(fit, series, first, targets, states, seed)
    if p_value <= found.p_value:
        return found
    return replace(found, p_value=p_value, at_floor=p_value == 1.0 / (1.0 + SIMULATED))


def _variants(
    fit: QuasiFit, series: Series, noise: NDArray[np.bool_]
) -> Iterator[tuple[QuasiFit, NDArray[np.bool_]]]:
    """At which noise it is asked, and which parameters share no innovations there."""
    nothing = np.zeros_like(noise)
    yield from ((fit, nothing), (fit, noise))
    try:
        fit = restricted(fit, series, noise)
    except (EngineError, np.linalg.LinAlgError):
        return
    yield from ((fit, nothing), (fit, noise))


def _by_simulation(
    fit: QuasiFit,
    series: Series,
    seen: LackOfFit,
    targets: Sequence[str],
    states: Sequence[str],
    seed: int,
) -> float:
    """The share of simulated records that lack as much; asked until it is above ``LEVEL``."""
    noise = np.zeros(len(fit.free), dtype=bool)
    reached = asked = 0
    for size in AT_ONCE:
        rng = np.random.default_rng([seed, 6, asked])
        try:
            drawn = several_drawn(fit, series, size, rng)
        except (EngineError, np.linalg.LinAlgError):  # no evidence against the name
            return (2 + reached) / (2 + asked)
        for one in drawn:
            asked += 1
            try:
                other = _lacking(fit, one, noise, targets, states, seed)
            except (EngineError, np.linalg.LinAlgError):
                other = None
            reached += other is None or other.tail <= seen.tail
            if 1 + reached > LEVEL * (1 + SIMULATED):
                return (1 + reached) / (1 + asked)
    return (1 + reached) / (1 + asked)


def _lacking(
    fit: QuasiFit,
    series: Series,
    noise: NDArray[np.bool_],
    targets: Sequence[str],
    states: Sequence[str],
    seed: int,
) -> LackOfFit | None:
    """The same at the noise of this fit; ``noise`` (n_free,) marks parameters that share no innovations."""
    model, theta = fit.model, np.asarray(fit.theta)
    columns = parameter_columns(model, theta, model.free_indices(fit.free), series)
    projection = Projection(apart(columns, noise, series.y.size))
    path = moment_path(model, theta, series)
    way = _Way(model, theta, series, path, _around(model, series, path, states))
    rng = np.random.default_rng([seed, 5])
    found = [one for name in targets if (one := _of_target(name, way, projection, rng))]
    if not found:
        return None
    worst = min(found, key=lambda one: (one.p_value, one.tail, -one.statistic))
    p_value = min(1.0, len(found) * worst.p_value)
    return replace(worst, p_value=p_value)


@dataclass(frozen=True, eq=False)
class _Way:
    """A fitted model's way along a record; ``around`` middle and spread of each channel that varies."""

    model: MixedModel
    theta: Array
    series: Series
    path: MomentPath
    around: Around


def _around(model: MixedModel, series: Series, path: MomentPath, states: Sequence[str]) -> Around:
    """Middle and spread of each channel that varies."""
    rows = [*model.nonlinear, *model.linear]
    values = {name: path.predicted[:, rows.index(name)] for name in states}
    values |= dict(zip(model.inputs, series.u.T, strict=True))
    both = {name: (float(np.median(x)), float(np.std(x))) for name, x in values.items()}
    return {name: (middle, spread) for name, (middle, spread) in both.items() if spread > 0.0}


def _of_target(
    target: str, way: _Way, projection: Projection, rng: np.random.Generator
) -> LackOfFit | None:
    """The test of one equation."""
    terms: list[Term] = []
    columns: list[Column] = []
    by_degree = (combinations_with_replacement(way.around, k) for k in range(1, DEGREE + 1))
    for term in chain.from_iterable(by_degree):
        column = _column(target, term, way)
        if column is not None:
            terms.append(term)
            columns.append(column)
    if not columns:
        return None
    columns = apart(columns, np.zeros(len(columns), dtype=bool), way.series.y.size)
    s, v = projection(np.array([c.s for c in columns]), np.array([c.v for c in columns]))
    raw = np.array([c.v @ c.v for c in columns])
    size = (v**2).sum(axis=1)
    told = size > NEW * raw  # the rest is said by the parameters already
    if not told.any():
        return None
    s, v = (x[told] / np.sqrt(size[told])[:, None] for x in (s, v))
    power, axes = np.linalg.eigh(v @ v.T)
    new = power > NEW
    scores = (axes[:, new].T @ s) / np.sqrt(power[new])[:, None]
    statistic = float((scores.sum(axis=1) ** 2).sum())
    signs = rng.choice((-1.0, 1.0), size=(DRAWS, scores.shape[1]))
    drawn = ((signs @ scores.T) ** 2).sum(axis=1)
    by_draws = (1.0 + float((drawn >= statistic).sum())) / (DRAWS + 1.0)
    k = int(new.sum())
    tail = float(chi2_sf(statistic, k))
    at_floor = tail < by_draws == 1.0 / (DRAWS + 1.0)
    largest = np.flatnonzero(told)[int(np.argmax(np.abs(s.sum(axis=1))))]
    return LackOfFit(target, statistic, k, max(by_draws, tail), terms[largest], at_floor)


def _column(target: str, term: Term, way: _Way) -> Column | None:
    """The column of one term; None where it cannot be calculated."""
    effect = Effect(
        "polynomial",
        target,
        "state",
        "a term of a polynomial",
        f"{target}' = ... + dt * polynomial * {' '.join(term)}",
        (Parameter("polynomial_term", 0.0, "1"),),
        lambda base: add_to_state(base, target, _product(term, way.around), _linear(base, term)),
    )
    try:
        extended = effect.apply(way.model)
        at, n = np.append(way.theta, 0.0), len(way.theta)
        column = static_column(effect, extended, at, n, way.model, way.series, way.path)
    except (EngineError, np.linalg.LinAlgError):
        return None
    finite = np.isfinite(column.s).all() and np.isfinite(column.v).all()
    return column if finite else None


def _linear(model: MixedModel, term: Term) -> tuple[str, ...]:
    return tuple(name for name in term if name in model.linear)


def _product(term: Term, around: Around) -> Callable[[Values, Sequence[Any]], Any]:
    """size * product of (x - middle) / spread over the channels of a term."""

    def value(v: Values, own: Sequence[Any]) -> Any:
        out = own[0]
        for name in term:
            middle, spread = around[name]
            out = out * ((v[name] - middle) / spread)
        return out

    return value
