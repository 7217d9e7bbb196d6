"""Models that jump where a state changes its sign: one row must not tell a parameter more than all others."""

import numpy as np

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.jumps import slopes
from engine.estimation.quasi_ml import derivatives, log_likelihoods


def test_the_slope_of_a_row_that_jumps_is_that_of_the_side_that_does_not():
    step = np.array([1e-3])

    def of(function):
        rows = [[one(x) for x in (2.0, 2.0 - 1e-3, 2.0 + 1e-3)] for one in (function, np.square)]
        return float(slopes(np.array(rows), step, step, 2.0 * step)[0, 0])

    assert np.isclose(of(lambda x: x**2), 4.0)
    assert np.isclose(of(lambda x: x**2 + 5.0 * (x < 1.9995)), 4.0, rtol=1e-3)
    assert np.isclose(of(lambda x: x**2 - 5.0 * (x > 2.0005)), 4.0, rtol=1e-3)
    assert np.isclose(of(lambda x: (x - 1.99951) ** 2), 0.00098)  # turns nearby, and does not jump
    assert np.isnan(of(lambda x: np.nan if x < 2.0 else x))
    on_a_bound = slopes(np.array([[4.0, 4.0, 4.002]]), 0.0 * step, step, step)
    assert np.isclose(on_a_bound[0, 0], 2.0)


def filter_drift(a, u, t, theta):
    return [u[0] / theta.R1], [[-(1.0 / theta.R1 + 0.025)]]


FILTER = engine.continuous(
    name="jumping-filter",
    drift=filter_drift,
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [0.0], [[0.01]]),
    nonlinear={},
    linear={"v": "V"},
    inputs={"u": "V"},
    outputs={"y": "V"},
    parameters=[
        engine.Parameter("R1", 12.0, "kohm", (1.0, 100.0)),
        engine.Parameter("q", 5e-4, "V^2/ms", (1e-10, 1.0)),
        engine.Parameter("r", 6e-5, "V^2", (1e-10, 1.0)),
    ],
)


def a_jump(model, series, start):
    """A value of r beside which the likelihood jumps, by grids that grow finer."""
    low, high = 5e-5, 7e-5
    for _ in range(3):
        grid = np.linspace(low, high, 201)
        thetas = np.tile(start, (len(grid), 1))
        thetas[:, model.index("r")] = grid
        steps = np.diff(log_likelihoods(model, [series], thetas))
        i = int(np.argmax(np.abs(steps - np.median(steps))))
        low, high = grid[i], grid[i + 1]
    return high


def test_no_variance_is_known_better_than_so_many_readings_can_tell_it():
    """The bound is that of readings without any other noise: the variance times sqrt(2 / T)."""
    T = 200
    u = np.repeat(np.random.default_rng(0).uniform(-5.0, 5.0, T // 20), 20)
    run = engine.simulate(FILTER, {}, T, np.random.default_rng(0), u=u, dt=0.2)
    base = np.asarray(FILTER.theta({}))
    model = make_effect("stribeck:v", setting_for(FILTER, run.series, base)).apply(FILTER)
    theta = np.array(model.theta({"stribeck_v": 0.06, "stribeck_v_width": 0.08}))
    at = model.index("r")
    theta[at] = a_jump(model, run.series, theta)
    _, _, H = derivatives(model, [run.series], theta, np.array([at]))
    assert H[0, 0] < T / (2.0 * theta[at] ** 2)
