"""A reaction of two substances: a term that neither of them has by itself."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.records import Records
from engine.diagnose.steps.substeps import prepare, undeclared

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


def dryer_dynamics(a, u, t, dt, theta):
    decay = np.exp(-dt * theta.loss)
    return [(1.0 - decay) * u[1] + dt * theta.gain * u[0]], [[decay]], [[1e-3 * dt]]


# nothing says where degC begin: counted from anywhere, the equations are the same
DRYER = engine.MixedModel(
    name="dryer",
    dynamics=dryer_dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[0.01]]),
    initial=lambda theta: (None, [20.0], [[1.0]]),
    nonlinear={},
    linear={"air": "degC"},
    inputs={"fan": "kW", "room": "degC"},
    outputs={"reading": "degC"},
    parameters=[
        engine.Parameter("loss", 0.1, "1/s", (1e-3, 10.0)),
        engine.Parameter("gain", 1.0, "K/kJ", (1e-3, 10.0)),
    ],
)
WITH_FAN = "product:air*fan->air"


def dryer_record():
    rng = np.random.default_rng(3)
    u = np.column_stack([np.repeat(rng.uniform(0.0, 4.0, 20), 10), np.full(200, 18.0)])
    return engine.simulate(DRYER, None, 200, rng, u=u, dt=1.0).series


def test_a_model_made_again_by_name_counts_from_where_the_parameters_say():
    """From the record's middle only where the record was at hand: the same parameters were another model."""
    series = dryer_record()
    made = extend(DRYER, [WITH_FAN], setting_for(DRYER, series, np.asarray(DRYER.theta())))
    theta = made.theta({"product_air_fan_air": 0.02})
    middle = theta["product_air_fan_air_zero_air"]
    assert 20.0 < middle < 60.0
    again = extend(DRYER, [WITH_FAN])
    assert again.parameter_names == made.parameter_names
    a = np.zeros((1, 1)) + middle + 5.0
    steps = [
        model.transition(a, np.array([3.0, 18.0]), 0.0, 1.0, model.record(np.asarray(theta)))[0]
        for model in (made, again)
    ]
    assert steps[0] == pytest.approx(steps[1], rel=1e-12)
    nothing = np.asarray(made.theta({**theta.asdict(), "product_air_fan_air": 0.0}))
    without = made.transition(a, np.array([3.0, 18.0]), 0.0, 1.0, made.record(nothing))[0]
    assert (steps[0] - without)[0, 0] == pytest.approx(0.02 * 5.0 * 3.0)


@pytest.mark.long
def test_a_bent_loss_of_which_the_record_shows_one_branch_is_no_product():
    """Looked for about the middle of the record it was a straight loss, or a product, and a bent one."""
    rng = np.random.default_rng(3)
    swings = 18.0 + 4.0 * np.sin(0.05 * np.arange(300))
    u = np.column_stack([np.repeat(rng.uniform(0.0, 4.0, 30), 10), swings])
    bent = extend(DRYER, ["quadratic:air"])
    sizes = {"quadratic_air": -0.002, "quadratic_air_zero": 0.0}
    series = engine.simulate(bent, sizes, 300, rng, u=u, dt=1.0).series
    assert series.y.min() > 10.0
    kinds = ["quadratic", "product", "linear", "extra-input"]
    found = diagnose(DRYER, series, effects=kinds, held_out=0, processes=1)
    assert [cause.effect for cause in found.causes] == ["quadratic:air"]
    (cause,) = found.causes
    assert abs(cause.size + 0.002) < 3.0 * cause.standard_error
    assert abs(cause.parameters["quadratic_air_zero"]) < 5.0


def test_the_zeros_of_a_product_stay_where_they_are():
    effect = make_effect(WITH_FAN, Setting(DRYER))
    assert effect.held == ("product_air_fan_air_zero_air", "product_air_fan_air_zero_fan")
    assert "(air - product_air_fan_air_zero_air)" in effect.equation


@pytest.mark.long
def test_what_is_converted_above_a_least_concentration_is_one_product():
    """About 0 of the unit it was a product and a coupling."""
    name, least = "product:enzyme*substrate->substrate", 0.6
    size, zero = (f"product_enzyme_substrate_substrate{end}" for end in ("", "_zero_substrate"))
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0.2, 1.5, (T // 20, 2)), 20, axis=0)
    true = extend(TUBE, [name])
    series = engine.simulate(true, {size: -0.3, zero: least}, T, rng, u=u, dt=DT).series
    found = diagnose(
        TUBE, series, effects=["product", "coupling", "force"], held_out=0, processes=1
    )
    (cause,) = found.causes
    assert cause.effect == name
    assert abs(cause.size + 0.3) < 3.0 * cause.standard_error
    assert cause.parameters[zero] == pytest.approx(least, abs=0.15)


@pytest.mark.parametrize(
    ("asked", "named"),
    [("fan*room->air", "fan*room->air"), ("fan*air->air", "air*fan->air")],
)
def test_a_product_asked_for_by_name_is_looked_for(asked, named):
    """Beside other kinds one of two inputs, or written the other way round, was left out without a word."""
    setting = setting_for(DRYER, dryer_record(), np.asarray(DRYER.theta()))
    found = all_effects(setting, ["force", f"product:{asked}"])
    assert [e.name for e in found] == ["force:air", f"product:{named}"]
    assert make_effect(f"product:{asked}", setting).name == f"product:{named}"


@pytest.mark.long
def test_a_name_that_nothing_has_is_told():
    found = diagnose(
        DRYER, dryer_record(), effects=["force", "product:air*sun->air"], held_out=0, processes=1
    )
    assert any("product:air*sun->air" in note for note in found.notes)


def test_a_channel_may_have_the_sign_of_a_product_in_its_name():
    model = replace(DRYER, inputs={"fan*2": "kW", "room": "degC"})
    names = [e.name for e in all_effects(Setting(model), ["product"])]
    assert "product:air*fan*2->air" in names


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


@pytest.mark.parametrize(
    ("channel", "said"),
    [
        ("enzyme*substrate->substrate", "k_s depends on enzyme"),
        ("enzyme*substrate->enzyme", "k_e depends on substrate"),
        ("enzyme*feed->substrate", ""),
    ],
)
def test_a_product_tells_which_parameter_would_depend_on_what(channel, said):
    """A spring whose stiffness depends on its temperature has that name, which says nothing of a stiffness."""
    title = make_effect(f"product:{channel}", Setting(TUBE)).title
    assert title.partition(", as where ")[2] == said
