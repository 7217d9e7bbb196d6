"""A parameter that depends on a state: a resistance on its heat, an exchange on a temperature."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, extend, make_effect
from engine.diagnose.effects.kinds import slopes
from engine.diagnose.effects.kinds.parameters import stopped_share
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.rates import slopes_by
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.score_columns import effect_columns
from engine.diagnose.symptoms.runs import noise_free
from engine.filters.sigma_point import moment_path
from tests.engine.plain_models import Units

own = engine.Parameter
NO_STATE = engine.Gaussian([], np.zeros((0, 0)))
KINDS = [
    "parameter-slope",
    "product",
    "quadratic",
    "coupling",
    "gain",
    "cubic-sensor",
    "parameter-step",
    "level",
]
FINE = 20


def run(rate, x, n, dt, noise, rng):
    """States (n, nx) of x' = rate(x, k) by Euler's rule at a twentieth of a sample."""
    x, out, h = np.array(x, dtype=float), [], dt / FINE
    for k in range(n):
        out.append(x)
        for _ in range(FINE):
            pushes = np.multiply(noise, np.sqrt(h)) * rng.standard_normal(len(x))
            x = x + h * np.array(rate(x, k)) + pushes
    return np.array(out)


def levels(rng, n, low, high, each):
    return np.repeat(rng.uniform(low, high, -(-n // each)), each)[:n]


# the resistance is in the heat and in the current that is read
WINDING = engine.continuous(
    name="winding",
    drift=lambda a, u, t, th: ([(u[0] ** 2 / th.R - th.h * a[:, 0]) / 45.0], np.zeros((1, 0))),
    diffusion=lambda a, u, t, th: [[th.q**2]],
    measurement=lambda a, u, t, th: (
        [u[0] / th.R, a[:, 0]],
        np.zeros((2, 0)),
        np.diag([th.r**2, 0.3**2]),
    ),
    initial=lambda th: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
    nonlinear={"heat": "K"},
    inputs={"voltage": "V"},
    outputs={"amps": "A", "probe": "K"},
    parameters=[
        own("R", 2.0, "Ohm", (0.1, 20.0)),
        own("h", 0.5, "W/K", (0.01, 10.0)),
        own("q", 0.02, "K/s^0.5", (0.0, 1.0)),
        own("r", 0.03, "A", (1e-3, 1.0)),
    ],
)


def warm(slope, seed, n=300):
    rng = np.random.default_rng(seed)
    volts = levels(rng, n, 1.0, 8.0, 20)

    def rate(x, k):
        return [(volts[k] ** 2 / (2.2 + slope * (x[0] - 20.0)) - 0.45 * x[0]) / 45.0]

    heat = run(rate, [0.0], n, 2.0, [0.02], rng)[:, 0]
    amps = volts / (2.2 + slope * (heat - 20.0))
    y = np.column_stack([amps, heat]) + [0.03, 0.3] * rng.standard_normal((n, 2))
    return engine.Series(y, u=volts, dt=2.0)


# two bodies exchange heat; all states are linear, and with a coefficient that depends on one they are not
BODIES = engine.continuous(
    name="bodies",
    drift=lambda a, u, t, th: (
        [u[0] / 11.0, th.h * u[1] / 22.0],
        [[-th.k / 11.0, th.k / 11.0], [th.k / 22.0, -(th.k + th.h) / 22.0]],
    ),
    diffusion=lambda a, u, t, th: th.q**2 * np.eye(2),
    measurement=lambda a, u, t, th: ([0.0, 0.0], np.eye(2), th.r**2 * np.eye(2)),
    initial=lambda th: (NO_STATE, [40.0, 30.0], 9.0 * np.eye(2)),
    nonlinear={},
    linear={"inner": "degC", "outer": "degC"},
    inputs={"heater": "W", "air": "degC"},
    outputs={"one": "degC", "other": "degC"},
    parameters=[
        own("k", 2.0, "W/K", (0.01, 50.0)),
        own("h", 3.0, "W/K", (0.01, 50.0)),
        own("q", 0.2, "K/h^0.5", (0.0, 5.0)),
        own("r", 0.3, "K", (1e-2, 5.0)),
    ],
)


def exchanged(slope, seed, n=400):
    rng = np.random.default_rng(seed)
    heater, air = levels(rng, n, 0.0, 120.0, 25), levels(rng, n, 5.0, 25.0, 60)

    def rate(x, k):
        passed = (2.2 + slope * (x[0] - 40.0)) * (x[0] - x[1])
        return [(heater[k] - passed) / 11.0, (passed - 3.2 * (x[1] - air[k])) / 22.0]

    x = run(rate, [40.0, 30.0], n, 0.5, [0.2, 0.2], rng)
    y = x + 0.3 * rng.standard_normal((n, 2))
    return engine.Series(y, u=np.column_stack([heater, air]), dt=0.5, time_unit="h")


def setting_of(model, series):
    return setting_for(model, series, np.asarray(model.theta()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "series", "name", "size"),
    [
        (WINDING, warm(0.009, 21), "heat->R", 0.009),
        (BODIES, exchanged(0.03, 22), "inner->k", 0.03),
    ],
)
def test_a_parameter_that_depends_on_a_state_is_named_with_its_slope(model, series, name, size):
    """The winding was coloured noise and another resistance for a while, and so unknown."""
    found = diagnose(model, series, effects=KINDS, processes=1)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == f"parameter-slope:{name}"
    assert cause.size == pytest.approx(size, abs=3.0 * cause.standard_error + 0.03 * size)
    assert found.adopted


@pytest.mark.long
def test_what_is_one_product_a_square_or_a_coupling_has_that_name_alone():
    """A coefficient that weighs one channel in one equation, as a spring's; the mass weighs all of them."""
    spring = engine.continuous(
        name="spring",
        drift=lambda a, u, t, th: (
            [0.0, (u[0] + th.rest) / th.m, u[1]],
            [[0.0, 1.0, 0.0], [-th.k / th.m, -0.6 / th.m, 0.0], [0.0, 0.0, -th.h]],
        ),
        diffusion=lambda a, u, t, th: np.diag([0.0, 0.1, 0.1]),
        measurement=lambda a, u, t, th: ([0.0, 0.0], [[1.0, 0, 0], [0, 0, 1.0]], 0.1 * np.eye(2)),
        initial=lambda th: (NO_STATE, [0.0, 0.0, 20.0], np.eye(3)),
        nonlinear={},
        linear={"position": "m", "speed": "m/s", "warmth": "K"},
        inputs={"force": "N", "lamp": "W"},
        outputs={"laser": "m", "probe": "K"},
        parameters=[own("m", 1.0), own("k", 4.0), own("h", 0.1), own("rest", 0.5)],
    )
    rng = np.random.default_rng(3)
    u = np.column_stack([levels(rng, 80, -6.0, 6.0, 8), levels(rng, 80, 0.0, 3.0, 20)])
    for zero in (0.0, 300.0):
        units = Units(spring, {"warmth": (1.8, zero), "probe": (1.8, zero)})
        model = units.converted()
        series = engine.simulate(model, None, 80, rng, u=u, dt=0.25).series
        effects = all_effects(setting_of(model, series), ["parameter-slope", "product"])
        names = {e.name for e in effects if e.family == "state"}
        slopes = {name for name in names if name.startswith("parameter-slope")}
        # of the mass only: k weighs the position, h the warmth, rest nothing at all
        assert slopes == {f"parameter-slope:{x}->m" for x in ("position", "speed", "warmth")}
        assert "product:position*warmth->speed" in names


