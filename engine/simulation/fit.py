"""Simulation-error fit: parameters that make the noise-free run follow the data (Q = 0).

Least squares over the free parameters and each series' first state, by a trust-region method
within the bounds (scipy.optimize.least_squares). A run and all its derivatives are found at once where that
converges, see :mod:`engine.simulation.whole_record` and :mod:`engine.simulation.sensitivities`; else by
differences of perturbed runs, which are one pass over time where the model's functions take arrays of
parameters, as plain NumPy ones do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from engine.data.series import Series, as_series_list
from engine.errors import ModelError
from engine.simulation.free_run import FreeRun, first_state, free_run, output_scale, run_rows
from engine.simulation.sensitivities import sensitivities
from engine.simulation.steps import observations, tested
from engine.simulation.whole_record import whole_record
from engine.statespace.checks import check_start
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.statespace.refutation import repeated_if_refuted
from engine.views import Figures, figures, html, tables

STEP = 1e-5  # finite-difference step as a share of a parameter's scale
FLAT = 1e-4  # a direction this much weaker than the strongest is lost in the differences
REFINED = 4  # random starts that are followed
SHORT = 12  # evaluations that each start gets before the best one is followed to its end
TRIALS = 8  # sizes tried for a parameter of unknown scale
PRECISE = 1e-7  # relative change of the cost or of p at which the search ends
SILENT = 1e-9  # a derivative below this share of the largest one is no influence
ALIKE = 0.01  # share by which a column of derivatives may differ from differences of runs ...
WEAK = 1e-6  # ... of the largest column: what differences of runs resolve


@dataclass(frozen=True, eq=False)
class SimulationFit:
    """Estimate by simulation error.

    ``theta`` holds every parameter, ``rmse`` the root mean square of all residuals in the outputs'
    unit. ``runs`` are the free runs of each series, ``a1`` (S, na), ``z1`` (S, nz) their estimated
    first states. ``silent`` parameters were free and cannot change a noise-free run (variances of
    noise, say); they keep their start. ``covariance`` (n_theta, n_theta) takes the residuals for
    white; they hardly ever are, so read it as a lower bound. Zero for parameters not estimated.
    """

    model: MixedModel
    theta: Theta
    rmse: float
    runs: list[FreeRun]
    a1: Array
    z1: Array
    estimated: tuple[str, ...]
    silent: tuple[str, ...]
    covariance: Array
    evaluations: int
    seconds: float
    success: bool
    message: str

    @property
    def residuals(self) -> list[Array]:
        """Measured minus simulated (T, ny) of each series, NaN where nothing was measured."""
        return [run.residuals for run in self.runs]

    @property
    def standard_errors(self) -> dict[str, float]:
        """Of the estimated parameters; see ``covariance``."""
        errors = np.sqrt(np.diag(self.covariance))
        return {name: float(errors[self.model.index(name)]) for name in self.estimated}

    def plot(self) -> Figures:
        """Each series' free run against its data, ``outputs`` and ``states``; extra ``plot``."""
        several = len(self.runs) > 1
        return figures(
            {
                f"{name}-{i + 1}" if several else name: figure
                for i, run in enumerate(self.runs)
                for name, figure in run.plot().items()
            }
        )

    def _repr_html_(self) -> str:
        errors = self.standard_errors
        rows = [
            (p.name, value, errors.get(p.name, "held"), p.unit)
            for p, value in zip(self.model.parameters, self.theta.tolist(), strict=True)
        ]
        return html(
            f"{self.model.name}: simulation-error fit, rms error {self.rmse:.4g}",
            tables().line(self.message),
            tables().table(("parameter", "estimate", "standard error", "unit"), rows),
        )


