"""The RBPF of a model whose functions are on tape, all time steps in one call; report, Algorithm 2."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.adapted import draw_adapted, spread_points
from engine.kernels.curve import along_curve
from engine.kernels.filtering import advance, draw_prior, predict
from engine.kernels.gaussian import any_impossible
from engine.kernels.resampling import multinomial, residual, stratified, systematic
from engine.kernels.tape import evaluate

SCHEMES = ("multinomial", "stratified", "systematic", "residual", "sorted")  # by their numbers
_MULTINOMIAL, _STRATIFIED, _SYSTEMATIC, _RESIDUAL, _SORTED = range(len(SCHEMES))


@njit(cache=True, error_model="numpy")
def filter_particles_taped(
    reading, spread, moving, record, start, y, state, options, rng, updated, predicted
):
    """All rows of the filter but the first reading; False where calls of the functions are needed.

    ``reading``, ``moving`` and ``record`` as :func:`engine.kernels.taped.filter_taped` has them; ``spread`` is
    ``reading`` for the points that the adapted draw looks at. ``start``: means (M, nx) and covariance of x_1
    (1, nx, nx). ``state``: a, z, Z, w, log w and the effective sample size after y_1. ``options``: the share of
    particles at which they are resampled, the number of the scheme, whether draws are adapted, their share from
    the prediction, their inflation. ``updated`` and ``predicted`` are filled: the fields of the filter's rows,
    each flat, (T, .) and (T - 1, .). Random numbers are drawn from ``rng`` in the order of calls.
    """
    tape_x, links_x, W_x, places_x, flat_x, (f, A, Q) = moving
    u, u_step, t, dt, begins = record
    a, z, Z, w, log_w, ess = state
    threshold, scheme, is_adapted, defensive, inflation = options
    M, nx, nz = a.shape[0], f.shape[1], z.shape[1]
    own, even, nothing = np.arange(M), np.full(M, -np.log(M)), np.zeros(M)
    noiseless = np.zeros((1, nx, nz))
    first, Q_1 = start
    for k in range(1, len(y)):
        # 5. Resampling, and the prediction of each particle from which this step starts
        if begins[k]:
            mu, L, V, Z_plus = predict(first, noiseless, Q_1, z, Z)
        else:
            given = u_step[k - 1], t[k - 1], dt[k - 1]
            if not evaluate(
                tape_x, links_x, W_x, places_x, flat_x, a, given[0], given[1], given[2]
            ):
                return False
            if any_impossible(Q):
                return False
            mu, L, V, Z_plus = predict(f, A, Q, z, Z)
        _keep(predicted[0], k - 1, mu)
        _keep(predicted[1], k - 1, L)
        _keep(predicted[2], k - 1, V)
        _keep(predicted[3], k - 1, Z_plus)
        ancestors = own
        if ess <= threshold * M:
            ancestors, log_w = _resampled(w, rng.random(M), mu, scheme), even

        # 1. Sampling
        blind = not is_adapted or np.isnan(y[k]).all()
        log_q = nothing
        if blind:
            a = draw_prior(mu, L, ancestors, rng.standard_normal(a.shape))
        else:
            points = spread_points(mu, L, ancestors, a.shape[1])
            if not _read(spread, points, u[k], t[k]):
                return False
            h, C, R = spread[5]
            noise, uniform = rng.standard_normal(a.shape), rng.random(M)
            a, log_q = draw_adapted(
                mu, L, ancestors, h, C, R, y[k], noise, uniform, defensive, inflation
            )

        # 2. Prediction, 3. Weighting, 4. Update of the linear states
        if not _read(reading, a, u[k], t[k]):
            return False
        h, C, R = reading[5]
        if any_impossible(R):
            return False
        z, Z, log_w, w, log_sum, ess = advance(
            mu, L, ancestors, a, log_q, blind, h, C, R, y[k], log_w
        )
        _keep(updated[0], k, a)
        _keep(updated[1], k, z)
        _keep(updated[2], k, Z)
        _keep(updated[3], k, w)
        _keep(updated[4], k, log_w)
        updated[5][k, 0], updated[6][k, 0] = log_sum, ess
        _keep(updated[7], k, ancestors)
    return True


@njit(cache=True, error_model="numpy")
def _keep(rows, k, found):
    """Row k of (T, .): what was found for all, or one for all.

    An assignment of slices takes seconds to compile.
    """
    of, size = found.ravel(), rows.shape[1]
    for start in range(0, size, max(of.size, 1)):
        for i in range(of.size):
            rows[k, start + i] = of[i]


@njit(cache=True, error_model="numpy")
def _read(reading, a, u, t):
    """The measurement at the states a (M, na)."""
    tape, links, W, places, flat, _ = reading
    return evaluate(tape, links, W, places, flat, a, u, t, 0.0)


@njit(cache=True, error_model="numpy")
def _resampled(w, uniform, mu, scheme):
    """Ancestors (M,) by one of ``SCHEMES``."""
    if scheme == _MULTINOMIAL:
        return multinomial(w, uniform)
    if scheme == _STRATIFIED:
        return stratified(w, uniform)
    if scheme == _SYSTEMATIC:
        return systematic(w, uniform)
    if scheme == _RESIDUAL:
        return residual(w, uniform)
    order = along_curve(mu)
    return order[systematic(w[order], uniform)]