@pytest.mark.parametrize(("taken_along", "asked"), [(0.5, True), (0.0, False)])
def test_a_product_that_misses_the_way_within_a_whole_step_has_that_name_beside_it(
    taken_along, asked
):
    """A brake that fades with speed, of a model not stepped more finely: it was a drag that brakes lessen."""

    def dynamics(a, u, t, dt, theta):
        push = dt * (theta.traction * u[1] - theta.brake * u[0] - theta.air * a[:, 0] ** 2)
        return (
            [a[:, 0] + push, dt * (a[:, 0] + taken_along * push)],
            [[0.0], [1.0]],
            np.diag([0.02 * dt, 1e-4]),
        )

    train = engine.MixedModel(
        name="train",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0], 0.0], [[0.0], [1.0]], np.diag([0.1, 0.3])),
        initial=lambda theta: (engine.Gaussian([20.0], [[1.0]]), [0.0], [[1.0]]),
        nonlinear={"speed": "m/s"},
        linear={"way": "m"},
        inputs={"brake": "bar", "traction": "kN"},
        outputs={"radar": "m/s", "odometer": "m"},
        kinematic=("way",),
        parameters=[own("brake", 0.5), own("traction", 0.012), own("air", 5e-4)],
    )
    rng = np.random.default_rng(2)
    u = np.column_stack([levels(rng, 90, 0.0, 1.0, 9), levels(rng, 90, 20.0, 90.0, 9)])
    series = engine.simulate(train, None, 90, rng, u=u, dt=1.0).series
    effects = all_effects(setting_of(train, series), ["parameter-slope", "product"])
    names = {e.name for e in effects if e.family == "state"}
    assert "product:speed*brake->speed" in names
    assert ("parameter-slope:speed->brake" in names) == asked
    assert "parameter-slope:speed->air" not in names  # another curve of the speed


