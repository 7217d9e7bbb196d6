"""How far apart two causes are in an experiment.

Let cause i be true, and Delta the difference of the readings that i and its rival j predict. The rival may
still adapt its parameters, along the sensitivities Gamma_j of its readings, as far as their covariance P_j
lets it. With S the covariance of the readings about a prediction (process noise, measurement noise, first
state) twice the log-likelihood ratio of i against the adapted j is about N(D, 4 D),

    D_ij(u) = Delta' (S + Gamma_j P_j Gamma_j')^{-1} Delta
            = min over d of |L^{-1} (Delta - Gamma_j d)|^2 + d' P_j^{-1} d,      S = L L'

(Hunter, Reiner 1965; Buzzi-Ferraris, Forzatti 1983; Atkinson, Fedorov 1975). L^{-1} is a Kalman filter along
the rival's run, so process noise counts, and D is a sum over time. A diagnosis of the new record alone
estimates all parameters again: then P_j is without end, but for LOOSE.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.design.candidates import Candidate
from engine.design.runs import Experiments, Runs, linearised, of_many
from engine.estimation.expectation import parameter_scale
from engine.kernels.whitening import whitened
from engine.statespace.model import Array

LOOSE = 100.0  # sizes of a parameter by which it may be anywhere before a record tells of it
STEPS = 8  # Gauss-Newton steps of a rival that adapts
TRIES = (1.0, 0.5, 0.2, 0.05)  # lengths of them
SETTLED = 0.01  # a gain in D below this share, or this much, ends them


def precision(candidate: Candidate, anew: bool) -> Array:
    """P_j^{-1} (p, p) of the free parameters: what holds them beside the new record."""
    sizes = [parameter_scale(candidate.model, candidate.theta, k) for k in candidate.indices]
    loose = np.diag(1.0 / (LOOSE * np.array(sizes)) ** 2)
    return loose if anew else loose + candidate.information


def whiten(runs: Runs, changes: Array, seen: NDArray[np.bool_]) -> Array:
    """L^{-1} of changes (B, n, ny, k) of the readings that a run's model predicts; ``seen`` (n, ny)."""
    d = np.ascontiguousarray(changes)
    return np.asarray(whitened(runs.J, runs.H, runs.Q, runs.R, runs.P1, d, seen))


def linear_distances(
    truth: Array, runs: Runs, held: Array, away: Array, seen: NDArray[np.bool_]
) -> Array:
    """D (B,) of readings ``truth`` (B, n, ny) against a rival's runs, linear about them.

    ``held`` (p, p) is P_j^{-1}, ``away`` (p,) how far the runs' parameters are from their estimates. NaN where
    a run went so far that its distances overflow.
    """
    W = whiten(runs, np.concatenate([(truth - runs.y)[..., None], runs.dy], axis=-1), seen)
    W = W.reshape(len(truth), -1, W.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        M = W.transpose(0, 2, 1) @ W
    out = np.empty(len(truth))
    for k, one in enumerate(M):
        if not np.isfinite(one).all():
            out[k] = np.nan
            continue
        b = one[1:, :1] - (held @ away)[:, None]
        step = adaptation(one[1:, 1:], b, held)
        out[k] = one[0, 0] + away @ held @ away - float((b * step).sum())
    return np.maximum(out, 0.0)


def adaptation(G: Array, b: Array, P_inverse: Array) -> Array:
    """d (p, k) that solves (G + P^{-1}) d = b, in whatever units the parameters are."""
    if not len(G):
        return np.zeros_like(b)
    A = G + P_inverse
    s = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(A * s[:, None] * s)
    inverse = np.where(values > 1e-13 * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    out: Array = s[:, None] * (vectors @ (inverse[:, None] * (vectors.T @ (s[:, None] * b))))
    return out


def adapted(
    truth: Array,
    rival: Candidate,
    held: Array,
    experiment: Experiments,
    seen: NDArray[np.bool_],
    start: Array | None = None,
) -> tuple[Array, Runs, float]:
    """The rival's theta nearest to readings ``truth`` (1, n, ny), its runs there, and D.

    Gauss-Newton on D, which the model makes non-linear, from ``start``; ``held`` (p, p) is P_j^{-1} at the
    estimates.
    """
    indices = rival.indices
    model, theta = rival.model, (rival.theta if start is None else start).copy()
    first = rival.theta[indices]
    least = np.inf
    runs = linearised(model, theta, experiment, indices)
    for _ in range(STEPS):
        W = whiten(runs, np.concatenate([(truth - runs.y)[..., None], runs.dy], axis=-1), seen)
        W = W.reshape(-1, W.shape[-1])
        away = theta[indices] - first
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(W[:, 0] @ W[:, 0] + away @ held @ away)
            G, b = W[:, 1:].T @ W[:, 1:], W[:, 1:].T @ W[:, 0] - held @ away
        if not (np.isfinite(cost) and np.isfinite(G).all() and np.isfinite(b).all()):
            break
        step = adaptation(G, b[:, None], held)[:, 0]
        least = cost
        if float(b @ step) < SETTLED:  # nothing to gain
            break
        moved = np.tile(theta, (len(TRIES), 1))
        moved[:, indices] += np.array(TRIES)[:, None] * step
        moved = np.clip(moved, model.lower, model.upper)
        y, x = of_many(model, moved, experiment)
        there = np.full(len(TRIES), np.inf)
        fine = np.isfinite(y).all(axis=(1, 2))
        away = moved[fine][:, indices] - first
        W = whiten(runs, (truth - y[fine]).transpose(1, 2, 0)[None], seen)
        with np.errstate(over="ignore"):
            there[fine] = (W**2).sum(axis=(0, 1, 2)) + np.einsum("ki,ij,kj->k", away, held, away)
        k = int(np.argmin(there))
        if not there[k] < cost:
            break
        theta, least = moved[k], float(there[k])
        runs = linearised(model, theta, experiment, indices, x[k][None])
        if cost - least < max(SETTLED * cost, SETTLED):
            break
    return theta, runs, least


def square_root(S: Array) -> Array:
    """A factor W with W W' = S for symmetric S (..., n, n), negative eigenvalues from rounding set to zero."""
    values, vectors = np.linalg.eigh(S)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])
