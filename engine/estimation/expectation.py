"""The Q-function from smoothed moments; paper, eqs. (8)-(19)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from engine.errors import ModelError
from engine.estimation.q_function import Evaluate, GaussianTerm, Neighbours
from engine.failing import where_it_fails
from engine.smoothers.moments import Moments
from engine.smoothers.rb_ffbsi import Smoothed
from engine.statespace.base import BaseModel
from engine.statespace.model import Array, Gaussian, MixedModel, Theta
from engine.statespace.points import Points
from engine.statespace.refutation import refutations

BLOCK_NUMBERS = 2**17  # numbers in an array of points; what fits the cache keeps time linear in T
FEW_ROWS = 3  # time steps at which it is asked first whether a parameter is used
STEP_SHARE = 1e-5  # of a parameter's size, for differences of the model's functions
# Of the distance of its bounds: a parameter's size where nothing else is known.
TYPICAL_SHARE = 0.05


Ends: TypeAlias = list[tuple[Array, Array]]  # points below and above theta, for each free parameter
Told = TypeVar("Told")


@dataclass(frozen=True, eq=False)
class QFunction:
    """Q(theta, theta_k) = I1 + I2 + I3, paper, eq. (8), as a sum of terms.

    ``depends[i]`` are the indices of the parameters that can enter ``terms[i]``; ``ranks[i]`` its number
    of directions with noise at theta_k, which an M step must keep. No parameter enters the terms in
    ``fixed``.
    """

    model: MixedModel
    terms: Sequence[Term]
    depends: Sequence[NDArray[np.bool_]]
    ranks: Sequence[int]
    fixed: Sequence[Term] = ()

    @cached_property
    def constant(self) -> float:
        """The sum of the fixed terms."""
        record = self.model.record(self.model.theta())
        return sum(term.value(record) for term in self.fixed)

    @cached_property
    def _last(self) -> dict[tuple[int, bytes, bytes], tuple[float, Array, Array]]:
        return {}

    @where_it_fails(-np.inf)
    def value(self, theta: Array) -> float:
        """Q(theta, theta_k); -inf where the model cannot be had."""
        record = self.model.record(theta)
        return self.constant + sum(
            term.value(record, rank) for term, rank in zip(self.terms, self.ranks, strict=True)
        )

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        """Value, gradient (n,) and scoring matrix (n, n) in the n free parameters.

        The last ones are kept: an iteration asks for those at its theta to step, and again for what it tells.
        """
        at = refutations(), np.asarray(theta).tobytes(), free.tobytes()
        if at not in self._last:
            self._last.clear()
            told = partial(self._derivatives, theta, free)
            self._last[at] = beside(self.model, self.value, theta, free, told)
        value, gradient, H = self._last[at]
        return value, gradient.copy(), H.copy()

    def _derivatives(
        self, theta: Array, free: NDArray[np.intp], ends: Ends
    ) -> tuple[float, Array, Array]:
        record, neighbours = self.model.record(theta), self._neighbours(free, ends)
        value, gradient = self.constant, np.zeros(len(free))
        H = np.zeros((len(free), len(free)))
        for term, depends in zip(self.terms, self.depends, strict=True):
            which = np.flatnonzero(depends[free])
            if not which.size:
                value += term.value(record)
                continue
            v, g, h = term.derivatives(record, [neighbours[i] for i in which])
            value += v
            gradient[which] += g
            H[np.ix_(which, which)] += h
        return value, gradient, H

    @where_it_fails(False)
    def possible(self, theta: Array) -> bool:
        """Whether all noise has a covariance at theta."""
        record = self.model.record(theta)
        return all(term.possible(record) for term in self.terms)

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which free parameters move what has no noise (n,): Q is no guide to these."""
        told = partial(self._moves_noise_free, theta, free)
        return beside(self.model, self.value, theta, free, told)

    def _moves_noise_free(
        self, theta: Array, free: NDArray[np.intp], ends: Ends
    ) -> NDArray[np.bool_]:
        record, neighbours = self.model.record(theta), self._neighbours(free, ends)
        out = np.zeros(len(free), dtype=bool)
        for term, depends in zip(self.terms, self.depends, strict=True):
            which = np.flatnonzero(depends[free] & ~out)
            if which.size:
                out[which] = term.moves_noise_free(record, [neighbours[i] for i in which])
        return out

    def _neighbours(self, free: NDArray[np.intp], ends: Ends) -> Neighbours:
        record = self.model.record
        return [
            (record(below), record(above), apart(below, above, int(k)))
            for k, (below, above) in zip(free, ends, strict=True)
        ]


