"""Simulation-error fit: parameters that make the noise-free run follow the data (Q = 0).

Least squares over the free parameters and each series' first state, by a trust-region method
within the bounds (scipy.optimize.least_squares), see :mod:`engine.simulation.problem`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult

from engine.data.faults import about_faults
from engine.data.given import as_series_list
from engine.data.series import Series
from engine.randomness import check_seed
from engine.simulation.free_run import (
    FreeRun,
    free_run,
    root_mean_square,
    root_mean_squares,
    spread_of,
)
from engine.simulation.other_minima import other_minimum, said_of
from engine.simulation.own_steps import about_own_free_runs
from engine.simulation.problem import FreeRunProblem
from engine.simulation.starts import Progress, best_of_starts, speaks_at_its_end
from engine.simulation.step_length import AWAY, about_free_runs
from engine.statespace.checks import check_start
from engine.statespace.clock import about_clock
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.statespace.refutation import repeated_if_refuted
from engine.threads import single_threaded
from engine.ties import Ties
from engine.views import Figures, Shown, View, figures, frame, save, sheet, tables
from engine.words import Told, digits, errors_in_words, hardly_told, tidy

OF_THE_RUN = (
    "Standard errors allow for errors of the run that last, as process noise makes them. Where it moves the "
    "states, maximum likelihood (rbps_em) knows the parameters better."
)
SHORT_RECORD = 3.0  # degrees of freedom of a variance, below which it is told
RUNS_AWAY = (
    "The simulation runs away from the record: its error is larger than all that the readings move. Where the "
    "model is unstable, as a plant that only its controller holds, no free run can be fitted to them: estimate "
    "by maximum likelihood (rbps_em), which follows the readings. Else start elsewhere. What is said of its "
    "parameters means nothing."
)
ROUNDS = 3  # of fits, where parameters turn out to matter that did not at the start


@dataclass(frozen=True, eq=False)
class SimulationFit(Shown):
    """The result of :func:`engine.fit_simulation`; print it for a short table.

    Attributes
    ----------
    model : MixedModel
        The model that was fitted.
    theta : Theta
        Every parameter: the estimated ones, and the others at their start.
    runs : list of FreeRun
        The simulation of each of the S series, with ``y`` (T, ny) and the states.
    a1 : array (S, na)
        Estimated first nonlinear states, a row for each series.
    z1 : array (S, nz)
        Estimated first linear states, likewise.
    estimated : tuple of str
        The parameters that were estimated.
    silent : tuple of str
        Free parameters that cannot change a noise-free run, such as variances of noise; they keep their start.
    tied : tuple of str
        Estimated parameters that the data only determine together; nothing can be said of one alone.
    covariance : array (n_theta, n_theta)
        Covariance of the parameters, from residuals that may be correlated over time, as process noise makes
        them; zero for parameters not estimated. Wide enough that 1.96 standard errors to either side are 95 %
        also where a record is short beside how long errors last; ``message`` says where it is.
    evaluations : int
        Runs of the model.
    seconds : float
        Computing time, s.
    success : bool
        Whether the search converged.
    message : str
        The same in a sentence, with details.
    """

    model: MixedModel
    theta: Theta
    runs: list[FreeRun]
    a1: Array
    z1: Array
    estimated: tuple[str, ...]
    silent: tuple[str, ...]
    tied: tuple[str, ...]
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
    def rmse(self) -> float:
        """Root mean square of all residuals, in the outputs' unit; NaN where they have several units."""
        return root_mean_square(self.model, np.concatenate(self.residuals))

    @property
    def rmse_by_output(self) -> dict[str, float]:
        """Root mean square of the residuals of each output, in its unit; NaN where none was measured."""
        return root_mean_squares(self.model, np.concatenate(self.residuals))

    @property
    def nrmse(self) -> float:
        """Root mean square of all residuals, each as a share of its output's standard deviation: of no unit."""
        scale = spread_of([run.series for run in self.runs])
        return float(np.sqrt(np.nanmean((np.concatenate(self.residuals) / scale) ** 2)))

    @property
    def standard_errors(self) -> dict[str, float]:
        """{name: standard error} of the estimated parameters; infinite for those that are ``tied``."""
        errors = np.sqrt(np.diag(self.covariance))
        return {
            name: np.inf if name in self.tied else float(errors[self.model.index(name)])
            for name in self.estimated
        }

    def plot(self) -> Figures:
        """Draw each series' simulation and data, ``outputs`` and ``states``; needs the extra ``plot``."""
        several = len(self.runs) > 1
        return figures(
            {
                f"{name}-{i + 1}" if several else name: figure
                for i, run in enumerate(self.runs)
                for name, figure in run.plot().items()
            }
        )

    def to_frame(self) -> Any:
        """A pandas table of the parameters: estimate, standard error, unit; needs pandas."""
        errors = self.standard_errors
        columns = {
            "estimate": self.theta.tolist(),
            "standard_error": [errors.get(name, np.nan) for name in self.theta.names],
            "unit": [p.unit for p in self.model.parameters],
        }
        return frame(columns, {"parameter": list(self.theta.names)})

    def save(self, path: str | Path) -> Path:
        """Write it with its model; :func:`engine.load` reads it."""
        return save(self, path)

    def _view(self) -> View:
        errors = self.standard_errors
        rows = [
            (
                p.name,
                Told(value, digits(value, errors.get(p.name), 4)),
                self._remark(p.name) or errors[p.name],
                tidy(p.unit),
            )
            for p, value in zip(self.model.parameters, self.theta.tolist(), strict=True)
        ]
        return sheet(
            f"{self.model.name}: simulation-error fit, rms error "
            + errors_in_words(self.rmse_by_output, self.model.outputs),
            tables().line(self.message),
            tables().table(("parameter", "estimate", "standard error", "unit"), rows),
            tables().line(OF_THE_RUN),
        )

    def _remark(self, name: str) -> str:
        if name in self.tied:
            return "tied to others"
        if name in self.estimated:
            return ""
        return "no influence" if name in self.silent else "held"


