"""The kernels of the moment filter: matrices that points share or not, and readings that are missing."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.moments import gaussian_update, sigma_points, transform

K, NA, NZ, NY = 3, 2, 2, 3
NX, S = NA + NZ, 2 * NA + 1
ALIKE = ("filter", "point", "some")  # of which the matrices are: one for each, or for some points


def moments(rng):
    root = rng.standard_normal((K, NX, NX))
    return rng.standard_normal((K, NX)), root @ root.transpose(0, 2, 1)


def matrices(rng, n, alike):
    """A (K S, n, nz) and Q (K S, n, n)."""
    rows = np.arange(K * S)
    own = {"filter": rows // S, "point": rows, "some": rows // 2}[alike]
    root = rng.standard_normal((K * S, n, n))
    return rng.standard_normal((K * S, n, NZ))[own], (root @ root.transpose(0, 2, 1))[own]


def by_sums(f, A, Q, z, V, offsets):
    """Mean, covariance and Cov(., x), term by term."""
    weights = np.array([1.0 - 2.0 * NA / 6.0] + [1.0 / 6.0] * (2 * NA))
    f, A, Q = (x.reshape(K, S, *x.shape[1:]) for x in (f, A, Q))
    values = f + np.einsum("ksij,ksj->ksi", A, z)
    mean = np.einsum("s,ksi->ki", weights, values)
    d = values - mean[:, None]
    cov = np.einsum("s,ksi,ksj->kij", weights, d, d)
    cov += np.einsum("s,ksij->kij", weights, Q + A @ V[:, None] @ A.swapaxes(-1, -2))
    steps = np.concatenate([np.zeros((K, 1, NX)), np.repeat(offsets, 2, axis=1)], axis=1)
    steps *= np.array([0.0] + [1.0, -1.0] * NA)[:, None]
    cross = np.einsum("s,ksi,ksj->kij", weights, values, steps)
    cross[:, :, NA:] += np.einsum("s,ksij->kij", weights, A @ V[:, None])
    return mean, cov, cross


@pytest.mark.parametrize("of_Q", ALIKE)
@pytest.mark.parametrize("of_A", ALIKE)
def test_points_have_the_matrices_that_they_have(of_A, of_Q):
    rng = np.random.default_rng(5)
    m, P = moments(rng)
    _, z, V, offsets = sigma_points(m, P, NA)
    f, A, Q = (
        rng.standard_normal((K * S, NY)),
        matrices(rng, NY, of_A)[0],
        matrices(rng, NY, of_Q)[1],
    )
    for one, other in zip(
        transform(f, A, Q, z, V, offsets, NA), by_sums(f, A, Q, z, V, offsets), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("alike", ALIKE)
def test_noise_that_is_none_loses_its_own_filter(alike):
    rng = np.random.default_rng(6)
    m, P = moments(rng)
    _, z, V, offsets = sigma_points(m, P, NA)
    A, Q = matrices(rng, NY, alike)
    Q[S : 2 * S if alike == "filter" else S + 1] *= -1.0
    mean, _, _ = transform(rng.standard_normal((K * S, NY)), A, Q, z, V, offsets, NA)
    assert np.isnan(mean[1]).all()
    assert np.isfinite(mean[[0, 2]]).all()


def test_a_reading_that_is_missing_is_as_none_at_all():
    rng = np.random.default_rng(7)
    m, P = moments(rng)
    root = rng.standard_normal((K, NY, NY))
    S_y, cross = root @ root.transpose(0, 2, 1), 0.1 * rng.standard_normal((K, NY, NX))
    y, mean = np.array([0.3, np.nan, -1.2]), rng.standard_normal((K, NY))
    there = [0, 2]
    own = np.ascontiguousarray(S_y[:, there][:, :, there]), np.ascontiguousarray(cross[:, there])
    with_gap = gaussian_update(m, P, mean, S_y, cross, y)
    without = gaussian_update(m, P, np.ascontiguousarray(mean[:, there]), *own, y[there])
    for one, other in zip(with_gap, without, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("common", [True, False])
def test_states_that_are_handed_on_are_summed_as_a_whole_sum_is(common):
    """Many states in z, of which most are moved by one place: zeros of A are left out."""
    rng = np.random.default_rng(6)
    nz = 9
    A = np.eye(nz, k=-1)
    A[0, :3] = rng.standard_normal(3)
    root = rng.standard_normal((nz, nz))
    V, Q = (root @ root.T)[None], np.diag(rng.uniform(0.0, 1.0, nz))
    rows = 1 if common else 3
    f, z, offsets = np.zeros((3, nz)), np.zeros((1, 3, nz)), np.zeros((1, 1, 1 + nz))
    _, cov, _ = transform(f, np.tile(A, (rows, 1, 1)), np.tile(Q, (rows, 1, 1)), z, V, offsets, 1)
    whole = Q.copy()
    for i, j in np.ndindex(nz, nz):
        for c in range(nz):
            whole[i, j] += sum((A[i, d] * V[0, d, c] for d in range(nz)), 0.0) * A[j, c]
    np.testing.assert_allclose(cov[0], whole, rtol=1e-14)
