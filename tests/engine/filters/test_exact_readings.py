"""Readings without noise: a likelihood by linear states, none by particles."""

import numpy as np
import pytest

import engine
from engine.errors import ModelError


@pytest.mark.parametrize("reached", [0.0, 1.0])
def test_a_reading_without_noise_is_refused_where_particles_alone_would_have_to_meet_it(reached):
    """With a linear state in it the likelihood is that of the Kalman filter; without one there is none."""
    model = engine.MixedModel(
        name="exact",
        dynamics=lambda a, u, t, dt, th: ([0.9 * a[:, 0], 0.0], [[0.1], [0.8]], 0.01 * np.eye(2)),
        measurement=lambda a, u, t, th: ([a[:, 0]], [[reached]], [[0.0]]),
        initial=lambda th: (engine.Gaussian([0.0], [[0.1]]), [0.0], [[0.1]]),
        nonlinear={"a": "m"},
        linear={"z": "m"},
        outputs={"y": "m"},
        parameters=[],
    )
    series = engine.Series(0.3 * np.random.default_rng(1).normal(size=60), dt=1.0)
    if reached:
        found = [
            engine.rbpf(model, None, series, 400, np.random.default_rng(k)).log_likelihood
            for k in range(4)
        ]
        exact = engine.kalman_smoother(model, None, series).log_likelihood
        assert np.mean(found) == pytest.approx(exact, abs=1.0)
        return
    for run in (engine.rbpf, engine.particle_filter):
        with pytest.raises(
            ModelError, match="R has a zero on its diagonal, of 'y', which no linear state"
        ):
            run(model, None, series, 50, np.random.default_rng(0))


def test_a_channel_that_is_never_read_needs_no_noise():
    model = engine.MixedModel(
        name="beside",
        dynamics=lambda a, u, t, dt, th: ([0.9 * a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        measurement=lambda a, u, t, th: ([a[:, 0]] * 2, np.zeros((2, 0)), np.diag([0.1, 0.0])),
        initial=lambda th: (engine.Gaussian([0.0], [[0.1]]), [], np.zeros((0, 0))),
        nonlinear={"a": "m"},
        outputs={"y": "m", "beside": "m"},
        parameters=[],
    )
    y = np.column_stack([np.zeros(20), np.full(20, np.nan)])
    filtered = engine.rbpf(model, None, engine.Series(y, dt=1.0), 50, np.random.default_rng(0))
    assert np.isfinite(filtered.log_likelihood)