@single_threaded
@repeated_if_refuted
def fit_simulation(
    model: MixedModel,
    series: Series | Sequence[Series],
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_starts: int = 32,
    seed: int = 0,
    max_evaluations: int = 200,
    callback: Callable[[int, int], object] | None = None,
) -> SimulationFit:
    """Fit the simulation without noise to one or several series by least squares.

    The free parameters are estimated and, for each series, those components of the first state that the
    model's initial density leaves uncertain. Several starts are tried, one of them fitted to growing parts of
    the records first, as all are where none follows the readings. The one with the least error after a few
    evaluations is followed to its end. It may be a local minimum, so start near what is known; another one
    that was met and is as good is told. Several outputs are weighed by their standard deviations. Missing
    measurements are left out.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    theta0 : Theta, mapping, array or None
        Start values: all as (n_theta,), some by name, or None for the model's defaults.
    free : sequence of str, optional
        Names of the parameters to estimate, all by default; the others keep their start value.
    n_starts : int
        How many random parameter vectors around ``theta0`` are tried besides it.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    max_evaluations : int
        Upper limit on evaluations of the start that is followed to its end.
    callback : callable, optional
        ``callback(done, steps)`` is called after each start that is tried and at the end, ``done`` counted from
        1. Where the fit makes all starts anew, as parameters matter at its end that did not at its start, they
        are counted on and ``steps`` grows. It stops the fit by returning True or raising StopIteration; the
        best start so far is the result.

    Returns
    -------
    SimulationFit
        Parameters ``theta`` (n_theta,), first states, simulations and a covariance.

    Raises
    ------
    ModelError
        The run from every start is not finite.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel. Or no more readings
        than parameters and first states.
    """
    began = time.perf_counter()
    check_seed(seed)
    listed = as_series_list(series, model)
    for one in listed:
        check_start(model, model.theta(theta0), one)
    theta, indices = model.theta(theta0), model.free_indices(free)
    told, x1 = Progress(callback), None
    for left in reversed(range(ROUNDS)):  # what changes nothing at the start may where the fit ends
        problem = FreeRunProblem(model, listed, theta, indices, x1)
        best, tried, stopped = best_of_starts(problem, n_starts, seed, max_evaluations, told)
        again = bool(left and not stopped and speaks_at_its_end(problem, best, indices))
        if not stopped and told.stops(more=again) and again:
            stopped = told.done
        if stopped or not again:
            break
        theta, x1 = problem.split(best.x)
    other = None if stopped else other_minimum(problem, best, tried, max_evaluations)
    if other is not None and other.cost < best.cost:
        best, other = other, best
    theta, x1 = problem.split(best.x)
    runs = _runs(model, theta, listed, x1)
    found = problem.uncertainty(*problem.evaluate(best.x), best.x)
    k = problem.active.size
    covariance = np.zeros((theta.size, theta.size))
    covariance[np.ix_(problem.active, problem.active)] = found.covariance[:k, :k]
    estimated = problem.names(problem.active)
    ties, tied = Ties(estimated, found.directions), problem.names(problem.active[found.tied[:k]])
    errors = np.sqrt(np.diag(covariance))
    known = {name: float(errors[model.index(name)]) for name in estimated if name not in tied}
    degrees = dict(zip(estimated, found.degrees[:k].tolist(), strict=True))
    hardly = model.hardly_known(theta, known)
    faults = about_faults(model.outputs, model.inputs, listed, outliers=True)
    clock = about_clock(model, listed)
    if _run_away(runs):  # of a run that is nowhere near the data nothing more is to be said
        parts = [_ended(best, stopped), RUNS_AWAY, faults, clock]
    else:
        parts = [
            _ended(best, stopped) if estimated else NOTHING,
            _silent_in_words(problem.names(problem.silent), bool(problem.uncertain.size)),
            "" if other is None else said_of(problem, best, other),
            ties.in_words,
            model.held_in_words(theta, [name for name in estimated if name not in hardly], ties),
            hardly_told(hardly),
            _short_in_words(name for name in known if degrees[name] < SHORT_RECORD),
            faults,
            clock,
            about_free_runs(model, theta, listed, x1),
            about_own_free_runs(
                problem, best.x, [np.hstack([run.a, run.z]) for run in runs], known
            ),
        ]
    return SimulationFit(
        model=model,
        theta=theta,
        runs=runs,
        a1=x1[:, : model.na],
        z1=x1[:, model.na :],
        estimated=estimated,
        tied=tied,
        silent=problem.names(problem.silent),
        covariance=covariance,
        evaluations=problem.evaluations,
        seconds=time.perf_counter() - began,
        success=bool(best.status > 0) and not stopped,
        message=" ".join(part for part in parts if part),
    )


