"""Filters through a model that is known near its points: matrices as they are, or written out in full."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.moments import gaussian_update, sigma_points, transform
from engine.kernels.near import filter_near

T, K = 12, 3


def part(rng, n, na, nz, times, rows, own_slopes):
    """Points, f, A, Q and slopes by a; ``rows`` 1, "K" or "KS" for A and Q."""
    S = 2 * na + 1
    R = {1: 1, "K": K, "KS": K * S}[rows]
    B = T if times else 1
    root = rng.standard_normal((B, R, n, n))
    wide = (B, S if rows == "KS" else 1, na if own_slopes else 0)
    return (
        rng.standard_normal((T, K * S, na)),
        rng.standard_normal((T, K * S, n)),
        0.4 * rng.standard_normal((B, R, n, nz)),
        root @ np.swapaxes(root, -1, -2) + np.eye(n),
        0.1 * rng.standard_normal((T, S, na, n)),
        0.05 * rng.standard_normal((*wide, n, nz)),
        np.zeros((*wide, n, n)),
    )


def stepwise(y, seen, moved, m, P, na):
    """The same filters by the moments of one step at a time."""
    m, P, S = m.copy(), P.copy(), 2 * na + 1
    found = []
    for t in range(len(y)):
        for points, f, A, Q, df, dA, dQ in (seen, moved):
            a, z, V, offsets = sigma_points(m, P, na)
            rows = a.reshape(K * S, na)
            d = rows - points[t]
            values = f[t].copy()
            full = []
            for matrix, slope in ((A, dA), (Q, dQ)):
                one = matrix[t if len(matrix) > 1 else 0]
                one = np.repeat(one, K * S // len(one), axis=0)
                for j in range(slope.shape[2]):
                    by = np.broadcast_to(
                        slope[t if len(slope) > 1 else 0, :, j], (S, *slope.shape[3:])
                    )
                    one = one + d[:, j, None, None] * np.tile(by, (K, 1, 1))
                full.append(np.ascontiguousarray(one))
            for j in range(na):
                values += d[:, j, None] * np.tile(df[t, :, j], (K, 1))
            mean, cov, cross = transform(values, *full, z, V, offsets, na)
            if points is seen[0]:
                m, P, terms = gaussian_update(m, P, mean, cov, cross, y[t])
                found.append((y[t] - mean, cov, terms))
            else:
                m, P = mean, cov
    return [np.array(x) for x in zip(*found, strict=True)]


@pytest.mark.long
@pytest.mark.parametrize("na", [0, 1, 2])
@pytest.mark.parametrize("rows", [1, "K", "KS"])
@pytest.mark.parametrize(("times", "own_slopes"), [(False, False), (True, False), (True, True)])
def test_matrices_are_taken_as_they_are(na, rows, times, own_slopes):
    rng = np.random.default_rng(4)
    nz, ny = 2, 2
    seen = part(rng, ny, na, nz, times, rows, own_slopes)
    moved = part(rng, na + nz, na, nz, times, rows, own_slopes)
    y = rng.standard_normal((T, ny))
    y[3, 0], y[5] = np.nan, np.nan
    m, P = rng.standard_normal((K, na + nz)), np.tile(np.eye(na + nz), (K, 1, 1))
    expected = stepwise(y, seen, moved, m, P, na)
    before = seen[0].copy()
    out = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    farthest = filter_near(0, T, y, seen, moved, m.copy(), P.copy(), *out)
    for own, other in zip(out, expected, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-11)
    assert len(farthest) == na
    assert (farthest >= np.abs(seen[0] - before).max(axis=(0, 1), initial=0.0)).all()
