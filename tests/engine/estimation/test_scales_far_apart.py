"""Parameters in units far apart, as of a capacitor of nanofarads beside a leak of gigaohms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import engine
from engine.estimation.expectation import either_side
from engine.estimation.quasi_ml import quasi_ml

UNITS = {"C": 1e-9, "R": 1e9, "q": 1e-6}  # of the same model in SI units


def capacitor(units: dict[str, float]) -> engine.MixedModel:
    """v' = (i - v / R) / C in V, with i in nA; C in nF, R in GOhm and q in V^2/s times ``units``."""
    C, R, q = (units[name] for name in "CRq")

    def dynamics(a, u, t, dt, theta):
        keep = np.exp(-dt / (theta.R / R * theta.C / C))
        return [(1.0 - keep) * theta.R / R * u[0]], [[keep]], [[theta.q / q * dt]]

    return engine.MixedModel(
        name="capacitor",
        linear={"v": "V"},
        inputs={"i": "nA"},
        outputs={"y": "V"},
        parameters=[
            engine.Parameter("C", 3.0 * C, "F", (0.1 * C, 100.0 * C)),
            engine.Parameter("R", 2.5 * R, "ohm", (0.1 * R, 100.0 * R)),
            engine.Parameter("q", 0.01 * q, "V^2/s", (1e-6 * q, 10.0 * q)),
        ],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[0.01]]),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[0.01]]),
    )


@pytest.fixture(scope="module")
def record() -> engine.Series:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-2.0, 4.0, 20), 15)
    return engine.simulate(capacitor(dict.fromkeys(UNITS, 1.0)), None, 300, rng, u=u, dt=0.5).series


@pytest.mark.long
@pytest.mark.parametrize("exact", [pytest.param(True, marks=pytest.mark.slow), False])
def test_standard_errors_do_not_depend_on_units(record, exact):
    usual = dict.fromkeys(UNITS, 1.0)
    scale = np.array(list(UNITS.values()))
    plain = capacitor(usual)
    at = engine.rts_em(plain, record, n_iterations=100).theta
    found = engine.standard_errors(plain, at, record, exact=exact, n_particles=20)
    far = capacitor(UNITS)
    there = engine.standard_errors(far, np.asarray(at) * scale, record, exact=exact, n_particles=20)
    np.testing.assert_allclose(there.values / scale, found.values, rtol=1e-3)
    both = np.outer(scale, scale)
    largest = np.sqrt(np.outer(np.diag(found.covariance), np.diag(found.covariance)))
    assert (np.abs(there.covariance / both - found.covariance) < 2e-3 * largest).all()


@pytest.mark.slow
def test_likelihood_intervals_neither(record):
    plain, far = capacitor(dict.fromkeys(UNITS, 1.0)), capacitor(UNITS)
    at = engine.rts_em(plain, record, n_iterations=100).theta
    options = {"exact": True, "free": ["C", "R"]}
    here = engine.likelihood_intervals(plain, at, record, **options)
    there = engine.likelihood_intervals(
        far, np.asarray(at) * np.array(list(UNITS.values())), record, **options
    )
    scale = np.array(list(UNITS.values()))[:, None]
    np.testing.assert_allclose(there.values[:2] / scale[:2], here.values[:2], rtol=1e-3)


def level_by_deviations(default: float, na: int = 0) -> engine.MixedModel:
    """A local level with standard deviations as parameters, which begin at 0."""
    none = np.zeros((1, 0))

    def initial(th):
        if na:
            return engine.Gaussian([0.0], [[1e-9]]), [], np.zeros((0, 0))
        return None, [0.0], [[1e-9]]

    return engine.MixedModel(
        name="level",
        dynamics=lambda a, u, t, dt, th: (a if na else [0.0], none if na else [[1.0]], th.sw**2),
        measurement=lambda a, u, t, th: (a if na else [0.0], none if na else [[1.0]], th.sy**2),
        initial=initial,
        outputs={"y": "V"},
        parameters=[engine.Parameter(name, default, "V", (0.0, 10.0)) for name in ("sw", "sy")],
        **({"nonlinear": {"x": "V"}} if na else {"linear": {"x": "V"}}),
    )


@pytest.mark.long
@pytest.mark.parametrize("far", [pytest.param(1e4, marks=pytest.mark.slow), 1e6])
def test_errors_of_deviations_far_below_their_defaults_are_as_of_others(far: float) -> None:
    rng = np.random.default_rng(0)
    y = 1e-7 * (np.cumsum(rng.standard_normal(150)) + rng.standard_normal(150))
    series, near = engine.Series(y, dt=1.0), {"sw": 2e-7, "sy": 2e-7}
    found = []
    for default in (1e-7, 1e-7 * far):
        model = level_by_deviations(default)
        estimate = engine.rts_em(model, series, near)
        errors = engine.standard_errors(model, estimate, series, exact=True)
        quasi = quasi_ml(level_by_deviations(default, 1), series, near)
        found.append([estimate.theta, errors.values, quasi.theta, quasi.standard_errors])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)


@given(st.integers(-9, 9), st.floats(0.0, 12.0), st.floats(2.0, 5.0))
def test_differences_fit_the_value_and_are_not_lost_in_rounding(power, smaller, share):
    unit, share = 10.0**power, 10.0**-share
    model = engine.MixedModel(
        name="any",
        linear={"x": ""},
        outputs={"y": ""},
        parameters=[engine.Parameter("s", unit, "", (0.0, 10.0 * unit))],
        dynamics=lambda a, u, t, dt, th: ([0.0], [[1.0]], [[th.s]]),
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[1.0]]),
        initial=lambda th: (None, [0.0], [[1.0]]),
    )

    def sides(value: float) -> np.ndarray:
        return np.ravel(either_side(model, np.array([value * unit]), 0, share)) / unit

    value = 10.0**-smaller
    low, high = sides(value)
    assert 0.0 <= low < value < high
    assert high - value <= max(np.sqrt(share) * value, share**2) * (1.0 + 1e-6)
    assert high - value >= share**2 * (1.0 - 1e-3)
    if value >= np.sqrt(share):  # as ever
        assert high - low == pytest.approx(2.0 * share * max(value, 1.0))
    assert sides(0.0) == pytest.approx([0.0, share])
