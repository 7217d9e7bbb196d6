"""The filter of :mod:`engine.filters.strata` for many rows, where only the random scales are not linear."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.moments import gaussian_update, transform


@njit(cache=True, error_model="numpy")
def filter_strata(y, seen, moved, log_shares, m, P, y_mean, S, log_w, terms):
    """Rows y (B, ny) of K filters with J strata each, from m (K J, n) and P (K J, n, n), in place.

    ``seen`` are h (B, K J, ny), C and R, ``moved`` f, A and Q of the first rows, or of all; matrices
    (B or 1, K J, ., .). Filled are ``y_mean`` (B, K J, ny), ``S`` (B, K J, ny, ny), the logarithms of the
    strata's weights ``log_w`` (B, K, J) and the likelihood's ``terms`` (B, K), 0 at rows without a reading.
    """
    h, C, R = seen
    f, A, Q = moved
    copies, n = m.shape
    offsets = np.zeros((copies, 0, n))
    for t in range(y.shape[0]):
        if not np.isnan(y[t]).all():
            z = m.copy().reshape(copies, 1, n)
            C_t, R_t = C[t if C.shape[0] > 1 else 0], R[t if R.shape[0] > 1 else 0]
            y_mean[t], S[t], cross = transform(h[t], C_t, R_t, z, P, offsets, 0)
            m[:], P[:], log_p = gaussian_update(m, P, y_mean[t], S[t], cross, y[t])
            log_w[t] = log_p.reshape(log_shares.shape) + log_shares
            merge(m, P, log_w[t], terms[t])
        else:
            log_w[t] = log_shares
            merge(m, P, log_w[t], terms[t])
            terms[t] = 0.0
        if t < f.shape[0]:
            z = m.copy().reshape(copies, 1, n)
            A_t, Q_t = A[t if A.shape[0] > 1 else 0], Q[t if Q.shape[0] > 1 else 0]
            m[:], P[:], _ = transform(f[t], A_t, Q_t, z, P, offsets, 0)


@njit(cache=True, error_model="numpy")
def merge(m, P, log_w, total):
    """Mean and covariance of each mixture in place of its Gaussians'; the logarithm of its weights' sum."""
    K, J = log_w.shape
    n = m.shape[1]
    mean, cov = np.empty(n), np.empty((n, n))
    for k in range(K):
        most = log_w[k].max()
        total[k] = most + np.log(np.exp(log_w[k] - most).sum())
        mean[:], cov[:] = 0.0, 0.0
        for j in range(J):
            mean += np.exp(log_w[k, j] - total[k]) * m[k * J + j]
        for j in range(J):
            w, one = np.exp(log_w[k, j] - total[k]), k * J + j
            for r in range(n):
                for c in range(n):
                    cov[r, c] += w * (P[one, r, c] + (m[one, r] - mean[r]) * (m[one, c] - mean[c]))
        for j in range(J):
            m[k * J + j], P[k * J + j] = mean, cov