@repeated_if_refuted
def fit_simulation(
    model: MixedModel,
    series: Series | Sequence[Series],
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_starts: int = 32,
    seed: int = 0,
    max_evaluations: int = 200,
) -> SimulationFit:
    """Fit the free run to one or several series by least squares.

    Estimated are the free parameters and, for each series, those components of the first state that the
    model's initial density leaves uncertain. The start that gets furthest in a few evaluations is followed
    to its end. That is no guarantee: two tanks with their time constants exchanged, say, are a minimum of
    their own, so start near what is known. Outputs are weighed by their standard deviation when there are
    several. Missing measurements are left out.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times in seconds.
    theta0 : Theta, mapping, array or None
        Start values: all as (n_theta,), some by name, or None for the model's defaults.
    free : sequence of str, optional
        Names of the parameters to estimate; all by default.
    n_starts : int
        Random parameter vectors around ``theta0`` that are tried besides it.
    seed : int
        The same seed gives the same bits.
    max_evaluations : int
        Evaluations at most of the start that is followed to its end.

    Returns
    -------
    SimulationFit
        Parameters, first states, free runs and a covariance that takes residuals for white.

    Raises
    ------
    ModelError
        The run from every start is not finite.
    SeriesError
        The data do not fit the model.
    """
    began = time.perf_counter()
    listed = as_series_list(series, model)
    for one in listed:
        check_start(model, model.theta(theta0), one)
    problem = _Problem(model, listed, model.theta(theta0), model.free_indices(free))
    problem.look_for_silent()
    tried = [
        problem.descend(start, SHORT)
        for start in problem.starts(n_starts, np.random.default_rng(seed))
    ]
    best = problem.descend(min(tried, key=lambda end: float(end.cost)).x, max_evaluations)
    theta, x1 = problem.split(best.x)
    runs = [
        free_run(model, theta, one, x[: model.na], x[model.na :])
        for one, x in zip(listed, x1, strict=True)
    ]
    left = np.concatenate([run.residuals[run.series.observed] for run in runs])
    covariance, flat = problem.covariance(best)
    return SimulationFit(
        model=model,
        theta=theta,
        rmse=float(np.sqrt(np.mean(left**2))),
        runs=runs,
        a1=x1[:, : model.na],
        z1=x1[:, model.na :],
        estimated=problem.names(problem.active),
        silent=problem.names(problem.silent),
        covariance=covariance,
        evaluations=problem.evaluations,
        seconds=time.perf_counter() - began,
        success=bool(best.status > 0),
        message=_message(best, problem.names(problem.silent), flat),
    )


