"""Standard errors from the observed information, by differences of the score.

The observed information is the negative derivative of the score. Louis' identity would subtract the
variance of the complete-data score from the complete-data information: where EM contracts slowly the
two nearly cancel, and their Monte Carlo noise does not. Differences of the score over half a standard
error to either side need far fewer trajectories. The directions of the differences are the columns of a
square root of the covariance, so they are found in a first round and refined in a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine import display
from engine.errors import ModelError
from engine.model import Array, MixedModel, Theta, ThetaLike
from engine.series import Series, as_series_list
from engine.standard_errors.score import Score, inside

ROUNDS = 3  # of finding the directions; only the last uses all replicates
GUESS = 0.1  # share of the complete-data information that the data usually hold, to start with
REACH = 0.5  # length of the differences in standard errors: further out the curvature differs
FLOOR = 0.05  # a round may widen a direction by 1 / sqrt(FLOOR) at most


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Asymptotic uncertainty of the free parameters at theta.

    ``covariance`` (n, n) of the free parameters ``names`` that are not at a bound; ``score`` (n,) at
    theta, which is zero at the maximum up to ``score_error`` (n,), its Monte Carlo standard error;
    ``relative_error`` (n,) of the standard errors themselves, as Monte Carlo noise leaves it.
    """

    model: MixedModel
    theta: Theta
    names: tuple[str, ...]
    covariance: Array
    score: Array
    score_error: Array
    relative_error: Array

    @property
    def values(self) -> Array:
        """Standard error of each parameter of the model (n_theta,); NaN for those held fixed."""
        out = np.full(len(self.model.parameters), np.nan)
        out[[self.model.index(name) for name in self.names]] = np.sqrt(np.diag(self.covariance))
        return out

    def interval(self, level: float = 0.95) -> Array:
        """Symmetric confidence intervals (n_theta, 2), NaN for parameters held fixed."""
        from scipy.stats import norm

        half = float(norm.ppf(0.5 + level / 2.0)) * self.values
        return np.stack([np.asarray(self.theta) - half, np.asarray(self.theta) + half], axis=1)

    def _repr_html_(self) -> str:
        numbers = zip(
            self.theta.tolist(), self.values.tolist(), self.interval().tolist(), strict=True
        )
        rows = [
            (p.name, value, error, low, high, p.unit)
            if np.isfinite(error)
            else (p.name, value, "held", "", "", p.unit)
            for p, (value, error, (low, high)) in zip(self.model.parameters, numbers, strict=True)
        ]
        head = ("parameter", "estimate", "standard error", "95 % from", "to", "unit")
        return display.show(f"{self.model.name}: standard errors", display.table(head, rows))


def standard_errors(
    model: MixedModel,
    theta: ThetaLike,
    series: Series | Sequence[Series],
    free: Sequence[str] | None = None,
    n_particles: int = 100,
    n_trajectories: int = 100,
    replicates: int = 8,
    seed: int = 0,
    exact: bool = False,
) -> StandardErrors:
    """Standard errors at an estimate; observed information by differences of the score.

    Each of the 2 n scores is averaged over ``replicates`` smoothers. ``exact`` uses the Kalman
    smoother (linear Gaussian models). A free parameter at one of its bounds is held there.
    Raises ModelError where the data hold no information on a parameter.
    """
    theta = model.theta(theta)
    listed = as_series_list(series, model)
    indices = inside(model, theta, free)
    score = Score.of(model, theta, listed, indices, n_particles, n_trajectories, exact)
    names, x, replicates = score.names, score.x, 1 if exact else replicates
    seeds = np.random.SeedSequence(seed).spawn(replicates)
    centre = [score.at(x, which) for which in seeds]
    H = np.mean([h for _, h in centre], axis=0)
    silent = [name for name, h in zip(names, np.diag(H), strict=True) if not h > 0.0]
    if silent:
        raise ModelError(
            f"the data hold no information on {', '.join(silent)} at this theta; hold it fixed "
            "(free=) or choose other data"
        )
    L = _root(np.linalg.inv(H / GUESS))
    for n in [1] * (ROUNDS - 1) + [replicates]:
        G = np.array([_whitened_information(score, L, which) for which in seeds[:n]])
        refined = L @ _root(_inverse(G.mean(axis=0)))
        spread, L_last, L = G, L, refined
    covariance = L @ L.T
    scores = np.array([g for g, _ in centre])
    return StandardErrors(
        model,
        theta,
        names,
        covariance,
        scores.mean(axis=0),
        scores.std(axis=0, ddof=min(replicates - 1, 1)) / np.sqrt(replicates),
        _jackknife(L_last, spread),
    )


def _whitened_information(score: Score, L: Array, which: np.random.SeedSequence) -> Array:
    """L' I L from central differences of the score along the columns of L, clipped to the bounds."""
    n, x = len(L), score.x
    G = np.empty((n, n))
    for k in range(n):
        ends, lengths = [], []
        for sign in (-1.0, 1.0):
            length = _within(x, sign * L[:, k], *score.bounds)
            ends.append(score.at(x + sign * length * L[:, k], which)[0])
            lengths.append(length)
        G[:, k] = L.T @ (ends[0] - ends[1]) / sum(lengths)
    return 0.5 * (G + G.T)


def _within(x: Array, step: Array, lower: Array, upper: Array) -> float:
    """The largest share (at most REACH) of a step that stays well within the bounds."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(
            step > 0.0, (upper - x) / step, np.where(step < 0.0, (lower - x) / step, np.inf)
        )
    return float(min(REACH, 0.9 * room.min()))


def _root(S: Array) -> Array:
    """The symmetric square root of S: its columns treat all parameters alike."""
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return root


def _inverse(G: Array) -> Array:
    """G^{-1} with the eigenvalues of G kept above FLOOR, so that noise cannot make it negative."""
    values, vectors = np.linalg.eigh(G)
    inverse: Array = vectors / np.maximum(values, FLOOR) @ vectors.T
    return inverse


def _jackknife(L: Array, G: Array) -> Array:
    """Relative standard error of each standard error, from the replicates G (R, n, n)."""
    R = len(G)
    if R < 2:
        return np.zeros(len(L))
    left_out = (G.sum(axis=0) - G) / (R - 1)
    logs = np.array([0.5 * np.log(np.diag(L @ _inverse(g) @ L.T)) for g in left_out])
    return np.asarray(np.sqrt((R - 1) * logs.var(axis=0)))
