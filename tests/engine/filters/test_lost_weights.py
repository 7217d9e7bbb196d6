"""Where all weights vanish, a backward draw goes back along its own past, never to an arbitrary particle."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.kernels.backward import pick
from engine.kernels.linear_cost import backward_linear
from engine.kernels.resampling import inverse_cdf, normalize
from engine.smoothers.general import filter_general, smooth_general
from engine.statespace.general import NonlinearModel
from tests.studies import scalar_linear


def test_pick_refuses_what_has_no_weight():
    scratch = np.empty(3)
    for weights in ([-np.inf] * 3, [np.nan] * 3, [0.0, np.inf, 0.0]):
        assert pick(np.array(weights), scratch, 0.5) == -1
    for u in (0.0, 0.5, 1.0 - 1e-16):
        assert pick(np.array([-np.inf, -800.0, -np.inf]), scratch, u) == 1


def test_no_scheme_takes_a_particle_of_weight_zero():
    """Also where rounding leaves the sum of the weights below the last point."""
    w = np.array([0.0, 0.3, 0.7 - 1e-12, 0.0])
    points = np.array([0.0, 0.3, 1.0 - 1e-16])
    assert inverse_cdf(w, points).tolist() == [1, 2, 2]
    assert normalize(np.full(4, -np.inf), w) == (-np.inf, 0.0)
    np.testing.assert_array_equal(w, 0.25)


def test_a_general_smoother_goes_back_to_the_ancestor(monkeypatch):
    """A state that is drawn once and then kept: only its own past leads to each particle.

    Its density is that of a state equation without noise as a user may write it: -inf beside the state.
    """
    model = scalar_linear.MODEL
    series = engine.simulate(model, None, 12, np.random.default_rng(0)).series
    filtered = filter_general(
        scalar_linear.GENERAL, None, series, 30, np.random.default_rng(1), ess_threshold=0.9
    )
    monkeypatch.setattr(
        NonlinearModel, "log_transition", lambda self, x, f, g, record: np.full((20, 30), -np.inf)
    )
    draws = smooth_general(filtered, 20, np.random.default_rng(2))
    for j in range(20):
        i = int(np.flatnonzero(filtered.x[-1, :, 0] == draws[-1, j, 0])[0])
        for t in range(len(series) - 1, 0, -1):
            assert draws[t, j, 0] == filtered.x[t, i, 0]
            i = filtered.ancestors[t, i]
        assert draws[0, j, 0] == filtered.x[0, i, 0]


@pytest.mark.parametrize("common", [True, False])
def test_the_linear_cost_sampler_never_takes_an_impossible_candidate(common):
    """Two particles at rest in different places, no noise: each trajectory stays where it ends.

    Both the start of the chain and its candidates can be impossible, when the drawn state is off its
    particle by rounding; -inf >= -inf must then not let a candidate in.
    """
    T, M, N = 6, 2, 40
    a = np.tile(np.array([[[0.0], [1.0]]]), (T, 1, 1))
    a[1:] += 1e-3  # by more than rounding: nobody's prediction leads there
    z, Z = np.zeros((T, M, 0)), np.zeros((T, 1, 0, 0))
    w = np.full((T, M), 0.5)
    mu = np.tile(np.array([[[0.0], [1.0]]]), (T - 1, 1, 1))
    L = np.zeros((T - 1, 1 if common else M, 1, 1))
    V, Z_plus = (np.zeros((T - 1, 1 if common else M, 0, n)) for n in (1, 0))
    ancestors = np.tile(np.arange(M), (T, 1))
    first = np.arange(N) % M
    rng = np.random.default_rng(0)
    index, *_ = backward_linear(
        a, z, Z, w, mu, L, V, Z_plus, ancestors, first, np.zeros((T, N, 0)), rng, 16, 3
    )
    np.testing.assert_array_equal(index, np.tile(first, (T, 1)))
