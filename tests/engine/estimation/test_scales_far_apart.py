"""Parameters in units far apart, as of a capacitor of nanofarads beside a leak of gigaohms."""

from __future__ import annotations

import numpy as np
import pytest

import engine

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


@pytest.mark.parametrize("exact", [True, False])
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