def test_any_parameter_of_a_reading_is_asked_on_any_state_that_moves():
    setting = setting_of(WINDING, warm(0.0, 1, 60))
    effects = [e for e in all_effects(setting, ["parameter-slope"]) if e.family == "state"]
    assert [e.channel for e in effects] == ["heat->R"]  # h weighs the heat alone, q and r are noise
    (effect,) = effects
    assert effect.size.unit == "Ohm/K"
    assert effect.held == (effect.parameters[1].name,)
    for channel in ("heat->nothing", "nothing->R", "R->heat", "heat->heat"):
        with pytest.raises(engine.OptionError, match="cannot enter"):
            extend(WINDING, [f"parameter-slope:{channel}"])


def test_it_is_what_the_model_does_with_that_parameter_at_each_state():
    tank = replace(WINDING, continuous=False)
    model = make_effect("parameter-slope:heat->R", Setting(tank)).apply(tank)
    heats = np.array([[0.0], [20.0], [55.0], [400.0]])
    record = model.record(np.array([2.0, 0.5, 0.02, 0.03, 0.01, 20.0]))
    step = model.transition(heats, np.array([6.0]), 0.0, 2.0, record)
    read = model.observation(heats, np.array([6.0]), 0.0, record)
    low = make_effect("parameter-slope:heat->R", Setting(tank)).apply(tank)
    falling = low.record(np.array([2.0, 0.5, 0.02, 0.03, -0.01, 20.0]))
    bounded = low.observation(heats, np.array([6.0]), 0.0, falling)
    for i, heat in enumerate(heats[:, 0]):
        plain = tank.record(np.array([2.0 + 0.01 * (heat - 20.0), 0.5, 0.02, 0.03]))
        alone = tank.transition(heats[[i]], np.array([6.0]), 0.0, 2.0, plain)
        np.testing.assert_allclose(step[0][i], alone[0][0], rtol=1e-12)
        alone = tank.observation(heats[[i]], np.array([6.0]), 0.0, plain)
        np.testing.assert_allclose(read[0][i], alone[0][0], rtol=1e-12)
    np.testing.assert_allclose(bounded[0][3, 0], 6.0 / 0.1)  # not below its bound


def test_within_steps_it_is_of_second_order():
    """A free run of half as long steps is wrong by a quarter; with what the step begins with, by a half."""
    series = exchanged(0.0, 4, 40)
    model = make_effect("parameter-slope:inner->k", setting_of(BODIES, series)).apply(BODIES)
    theta = np.array([2.0, 3.0, 0.2, 0.3, 0.06, 40.0])

    def ends(k):
        fine = series.refined(k)
        y, _ = noise_free(model, theta, fine, np.array([40.0, 30.0]))
        return y[fine.samples]

    exact = ends(64)
    wrong = [np.sqrt(np.mean((ends(k) - exact) ** 2)) for k in (2, 4, 8)]
    assert wrong[1] == pytest.approx(0.25 * wrong[0], rel=0.2)
    assert wrong[2] == pytest.approx(0.25 * wrong[1], rel=0.2)