class _Problem:
    """Residuals and their derivatives as a function of p = (active parameters, first states)."""

    def __init__(
        self, model: MixedModel, series: list[Series], theta: Theta, free: NDArray[np.intp]
    ) -> None:
        self.model, self.series, self.theta = model, series, theta
        self.active, self.silent = free, free[:0]
        self.scale = output_scale(series)
        given = [max(abs(p.default), p.scale) for p in model.parameters]
        self.sizes: Array = np.maximum(np.abs(np.asarray(theta)), given)
        self.x1, self.spread = first_state(model, theta)
        self.uncertain = np.flatnonzero(self.spread > 0.0)
        self.evaluations = 0
        self.at_once = True  # runs and derivatives as a whole, where they converge
        self._last: tuple[bytes, Array, Array] | None = None
        self._runs: list[Array | None] = [None] * len(
            series
        )  # the last one of each series, to begin with

    def names(self, indices: NDArray[np.intp]) -> tuple[str, ...]:
        return tuple(self.model.parameter_names[i] for i in indices)

    def start(self) -> Array:
        """The vector p at theta0 and the initial density's mean."""
        first_states = np.tile(self.x1[self.uncertain], len(self.series))
        return np.concatenate((np.asarray(self.theta)[self.active], first_states))

    def split(self, p: Array) -> tuple[Theta, Array]:
        """Theta and the first states (S, nx)."""
        theta, x1 = np.array(self.theta), np.tile(self.x1, (len(self.series), 1))
        theta[self.active] = p[: self.active.size]
        x1[:, self.uncertain] = p[self.active.size :].reshape(len(self.series), -1)
        return self.model.theta(theta), x1

    def bounds(self) -> tuple[Array, Array]:
        n = len(self.series) * self.uncertain.size
        low, high = self.model.lower[self.active], self.model.upper[self.active]
        return (
            np.concatenate((low, np.full(n, -np.inf))),
            np.concatenate((high, np.full(n, np.inf))),
        )

    def look_for_silent(self) -> None:
        """Take parameters out that do not change the run around the start."""
        self._look_for_sizes()
        self.at_once = self._agree()
        _, jacobian = self.evaluate(self.start())
        size = np.abs(jacobian[:, : self.active.size]).max(axis=0, initial=0.0) * self.steps()
        quiet = ~(size > SILENT * float(size.max(initial=0.0)))
        self.silent, self.active = self.active[quiet], self.active[~quiet]
        self._last = None

    def _look_for_sizes(self) -> None:
        """A size for each active parameter that starts at 0: what changes the run as much as it is wrong."""
        for i, k in enumerate(self.active):
            if self.sizes[k] > 0.0:
                continue
            self.sizes[k] = 1.0
            for _ in range(
                TRIALS
            ):  # differences over a wrong size are lost in rounding, or too long
                self._last = None
                residuals, jacobian = self.evaluate(self.start())
                wrong, slope = (float(np.sqrt(np.mean(x**2))) for x in (residuals, jacobian[:, i]))
                if not np.isfinite(slope):
                    self.sizes[k] *= 1e-3
                    continue
                found = wrong / slope if slope * wrong > 0.0 else 1e6 * self.sizes[k]
                if 0.1 < found / self.sizes[k] < 10.0 or not np.isfinite(found):
                    break
                self.sizes[k] = found

    def steps(self) -> Array:
        """Finite-difference steps of the active parameters."""
        return np.asarray(STEP * self.sizes[self.active])

    def descend(self, start: Array, evaluations: int) -> OptimizeResult:
        """Least squares from p = start."""
        return least_squares(
            self.residuals,
            start,
            self.jacobian,
            bounds=self.bounds(),
            x_scale=self.scales(),
            ftol=PRECISE,
            xtol=PRECISE,
            max_nfev=evaluations,
        )

    def scales(self) -> Array:
        """Typical size of each component of p: of the parameters, and of the first states."""
        return np.concatenate(
            (self.steps() / STEP, np.tile(self.spread[self.uncertain], len(self.series)))
        )

    def starts(self, n: int, rng: np.random.Generator) -> list[Array]:
        """theta0, and the best of n random vectors around it."""
        first, k = self.start(), self.active.size
        draws = np.tile(first, (n + 1, 1))
        typical = self.steps() / STEP
        factor = np.exp(0.7 * rng.standard_normal((n, k)))
        shift = 0.1 * typical * rng.standard_normal((n, k)) * (first[:k] == 0.0)
        low, high = self.bounds()
        draws[1:, :k] = np.clip(first[:k] * factor + shift, low[:k], high[:k])
        costs = self._costs(draws)
        if not np.isfinite(costs).any():
            self._runs_away()
        best = [i for i in np.argsort(costs) if i > 0 and np.isfinite(costs[i])][:REFINED]
        return [draws[i] for i in ([0] if np.isfinite(costs[0]) else []) + best]

    def _costs(self, draws: Array) -> Array:
        """Sum of squares of each p (K, n_p), inf where the run is not finite."""
        total = np.zeros(len(draws))
        pairs = [self.split(p) for p in draws]
        thetas = np.array([theta for theta, _ in pairs])
        for s, one in enumerate(self.series):
            y, _ = run_rows(self.model, thetas, one, np.array([x1[s] for _, x1 in pairs]))
            e = ((one.y[:, None] - y) / self.scale).transpose(0, 2, 1)[one.observed]
            with np.errstate(over="ignore"):
                total += (e**2).sum(axis=0)
        return np.where(np.isfinite(total), total, np.inf)

    def _runs_away(self) -> None:
        theta, x1 = self.split(self.start())
        for one, x in zip(self.series, x1, strict=True):
            free_run(self.model, theta, one, x[: self.model.na], x[self.model.na :])
        raise ModelError(f"model '{self.model.name}': the run from theta0 is too large to fit")

    def residuals(self, p: Array) -> Array:
        return self.evaluate(p)[0]

    def jacobian(self, p: Array) -> Array:
        return self.evaluate(p)[1]

    def evaluate(self, p: Array) -> tuple[Array, Array]:
        """Residuals (n,) and their derivatives (n, n_p); 0 where these are not finite."""
        key = p.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1], self._last[2]
        self.evaluations += 1
        theta, x1 = self.split(p)
        k, m, S = self.active.size, self.uncertain.size, len(self.series)
        blocks, derivatives = [], []
        for s, one in enumerate(self.series):
            y, dy = self._at_once(theta, x1[s], s) or self._by_differences(theta, x1[s], s)
            slope = (-dy / self.scale[:, None])[one.observed]
            block = np.zeros((len(slope), k + S * m))
            block[:, :k] = slope[:, :k]
            block[:, k + s * m : k + (s + 1) * m] = slope[:, k:]
            blocks.append(((one.y - y) / self.scale)[one.observed])
            derivatives.append(np.where(np.isfinite(block), block, 0.0))
        out = np.concatenate(blocks), np.concatenate(derivatives)
        self._last = (key, *out)
        return out

    def _at_once(self, theta: Theta, x1: Array, s: int) -> tuple[Array, Array] | None:
        """y (T, ny) of a series and its derivatives (T, ny, k + m), None where that does not converge."""
        if not self.at_once:
            return None
        model, one, record = self.model, self.series[s], self.model.record(theta)
        model.observations.look_again()
        x = whole_record(model, record, one, x1, self._runs[s])
        if len(x) < len(one):
            return None
        self._runs[s] = x
        with np.errstate(all="ignore"):
            seen = tested(model, observations(model, record, one), x)
        if seen is None:
            return None
        steps, values = self.steps(), np.asarray(theta)
        dy, _ = sensitivities(model, values, one, x, self.active, self.uncertain, steps)
        return seen.value, dy

    def _by_differences(self, theta: Theta, x1: Array, s: int) -> tuple[Array, Array]:
        """The same by central differences of runs; one-sided at a bound, NaN where one is not finite."""
        k, m = self.active.size, self.uncertain.size
        h = np.concatenate((self.steps(), STEP * self.spread[self.uncertain]))
        thetas = np.tile(np.asarray(theta), (2 * (k + m) + 1, 1))
        for i, column in enumerate(self.active):
            thetas[1 + 2 * i, column] = min(theta[column] + h[i], self.model.upper[column])
            thetas[2 + 2 * i, column] = max(theta[column] - h[i], self.model.lower[column])
        x = np.tile(x1, (len(thetas), 1))
        for i, column in enumerate(self.uncertain):
            x[1 + 2 * (k + i), column] += h[k + i]
            x[2 + 2 * (k + i), column] -= h[k + i]
        y, _ = run_rows(self.model, thetas, self.series[s], x)
        up, down = thetas[1 : 1 + 2 * k : 2], thetas[2 : 2 + 2 * k : 2]
        reach = np.concatenate(((up - down)[np.arange(k), self.active], 2.0 * h[k:]))
        with np.errstate(all="ignore"):
            dy = np.swapaxes(y[:, 1::2] - y[:, 2::2], 1, 2) / reach
        return y[:, 0], dy

    def _agree(self) -> bool:
        """Whether derivatives found at once are, at the start, those of differences of runs.

        They are not where the model jumps, and where friction sticks and slips too often.
        """
        theta, x1 = self.split(self.start())
        h = np.concatenate((self.steps(), STEP * self.spread[self.uncertain]))
        for s, one in enumerate(self.series):
            found = self._at_once(theta, x1[s], s)
            if found is None:
                continue
            pair = found[1], self._by_differences(theta, x1[s], s)[1]
            own, other = ((dy * h / self.scale[:, None])[one.observed] for dy in pair)
            size = np.linalg.norm(other, axis=0)
            off = np.linalg.norm(own - other, axis=0)
            known = np.isfinite(size)
            allowed = ALIKE * size + WEAK * size[known].max(initial=0.0)
            if not (off <= allowed)[known].all():
                return False
        return True

    def covariance(self, best: OptimizeResult) -> tuple[Array, tuple[str, ...]]:
        """Covariance (n_theta, n_theta), and the parameters only determined together."""
        J = np.asarray(best.jac)
        n, n_p = J.shape
        size = np.linalg.norm(J, axis=0)
        size[size == 0.0] = 1.0
        _, s, Vt = np.linalg.svd(J / size, full_matrices=False)
        weak = s < FLAT * s.max(initial=0.0)
        flat: tuple[str, ...] = ()
        if weak.any():
            share = np.abs(Vt[weak, : self.active.size]).max(axis=0)
            flat = self.names(self.active[share > 0.05])
        variance = 2.0 * float(best.cost) / max(n - n_p, 1)
        V = (Vt[~weak] / size).T / s[~weak]
        full = np.zeros((self.theta.size, self.theta.size))
        k = self.active.size
        full[np.ix_(self.active, self.active)] = variance * (V @ V.T)[:k, :k]
        return full, flat


def _message(best: OptimizeResult, silent: tuple[str, ...], flat: tuple[str, ...]) -> str:
    parts = [
        "Converged." if best.status > 0 else "All evaluations were used up before convergence."
    ]
    if silent:
        parts.append(f"No influence on a noise-free run, left at the start: {', '.join(silent)}.")
    if flat:
        parts.append(f"Only determined together, keep one of them fixed: {', '.join(flat)}.")
    return " ".join(parts)
