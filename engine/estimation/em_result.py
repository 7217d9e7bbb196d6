"""What EM returns: the estimate and how it came about, and what its callback sees."""

from __future__ import annotations

from dataclasses import dataclass

from engine.estimation.outcome import Outcome
from engine.statespace.base import Array, BaseModel, Theta
from engine.views import Figures, figures, html, plots, tables


@dataclass(frozen=True)
class Iteration:
    """What the callback sees: iteration k of n, theta_k, and how the E step before it went.

    ``log_likelihood`` is that of the previous theta; ``ess`` the mean effective sample size;
    ``collapsed`` the share of rows at which the filter had one particle left.
    """

    k: int
    n_iterations: int
    theta: Theta
    log_likelihood: float
    ess: float
    seconds: float
    collapsed: float


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """All that resuming needs: trace (k+1, n_theta), log_likelihood, ess, seconds, collapsed (k,)."""

    trace: Array
    log_likelihood: Array
    ess: Array
    seconds: Array
    collapsed: Array


@dataclass(frozen=True, eq=False)
class EmResult:
    """The estimate and how it came about.

    ``theta`` the estimate; ``trace`` (K+1, n_theta) with the start first; ``log_likelihood`` (K,) of
    trace[:K] as estimated by each E step; ``ess`` (K,); ``seconds`` (K,); ``collapsed`` (K,) share of
    rows at which the filter collapsed; ``outcome``; ``message`` with the particulars;
    ``not_estimated`` names the free parameters that nothing could move: they are where they started.
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

    @property
    def checkpoint(self) -> Checkpoint:
        """What ``resume=`` takes to go on from here."""
        return Checkpoint(self.trace, self.log_likelihood, self.ess, self.seconds, self.collapsed)

    def plot(self, intervals: Array | None = None) -> Figures:
        """``convergence``: every free parameter by iteration, log-likelihood, effective sample size.

        ``intervals`` (n_theta, 2) are drawn as bands: ``standard_errors(...).interval()``. Needs the
        extra ``plot``.
        """
        return figures(convergence=plots().convergence(self, intervals))

    def _repr_html_(self) -> str:
        rows = [
            (p.name, value, p.unit, start, self._remark(p.name))
            for p, value, start in zip(
                self.model.parameters, self.theta.tolist(), self.trace[0].tolist(), strict=True
            )
        ]
        return html(
            f"{self.model.name}: {len(self.log_likelihood)} iterations of EM",
            tables().line(self.message),
            tables().table(("parameter", "estimate", "unit", "start", ""), rows),
        )

    def _remark(self, name: str) -> str:
        if name in self.not_estimated:
            return "not estimated"
        return "" if name in self.free else "fixed"
