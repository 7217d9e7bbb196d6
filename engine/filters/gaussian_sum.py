"""A moment filter whose noise has outliers in one channel: two Gaussians per step, kept as one.

With probability ``share`` the noise of a reading, or of a state's equation, is ``ratio`` times as large.
Each step weighs both cases by what they predicted and keeps the mean and covariance of the mixture
(Harrison and Stevens 1976). Its likelihood is smooth and comparable with :mod:`engine.filters.sigma_point`'s,
where a few hundred particles would lose track at every jump and favour whatever noise is wider.
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.filters.sigma_point import FilterSteps, Thetas
from engine.kernels.moments import gaussian_update
from engine.statespace.model import Array, MixedModel
from engine.statespace.refutation import repeated_if_refuted


@repeated_if_refuted
@np.errstate(all="ignore")
def outlier_log_terms(
    model: MixedModel, thetas: Array, series: Series, channel: str, shares: Array, ratios: Array
) -> Array:
    """log p(y_t | y_{1:t-1}) (T, K) for K pairs of share and ratio of the outliers in ``channel``.

    ``thetas`` (n_theta,) is the same for all pairs, or (K, n_theta) each pair's own.
    """
    K, T = len(shares), len(series)
    each = np.broadcast_to(thetas, (K, np.shape(thetas)[-1]))
    run = FilterSteps(model, Thetas(model, np.concatenate([each, each])), series)
    record = model.records(each)
    at_output = channel in model.outputs
    names = list(model.outputs) if at_output else [*model.nonlinear, *model.linear]
    factor = np.ones((K, len(names)))
    factor[:, names.index(channel)] = ratios
    wider = factor[:, :, None] * factor[:, None, :] - 1.0
    prior = np.log(np.concatenate([1.0 - shares, shares]))
    terms = np.empty((T, K))
    m, P = run.start()  # rows K and more: the case of an outlier
    for t in range(T):
        u, time = series.u[t], float(series.t[t])
        y_mean, S, cross = run.through(run.observation, t, m, P)
        if at_output:
            R = model.observation(m[K:, : model.na], u, time, record)[2]
            S[K:] += wider * R
        m, P, log_p = gaussian_update(m, P, y_mean, S, cross, series.y[t])
        m, P, terms[t] = _merged(m, P, log_p + prior)
        if t < T - 1:
            a = m[K:, : model.na]
            m, P, _ = run.through(run.transition, t, m, P)
            if not at_output and t + 1 not in series.begins:
                Q = model.transition(a, series.u_step[t], time, float(series.steps[t]), record)[2]
                P[K:] += wider * Q
    return terms


def _merged(m: Array, P: Array, log_w: Array) -> tuple[Array, Array, Array]:
    """Both cases as one Gaussian each, twice; and the logarithm of their weights' sum (K,)."""
    K = len(m) // 2
    total = np.logaddexp(log_w[:K], log_w[K:])
    w = np.exp(log_w[K:] - total)[:, None]
    d = m[K:] - m[:K]
    mean = m[:K] + w * d
    W = w[:, :, None]
    cov = (1.0 - W) * P[:K] + W * P[K:] + W * (1.0 - W) * d[:, :, None] * d[:, None, :]
    return np.concatenate([mean, mean]), np.concatenate([cov, cov]), total
