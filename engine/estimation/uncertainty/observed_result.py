"""What :func:`engine.standard_errors` returns: covariance, score, and what is to be known of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.distributions import normal_quantile
from engine.statespace.model import Array, MixedModel, Theta
from engine.views import html, save, tables
from engine.words import Told, digits, digits_of_ends, ends, number


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Asymptotic uncertainty of the free parameters at theta.

    Attributes
    ----------
    model : MixedModel
        The model that was estimated.
    theta : Theta
        Where the errors were computed.
    names : tuple of str
        The n free parameters that are not at a bound.
    covariance : array (n, n)
        Covariance C of the named parameters, in their units. Where some are ``tied`` it is that with as many
        of them held as must be, whose rows are zero.
    score : array (n,)
        Derivatives s of the log-likelihood, which are zero at the maximum up to ``score_error``.
    score_error : array (n,)
        Monte Carlo standard errors of the score.
    relative_error : array (n,)
        Monte Carlo errors of the standard errors themselves, as shares of them.
    decrement : float
        s' C s: the squared distance, in standard errors, between theta and the maximum that s and C point to
        (Newton's decrement; twice what the log-likelihood can still gain). Where the score of one parameter
        alone surely tells of a distance in the errors that complete data would leave, it is no less than that.
    settled : bool
        Whether theta is a maximum of the likelihood. False where the decrement exceeds a quarter by more than
        its Monte Carlo noise, or where the likelihood draws a parameter away from the bound that holds it.
        Nor is it one where the estimation was lost.
    warning : str
        What is to be known of the errors: that it is not settled, and they are none of an estimate; that
        particles could not check them; which parameters are tied. Else "".
    note : str
        A sentence where the model's steps are too long for the data: errors then say nothing of what the steps
        get wrong; else "".
    tied : tuple of str
        Parameters that the data only determine together; nothing can be said of one alone.
    drawn : tuple of str
        What the likelihood clearly draws away from its bound, in words; a file does not keep it.
    """

    model: MixedModel
    theta: Theta
    names: tuple[str, ...]
    covariance: Array
    score: Array
    score_error: Array
    relative_error: Array
    decrement: float = 0.0
    settled: bool = True
    warning: str = ""
    note: str = ""
    tied: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()

    @property
    def values(self) -> Array:
        """Standard error of each parameter (n_theta,); NaN for those held fixed, infinite for those tied."""
        out = np.full(len(self.model.parameters), np.nan)
        out[[self.model.index(name) for name in self.names]] = np.sqrt(np.diag(self.covariance))
        out[[self.model.index(name) for name in self.tied]] = np.inf
        return out

    def interval(self, level: float = 0.95) -> Array:
        """Confidence intervals (n_theta, 2), theta +- a multiple of its error as far as bounds let it.

        NaN for parameters held, infinite for those tied. An end that is a bound says that the error is too
        large for a parabola: :func:`engine.likelihood_intervals` follows the likelihood itself.
        """
        half = float(normal_quantile(0.5 + level / 2.0)) * self.values
        ends = np.stack([np.asarray(self.theta) - half, np.asarray(self.theta) + half], axis=1)
        within = np.clip(ends, self.model.lower[:, None], self.model.upper[:, None])
        return np.where(np.isfinite(ends), within, ends)

    def save(self, path: str | Path) -> Path:
        """Write it with its model; :func:`engine.load` reads it."""
        return save(self, path)

    def _repr_html_(self) -> str:
        numbers = zip(
            self.theta.tolist(), self.values.tolist(), self.interval().tolist(), strict=True
        )
        rows = [
            (
                p.name,
                Told(value, digits(value, error, 4)),
                error,
                *(Told(end, digits_of_ends(low, high)) for end in (low, high)),
                p.unit,
            )
            if np.isfinite(error)
            else (p.name, value, self._remark(p.name), "", "", p.unit)
            for p, (value, error, (low, high)) in zip(self.model.parameters, numbers, strict=True)
        ]
        head = ("parameter", "estimate", "standard error", "95 % from", "to", "unit")
        title = f"{self.model.name}: standard errors"
        return html(title, tables().line(self._said), tables().table(head, rows))

    def __str__(self) -> str:
        low, high = self.interval().T
        rows = [
            f"{p.name} = {number(value, digits(value, error, 5))} +- {number(error, 2)} {p.unit}, 95 %: "
            + " to ".join(ends(a, b))
            if np.isfinite(error)
            else f"{p.name} = {number(value, 5)} {p.unit}, {self._remark(p.name)}"
            for p, value, error, a, b in zip(
                self.model.parameters, self.theta.tolist(), self.values, low, high, strict=True
            )
        ]
        return "\n".join([*rows, *([self._said] if self._said else [])])

    @property
    def _said(self) -> str:
        return " ".join(one for one in (self.warning, self.note) if one)

    def _remark(self, name: str) -> str:
        return "tied to others" if name in self.tied else "held"
