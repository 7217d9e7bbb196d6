"""The free run names what the likelihood explains as noise, and nothing where noise is all there is."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.data.series import Series
from engine.diagnose.free_run.search import survivors

OSCILLATOR = engine.get_model("oscillator")
SERVO = engine.get_model("servo")


def _duffing(T=600, dt=0.1, seed=4, scale=1.0):
    """x'' = -36 x - 0.6 x' - 30 x^3 + 36 (u + 0.05), integrated by another program; u held."""
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(T + 8), np.ones(8) / 8.0)[8 : T + 8]
    y, x = np.zeros(T), np.zeros(2)
    for k in range(T):
        y[k] = x[0]
        force = 36.0 * (u[k] + 0.05)
        run = solve_ivp(
            lambda t, s, force=force: [s[1], force - 36.0 * s[0] - 0.6 * s[1] - 30.0 * s[0] ** 3],
            (0.0, dt),
            x,
            rtol=1e-9,
            atol=1e-12,
        )
        x = run.y[:, -1]
    y += 1e-4 * rng.standard_normal(T)
    return Series(scale * y, u, dt=dt)


@pytest.fixture(scope="module")
def found():
    return engine.diagnose(OSCILLATOR, _duffing(), seed=1)


def test_two_causes_at_once_are_named_by_the_free_run(found):
    """An offset and a cubic spring, hidden in a nearly noise-free record of another simulator."""
    names = {cause.effect for cause in found.causes}
    assert "cubic:position->velocity" in names
    assert names & {"force:velocity", "input-offset:drive"}
    by_name = {cause.effect: cause for cause in found.causes}
    cubic = by_name["cubic:position->velocity"]
    assert cubic.size == pytest.approx(-30.0, rel=0.1)
    assert found.gain.adopt
    run = found.gain.outputs[0]
    assert run.rmse_after < 0.1 * run.rmse_before


def test_both_criteria_are_on_the_page_and_in_the_document(found):
    page = str(found)
    assert "By the likelihood" in page
    document = found.to_dict()["free_run"]
    assert document["likelihood"]["verdict"] in ("nothing", "named", "set", "unknown")
    assert document["decides"] == (found.decided_by == "free run")
    if document["decides"]:
        judged = document["rounds"][0]["judged"]
        assert judged
        assert any(row["survives"] for row in judged)
        errors = [row["held_out"] for row in judged]
        assert errors == sorted(errors)


def test_process_noise_alone_is_no_cause():
    """A drive whose load drifts runs away from its simulation by itself."""
    T, dt = 500, 0.01
    rng = np.random.default_rng(8)
    u = np.repeat(rng.standard_normal(25), 20)
    series = engine.simulate(SERVO, None, T, rng, u=u, dt=dt).series
    free = [name for name in SERVO.parameter_names if name != "gtau"]
    found = engine.diagnose(SERVO, series, free=free, seed=2)
    assert found.decided_by == "likelihood"
    assert found.verdict.value == "nothing"
    assert found.free_run.alarm.p_value > 0.01


def test_what_gains_nothing_does_not_survive():
    assert survivors(np.zeros(16), [], None) == ()
