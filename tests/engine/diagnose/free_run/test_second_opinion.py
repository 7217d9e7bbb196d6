"""The free run names what the likelihood explains as noise, and nothing where noise is all there is."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.data.series import Series
from engine.diagnose.free_run.answer import search_free_runs
from engine.diagnose.free_run.search import survivors
from engine.diagnose.free_run.second_opinion import (
    SecondOpinion,
    _decided,
    heeding,
    second_opinion,
)
from engine.diagnose.gain.adoption import Decision
from engine.diagnose.judging.findings import Verdict
from engine.estimation.quasi_ml import quasi_ml

OSCILLATOR = engine.get_model("oscillator")
SERVO = engine.get_model("servo")


def _duffing(T=300, dt=0.1, seed=4, scale=1.0):
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


KINDS = ("cubic", "drag", "quadratic", "force", "input-offset", "bias", "gain", "variance")


@pytest.fixture(scope="module")
def found():
    return engine.diagnose(OSCILLATOR, _duffing(), seed=1, effects=KINDS)


def _searched(series):
    """The free run's own search, from the true parameters of the base."""
    theta = OSCILLATOR.theta({"zeta": 0.05, "sigma_v": 0.5, "sigma_y": 1e-3})
    base = quasi_ml(OSCILLATOR, series, theta, max_iterations=3)
    return search_free_runs(
        base,
        [series],
        theta,
        levels=(0.05, 0.01),
        kinds=KINDS,
        seed=1,
        progress=lambda stage, fraction: None,
    )


@pytest.mark.slow
def test_a_pair_is_found_that_no_greedy_order_is_needed_for():
    series = _duffing().refined(2)
    found = _searched(series)
    names = set(found.found[0].names)
    assert "cubic:position->velocity" in names
    assert names & {"force:velocity", "input-offset:drive"}
    assert found.final.rms < 0.1 * found.rounds[0].fit.rms
    assert found.rounds[0].alarm.p_value <= 0.01


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("likelihood", "held_out", "missing", "decides", "verdict"),
    [
        (Verdict.NOTHING, Decision.ADOPTED, None, True, Verdict.NAMED),
        (Verdict.NOTHING, Decision.NO_EVIDENCE, None, False, Verdict.NOTHING),
        (Verdict.NOTHING, Decision.LOSES, None, False, Verdict.NOTHING),
        (Verdict.NOTHING, None, None, False, Verdict.NOTHING),
        (Verdict.NOTHING, None, "a curve", True, Verdict.NAMED),
        (Verdict.UNKNOWN, Decision.NO_EVIDENCE, None, True, Verdict.NAMED),
        (Verdict.UNKNOWN, Decision.LOSES, None, True, Verdict.UNKNOWN),
    ],
)
def test_what_loses_on_data_not_seen_is_not_named(likelihood, held_out, missing, decides, verdict):
    asked = SecondOpinion(likelihood, (), True, "The free run decides.", missing=missing)
    said, answer = heeding(asked, Verdict.NAMED, held_out)
    assert (said.decides, answer) == (decides, verdict)
    assert (said.reason == asked.reason) == (answer is Verdict.NAMED)


def test_what_does_nothing_better_on_data_not_seen_is_not_named():
    """A pendulum's chirp was cogging beside a slow sensor, as seen in free run alone, until asked elsewhere."""
    asked = SecondOpinion(Verdict.UNKNOWN, (), True, "The free run decides.")
    said, answer = heeding(asked, Verdict.NAMED, Decision.NO_EVIDENCE, nothing_better=True)
    assert (said.decides, answer) == (True, Verdict.UNKNOWN)
    assert "does nothing better, and predicts worse" in said.reason


@pytest.mark.parametrize(
    ("free_run", "decides"), [(["path:u->x", "cubic-sensor:y"], False), (["path:u->x"], True)]
)
def test_a_pair_with_a_name_that_the_likelihood_refuted_is_not_named(free_run, decides):
    """A bent sensor showed beside a direct path of the model; the free run named it beside another path."""
    named = [
        SimpleNamespace(effect=SimpleNamespace(name=n)) for n in ("cubic-sensor:y", "direct:u->y")
    ]
    alarm = SimpleNamespace(p_near=0.5, p_size=0.01, p_gain=0.1, probability="p = 0.01")
    first = SimpleNamespace(alarmed=True, alarm=alarm)
    found = [SimpleNamespace(names=free_run)]
    search = SimpleNamespace(rounds=[first], found=found, alone=None, is_patchwork=False)
    refuted = ("cubic-sensor:y", "direct:u->y")
    causes = SimpleNamespace(verdict=Verdict.UNKNOWN, another_shape=False, refuted=refuted)
    said, reason = _decided(causes, False, named, search)
    assert said is decides
    assert ("cubic-sensor:y, of what the free run finds, is refuted" in reason) is not decides


@pytest.mark.parametrize(("free_run", "decides"), [(["cubic:x"], False), (["drag:x"], True)])
def test_a_shape_that_the_likelihood_refuted_is_refuted_for_the_free_run(free_run, decides):
    """A reactor's product of two states, nearly free of noise, was named as what imitates it."""
    named = [SimpleNamespace(effect=SimpleNamespace(name=name)) for name in ("cubic:x", "force:x")]
    alarm = SimpleNamespace(p_near=0.5, p_size=0.01, p_gain=0.1, probability="p = 0.01")
    first = SimpleNamespace(alarmed=True, alarm=alarm)
    found = [SimpleNamespace(names=free_run)]
    search = SimpleNamespace(rounds=[first], found=found, alone=None, is_patchwork=False)
    for refuted in (True, False):
        causes = SimpleNamespace(verdict=Verdict.UNKNOWN, another_shape=refuted, refuted=())
        said, reason = _decided(causes, False, named, search)
        assert said is (decides or not refuted)
        assert ("another shape" in reason) is not said


VESSEL = engine.MixedModel(
    name="vessel",
    nonlinear={"T": "K"},
    linear={},
    inputs={"heat": "kW"},
    outputs={"y": "K"},
    dynamics=lambda a, u, t, dt, th: (
        [a[:, 0] + dt * (th.gain * u[0] - th.loss * a[:, 0])],
        np.zeros((1, 0)),
        [[dt * th.q]],
    ),
    measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1e-2]]),
    initial=lambda th: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
    parameters=[
        engine.Parameter("gain", 1.0, "K/s/kW", (0, 10)),
        engine.Parameter("loss", 0.05, "1/s", (0, 1)),
        engine.Parameter("q", 0.3, "K^2/s", (1e-6, 10)),
    ],
)


def test_where_noise_explains_the_free_run_no_function_is_said_to_act():
    """Noise that adds up goes astray slowly, and here a function of the state follows a third of it."""
    rng = np.random.default_rng(6)
    u = np.repeat(rng.uniform(0.0, 4.0, 8), 25)
    series = engine.simulate(VESSEL, {}, 200, rng, u=u, dt=1.0).series
    base = quasi_ml(VESSEL, series)
    search = SimpleNamespace(rounds=[])
    causes = SimpleNamespace(base=base, search=search, verdict=Verdict.UNKNOWN, misread=False)
    one = [series]
    asked = second_opinion(
        causes,
        one,
        VESSEL.theta(),
        alpha=0.05,
        kinds=["bias"],
        seed=1,
        progress=lambda stage, fraction: None,
    )
    assert asked.alarm is not None
    assert asked.alarm.p_value > 0.1
    assert asked.missing is None
