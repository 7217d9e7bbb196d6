"""Matrix exponentials and the integrals of van Loan; see :mod:`engine.statespace.discretization`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TERMS = 18  # of each series: h |F| <= 1/2, and 1 / 18! is below rounding


@njit(cache=True, error_model="numpy")
def van_loan(F, G, Qc, dt):
    """A (K, n, n), B (K, n, m), Q (K, n, n) of F (K, n, n), G (K, n, m), symmetric Qc (K, n, n), dt (K,)."""
    K, n = F.shape[0], F.shape[1]
    m = G.shape[2]
    A, B, Q = np.zeros((K, n, n)), np.zeros((K, n, m)), np.zeros((K, n, n))
    power, term, Gamma = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    here, drive = np.empty((n, n)), np.empty((n, m))
    for k in range(K):
        noisy = False
        norm = 0.0
        for i in range(n):
            row = 0.0
            for j in range(n):
                row += abs(F[k, i, j])
                noisy = noisy or Qc[k, i, j] != 0.0
            norm = max(norm, row)
        stiffness = norm * dt[k]
        halvings = max(0, 1 + math.ceil(math.log2(stiffness))) if stiffness > 0.0 else 0
        h = dt[k] / 2.0**halvings
        # the three series over the shortest step
        for i in range(n):
            for j in range(n):
                power[i, j] = 1.0 if i == j else 0.0
                A[k, i, j] = power[i, j]
                Gamma[i, j] = h * power[i, j]
                term[i, j] = h * Qc[k, i, j]
                Q[k, i, j] = term[i, j]
        for order in range(1, TERMS):
            multiply(power, F[k], h / order, here)
            for i in range(n):
                for j in range(n):
                    power[i, j] = here[i, j]
                    A[k, i, j] += power[i, j]
                    Gamma[i, j] += power[i, j] * h / (order + 1)
            if noisy:
                multiply(F[k], term, h / (order + 1), here)
                for i in range(n):  # F S + S F' of a symmetric S
                    for j in range(n):
                        term[i, j] = here[i, j] + here[j, i]
                        Q[k, i, j] += term[i, j]
        multiply(Gamma, G[k], 1.0, B[k])
        # doubled back
        for _ in range(halvings):
            multiply(A[k], B[k], 1.0, drive)
            for i in range(n):
                for j in range(m):
                    B[k, i, j] += drive[i, j]
            if noisy:
                multiply(A[k], Q[k], 1.0, here)
                for i in range(n):
                    for j in range(i + 1):
                        s = 0.0
                        for r in range(n):
                            s += here[i, r] * A[k, j, r]
                        term[i, j] = s
                for i in range(n):
                    for j in range(i + 1):
                        Q[k, i, j] += term[i, j]
                        Q[k, j, i] = Q[k, i, j]
            multiply(A[k], A[k], 1.0, here)
            for i in range(n):
                for j in range(n):
                    A[k, i, j] = here[i, j]
    return A, B, Q


@njit(cache=True, error_model="numpy")
def multiply(X, Y, factor, out):
    """out = factor X Y."""
    for i in range(X.shape[0]):
        for j in range(Y.shape[1]):
            s = 0.0
            for r in range(X.shape[1]):
                s += X[i, r] * Y[r, j]
            out[i, j] = factor * s
