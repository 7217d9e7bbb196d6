"""Maximum of the moment filter's likelihood: Fisher scoring on a smooth, deterministic function.

With innovations nu_t and their covariance S_t from :mod:`engine.filters.sigma_point`, the log-likelihood is
the sum of log N(nu_t; 0, S_t), its gradient the central difference of its own values, and the
information

    H_kl = sum nu_t,k' S_t^{-1} nu_t,l + 1/2 tr(S_t^{-1} S_t,k S_t^{-1} S_t,l),

with nu_t,k and S_t,k the derivatives along parameter k. One pass of the filter evaluates all neighbours
of theta, another a whole line search.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.data.given import as_series_list
from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.along_edges import Edge, Place
from engine.estimation.differences import alive, neighbours
from engine.estimation.edges import Edges
from engine.estimation.expectation import parameter_scale
from engine.estimation.jumps import sides, slopes
from engine.estimation.maximization import scoring_step
from engine.failing import where_it_fails
from engine.filters.neighbours import Visited, filter_all, filter_neighbours
from engine.filters.sigma_point import free_thetas, moment_filter, moment_path
from engine.statespace.checks import check_start, failure, with_least_noise
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.statespace.refutation import repeated_if_refuted
from engine.ties import Ties, flat_directions, tied

TRIES = 2.0 ** -np.arange(0.0, 9.0, 1.0)  # step lengths
# those tried together, until one is good: after the whole step, and where that was too long before
BATCHES = (slice(1, 3), slice(3, None))
SHORT = (slice(0, 3), slice(3, None))
GOOD = 0.25  # of the expected gain; expected is twice what a quadratic function gains
ENOUGH = 1e-3  # an expected gain in log-likelihood below this ends the search
TRIALS = 8  # sizes tried for a parameter of unknown scale
PATIENCE = 3  # iterations before a search may be given up as hopeless
DAMPING = 1e-8  # of the information scaled to a unit diagonal
RIDGE = 1e-12
# of what is left of a search, after each iteration: nobody knows how many it needs
LEFT_AFTER = 0.8


def share_done(k: int) -> float:
    """The share of a search that is told as done when its iteration k begins."""
    return 1.0 - LEFT_AFTER ** (k - 1)


@dataclass(frozen=True, eq=False)
class QuasiFit:
    """The maximum: ``theta``, ``log_likelihood``, ``information`` (n, n) of the free parameters ``free``.

    ``given_up`` tells that the search was left before its end, as it was not expected to reach its target.
    ``rivals`` are thetas of other maxima, nearly as high, where they were looked for.
    """

    model: MixedModel
    theta: Theta
    log_likelihood: float
    free: tuple[str, ...]
    information: Array
    iterations: int
    converged: bool
    given_up: bool = False
    rivals: tuple[tuple[float, ...], ...] = ()

    @property
    def covariance(self) -> Array:
        """Of the free parameters (n, n), from the information; inf where there is none."""
        H = self.information
        with np.errstate(divide="ignore", invalid="ignore"):
            d = np.where(np.diag(H) > 0.0, 1.0 / np.sqrt(np.diag(H)), 0.0)
        scaled = H * d[:, None] * d[None, :] + np.diag(np.where(d > 0.0, DAMPING, 1.0))
        covariance = np.linalg.pinv(scaled, hermitian=True) * d[:, None] * d[None, :]
        unknown = np.flatnonzero(d == 0.0)
        covariance[unknown, unknown] = np.inf
        return np.asarray(covariance)

    @property
    def standard_errors(self) -> Array:
        """Of the free parameters (n,), from the information; inf where there is none and for the tied."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.asarray(np.where(tied(self._flat), np.inf, errors))

    @property
    def tied(self) -> tuple[str, ...]:
        """Free parameters that the data only determine together; nothing can be said of one alone."""
        return tuple(name for name, yes in zip(self.free, tied(self._flat), strict=True) if yes)

    def holding(self, names: Collection[str]) -> QuasiFit:
        """The same fit with what is known of the others where these free parameters are held."""
        rest = [i for i, name in enumerate(self.free) if name not in names]
        free = tuple(self.free[i] for i in rest)
        return replace(self, free=free, information=self.information[np.ix_(rest, rest)])

    @property
    def ties(self) -> Ties:
        """The same with the directions."""
        return Ties(self.free, self._flat)

    @property
    def _flat(self) -> Array:
        return flat_directions(self.information)

    def log_terms(self, series: Series) -> Array:
        """One-step predictive log-densities (T,) of a series under the fitted model."""
        thetas = np.asarray(self.theta)[None]
        return np.asarray(moment_filter(self.model, thetas, series).log_terms[:, 0])


