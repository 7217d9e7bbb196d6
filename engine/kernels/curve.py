"""The order of points along a space-filling curve, which keeps neighbours together; Skilling (2004)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

MOST_BITS = 62  # of a place on the curve
BITS = 12  # at most of a coordinate
SAME = 1e-12  # of the largest value: a spread that is rounding


@njit(cache=True, error_model="numpy")
def along_curve(x):
    """Indices (M,) of the points x (M, n) along a Hilbert curve; of one coordinate they are sorted.

    Each coordinate is taken from its mean in standard deviations, through the logistic function (Gerber,
    Chopin 2015, section 3.2), so that units do not matter; one without spread is left out.
    """
    M, n = x.shape
    used = np.empty((M, n))
    d = 0
    for k in range(n):
        mean, top = 0.0, 0.0
        for i in range(M):
            mean += x[i, k] / M
            top = max(top, abs(x[i, k]))
        square = 0.0
        for i in range(M):
            square += (x[i, k] - mean) ** 2 / M
        spread = math.sqrt(square)
        if spread > SAME * top and d < MOST_BITS:
            for i in range(M):
                used[i, d] = (x[i, k] - mean) / spread
            d += 1
    if d == 0:
        return np.arange(M)
    if d == 1:
        return np.argsort(used[:, 0])
    bits = min(BITS, MOST_BITS // d)
    place = np.empty(M, np.int64)
    axes = np.empty(d, np.int64)
    for i in range(M):
        for k in range(d):
            axes[k] = min(int(2**bits / (1.0 + math.exp(-used[i, k]))), 2**bits - 1)
        place[i] = _place(axes, bits)
    return np.argsort(place)


@njit(cache=True, error_model="numpy")
def _place(axes, bits):
    """Where on the curve the cell ``axes`` (d,) of a grid of 2^bits a side lies; changes ``axes``."""
    d = axes.shape[0]
    q = 1 << (bits - 1)
    while q > 1:
        for k in range(d):
            if axes[k] & q:
                axes[0] ^= q - 1
            else:
                swap = (axes[0] ^ axes[k]) & (q - 1)
                axes[0] ^= swap
                axes[k] ^= swap
        q >>= 1
    for k in range(1, d):
        axes[k] ^= axes[k - 1]
    turn = 0
    q = 1 << (bits - 1)
    while q > 1:
        if axes[d - 1] & q:
            turn ^= q - 1
        q >>= 1
    place = 0
    for b in range(bits - 1, -1, -1):
        for k in range(d):
            place = (place << 1) | (((axes[k] ^ turn) >> b) & 1)
    return place
