"""What one disturbance at one time would explain, for all times, and from it for all frequencies.

The disturbance smoother (de Jong 1989; Harvey, Koopman 1992): with L_t = F_t (I - K_t H_t),
r_{t-1} = H_t' S_t^{-1} nu_t + L_t' r_t and N likewise, a disturbance that adds b_t to x_{t+1} and e_t
to y_t scores b_t' r_t + e_t' (S_t^{-1} nu_t - (F_t K_t)' r_t). A course c_t of disturbances scores
sum c_t score_t: one pass backward serves every course there is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.estimation.quasi_ml import whitening
from engine.filters.sigma_point import MomentPath
from engine.statespace.model import Array

BLOCK_NUMBERS = 1_000_000  # numbers held at once where times are irregular


def backward(
    path: MomentPath, series: Series
) -> Iterator[tuple[int, Array, Array, Array, Array, Array]]:
    """From the last row to the first: t, u_t (ny,), D_t (ny, ny), r_t (nx,), N_t (nx, nx), F_t K_t.

    u_t = S_t^{-1} nu_t - (F_t K_t)' r_t scores a unit disturbance of y_t, r_t one of x_{t+1}; their
    informations are D_t = S_t^{-1} + (F_t K_t)' N_t F_t K_t and N_t. At the last row r and N are zero.
    """
    T, _, nx = path.H.shape
    root = whitening(path.S, series.observed)
    nu = np.nan_to_num(path.innovations)
    r, N = np.zeros(nx), np.zeros((nx, nx))
    for t in range(T - 1, -1, -1):
        precision = root[t].T @ root[t]
        F = path.F[t] if t < T - 1 else np.zeros((nx, nx))
        gain = F @ path.K[t]
        u, D = precision @ nu[t] - gain.T @ r, precision + gain.T @ N @ gain
        yield t, u, D, r, N, gain
        L = F - gain @ path.H[t]
        r = path.H[t].T @ precision @ nu[t] + L.T @ r
        N = path.H[t].T @ precision @ path.H[t] + L.T @ N @ L


def pulse_scores(path: MomentPath, series: Series, b: Array, e: Array) -> tuple[Array, Array]:
    """Scores (T,) of a unit disturbance (b_t, e_t) at each time alone, and their information (T,).

    ``b`` (T-1, nx), ``e`` (T, ny).
    """
    T = len(path.H)
    scores, information = np.zeros(T), np.zeros(T)
    for t, u, D, r, N, gain in backward(path, series):
        scores[t] = e[t] @ u
        information[t] = e[t] @ D @ e[t]
        if t < T - 1:
            scores[t] += b[t] @ r
            information[t] += b[t] @ N @ b[t] - 2.0 * e[t] @ gain.T @ N @ b[t]
    return scores, information


def best_frequencies(
    path: MomentPath, series: Series, b: Array, e: Array, frequencies: Array, most: int
) -> Array:
    """Places (n <= ``most``) of the ``frequencies`` (m,) in Hz at which a harmonic promises to explain most.

    ``b`` (T-1, nx), ``e`` (T, ny) as in :func:`pulse_scores`; n places in ascending order.
    The score of exp(i w t) is the Fourier sum of the pulses' scores; its information is taken from
    the mean filter's response, which is near enough to choose peaks by.
    """
    scores, _ = pulse_scores(path, series, b, e)
    sums = _fourier_sums(scores, series, frequencies)
    promise = np.abs(sums) ** 2 / _response(path, series, b, e, frequencies)
    padded = np.concatenate([[-np.inf], promise, [-np.inf]])
    peaks = np.flatnonzero((promise >= padded[:-2]) & (promise >= padded[2:]))
    return np.asarray(np.sort(peaks[np.argsort(-promise[peaks])[:most]]))


def _fourier_sums(scores: Array, series: Series, frequencies: Array) -> NDArray[np.complex128]:
    """Sums (m,) of scores_t exp(-2 pi i f (t - t_1)) at equally spaced frequencies (m,)."""
    if series.dt is not None:
        from scipy.signal import czt  # here, as it takes longer to load than most of the engine

        first, step = frequencies[0], frequencies[1] - frequencies[0]
        turn = 2j * np.pi * series.dt
        return np.asarray(czt(scores, len(frequencies), np.exp(-turn * step), np.exp(turn * first)))
    t = series.t - series.t[0]
    rows = max(1, BLOCK_NUMBERS // len(t))
    return np.concatenate(
        [
            np.exp(-2j * np.pi * np.outer(frequencies[i : i + rows], t)) @ scores
            for i in range(0, len(frequencies), rows)
        ]
    )


def _response(path: MomentPath, series: Series, b: Array, e: Array, frequencies: Array) -> Array:
    """|S^{-1/2} g|^2 of the mean filter for g_t = g exp(i w t) driven by (b, e), per frequency."""
    F, H, K, S = (x.mean(axis=0) for x in (path.F, path.H, path.K, path.S))
    b, e = b.mean(axis=0), e.mean(axis=0)
    step = float(np.median(series.steps))
    turn = np.exp(2j * np.pi * frequencies * step)[:, None, None] * np.eye(len(F))
    x = np.linalg.solve(turn - F @ (np.eye(len(F)) - K @ H), (b - F @ K @ e)[:, None])
    g = (H @ x)[:, :, 0] + e
    power = np.einsum("ki,ij,kj->k", g.conj(), np.linalg.pinv(S, hermitian=True), g).real
    return np.asarray(np.maximum(power, 1e-12 * power.max() + np.finfo(float).tiny))