@repeated_if_refuted
def quasi_ml(  # noqa: PLR0913
    model: MixedModel,
    series: Series | Sequence[Series],
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    max_iterations: int = 40,
    tolerance: float = ENOUGH,
    target: float = -np.inf,
    hope: float = 1.0,
    callback: Callable[[int], object] | None = None,
    visited: Sequence[Visited] | None = None,
    leave: Callable[[Array, float, Array], bool] = lambda theta, value, information: False,
) -> QuasiFit:
    """Maximise the moment filter's log-likelihood over the free parameters, within their bounds.

    The search ends where less than ``tolerance`` is expected to be gained, or, after a few iterations,
    where even ``hope`` times twice what a quadratic function gains would not reach ``target``, or ``hope``
    times what the iterations left gain at the pace of the last ones; then ``given_up`` is True.
    ``callback(k)`` is called as iteration k begins. ``visited``, one for each series, are points at a theta not
    far from the start; they are brought up to date. ``leave(theta, value, information)`` may give a search up
    before each iteration.
    Raises ModelError where the model cannot be used or the likelihood is not finite at the start.
    """
    all_series = as_series_list(series, model, together=True)
    theta = np.asarray(model.theta(theta0))
    indices = model.free_indices(free)
    for one in all_series:
        check_start(model, theta, one)
    given, model = model, with_scales(model, all_series, theta, indices)
    names = tuple(model.parameter_names[i] for i in indices)
    edges = Edges(model.lower[indices], model.upper[indices])
    visited = [Visited() for _ in all_series] if visited is None else visited
    value, g, H = derivatives(model, all_series, theta, indices, visited)
    if not np.isfinite(value):
        for one in all_series:
            moment_path(model, theta, one)  # tells where it is lost, and why
        raise ModelError(
            f"model '{model.name}': the likelihood is not finite at the start values; choose others"
        )

    def learnt() -> bool:
        x = theta[indices]
        step = scoring_step(x, g, H, edges.lower, edges.upper, DAMPING)
        return edges.learnt(
            x,
            step,
            lambda each: log_likelihoods(model, all_series, free_thetas(theta, indices, each)),
        )

    converged, given_up, iterations, damping, whole = False, False, 0, DAMPING, True
    gains: list[float] = []
    idle = 0  # steps in turn that gained next to nothing
    while iterations < max_iterations:
        iterations += 1
        if callback is not None:
            callback(iterations)
        x = theta[indices]
        direction = scoring_step(x, g, H, edges.lower, edges.upper, damping)
        with np.errstate(over="ignore", invalid="ignore"):
            expected = float(g @ direction)
        if not np.isfinite(expected):
            break  # no slope leads anywhere
        if not expected > tolerance:
            if edges.closer(x, g, tolerance):
                continue
            converged = True
            break
        # at a kink hardly anything of what is expected is gained, however far away the maximum is
        left = max_iterations - iterations + 1
        most = min(expected, left * max(gains[-PATIENCE:], default=np.inf))
        hopeless = iterations > PATIENCE and value + hope * most < target
        if hopeless or leave(theta, value, H):
            given_up = True
            break
        moved, there, whole = _step(
            model, all_series, theta, indices, direction, value, expected, visited, whole, edges
        )
        if moved is None:
            if damping <= 1.0:
                damping = max(damping * 1e3, 1e-4)
                continue
            if not learnt():
                break
            damping, whole = DAMPING, True
            continue
        free_step = whole and damping <= DAMPING
        damping = max(damping / 10.0, DAMPING)
        if not np.isfinite(there[0]):
            break
        gained, theta = there[0] - value, moved
        gains.append(gained)
        value, g, H = there
        # a step that was cut short may gain next to nothing at a kink beside a long way up
        idle = idle + 1 if gained < 0.1 * tolerance else 0
        if idle > 1 or (idle and free_step):
            if learnt():
                idle, damping, whole = 0, DAMPING, True
                continue
            converged = True
            break
    bounds = model.lower[indices], model.upper[indices]
    if not given_up and edges.narrower_than(*bounds):
        edge = _edge(model, all_series, theta, indices, visited)
        here = Place(theta[indices], value, g, H)
        place, converged = edge.climbed(here, tolerance, converged, max_iterations)
        theta, value, H = free_thetas(theta, indices, place.x[None])[0], place.value, place.H
    best = Theta(theta, model.parameter_names)
    return QuasiFit(given, best, float(value), names, H, iterations, converged, given_up)


