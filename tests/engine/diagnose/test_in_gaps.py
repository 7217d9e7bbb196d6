"""A pulse or an episode that lies where a record has no rows is no cause, in any unit of time."""

from types import SimpleNamespace as Of

import numpy as np
import pytest

import engine
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.in_gaps import in_gaps


def box():
    """A heated box, its rates per unit of time as the test counts it."""

    def drift(a, u, t, theta):
        return [(u[0] - theta.G * a[:, 0]) / theta.C], np.zeros((1, 0))

    def diffusion(a, u, t, theta):
        return [[theta.q]]

    def measurement(a, u, t, theta):
        return [a[:, 0]], np.zeros((1, 0)), [[theta.r]]

    def initial(theta):
        return engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))

    return engine.continuous(
        name="box",
        drift=drift,
        diffusion=diffusion,
        measurement=measurement,
        initial=initial,
        nonlinear={"warm": "K"},
        linear={},
        inputs={"heater": "W"},
        outputs={"T": "K"},
        parameters=[
            engine.Parameter("G", 1.5, "W/K", (0.05, 20.0)),
            engine.Parameter("C", 500.0, "J/K", (20.0, 20000.0)),
            engine.Parameter("q", 1e-4, "K^2/s", (0.0, 1.0)),
            engine.Parameter("r", 0.01, "K^2", (1e-8, 10.0)),
        ],
    )


def recorded(seed, gap=slice(80, 130)):
    """Readings of the box, without those of a gap in which the heater went on."""
    rng = np.random.default_rng(seed)
    n, dt, G, C = 250, 5.0, 1.8, 420.0
    u = np.repeat(rng.uniform(0.0, 40.0, n // 10), 10)
    u[gap] = 40.0 if u[gap.start - 1] < 20.0 else 0.0
    x, decay = np.zeros(n), np.exp(-G / C * dt)
    for k in range(n - 1):
        x[k + 1] = decay * x[k] + (1.0 - decay) * u[k] / G
    y = x + 0.08 * rng.standard_normal(n)
    seen = np.delete(np.arange(n), np.arange(n)[gap])
    return engine.Series(y=y[seen], u=u[seen], t=dt * seen, y_names=["T"], u_names=["heater"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_acts_in_a_gap_alone_is_not_named(seed):
    series = recorded(seed)
    found = engine.diagnose(
        box(), series, effects=["pulse:warm", "bias:T"], seed=1, processes=1, held_out=0
    )
    assert found.verdict is Verdict.UNKNOWN
    assert any("acts where there are no rows, for 255 s after t = 395 s" in s for s in found.why)
    assert "No rows for 255 s after t = 395 s" in found.faults[0]


def found_at(**times):
    parameters = {"pulse_warm": 0.1, **{f"pulse_warm_{name}": t for name, t in times.items()}}
    return [Of(effect="pulse:warm", parameters=parameters)]


@pytest.mark.parametrize("scale", [1.0, 1e-3, 3600.0])
@pytest.mark.parametrize("substeps", [1, 4])
def test_only_what_lasts_within_the_gap_is_told(scale, substeps):
    series = recorded(3)
    series = engine.Series(y=series.y, u=series.u, t=scale * series.t, u_names=["heater"])
    series = series.refined(substeps)

    def told(**times):
        return in_gaps(found_at(**{name: scale * t for name, t in times.items()}), series)

    assert len(told(time=500.0, width=5.0)) == 1
    assert len(told(time=395.0, width=5.0)) == 1
    assert len(told(time=395.0, end=660.0)) == 1
    assert not told(time=300.0, end=660.0)
    assert not told(time=300.0, width=5.0)
    assert not told(time=500.0)  # a step: what changed meanwhile may stay so


def test_of_an_input_that_rests_nothing_is_told():
    series = recorded(3)
    rests = engine.Series(y=series.y, u=np.ones(len(series)), t=series.t)
    assert not in_gaps(found_at(time=500.0, width=5.0), rests)
