"""What one disturbance at one time would explain, for all times, and from it for all frequencies.

The disturbance smoother (de Jong 1989; Harvey, Koopman 1992): with L_t = F_t (I - K_t H_t),
r_{t-1} = H_t' S_t^{-1} nu_t + L_t' r_t and N likewise, a disturbance that adds b_t to x_{t+1} and e_t
to y_t scores b_t' r_t + e_t' (S_t^{-1} nu_t - (F_t K_t)' r_t). A course c_t of disturbances scores
sum c_t score_t: one pass backward serves every course there is.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.screening.score_columns import whitened
from engine.filters.sigma_point import MomentPath
from engine.statespace.model import Array

BLOCK_NUMBERS = 1_000_000  # numbers held at once where times are irregular
_KEPT: WeakKeyDictionary[MomentPath, tuple[ref[Series], Backward]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Backward:
    """One pass from the last row to the first, of which every disturbance takes what it needs.

    ``u`` (T, ny), u_t = S_t^{-1} nu_t - (F_t K_t)' r_t, scores a unit disturbance of y_t, ``r`` (T, nx) one of
    x_{t+1}; their informations are ``D`` (T, ny, ny), D_t = S_t^{-1} + (F_t K_t)' N_t F_t K_t, and ``N``
    (T, nx, nx); ``gain`` (T, nx, ny) is F_t K_t. At the last row r, N and the gain are zero.
    """

    u: Array
    D: Array
    r: Array
    N: Array
    gain: Array


def backward(path: MomentPath, series: Series) -> Backward:
    """The disturbance smoother along a filter's way; kept with the way, as all disturbances share it."""
    known = _KEPT.get(path)
    if known is not None and known[0]() is series:
        return known[1]
    T, _, nx = path.H.shape
    _, precision, nu, _ = whitened(path, series)
    scaled = (precision @ nu[:, :, None])[:, :, 0]
    F = np.concatenate([path.F, np.zeros((1, nx, nx))])
    gain = F @ path.K
    L = F - gain @ path.H
    Hs = np.swapaxes(path.H, -1, -2)
    own, own_information = (Hs @ scaled[:, :, None])[:, :, 0], Hs @ precision @ path.H
    r, N = np.zeros((T, nx)), np.zeros((T, nx, nx))
    for t in range(T - 1, 0, -1):
        r[t - 1] = own[t] + L[t].T @ r[t]
        N[t - 1] = own_information[t] + L[t].T @ N[t] @ L[t]
    back = np.swapaxes(gain, -1, -2)
    u = scaled - (back @ r[:, :, None])[:, :, 0]
    out = Backward(u, precision + back @ N @ gain, r, N, gain)
    _KEPT[path] = ref(series), out
    return out


def pulse_scores(path: MomentPath, series: Series, b: Array, e: Array) -> tuple[Array, Array]:
    """Scores (T,) of a unit disturbance (b_t, e_t) at each time alone, and their information (T,).

    ``b`` (T-1, nx), ``e`` (T, ny).
    """
    way = backward(path, series)
    b = np.concatenate([b, np.zeros((1, b.shape[1]))])
    scores = (e * way.u).sum(axis=1) + (b * way.r).sum(axis=1)
    Nb = (way.N @ b[:, :, None])[:, :, 0]
    beside = (np.swapaxes(way.gain, -1, -2) @ Nb[:, :, None])[:, :, 0]
    of_y = (way.D @ e[:, :, None])[:, :, 0]
    information = (e * of_y).sum(axis=1) + (b * Nb).sum(axis=1) - 2.0 * (e * beside).sum(axis=1)
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
    if series.dt is not None and not series.begins:
        turn = -2j * np.pi * series.dt
        first, step = frequencies[0], frequencies[1] - frequencies[0]
        return _chirp(scores, len(frequencies), turn * first, turn * step)
    t = series.t - series.t[0]
    rows = max(1, BLOCK_NUMBERS // len(t))
    return np.concatenate(
        [
            np.exp(-2j * np.pi * np.outer(frequencies[i : i + rows], t)) @ scores
            for i in range(0, len(frequencies), rows)
        ]
    )


def _chirp(x: Array, m: int, first: complex, step: complex) -> NDArray[np.complex128]:
    """Sums (m,) over n of x_n exp(n (first + k step)) by three Fourier transforms (Bluestein 1970).

    With n k = (n^2 + k^2 - (k - n)^2) / 2 they are a convolution. SciPy has it, in what takes long to load.
    """
    n, k = np.arange(len(x)), np.arange(m)
    reach = np.arange(-len(x) + 1, m)
    size = 1 << (len(reach) + len(x)).bit_length()
    spread = np.fft.fft(x * np.exp(n * first + 0.5 * n**2 * step), size)
    sums = np.fft.ifft(spread * np.fft.fft(np.exp(-0.5 * reach**2 * step), size))
    return np.asarray(np.exp(0.5 * k**2 * step) * sums[len(x) - 1 : len(x) - 1 + m])


def _response(path: MomentPath, series: Series, b: Array, e: Array, frequencies: Array) -> Array:
    """|S^{-1/2} g|^2 of the mean filter for g_t = g exp(i w t) driven by (b, e), per frequency."""
    F, H, K, S = (x.mean(axis=0) for x in (path.F, path.H, path.K, path.S))
    b, e = b.mean(axis=0), e.mean(axis=0)
    step = series.usual_step
    turn = np.exp(2j * np.pi * frequencies * step)[:, None, None] * np.eye(len(F))
    x = np.linalg.solve(turn - F @ (np.eye(len(F)) - K @ H), (b - F @ K @ e)[:, None])
    g = (H @ x)[:, :, 0] + e
    size = np.sqrt(np.diag(S))
    per = 1.0 / np.where(size > 0.0, size, 1.0)  # outputs may be in units far apart
    g *= per
    inverse = np.linalg.pinv(S * per[:, None] * per, hermitian=True)
    power = np.einsum("ki,ij,kj->k", g.conj(), inverse, g).real
    return np.asarray(np.maximum(power, 1e-12 * power.max() + np.finfo(float).tiny))