def _edge(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Array,
    indices: NDArray[np.intp],
    visited: Sequence[Visited],
) -> Edge:
    """The edge of where the model can be had, near theta."""

    def full(x: Array) -> Array:
        return free_thetas(theta, indices, np.atleast_2d(x))

    def at(x: Array) -> Place:
        return Place(x, *_derivatives_or_none(model, all_series, full(x)[0], indices, visited))

    return Edge(
        model.lower[indices],
        model.upper[indices],
        np.array([parameter_scale(model, theta, int(k)) for k in indices]),
        lambda x: failure(model, full(x)[0], all_series) is None,
        lambda each: log_likelihoods(model, all_series, full(each)),
        at,
    )


def with_scales(
    model: MixedModel, all_series: Sequence[Series], theta: Array, indices: NDArray[np.intp]
) -> MixedModel:
    """The model as a search needs it: :func:`with_least_noise`, and with a ``scale`` for each parameter.

    One is found for those of ``indices`` whose default is 0 and that have none. It is the value in ``theta``;
    where that is 0 too, what changes a prediction by about one of its standard deviations, from the information
    at theta, if it can be had.
    """
    model = with_least_noise(model, np.asarray(theta), indices, all_series)
    parameters = list(model.parameters)
    unknown = [k for k in indices if parameters[k].default == parameters[k].scale == 0.0]
    for k in unknown:
        scale = abs(float(theta[k])) or _informed_scale(
            model, all_series, np.asarray(theta), int(k)
        )
        scale = scale or parameter_scale(model, theta, k)
        parameters[k] = replace(parameters[k], scale=scale)
    return model.with_parameters(parameters) if unknown else model


def _informed_scale(model: MixedModel, all_series: Sequence[Series], theta: Array, k: int) -> float:
    """1 / sqrt(information of one reading) on parameter k; 0 where there is none."""
    scale, n = 1.0, sum(int(one.observed.sum()) for one in all_series)
    # differences over steps of a wrong size are lost in rounding, or too long
    for _ in range(TRIALS):
        parameters = list(model.parameters)
        parameters[k] = replace(parameters[k], scale=scale)
        tried = model.with_parameters(parameters)
        try:
            value, _, H = derivatives(tried, all_series, theta, np.array([k]))
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return 0.0
        if not np.isfinite(value):
            scale *= 1e-3
            continue
        found = float(np.sqrt(n / H[0, 0])) if H[0, 0] > 0.0 else 1e6 * scale
        if 0.1 < found / scale < 10.0:
            return found
        scale = found
    return 0.0


def _step(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Array,
    indices: NDArray[np.intp],
    direction: Array,
    value: float,
    expected: float,
    visited: Sequence[Visited],
    whole: bool,
    edges: Edges,
) -> tuple[Array | None, tuple[float, Array, Array], bool]:
    """The new theta with its derivatives, and whether the step was a whole one.

    None where no step along the direction is better. The ``whole`` step is tried with its derivatives at once,
    as most steps are good; where it gains less than a part of what was expected, or the last one did, step
    lengths are compared first.
    """
    x = theta[indices]
    trials = np.clip(x + TRIES[:, None] * direction, edges.lower, edges.upper)
    moved = free_thetas(theta, indices, trials[:1])[0]
    here = [one.copy() for one in visited]
    there = -np.inf, direction, direction
    if whole:
        there = _derivatives_or_none(model, all_series, moved, indices, visited)
        if there[0] > value + GOOD * expected:
            return moved, there, True
        if not np.isfinite(there[0]):  # perhaps at a bound: half the way there, then, and less
            trials = np.where(trials == trials[0], x + TRIES[:, None] * (trials[0] - x), trials)
    values = np.full(len(trials), -np.inf)
    for part in BATCHES if whole else SHORT:
        thetas = free_thetas(theta, indices, trials[part])
        values[part] = log_likelihoods(model, all_series, thetas, here)
        best = int(np.argmax(values))
        if values[best] > value + GOOD * TRIES[best] * expected:
            break
    if there[0] > value and not values[best] > there[0]:
        return moved, there, True
    if not values[best] > value:
        return None, there, True
    moved = free_thetas(theta, indices, trials[best : best + 1])[0]
    for one, before in zip(visited, here, strict=True):
        one.seen, one.moved = before.seen, before.moved
    there = _derivatives_or_none(model, all_series, moved, indices, visited)
    return moved, there, best == 0