def parameter_scale(model: BaseModel, theta: Array, k: int) -> float:
    """A typical size of parameter k, in its unit: its value, default or ``scale``, whichever is most.

    Without any, a share of its bounds; else 1. :func:`engine.estimation.quasi_ml.with_scales` finds a
    better one.
    """
    p = model.parameters[k]
    size = max(abs(float(theta[k])), abs(p.default), p.scale)
    if size > 0.0:
        return size
    width = float(model.upper[k] - model.lower[k])
    return TYPICAL_SHARE * width if np.isfinite(width) else 1.0


def either_side(model: BaseModel, theta: Array, k: int, share: float) -> tuple[Array, Array]:
    """Theta with parameter k less and more by a ``share`` of its size, within its bounds.

    By no more than the root of the share of a value far below its default: beside a small standard deviation a
    difference over the default's would be a secant, cut off at 0. Nor by less than the square of the share of
    the size: a value next to 0 may be small by chance, and smaller differences drown in rounding.
    """
    size, value = parameter_scale(model, theta, k), abs(float(theta[k]))
    step = share * size
    if value > 0.0:
        step = min(step, max(np.sqrt(share) * value, share * step))
    below, above = np.array(theta), np.array(theta)
    below[k] = max(theta[k] - step, model.lower[k])
    above[k] = min(theta[k] + step, model.upper[k])
    return below, above


def beside(
    model: BaseModel,
    value: Callable[[Array], float],
    theta: Array,
    free: NDArray[np.intp],
    told: Callable[[Ends], Told],
) -> Told:
    """What is ``told`` by points to either side of theta in each free parameter.

    Theta stands for one without a finite ``value``, as the model cannot be had there.
    """
    ends = [either_side(model, theta, int(k), STEP_SHARE) for k in free]
    try:
        found = told(ends)
    except ModelError as error:
        if not error.numeric:
            raise
    else:
        numbers: Any = found[1] if isinstance(found, tuple) else found
        if np.isfinite(numbers).all():
            return found
    here = np.asarray(theta)
    usable = [[one if np.isfinite(value(one)) else here for one in pair] for pair in ends]
    return told([(below, above) for below, above in usable])


def apart(below: Array, above: Array, k: int) -> float:
    """How far two points are apart in parameter k; 1 for one and the same, between which nothing differs."""
    return float(above[k] - below[k]) or 1.0


def expectation(
    model: MixedModel, theta: Theta, smoothed: Sequence[tuple[Smoothed | Moments, Points]]
) -> QFunction:
    """The Q-function at theta_k = theta from the smoothed moments of one or several series.

    The moments are those the smoother was asked for: exact given each trajectory, or Algorithm 3's.
    """
    depends = dependence(model, theta, [points for _, points in smoothed])
    record = model.record(theta)
    terms: list[Term] = []
    masks: list[NDArray[np.bool_]] = []
    fixed: list[Term] = []
    for moments, points in smoothed:
        for kind, term in (
            *((0, t) for t in initial_terms(model, theta, moments)),
            *((1, t) for t in dynamics_terms(model, moments, points)),
            *((2, t) for t in measurement_terms(model, moments, points)),
        ):
            if depends[kind].any():
                terms.append(term)
                masks.append(depends[kind])
            else:
                fixed.append(term)
    return QFunction(model, terms, masks, [term.rank(record) for term in terms], fixed)


