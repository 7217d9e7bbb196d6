"""Index draws for many trajectories at once."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.backward import pick


@njit(cache=True, error_model="numpy")
def pick_each(log_w, uniforms):
    """Index (N,) drawn from each row of exp(log_w) (N, M), -1 where all are zero.

    log_w is overwritten; uniforms (N,).
    """
    N, M = log_w.shape
    index = np.empty(N, np.int64)
    scratch = np.empty(M)
    for j in range(N):
        i = pick(log_w[j], scratch, uniforms[j])
        index[j] = i
    return index
