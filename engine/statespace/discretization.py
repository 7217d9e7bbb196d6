"""Continuous-time linear parts to discrete time: matrix exponential and van Loan's integrals.

For dx = (F x + G u) dt + dw with E dw dw' = Qc dt, u held over the step (zero-order hold),

    x_{t+dt} = A x_t + B u_t + w_t,   w_t ~ N(0, Q)
    A = exp(F dt),   B = int_0^dt exp(F s) ds G,   Q = int_0^dt exp(F s) Qc exp(F s)' ds

Source: C. F. van Loan, "Computing integrals involving the matrix exponential", IEEE Transactions
on Automatic Control 23 (1978) 395-404. The step is halved until h |F| <= 1/2, the three series

    A = sum (F h)^k / k!,   B = h sum (F h)^k / (k+1)! G,   Q = h sum h^k L^k(Qc) / (k+1)!

with L(S) = F S + S F' are summed to rounding, and the step is doubled back by A(2h) = A A,
B(2h) = B + A B, Q(2h) = Q + A Q A'. Nothing of exp(-F dt) appears, which would overflow where a
stable F is fast beside dt, and Q stays symmetric and non-negative.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from engine.arrays import Array
from engine.errors import OptionError
from engine.kernels.van_loan import van_loan
from engine.statespace.shapes import is_symmetric


def discretize(
    F: ArrayLike,
    G: ArrayLike | None = None,
    Qc: ArrayLike | None = None,
    *,
    dt: float | Array,
) -> tuple[Array, Array, Array]:
    """Discretise dx = (F x + G u) dt + dw over a step with held inputs, by matrix exponentials (van Loan 1978).

    Parameters
    ----------
    F : array (..., n, n)
        System matrix, per unit of time.
    G : array (..., n, m), optional
        Input matrix, per unit of time; no inputs by default.
    Qc : array (..., n, n), optional
        Intensity of the noise, E dw dw' = Qc dt: covariance per unit of time; no noise by default.
    dt : float or array (...)
        Time step, positive, in the unit of time of the matrices; leading axes are broadcast.

    Returns
    -------
    tuple of arrays
        A (..., n, n), B (..., n, m), n x 0 without ``G``, and Q (..., n, n), zero without ``Qc``.

    Raises
    ------
    OptionError
        An argument has the wrong shape or is not finite; names it.
    """
    F = _matrix(F, "F")
    n = F.shape[-1]
    if F.shape[-2] != n:
        raise OptionError(f"F has shape {F.shape}; a square matrix is needed", "F")
    G = np.zeros((n, 0)) if G is None else _matrix(G, "G")
    Qc = np.zeros((n, n)) if Qc is None else _matrix(Qc, "Qc")
    if G.shape[-2] != n:
        raise OptionError(f"G has shape {G.shape}; {n} rows are needed, as F has", "G")
    if Qc.shape[-2:] != (n, n):
        raise OptionError(f"Qc has shape {Qc.shape}; ({n}, {n}) is needed, as F has", "Qc")
    if not is_symmetric(Qc):
        raise OptionError(f"Qc is not symmetric: {Qc}", "Qc")
    step = np.asarray(dt, dtype=float)
    if not (np.isfinite(step).all() and (step > 0.0).all()):
        raise OptionError(f"dt = {dt} s; positive time steps are needed", "dt")
    batch = np.broadcast_shapes(F.shape[:-2], G.shape[:-2], Qc.shape[:-2], step.shape)

    steps = np.array(np.broadcast_to(step, batch)).ravel()

    def rows(matrix: Array) -> Array:
        shape = matrix.shape[-2:]
        return np.array(np.broadcast_to(matrix, (*batch, *shape))).reshape(len(steps), *shape)

    symmetric = 0.5 * (Qc + np.swapaxes(Qc, -1, -2))  # to the last bit
    found = van_loan(rows(F), rows(G), rows(symmetric), steps)
    A, B, Q = (matrix.reshape(*batch, *matrix.shape[-2:]) for matrix in found)
    return A, B, Q


def checked_step(F: Array, G: Array, Qc: Array, dt: Array) -> tuple[Array, Array, Array]:
    """:func:`discretize`, by a name of which a tape knows what it does."""
    return discretize(F, G, Qc, dt=dt)


def _matrix(value: Any, name: str) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim < 2:
        raise OptionError(f"{name} has shape {array.shape}; a matrix is needed", name)
    if not np.isfinite(array).all():
        raise OptionError(f"{name} is not finite: {array}", name)
    return array