def dynamics_terms(model: MixedModel, s: Smoothed | Moments, points: Points) -> list[GaussianTerm]:
    """I2, paper, eqs. (14)-(17): x_{t+1} given x_t; one term per block of rows."""
    B, nz = s.cov.shape[1], model.nz
    na, nx = model.na, model.nx
    terms = []
    for rows in blocks(np.arange(len(s.a) - 1), points.N * nx):
        now, after = slice(rows[0], rows[-1] + 1), slice(rows[0] + 1, rows[-1] + 2)
        cross = np.zeros((len(rows), B, nx, nz))
        cross[:, :, na:] = np.swapaxes(s.cross[now], -1, -2)  # Cov(x_{t+1}, z_t) = (0, M')'
        var = np.zeros((len(rows), B, nx, nx))
        var[:, :, na:, na:] = s.cov[after]
        x_next = np.concatenate([s.a[after], s.z[after]], axis=2)
        evaluate = partial(points.at, rows, transition=True)
        terms.append(GaussianTerm(evaluate, x_next, s.z[now], s.cov[now], cross, var))
    return terms


def blocks(rows: NDArray[np.intp], width: int) -> list[NDArray[np.intp]]:
    """Rows in parts of about BLOCK_NUMBERS numbers each, ``width`` numbers per row."""
    return np.array_split(rows, -(-len(rows) * width // BLOCK_NUMBERS)) if len(rows) else []


def measurement_terms(
    model: MixedModel, s: Smoothed | Moments, points: Points
) -> list[GaussianTerm]:
    """I3, paper, eqs. (18b), (19b): y_t given x_t; a term per missing pattern and block."""
    terms = []
    for channels, there in points.series.patterns:
        B = s.cov.shape[1]
        for rows in blocks(there, points.N * model.ny):
            y = np.broadcast_to(
                points.series.y[rows][:, None, channels], (len(rows), points.N, len(channels))
            )
            cross = np.zeros((len(rows), B, len(channels), model.nz))
            var = np.zeros((len(rows), B, len(channels), len(channels)))
            evaluate = _some_channels(points, rows, channels)
            terms.append(GaussianTerm(evaluate, y, s.z[rows], s.cov[rows], cross, var))
    return terms


def _some_channels(points: Points, rows: Any, channels: Any) -> Any:
    everything = len(channels) == points.model.ny
    square = np.ix_(channels, channels)

    def evaluate(record: Any) -> tuple[Array, Array, Array]:
        h, C, R = points.observation(record, rows)
        if everything:
            return h, C, R
        return h[..., channels], C[..., channels, :], R[..., square[0], square[1]]

    return evaluate


def initial_terms(model: MixedModel, theta: Theta, s: Smoothed | Moments) -> list[Term]:
    """I1, paper, eqs. (18a), (19a): a_1, and z_1 given a_1."""
    terms: list[Term] = []
    N, na = s.a.shape[1], model.na
    a1 = s.a[:1]
    if na:
        if isinstance(model.start(model.record(theta)).density, Gaussian):
            certain = np.zeros((1, 1, na, na))
            terms.append(_without_z(lambda record: _first_a(model, record, N), a1, certain))
        else:
            terms.append(DensityTerm(model, a1[0]))
    if model.nz:
        terms.append(_without_z(lambda record: _first_z(model, record, a1[0]), s.z[:1], s.cov[:1]))
    return terms


def _without_z(evaluate: Evaluate, x: Array, var: Array) -> GaussianTerm:
    """The term of x (1, N, n), with Var(x) (1, B, n, n), given nothing else."""
    z, P = np.zeros((1, x.shape[1], 0)), np.zeros((1, 1, 0, 0))
    return GaussianTerm(evaluate, x, z, P, np.zeros((*var.shape[:3], 0)), var)


def _first_a(model: MixedModel, record: Any, N: int) -> tuple[Array, Array, Array]:
    density: Any = model.start(record).density
    mean = np.broadcast_to(density.mean, (1, N, model.na))
    return mean, np.zeros((1, 1, model.na, 0)), np.ascontiguousarray(density.cov)[None, None]


def _first_z(model: MixedModel, record: Any, a1: Array) -> tuple[Array, Array, Array]:
    z, P = model.start(record).linear(a1)
    return z[None], np.zeros((1, 1, model.nz, 0)), P[None, None] if P.ndim == 2 else P[None]


@dataclass(frozen=True, eq=False)
class DensityTerm:
    """Mean over j of log p(a_1^j) for a density that is not Gaussian."""

    model: MixedModel
    a1: Array

    def _log_density(self, record: Any) -> Array:
        return np.asarray(self.model.start(record).density.log_density(self.a1))

    def value(self, record: Any, rank: int | None = None) -> float:
        """The term at theta."""
        value = float(self._log_density(record).mean())
        return value if np.isfinite(value) else -np.inf

    def rank(self, record: Any) -> int:
        """Always 0: nothing to keep."""
        return 0

    def possible(self, record: Any) -> bool:
        """Always: a density has no covariance."""
        return True

    def moves_noise_free(self, record: Any, neighbours: Neighbours) -> NDArray[np.bool_]:
        """None: a density has no such directions."""
        return np.zeros(len(neighbours), dtype=bool)

    def derivatives(self, record: Any, neighbours: Neighbours) -> tuple[float, Array, Array]:
        """Value, gradient, and the outer product of the scores for the scoring matrix."""
        scores = np.array(
            [
                (self._log_density(above) - self._log_density(below)) / distance
                for below, above, distance in neighbours
            ]
        ).reshape(len(neighbours), len(self.a1))
        return self.value(record), scores.mean(axis=1), scores @ scores.T / len(self.a1)


Term = GaussianTerm | DensityTerm  # a summand of the Q-function


class _Forbidden:
    """Stands in for a parameter's value; any use of it raises."""

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        raise TypeError("used")

    def __bool__(self) -> bool:
        raise TypeError("used")

    def __getattr__(self, name: str) -> Any:
        raise TypeError("used")


def dependence(
    model: MixedModel, theta: Theta, records: Sequence[Points]
) -> list[NDArray[np.bool_]]:
    """Which parameters enter initial, dynamics and measurement of any record: three (n_theta,) masks.

    Parameters are replaced by something that cannot be used: a function that still returns, at all
    points, does not need them. A function that is not evaluated at all points in one call would be
    asked too often; there everything is assumed.
    """
    record = model.record(theta)
    masks = [np.zeros(len(model.parameters), dtype=bool) for _ in range(3)]
    for points in records:
        start = partial(_evaluate_start, model, points.a[0])
        masks[0] |= _used(start, start, model, theta, masks[0])
        for mask, transition, function in (
            (masks[1], True, model.transitions),
            (masks[2], False, model.observations),
        ):
            n = points.T - transition
            every = points.arguments(np.arange(n), transition)
            if not function.takes(*every, record):
                mask[:] = True
                continue
            rows = np.unique(np.linspace(0, n - 1, FEW_ROWS).astype(int))
            few = points.arguments(rows, transition)
            first, then = partial(function.once, *few), partial(function.once, *every)
            mask |= _used(first, then, model, theta, mask)
    return masks


def _used(
    first: Callable[[Any], Any],
    then: Callable[[Any], Any],
    model: MixedModel,
    theta: Theta,
    known: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Which parameters a call needs, or are ``known`` to: tried ``first`` on a part, ``then`` on all."""
    used = known.copy()
    asked = np.flatnonzero(~known)
    if asked.size and _fails(first, model, theta, asked):  # else it needs none of them
        for k in asked:
            used[k] = _fails(first, model, theta, [k])
    unused = np.flatnonzero(~used)
    if unused.size and _fails(then, model, theta, unused):
        used[unused] = [_fails(then, model, theta, [k]) for k in unused]
    return used


def _fails(call: Callable[[Any], Any], model: MixedModel, theta: Theta, which: Any) -> bool:
    values: list[Any] = theta.tolist()
    for k in which:
        values[k] = _Forbidden()
    try:
        call(model.record(values))
    except Exception:  # noqa: BLE001 - whatever a use of the value leads to
        return True
    return False


def _evaluate_start(model: MixedModel, a: Array, record: Any) -> None:
    start = model.start(record)
    start.density.log_density(a)
    start.linear(a)
