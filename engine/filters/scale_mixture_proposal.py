"""A proposal for models whose noise has a random scale; report, eqs. (29)-(31).

The scale s(g) of e_t does not move the predicted measurement, so a proposal that linearises the
measurement is blind for it, and at an outlier only the few particles that happen to have a large s
survive. Here g is drawn from what y_t says about it: its prior is cut into strata, the innovation's
density N(r; 0, G Sigma G' + R_k) with the scale of each stratum gives their probabilities, and a is
then drawn by the adapted proposal of the model without g, with the R that belongs to the drawn g.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from engine.filters.proposals import Step, adapted
from engine.kernels.adapted import spread_points
from engine.kernels.filtering import condition
from engine.kernels.scale_mixture import log_innovations
from engine.statespace.model import Array, LinearGaussian, MixedModel, stacked

SHARE_OF_PRIOR = 0.1  # of the draws of g, so that no weight is more than ten times as large


class WithoutScale:
    """What a proposal asks of a model, without one of its states g, which is held at a value."""

    def __init__(self, model: MixedModel, state: str, g: float) -> None:
        self.model, self.g = model, g
        self.at = list(model.nonlinear).index(state)
        self.na = model.na - 1
        self.nonlinear = {k: unit for k, unit in model.nonlinear.items() if k != state}
        self.random_scales = [one for one in model.random_scales if one.state != state]

    def observation(self, a: Array, u: Any, t: Any, theta: Any) -> LinearGaussian:
        """h, C and R at points a (M, na) of the others."""
        whole = np.insert(a, self.at, self.g, axis=1)
        return self.model.observation(np.ascontiguousarray(whole), u, t, theta)


@dataclass(frozen=True, eq=False)
class MixingProposal:
    """For the model ``others`` of all states but g and a ``record``; g ~ N(mean, 1) with ``edges`` (K + 1,)

    of strata of Phi(g - mean); ``roots`` g -> factors of standard deviations, of R (``informed``) or Q.
    """

    others: WithoutScale
    record: Any
    mean: float
    edges: Array
    roots: Callable[[Array], Array]
    informed: bool

    def __call__(self, step: Step) -> tuple[Array, Array]:
        """The draws (M, na + 1) and their log density (M,)."""
        M, na = len(step.ancestors), self.others.na
        rows = np.delete(np.arange(step.mu.shape[1]), self.others.at)
        inner = replace(
            step,
            model=self.others,
            theta=self.record,
            mu=np.ascontiguousarray(step.mu[:, rows]),
            L=np.ascontiguousarray(step.L[:, rows[:, None], rows]),
        )
        if self.informed:
            g, log_q = self._draw_informed(inner)
            inner.roots = self.roots(g) if step.roots is None else self.roots(g) * step.roots
        else:  # what s does shows in the next y only: cover its whole prior
            u = (step.rng.permutation(M) + step.rng.random(M)) / M
            g = self.mean + ndtri(u)
            log_q = _log_normal(g - self.mean)
        if na == 0:
            return g[:, None], log_q
        a, log_q_a = adapted(inner)
        if log_q_a is None:
            log_q_a = condition(inner.mu, inner.L, inner.ancestors, np.ascontiguousarray(a))[2]
        return np.insert(a, self.others.at, g, axis=1), log_q + log_q_a

    def _draw_informed(self, inner: Step) -> tuple[Array, Array]:
        """g (M,) and log q(g) (M,)."""
        M, rng = len(inner.ancestors), inner.rng
        share = np.diff(self.edges)
        middle = self.mean + ndtri(0.5 * (self.edges[1:] + self.edges[:-1]))
        points = spread_points(inner.mu, inner.L, inner.ancestors, self.others.na)
        h, C, R = self.others.observation(points, inner.u, inner.t, self.record)
        if inner.roots is not None:  # of another scale
            each = np.tile(inner.roots, (len(points) // M, 1))
            R = R * each[:, :, None] * each[:, None, :]
        roots = self.roots(middle)
        log_p = log_innovations(
            inner.mu, inner.L, inner.ancestors, h, stacked(C), stacked(R), roots, inner.y
        )
        p = share * np.exp(log_p - log_p.max(axis=1, keepdims=True))
        p = (1.0 - SHARE_OF_PRIOR) * p / p.sum(axis=1, keepdims=True) + SHARE_OF_PRIOR * share
        cumulated = np.cumsum(p, axis=1)
        goal = rng.random(M) * cumulated[:, -1]
        k = np.minimum((cumulated <= goal[:, None]).sum(axis=1), len(share) - 1)
        below = self.edges[k]
        g = self.mean + ndtri(below + (self.edges[k + 1] - below) * rng.random(M))
        log_q = _log_normal(g - self.mean) + np.log(p[np.arange(M), k] / share[k])
        return g, log_q


def _log_normal(r: Array) -> Array:
    return np.asarray(-0.5 * r * r - 0.5 * np.log(2.0 * np.pi))
