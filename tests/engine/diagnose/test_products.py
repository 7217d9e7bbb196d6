"""A reaction of two substances: a term that neither of them has by itself."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, make_effect
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.records import Records
from engine.diagnose.search.substeps import prepare, undeclared

T, DT, FINE = 400, 0.2, 20


def dynamics(a, u, t, dt, theta):
    decay = np.exp(-dt * np.array([theta.k_e, theta.k_s]))
    feed = [u[0] * (1.0 - decay[0]) / theta.k_e, u[1] * (1.0 - decay[1]) / theta.k_s]
    return feed, np.diag(decay), np.diag([theta.q**2 * dt, theta.q**2 * dt])


# an enzyme and what it works on, each fed and each decaying by itself
TUBE = engine.MixedModel(
    name="tube",
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0, 0.0], np.eye(2), theta.r**2 * np.eye(2)),
    initial=lambda theta: (None, [1.0, 2.0], 0.01 * np.eye(2)),
    nonlinear={},
    linear={"enzyme": "g/L", "substrate": "mmol/L"},
    inputs={"dose": "g/L/h", "feed": "mmol/L/h"},
    outputs={"activity": "g/L", "glucose": "mmol/L"},
    parameters=[
        engine.Parameter("k_e", 0.5, "1/h", (0.01, 10.0)),
        engine.Parameter("k_s", 0.5, "1/h", (0.01, 10.0)),
        engine.Parameter("q", 0.02, "", (1e-6, 1.0)),
        engine.Parameter("r", 0.02, "", (1e-6, 1.0)),
    ],
)


def record(rate, seed=0):
    """By Euler's rule at a twentieth of the step; the enzyme eats ``rate`` (L/g/h) of the substrate."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 1.5, (T // 20, 2)), 20, axis=0)
    x, y = np.array([1.0, 2.0]), np.zeros((T, 2))
    for k in range(T):
        y[k] = x + 0.02 * rng.standard_normal(2)
        for _ in range(FINE):
            eaten = rate * x[0] * x[1]
            x = x + DT / FINE * (u[k] - [0.6, 0.4] * x - [0.0, eaten])
            x = x + 0.01 * np.sqrt(DT / FINE) * rng.standard_normal(2)
    return engine.Series(y, u=u, dt=DT, time_unit="h", hold="zoh")


@pytest.mark.long
def test_a_reaction_of_two_substances_is_named_with_its_rate():
    series = record(0.05)
    found = diagnose(
        TUBE,
        series,
        effects=["product", "coupling", "quadratic", "drag", "saturation", "linear", "force"],
        seed=1,
        held_out=0,
        processes=1,
    )
    assert [cause.effect for cause in found.causes] == ["product:enzyme*substrate->substrate"]
    (cause,) = found.causes
    # it acts at the beginning of a step, in which the substrate decays by a tenth
    assert cause.size == pytest.approx(-0.05, abs=3.0 * cause.standard_error + 0.003)
    assert cause.standard_error < 0.005
    assert cause.unit == "L/h/g"


def test_products_are_asked_where_one_of_the_two_moves_the_state_already():
    setting = setting_for(TUBE, record(0.0), np.asarray(TUBE.theta()))
    names = [e.channel for e in all_effects(setting, ["product"])]
    assert "enzyme*substrate->substrate" in names
    assert "substrate*dose->substrate" in names
    assert "dose*feed->substrate" not in names
    assert make_effect("product:dose*feed->substrate", setting).size.unit == "L h/g"
    assert "enzyme*dose->substrate" not in names  # neither has anything to do with it
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    "channel", ["enzyme*enzyme->substrate", "enzyme*nothing->substrate", "enzyme*dose->glucose"]
)
def test_what_is_no_product_of_two_signals_onto_a_state_is_refused(channel):
    setting = setting_for(TUBE, record(0.0), np.asarray(TUBE.theta()))
    with pytest.raises(engine.OptionError):
        make_effect(f"product:{channel}", setting)


@pytest.mark.long
def test_a_model_that_may_be_stepped_more_finely_and_does_not_say_so_is_told():
    """With its step declared the rate is right however strong: the step's error had names of its own."""
    strong = record(0.15)
    (note,) = prepare(TUBE, Records(strong), lambda: np.asarray(TUBE.theta())).notes
    assert "continuous=True" in note
    steps = engine.get_model("linear-2")
    assert undeclared(steps, engine.simulate(steps, None, 60, 1).series) == ""
    declared = replace(TUBE, continuous=True)
    found = diagnose(
        declared, strong, effects=["product", "linear"], seed=1, held_out=0, processes=1
    )
    (cause,) = found.causes
    assert cause.size == pytest.approx(-0.15, abs=3.0 * cause.standard_error)
    assert not any("continuous=True" in note for note in found.notes)