def with_runs(
    model: MixedModel, series: Sequence[Series], content: Mapping[str, Any]
) -> SimulationFit:
    """The fit of which ``content`` holds everything but the free runs, which are made again."""
    theta = model.theta(content["theta"])
    S = len(series)
    a1, z1 = (
        np.array(content[name], dtype=float).reshape(S, n)
        for name, n in (("a1", model.na), ("z1", model.nz))
    )
    other: dict[str, Any] = {name: tuple(content[name]) for name in ("estimated", "silent", "tied")}
    for name in ("evaluations", "seconds", "success", "message"):
        other[name] = content[name]
    return SimulationFit(
        model=model,
        theta=theta,
        runs=_runs(model, theta, series, np.hstack([a1, z1])),
        a1=a1,
        z1=z1,
        covariance=np.array(content["covariance"], dtype=float),
        **other,
    )


def _runs(model: MixedModel, theta: Theta, series: Sequence[Series], x1: Array) -> list[FreeRun]:
    """The free run of each series from its first state x1 (S, nx)."""
    return [
        free_run(model, theta, one, x[: model.na], x[model.na :])
        for one, x in zip(series, x1, strict=True)
    ]


def _run_away(runs: Sequence[FreeRun]) -> bool:
    """Whether an output is further off than its readings vary, by far: a line through them would do better."""
    for i in range(runs[0].model.ny):
        y = np.concatenate([run.series.y[:, i] for run in runs])
        off = np.concatenate([run.residuals[:, i] for run in runs])
        seen = np.isfinite(y)
        # of a reading that stands still nothing is known
        moved = float(np.ptp(y[seen])) if seen.any() else 0.0
        if moved > 0.0 and not np.sqrt(np.mean(off[seen] ** 2)) <= AWAY * moved:
            return True
    return False


NOTHING = "Nothing was estimated: no free parameter has an influence on it."


def _ended(best: OptimizeResult, stopped: int) -> str:
    """How it ended; ``stopped`` is after how many starts, 0 where it was not."""
    if stopped:
        return f"Stopped after {stopped} of its starts, at the best of them."
    if best.status > 0:
        return "Converged."
    return "All evaluations were used up before convergence."


def _short_in_words(names: Iterable[str]) -> str:
    """Whose standard errors are themselves hardly known."""
    listed = ", ".join(names)
    if not listed:
        return ""
    return (
        "The record is short beside how long errors of its run last. So it hardly tells the standard error of "
        f"{listed}: what is given is on the safe side, and a longer record, or several, may give a smaller one."
    )


def _silent_in_words(silent: tuple[str, ...], begun: bool) -> str:
    """What does not matter to the run; ``begun``: first states are among what is estimated."""
    if not silent:
        return ""
    own = " whose first states are estimated, too" if begun else ""
    return f"No influence on a noise-free run{own}; left at the start: {', '.join(silent)}."
