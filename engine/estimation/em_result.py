"""What EM returns: the estimate and how it came about, and what its callback sees."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from engine.estimation.convergence import WINDOW, drift, mean_point
from engine.estimation.outcome import Outcome
from engine.estimation.quasi_newton import width
from engine.statespace.base import Array, BaseModel, Theta
from engine.statespace.model import MixedModel
from engine.ties import Ties
from engine.views import Figures, Shown, View, figures, frame, plots, save, sheet, tables
from engine.words import tidy


@dataclass(frozen=True)
class Iteration:
    """One iteration of an estimation, as a callback gets it.

    Attributes
    ----------
    k, n_iterations : int
        This iteration, counted from 1, and how many there are at most.
    theta : Theta
        Parameters (n_theta,) after it.
    log_likelihood : float
        Log-likelihood of the parameters before it, as its E step estimated it.
    ess : float
        Mean effective sample size of the filter.
    seconds : float
        Computing time, s.
    collapsed : float
        Share of the rows at which the filter had one particle left.
    memory : array (m,)
        What the next iteration needs besides, see :mod:`engine.estimation.quasi_newton`; EM needs nothing.
    """

    k: int
    n_iterations: int
    theta: Theta
    log_likelihood: float
    ess: float
    seconds: float
    collapsed: float
    memory: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What an estimation needs to go on after k iterations, as ``resume=`` takes it.

    Parameters
    ----------
    trace : array (k+1, n_theta)
        Parameters after each iteration, the start first.
    log_likelihood : array (k,)
        Log-likelihood of the parameters before each iteration.
    ess : array (k,)
        Effective sample size of the filter in each iteration, mean over time.
    seconds : array (k,)
        Computing time of each iteration, s.
    collapsed : array (k,)
        Share of the rows, in each iteration, at which the filter had one particle left.
    memory : array (k, m)
        What the quasi-Newton method needs besides, a row for each iteration; NaN or no columns for EM.
    """

    trace: Array
    log_likelihood: Array
    ess: Array
    seconds: Array
    collapsed: Array
    memory: Array = field(default_factory=lambda: np.empty((0, 0)))

    @staticmethod
    def width(n: int) -> int:
        """Numbers in a row of ``memory`` where n parameters are free."""
        return width(n)


@dataclass(frozen=True, eq=False)
class EmResult(Shown):
    """The estimate and its K iterations; print it for a short table.

    Attributes
    ----------
    model : MixedModel or NonlinearModel
        The model that was estimated.
    free : tuple of str
        The parameters that were estimated; the others kept their start.
    theta : Theta
        The estimate (n_theta,), where ``outcome.success`` is true, else the last iterate. It is the likeliest
        iterate where the last ones wandered off, and a point beside the trace where both filters find that
        likelier; ``message`` says so.
    trace : array (K+1, n_theta)
        Parameters after each iteration, the start first.
    log_likelihood : array (K,)
        Log-likelihood of each row of ``trace[:K]``, as its E step estimated it.
    ess : array (K,)
        Effective sample size of the filter in each iteration, mean over time.
    seconds : array (K,)
        Computing time of each iteration, s.
    collapsed : array (K,)
        Share of the rows, in each iteration, at which the filter had one particle left.
    outcome : Outcome
        How it ended, and whether ``theta`` is an estimate.
    message : str
        How it ended, in a sentence with details.
    not_estimated : tuple of str
        Free parameters that nothing could move: they are where they started.
    memory : array (K, m)
        What the quasi-Newton method needs to go on, see :class:`Checkpoint`.
    ties : Ties
        What is only determined together, by which ``message`` tells what bounds hold; a file does not keep it.
    """

    model: BaseModel
    free: tuple[str, ...]
    theta: Theta
    trace: Array
    log_likelihood: Array
    ess: Array
    seconds: Array
    collapsed: Array
    outcome: Outcome
    message: str
    not_estimated: tuple[str, ...] = ()
    memory: Array = field(default_factory=lambda: np.empty((0, 0)))
    ties: Ties = field(default_factory=Ties)

    @property
    def checkpoint(self) -> Checkpoint:
        """The iterations as a :class:`Checkpoint`, which ``resume=`` takes to go on from here."""
        columns = (self.log_likelihood, self.ess, self.seconds, self.collapsed)
        return Checkpoint(self.trace, *columns, self.memory)

    def plot(self, intervals: Array | None = None) -> Figures:
        """``convergence``: every free parameter by iteration, log-likelihood, effective sample size.

        ``intervals`` (n_theta, 2) are drawn as bands: ``standard_errors(...).interval()``. Needs the
        extra ``plot``.
        """
        return figures(convergence=plots().convergence(self, intervals))

    def to_frame(self) -> Any:
        """A pandas table of the iterations, the start first: parameters, log-likelihood; needs pandas."""
        columns = dict(zip(self.theta.names, self.trace.T, strict=True))
        columns["log_likelihood"] = np.append(self.log_likelihood, np.nan)
        return frame(columns, {"iteration": np.arange(len(self.trace))})

    def save(self, path: str | Path) -> Path:
        """Write it with its model; :func:`engine.load` reads it."""
        return save(self, path)

    def _view(self) -> View:
        rows = [
            (p.name, value, tidy(p.unit), start, self._remark(p.name))
            for p, value, start in zip(
                self.model.parameters, self.theta.tolist(), self.trace[0].tolist(), strict=True
            )
        ]
        return sheet(
            f"{self.model.name}: {len(self.log_likelihood)} iterations",
            tables().line(self.message),
            tables().line(self._likelihood()),
            tables().table(("parameter", "estimate", "unit", "start", ""), rows),
        )

    @property
    def log_likelihood_error(self) -> float | None:
        """Monte Carlo standard error of each ``log_likelihood``; 0 by an exact filter, None where not known.

        It is the scatter of the last iterations, each with random numbers of its own, where these show no trend
        any more.
        """
        if isinstance(self.model, MixedModel) and not self.model.nonlinear:
            return 0.0  # a Kalman filter, whatever the number of particles
        if len(self.ess) and (self.ess == 1.0).all() and not self.collapsed.any():
            return 0.0  # particles have an effective size of one only where they collapse
        last = self.log_likelihood[-WINDOW:]
        if len(last) < WINDOW or not np.isfinite(last).all():
            return None
        difference, error = drift(last[:, None])
        return None if abs(difference[0]) > 2.0 * error[0] else float(last.std(ddof=1))

    def _likelihood(self) -> str:
        if not len(self.log_likelihood):
            return ""
        said, value = "Log-likelihood before the last iteration:", self.log_likelihood[-1]
        usual = (self.trace[-1], mean_point(self.trace[-WINDOW:]))
        if not any(np.array_equal(self.theta, one) for one in usual):
            said = "Log-likelihood before the last iteration, which did not end at the estimate:"
        error = self.log_likelihood_error
        if error == 0.0 or not np.isfinite(value):
            return f"{said} {value:.2f}."
        if error is None:
            run = "rbpf" if isinstance(self.model, MixedModel) else "filter_general"
            return (
                f"{said} about {value:.2f}, by one particle filter. How exact that is, the spread of several "
                f"engine.{run}(...).log_likelihood tells."
            )
        return (
            f"{said} {value:.2f} +- {error:.2g} (Monte Carlo, by the scatter of the last {WINDOW})."
        )

    def _remark(self, name: str) -> str:
        if name in self.not_estimated:
            return "not estimated"
        return "" if name in self.free else "fixed"