def _derivatives_or_none(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Array,
    indices: NDArray[np.intp],
    visited: Sequence[Visited],
) -> tuple[float, Array, Array]:
    """The derivatives at a trial; a likelihood of -inf where a calculation of the model fails."""
    n = len(indices)
    nothing = -np.inf, np.zeros(n), np.zeros((n, n))
    return where_it_fails(nothing)(derivatives)(model, all_series, theta, indices, visited)


def log_likelihoods(
    model: MixedModel,
    all_series: Sequence[Series],
    thetas: Array,
    visited: Sequence[Visited] | None = None,
) -> Array:
    """Log-likelihood of all series together at each of the parameter vectors (K, n_theta).

    It is -inf where there is none, as a calculation of the model fails or a filter is lost. ``visited``, one
    for each series, at a theta not far from them, spares a model that takes one parameter vector a call the
    steps one by one.
    """
    try:
        each = [
            filter_all(model, thetas, one, visited[i] if visited else None).log_likelihood
            for i, one in enumerate(all_series)
        ]
    except ModelError as error:
        if not error.numeric:
            raise
        if len(thetas) == 1:
            return np.array([-np.inf])
        return np.concatenate([log_likelihoods(model, all_series, one[None]) for one in thetas])
    return np.asarray(np.sum(each, axis=0))


def derivatives(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Array,
    indices: NDArray[np.intp],
    visited: Sequence[Visited] | None = None,
) -> tuple[float, Array, Array]:
    """Log-likelihood, gradient (n,) and information (n, n) in the free parameters.

    ``visited``, one for each series, is what a search hands on from theta to theta. Where noise has a random
    scale the information is that of the predicted means, and beside it what the other part of the rows' scores
    tells (Berndt, Hall, Hall, Hausman 1974): of outliers the moments of y do not have it. Rows that jump
    between the neighbours of theta tell the slope of the side that does not. So does a neighbour that has no
    likelihood. Raises ModelError where the model fails at theta.
    """
    thetas = neighbours(model, theta, indices)
    n = len(indices)
    value, g, H = 0.0, np.zeros(n), np.zeros((n, n))
    for i, one in enumerate(all_series):
        f = filter_neighbours(model, thetas, one, visited[i] if visited else None)
        value += float(f.log_likelihood[0])
        if not np.isfinite(value):
            return -np.inf, g, H
        f, ends = alive(f, thetas)  # the value is -inf below where both sides are lost
        apart = sides(ends, indices)
        distances = apart[2]
        total = f.log_likelihood
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            d_log = slopes(f.log_terms, *apart)
            jumped = d_log - (f.log_terms[:, 2::2] - f.log_terms[:, 1::2]) / distances
            g += (total[2::2] - total[1::2]) / distances + np.nan_to_num(jumped).sum(axis=0)
            d_nu = np.nan_to_num(slopes(f.innovations, *apart))
            d_S = slopes(f.S, *apart)
            root = whitening(f.S[:, 0], one.observed)
            z = np.einsum("tij,tkj->kti", root, d_nu)
            if model.random_scales:
                by_mean = np.einsum("kti,tij,tj->tk", z, root, np.nan_to_num(f.innovations[:, 0]))
                rest = d_log + by_mean
                H += np.einsum("kti,lti->kl", z, z) + rest.T @ rest
                continue
            z = z.reshape(n, root.shape[0] * root.shape[1])
            E = root[:, None] @ d_S @ root[:, None].swapaxes(-1, -2)
            E = E.swapaxes(0, 1).reshape(n, root.size)
            H += z @ z.T + 0.5 * E @ E.T
    if not (np.isfinite(g).all() and np.isfinite(H).all()):
        value = -np.inf
    return value, g, H


def whitening(S: Array, observed: NDArray[np.bool_]) -> Array:
    """S_t^{-1/2} (T, ny, ny) by Cholesky, with zero rows and columns for missing channels."""
    ny = S.shape[1]
    there = observed[:, :, None] & observed[:, None, :]
    ridge = RIDGE * np.eye(ny) * S  # of each channel's own variance, whatever their units
    safe = np.where(there, S + ridge, np.eye(ny))
    inverse = np.linalg.inv(np.linalg.cholesky(safe))
    out: Array = np.where(there, inverse, 0.0)
    return out