@pytest.mark.parametrize("made", ["winding", "bodies"])
def test_its_score_is_the_same_in_other_units_and_from_another_zero(made):
    if made == "winding":
        model, series, name = WINDING, warm(0.009, 2, 80), "parameter-slope:heat->R"
        channels = {"heat": (1e3, 2e5), "probe": (1e3, 2e5), "amps": (1e-3, 0.0)}
    else:
        model, series, name = BODIES, exchanged(0.03, 2, 80), "parameter-slope:inner->k"
        channels = dict.fromkeys(("inner", "outer", "one", "other", "air"), (1.8, 32.0))

    def score(model, series):
        theta = np.asarray(model.theta())
        effect = make_effect(name, setting_for(model, series, theta))
        path = moment_path(model, theta, series)
        ((_, column),) = effect_columns(effect, model, theta, series, path)
        return column.s.sum() / np.linalg.norm(column.v)

    units = Units(model, channels, (3600.0, 500.0))
    one, other = score(model, series), score(units.converted(), units.series(series))
    assert abs(one) > 1.0
    assert other == pytest.approx(one, rel=2e-3)


@pytest.mark.parametrize(("least", "most", "share"), [(0.1, 20.0, 0.0), (2.0, 20.0, 0.5)])
def test_the_share_of_a_record_in_which_a_bound_stops_it(least, most, share):
    parameters = [
        replace(p, bounds=(least, most)) if p.name == "R" else p for p in WINDING.parameters
    ]
    model = replace(WINDING, parameters=parameters)
    series = warm(0.0, 1, 100)
    effect = make_effect("parameter-slope:heat->R", setting_of(model, series))
    extended = effect.apply(model)
    theta = extended.theta({effect.size.name: 0.005})
    assert stopped_share(effect, extended, theta, series) == pytest.approx(share, abs=0.03)


def test_a_curve_of_one_state_is_asked_on_no_dependence_on_that_state():
    """The outflow of the lower tank, a root of its level; that of the upper one flows into the lower, too."""
    asked = [
        effect.channel
        for effect in all_effects(Setting(engine.get_model("tanks")), ["parameter-slope"])
    ]
    assert "lower->k3" not in asked
    assert {"upper->k3", "upper->k1"} <= {*asked}


def test_nor_where_that_curve_moves_other_states_within_the_step():
    """Friction of a speed, which takes the position along."""
    asked = [
        effect.channel
        for effect in all_effects(Setting(engine.get_model("servo")), ["parameter-slope"])
    ]
    assert "velocity->Fc" not in asked
    assert "position->Fc" in asked


def test_a_model_that_refuses_some_states_beside_others_is_asked_all_the_same(monkeypatch):
    """The states at which it is looked whether a curve is one of a state alone are those of other rows."""
    calls = []

    def refusing(*given):
        calls.append(given)
        if len(calls) % 2 == 0:
            raise engine.ModelError("sqrt of a negative number")
        return slopes_by(*given)

    setting = Setting(engine.get_model("tanks"))
    known = [effect.channel for effect in all_effects(setting, ["parameter-slope"])]
    monkeypatch.setattr(slopes, "slopes_by", refusing)
    asked = [source for source in setting.moved if not slopes._bends(setting, "k3", source)]
    assert asked == list(setting.moved)
    assert "lower->k3" not in known


@pytest.mark.parametrize(("source", "odd"), [("velocity", True), ("position", False)])
def test_a_speed_is_hardly_a_condition_on_which_a_parameter_depends(source, odd):
    """A friction that depends on it is one of the others, and was named in place of an offset."""
    effect = make_effect(f"parameter-slope:{source}->Fc", Setting(engine.get_model("servo")))
    assert effect.traits.odd is odd
