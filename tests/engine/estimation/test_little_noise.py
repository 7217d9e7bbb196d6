"""Estimates and their errors where process noise is next to nothing, or units are far from one."""

import numpy as np
import pytest

import engine


def lag(q, r=1e-4):
    """A lag of first order behind a switched voltage."""
    return engine.continuous(
        name="lag",
        drift=lambda a, u, t, th: ([(u[0] - a[:, 0]) / th.tau], np.zeros((1, 0))),
        diffusion=lambda a, u, t, th: [[q]],
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[r]]),
        initial=lambda th: (engine.Gaussian([0.0], [[1e-2]]), [], np.zeros((0, 0))),
        nonlinear={"v": "V"},
        inputs={"u": "V"},
        outputs={"y": "V"},
        parameters=[engine.Parameter("tau", 1.0, "s", (1e-3, 100.0))],
    )


def record(seed=0):
    rng = np.random.default_rng(seed)
    u, x, y = np.repeat(rng.choice([0.0, 1.0], 20), 10), 0.0, []
    for k in range(200):
        y.append(x + 0.01 * rng.standard_normal())
        x = u[k] + (x - u[k]) * np.exp(-0.1 / 0.4)
    return engine.Series(y, u, dt=0.1)


def log_likelihood(tau, series, q, r=1e-4):
    """By a Kalman filter written here."""
    F = np.exp(-0.1 / tau)
    Q, m, P, out = q * tau / 2.0 * (1.0 - F * F), 0.0, 1e-2, 0.0
    for y, u in zip(series.y[:, 0], series.u[:, 0], strict=True):
        S, v = P + r, y - m
        out -= 0.5 * (v * v / S + np.log(2.0 * np.pi * S))
        m, P = m + P / S * v, P * (1.0 - P / S)
        m, P = F * m + (1.0 - F) * u, F * F * P + Q
    return out


@pytest.mark.long
@pytest.mark.parametrize("q", [1e-4, 1e-6, 1e-8, 1e-10])
def test_exact_standard_errors_are_the_curvature_however_little_the_noise(q):
    """With little noise the data hold a millionth of the complete-data information, which errors began at."""
    model, series = lag(q), record()
    found = engine.rts_em(model, series, {"tau": 0.4056}, method="quasi-newton")
    tau, h = found.theta["tau"], 1e-4
    values = [log_likelihood(tau + way, series, q) for way in (-h, 0.0, h)]
    by_hand = h / np.sqrt(2.0 * values[1] - values[0] - values[2])
    stated = engine.standard_errors(model, found, series, exact=True)
    assert stated.values[0] == pytest.approx(by_hand, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    "q", [*(pytest.param(q, marks=pytest.mark.slow) for q in (1e-4, 1e-6, 1e-8)), 1e-10]
)
def test_particles_standard_errors_are_the_curvature_however_little_the_noise(q):
    """Differences of their scores drown in noise there; the moment filter's information does not."""
    model, series = lag(q), record()
    theta = engine.rts_em(model, series, {"tau": 0.4056}, method="quasi-newton").theta
    exact = engine.standard_errors(model, theta, series, exact=True).values[0]
    stated = engine.standard_errors(model, theta, series, n_particles=50, n_trajectories=50)
    assert stated.values[0] == pytest.approx(exact, rel=0.2)
    assert ("too noisy here to check" in stated.warning) == (q < 1e-5)
    assert stated.settled


@pytest.mark.long
def test_how_far_the_maximum_is_does_not_drown_with_the_scores():
    """Two standard errors off the maximum that is said, whatever the particles' scores are."""
    model, series = lag(1e-8), record()
    theta = engine.rts_em(model, series, {"tau": 0.4056}, method="quasi-newton").theta
    exact = engine.standard_errors(model, theta, series, exact=True).values[0]
    off = model.theta({"tau": theta["tau"] + 2.0 * exact})
    with pytest.warns(engine.NotSettledWarning):
        stated = engine.standard_errors(model, off, series, n_particles=50, n_trajectories=50)
    assert "too noisy here to check" in stated.warning
    assert (
        "the moment filter's likelihood" in stated.warning
    )  # whose maximum it is that is 2 errors away
    assert stated.decrement == pytest.approx(4.0, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("estimate", [engine.rbps_em, engine.rts_em])
def test_em_that_stands_still_does_not_say_it_converged(estimate):
    """Its steps are shorter than any tolerance where the likelihood still rises by thousands of nats."""
    options = {"warm_start": False, "n_particles": 20} if estimate is engine.rbps_em else {}
    found = estimate(lag(1e-12), record(), {"tau": 1.0}, method="em", tolerance=1e-3, **options)
    assert found.outcome.name == "STALLED"
    assert "Standing still" in found.message
    assert "nats were seen ahead" in found.message
    settled = estimate(lag(1e-2), record(), {"tau": 0.5}, method="em", tolerance=1e-3, **options)
    assert settled.outcome.name == "CONVERGED"


def van_der_pol(unit):
    """x'' = mu (1 - x^2) x' - x + u, mu in this unit."""
    return engine.continuous(
        name="oscillator",
        drift=lambda a, u, t, th: (
            [a[:, 1], th.mu / unit * (1.0 - a[:, 0] ** 2) * a[:, 1] - a[:, 0] + u[0]],
            np.zeros((2, 0)),
        ),
        diffusion=lambda a, u, t, th: np.zeros((2, 2)),
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda th: (engine.Gaussian([1.0, 0.0], 1e-4 * np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"x": "", "v": ""},
        inputs={"u": ""},
        outputs={"y": ""},
        parameters=[engine.Parameter("mu", unit, "", (1e-3 * unit, 100.0 * unit))],
    )


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_a_fit_of_the_simulation_starts_where_it_is_told_in_any_unit(unit):
    """Starts nearer to a bound than 1e-10, in whatever unit, were moved off it, and lost, "Converged"."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1.0, 1.0, 20), 10)
    plain = van_der_pol(1.0)
    y = engine.free_run(plain, {"mu": 1.0}, engine.Series(np.zeros(200), u, dt=0.1)).y[:, 0]
    series = engine.Series(y + 0.01 * rng.standard_normal(200), u, dt=0.1)
    fit = engine.fit_simulation(van_der_pol(unit), series, {"mu": 0.9 * unit}, n_starts=0)
    assert fit.theta["mu"] / unit == pytest.approx(1.0, abs=0.02)
    assert 0.0 < fit.standard_errors["mu"] / unit < 0.02


@pytest.mark.long
def test_where_bounds_hold_all_that_is_estimated_an_estimation_ends():
    """A first state that the model believes to know, far from the data."""
    model = engine.MixedModel(
        name="far off",
        dynamics=lambda a, u, t, dt, th: ([0.0], [[th.phi]], [[th.q]]),
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
        initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[1.0]]),
        linear={"x": ""},
        outputs={"y": ""},
        parameters=[
            engine.Parameter("phi", 0.8, "", (-1.0, 1.0)),
            engine.Parameter("q", 0.5, "", (0.0, 100.0)),
            engine.Parameter("r", 0.5, "", (1e-9, 100.0)),
        ],
    )
    for off in (1e3, 1e4, 1e5):
        series = engine.Series(off + np.random.default_rng(0).standard_normal(200))
        found = engine.rts_em(model, series, method="quasi-newton")
        assert np.isfinite(np.asarray(found.theta)).all()
