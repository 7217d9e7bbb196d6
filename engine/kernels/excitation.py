"""An input brought within its bounds, sample by sample."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def within_bounds(wanted, low, high, step, bands, start):
    """The input (T,) nearest to ``wanted`` (T,) at each sample, given what it was before.

    It stays within [low, high], out of the open ``bands`` (n, 2), which are in order and apart, and moves by
    ``step`` a sample at most; ``start`` is its value before the first sample, NaN for any. It waits at the
    edge of a band that it cannot jump over.
    """
    out = np.empty_like(wanted)
    before = start
    for t in range(wanted.shape[0]):
        value = min(max(wanted[t], low), high)
        for b in range(bands.shape[0]):
            if bands[b, 0] < value < bands[b, 1]:
                nearer = 0 if value - bands[b, 0] <= bands[b, 1] - value else 1
                value = bands[b, nearer]
        if not np.isnan(before):
            value = min(max(value, before - step), before + step)
            for b in range(bands.shape[0]):
                if bands[b, 0] < value < bands[b, 1]:
                    far, near = bands[b, 1], bands[b, 0]
                    if before >= bands[b, 1]:
                        far, near = bands[b, 0], bands[b, 1]
                    value = far if abs(far - before) <= step else near
        out[t] = value
        before = value
    return out
