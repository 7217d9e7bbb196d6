"""The best pair of columns for each of many series, one pair after the other: there may be 100,000 pairs."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def best_pairs(z, C, i, j, one_sided):
    """Which of the pairs (i, j) (M,) of columns takes most of each of N series, their numbers (N,).

    ``z`` (K, N) are products of the columns, of length 1, with the series, ``C`` (K, K) those of the columns
    with each other. A pair in which a ``one_sided`` (K,) column would have a negative size takes nothing.
    """
    N = z.shape[1]
    most, at = np.zeros(N), np.zeros(N, dtype=np.int64)
    for p in range(len(i)):
        a, b = i[p], j[p]
        c = C[a, b]
        per = 1.0 / (1.0 - c * c)
        for s in range(N):
            za, zb = z[a, s], z[b, s]
            share = (za * za + zb * zb - 2.0 * c * za * zb) * per
            if share > most[s]:
                positive_a = not one_sided[a] or za - c * zb > 0.0
                if positive_a and (not one_sided[b] or zb - c * za > 0.0):
                    most[s], at[s] = share, p
    return at
