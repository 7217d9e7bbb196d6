"""A bootstrap particle filter with a divergence check, and FFBSi on it: Tables 1-4 as reported.

A common safeguard of the time: where the sum of the weights exp(-e' R^{-1} e / 2) is tiny, no particle
is near the measurement, and it is ignored (all weights equal) instead of letting the weights
collapse onto the least bad particle. The report does not mention one, but with it the particle filter's
figures for a and z_1 of eq. (72), which a few runs dominate, come out as reported.
Plain NumPy, only for these studies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.simulation.simulate import noise
from engine.statespace.model import Array, MixedModel
from engine.statespace.promotion import as_nonlinear

GUARD = 1e-12


def guarded_filter_and_smoother(
    model: MixedModel, series: Series, M: int, rng: np.random.Generator, guard: float = GUARD
) -> tuple[Array, Array]:
    """Filtered and smoothed means of x = (a, z), each (T, nx), with M particles and trajectories.

    The model's Q and R must be common to all particles and times, and Q positive definite.
    """
    full = as_nonlinear(model)
    record = full.record(full.theta(None))
    T, steps = len(series), series.steps
    x = np.asarray(full.start(record).density.sample(rng, M), dtype=float)
    points, weights, predictions, mean = [], [], [], []
    Q = np.empty(0)
    for t in range(T):
        h, _, R = full.observation(x, series.u[t], float(series.t[t]), record)
        e = series.y[t] - h
        w = np.exp(-0.5 * np.einsum("mi,mi->m", e, np.linalg.solve(R, e.T).T))
        w = w / w.sum() if w.sum() > guard else np.full(M, 1.0 / M)
        points.append(x)
        weights.append(w)
        mean.append(w @ x)
        if t < T - 1:
            u = series.u[t]
            f, _, Q = full.transition(x, u, float(series.t[t]), float(steps[t]), record)
            predictions.append(f)
            f = f[_draw(w, M, rng)]
            x = f + noise(Q, f.shape, rng)
    root = np.linalg.inv(np.linalg.cholesky(Q))
    now = points[-1][_draw(weights[-1], M, rng)]
    smoothed = [now.mean(axis=0)]
    for t in range(T - 2, -1, -1):
        e = (now[:, None] - predictions[t][None]) @ root.T
        log_w = np.log(weights[t] + 1e-300) - 0.5 * (e**2).sum(axis=2)
        w = np.exp(log_w - log_w.max(axis=1, keepdims=True))
        edges = np.cumsum(w, axis=1)
        level = rng.random(M) * edges[:, -1]
        now = points[t][np.minimum((edges < level[:, None]).sum(axis=1), M - 1)]
        smoothed.append(now.mean(axis=0))
    return np.array(mean), np.array(smoothed[::-1])


def _draw(w: Array, M: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Multinomial resampling."""
    return rng.choice(len(w), size=M, p=w)
