"""A parameter that was held at a wrong value is a candidate of the likelihood, and preferred."""

import numpy as np
import pytest

import engine
from engine import MixedModel, Parameter, Series
from engine.diagnose import Verdict


def kettle(first):
    """Heat stored and lost, T' = k P - T / tau, exact while P is held."""

    def dynamics(a, u, t, dt, th):
        kept = np.exp(-dt / th.tau)
        return [(1.0 - kept) * th.tau * th.k * u[0]], [[kept]], [[1e-3]]

    return MixedModel(
        name="kettle",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
        initial=lambda th: (None, [0.0], [[1.0]]),
        linear={"T": "K"},
        inputs={"P": "W"},
        outputs={"reading": "K"},
        parameters=[
            Parameter("tau", first, "s", (1.0, 1000.0)),
            Parameter("k", 0.05, "K/J", (0.0, 10.0)),
            Parameter("r", 0.04, "K^2", (1e-8, 100.0)),
        ],
    )


def heated(seed=3, n=200):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 20.0, n // 20), 20)[:, None]
    return engine.simulate(kettle(25.0), {"k": 0.06}, n, rng, u=u, dt=1.0).series


KINDS = ["held", "linear", "path", "drag", "bias", "lag"]


@pytest.mark.long
@pytest.mark.parametrize(("first", "named"), [(20.0, ["held:tau"]), (25.0, [])])
def test_a_time_constant_that_was_held(first, named):
    """Where it was right nothing is said of it; wrong, it was named a linear rate beside it before."""
    found = engine.diagnose(kettle(first), heated(), effects=KINDS, free=["k", "r"], seed=1)
    assert [cause.effect for cause in found.causes] == named
    assert found.verdict is (Verdict.NAMED if named else Verdict.NOTHING)
    if named:
        (cause,) = found.causes
        assert first + cause.size == pytest.approx(25.0, abs=3.0 * cause.standard_error)
        assert found.gain.adopt


@pytest.mark.long
def test_estimated_parameters_are_none():
    found = engine.diagnose(kettle(20.0), heated(), effects=["linear", "bias"], seed=1)
    assert found.verdict is Verdict.NOTHING
    assert isinstance(found.series, Series)
