"""The catalogue on other people's models: the same answers in all units, and from every zero."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

import engine
from engine.diagnose.effects.catalogue import all_effects, make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.zeros import without_zero
from engine.diagnose.screening.score_columns import Projection, effect_columns
from engine.diagnose.screening.screen import make_test
from engine.diagnose.screening.time_scan import family_test, is_timed
from engine.diagnose.symptoms.runs import noise_free
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_filter, moment_path
from engine.statespace.densities import GaussianMixture
from tests.engine.plain_models import Units, cart, pendulum, record, referred, room, tank

ROWS = 60
MODELS = {"room": room, "pendulum": pendulum, "tank": tank}
SLOW = pytest.mark.slow


def some(setting):
    """The first and the last place of each kind; outliers are the particle filter's."""
    by_kind = {}
    for effect in all_effects(setting):
        if effect.kind != "heavy-tails":
            by_kind.setdefault(effect.kind, []).append(effect)
    return [one for same in by_kind.values() for one in (same[:1] + same[1:][-1:])]


def seen(model, series):
    """{effect: its standardised scores, one per probe}, and the effects."""
    theta = np.asarray(model.theta())
    setting = setting_for(model, series, theta)
    path = moment_path(model, theta, series)
    out, effects = {}, {}
    for effect in some(setting):
        effects[effect.name] = effect
        if is_timed(effect):
            test = family_test(effect, model, theta, series, path, Projection([]))
            out[effect.name] = [] if test is None else test.statistics(test.s.sum(axis=1))
            continue
        columns = effect_columns(effect, model, theta, series, path)
        out[effect.name] = [c.s.sum() / max(np.linalg.norm(c.v), 1e-300) for _, c in columns]
    return out, effects


@cache
def plainly_seen(name, declared):
    """The scores of one of the models in the units it was written in."""
    model = MODELS[name]()
    return seen(referred(model) if declared else model, record(model, ROWS))


def compare(one, other, names):
    for name in names:
        np.testing.assert_allclose(
            np.asarray(other[name], dtype=float), one[name], rtol=2e-3, atol=2e-3, err_msg=name
        )


@pytest.mark.parametrize("name", MODELS)
def test_at_size_zero_every_effect_leaves_the_model_as_it_is(name):
    model = MODELS[name]()
    series = record(model, ROWS)
    theta = np.asarray(model.theta())
    base = moment_filter(model, theta[None], series).log_likelihood[0]
    setting = setting_for(model, series, theta)
    for effect in all_effects(setting):
        if effect.kind == "heavy-tails":
            continue
        extended = effect.apply(model)
        assert len(effect.probes[0]) == len(effect.parameters) - 1, effect.name
        at = np.array([[*theta, 0.0, *probe] for probe in effect.probes])
        values = moment_filter(extended, at, series).log_likelihood
        np.testing.assert_allclose(values, base, rtol=0.0, atol=1e-6, err_msg=effect.name)


# quickly one model in other units and another one from another zero
@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-3, pytest.param(1e4, marks=SLOW)])
@pytest.mark.parametrize(
    "name", [pytest.param("room", marks=SLOW), pytest.param("pendulum", marks=SLOW), "tank"]
)
def test_scores_are_the_same_in_other_units(name, factor):
    model = MODELS[name]()
    series = record(model, ROWS)
    channels = {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}
    # the room's temperatures float together, which is seen by their one unit: there they share a factor
    keys = list(channels.values()) if name == "room" else list(channels)
    each = dict.fromkeys(keys)
    of = dict(zip(each, factor ** np.linspace(0.5, 1.0, len(each)), strict=True))
    factors = {n: (of[key], 0.0) for n, key in zip(channels, keys, strict=True)}
    units = Units(model, factors, (1.0 / factor, 0.0))
    one, _ = plainly_seen(name, False)
    other, _ = seen(units.converted(), units.series(series))
    assert set(one) == set(other)
    compare(one, other, one)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param("room", marks=SLOW), "pendulum", pytest.param("tank", marks=SLOW)]
)
def test_scores_are_the_same_from_another_zero(name):
    model = MODELS[name]()
    series = record(model, ROWS)
    channels = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    shifts = {n: (1.0, 40.0 + 7.0 * i) for i, n in enumerate(channels)}
    for base, declared in ((model, False), (referred(model), True)):
        units = Units(base, shifts, (1.0, 300.0))
        one, effects = plainly_seen(name, declared)
        other, _ = seen(units.converted(), units.series(series))
        free = [n for n, effect in effects.items() if effect.zero is None]
        assert not declared or len(free) == len(effects)
        assert len(free) > 10
        compare(one, other, free)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "channels"),
    [
        (cart(), ["position", "tape"]),
        pytest.param(room(), ["air", "masonry", "outside", "y"], marks=SLOW),
    ],
)
def test_what_can_be_counted_from_anywhere_is(model, channels):
    """A position on a rail and a temperature have no zero; the user's, wherever it is, changes no score."""
    series = record(model, ROWS)
    one, effects = seen(model, series)
    assert any(effect.zero is not None for effect in effects.values())
    for away in (-3.0, 400.0):
        units = Units(model, dict.fromkeys(channels, (1.0, away)))
        other, _ = seen(units.converted(), units.series(series))
        assert set(one) == set(other)
        compare(one, other, one)


def two_rooms(nonlinear):
    """Two rooms as differential equations; so many of the states are declared nonlinear, all enter linearly."""
    names = ("north", "south")
    J = 4e-4 * np.array([[-1.0, 1.0], [1.0, -1.0]])

    def drift(a, u, t, th):
        x = np.concatenate([a, np.zeros((len(a), 2 - nonlinear))], axis=1)  # what z adds goes by A
        warmed = np.array([1e-3, 0.0]) * np.reshape(u[0], (-1, 1))
        outside = np.reshape(u[1], (-1, 1)) - x
        return x @ J.T + th.l * outside + warmed, (J - th.l * np.eye(2))[:, nonlinear:]

    return engine.continuous(
        name="rooms",
        drift=drift,
        diffusion=lambda a, u, t, th: 1e-6 * np.eye(2),
        measurement=lambda a, u, t, th: (
            [*a.T, *[0.0] * (2 - nonlinear)],
            np.eye(2)[:, nonlinear:],
            0.01 * np.eye(2),
        ),
        initial=lambda th: (
            engine.Gaussian([18.0] * nonlinear, np.eye(nonlinear)),
            [17.0] * (2 - nonlinear),
            np.eye(2 - nonlinear),
        ),
        nonlinear=dict.fromkeys(names[:nonlinear], "degC"),
        linear=dict.fromkeys(names[nonlinear:], "degC"),
        inputs={"heater": "kW", "outside": "degC"},
        outputs={"Tn": "degC", "Ts": "degC"},
        parameters=[engine.Parameter("l", 2e-4, "1/s", (1e-7, 1.0))],
    )


@pytest.mark.parametrize("nonlinear", [0, 1, 2])
def test_temperatures_count_from_anywhere_whichever_way_states_are_declared(nonlinear):
    """Derivatives by nonlinear states are differences, which are not as exact as a number."""
    afloat = {"north", "south", "outside", "Tn", "Ts"}
    assert without_zero(two_rooms(nonlinear), 300.0) == afloat


def in_kelvin_and_fahrenheit():
    """The room with its masonry in mK and the air outside in degF."""
    model = Units(room(), {"masonry": (1e3, 273150.0), "outside": (1.8, 32.0)}).converted()
    return replace(model, linear={"masonry": "mK"}, inputs={"heater": "W", "outside": "degF"})


@pytest.mark.parametrize(
    ("model", "afloat"),
    [
        (cart(), {"position", "tape"}),
        (cart(pull=1e-3), set()),  # a spring, however soft, knows where it is
        (cart(reading=lambda x: x + 0.01 * x**2), set()),
        (cart(rough=0.1), set()),
        (replace(cart(), reference={"position": 2.0}), {"position", "tape"}),
        (room(), {"air", "masonry", "outside", "y"}),
        (in_kelvin_and_fahrenheit(), {"air", "masonry", "outside", "y"}),
        (replace(in_kelvin_and_fahrenheit(), linear={"masonry": "K"}), set()),  # not what it is in
        (pendulum(), set()),
    ],
)
def test_what_can_be_counted_from_anywhere_is_told_by_the_equations(model, afloat):
    for dt in (0.1, 1e-3, 10.0):
        assert without_zero(model, dt) == afloat
    setting = setting_for(cart(), record(cart(), ROWS), np.asarray(cart().theta()))
    for channel in ("position", "tape"):
        middle = float(np.median(setting.record.values[channel]))
        assert setting.zero(channel) == middle
        assert replace(setting, record=None).zero(channel) == 0.0
    assert setting.zero("force") == 0.0


def likelihoods(model, series, name, starts):
    """Twice the log-likelihood that an effect gains, the best of a few starts, with what it is there."""
    base = quasi_ml(model, series)
    setting = setting_for(model, series, np.asarray(base.theta))
    effect = make_effect(name, setting)
    extended = effect.apply(model)
    free = [*base.free, *(p.name for p in effect.parameters if p.name not in effect.held)]
    fits = []
    for own in starts:
        start = extended.theta().asdict() | base.theta.asdict() | own
        fits.append(quasi_ml(extended, series, start, free))
    best = max(fits, key=lambda fit: fit.log_likelihood)
    return 2.0 * (best.log_likelihood - base.log_likelihood), best


@pytest.mark.slow
def test_a_lagging_sensor_is_seen_from_any_zero_of_the_temperature():
    """Memories that started at zero once hid it in degC, and showed it in degrees above 20."""
    rng = np.random.default_rng(3)
    outside = 5.0 + np.cumsum(0.2 * rng.standard_normal(200))
    u = np.column_stack([np.repeat(rng.uniform(0.0, 8.0, 20), 10), outside])
    model = room()
    series = hide(model, ["lag:y"], {"lag_y": 0.7}, 200, rng, u=u, dt=0.5).series
    gains = []
    for shift in (0.0, -20.0):
        degrees = dict.fromkeys(("air", "masonry", "outside", "y"), (1.0, shift))
        units = Units(model, degrees)
        one, other = units.converted(), units.series(series)
        gains.append(
            [
                likelihoods(one, other, name, [{f"{name.replace(':', '_')}": 0.4}])[0]
                for name in ("lag:y", "delay:heater", "pole:air")
            ]
        )
    assert gains[0][0] > 50.0
    np.testing.assert_allclose(gains[0], gains[1], atol=0.2)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_sensor_that_clips_at_one_end_is_screened_and_fitted(side):
    rng = np.random.default_rng(3)
    model, u = tank(), np.repeat(rng.uniform(1.0, 3.5, 20), 10)
    clean = engine.simulate(model, None, 200, rng, u=u, dt=0.5).series
    limit = np.quantile(clean.y, 0.5 + 0.35 * side)
    y = np.minimum(clean.y, limit) if side > 0.0 else np.maximum(clean.y, limit)
    series = engine.Series(y + 0.02 * rng.standard_normal(y.shape), u, dt=0.5)
    theta = np.asarray(quasi_ml(model, series).theta)
    setting = setting_for(model, series, theta)
    effect = make_effect("saturation-sensor:y", setting)
    path = moment_path(model, theta, series)
    columns = effect_columns(effect, model, theta, series, path)
    test = make_test(effect, [columns], Projection([]))
    best = test.at[int(np.argmax(test.statistics(test.s.sum(axis=1))))]
    assert test.statistics(test.s.sum(axis=1)).max() > 20.0
    assert best[1] == side
    own = dict(zip([p.name for p in effect.parameters], (0.5, *best), strict=True))
    gain, fit = likelihoods(model, series, effect.name, [own])
    assert gain > 200.0
    assert fit.theta["saturation_sensor_y"] == pytest.approx(1.0, abs=0.1)
    assert fit.theta["saturation_sensor_y_limit"] == pytest.approx(limit, abs=0.1)


def test_zeros_are_declared_told_or_parameters():
    model, series = pendulum(), record(pendulum(), ROWS)
    theta = np.asarray(model.theta())
    setting = setting_for(model, series, theta)
    assert setting.is_rate("rate")
    assert not setting.is_rate("angle")
    assert make_effect("drag:rate", setting).zero is None  # the angle stands still there
    cubic = make_effect("cubic:angle->rate", setting)
    assert cubic.zero == "cubic_angle__rate_zero"
    assert cubic.zero in cubic.held
    shifted = Units(model, {"rate": (1.0, 30.0)}).converted()
    assert Setting(shifted).zero("rate") == pytest.approx(30.0)
    declared = replace(model, reference={"angle": 0.3})
    assert make_effect("cubic:angle->rate", Setting(declared)).zero is None
    assert Setting(declared).zero("angle") == 0.3
    with pytest.raises(
        engine.ModelError, match="reference of 'speed', which is none of its channels"
    ):
        replace(model, reference={"speed": 0.0})
    with pytest.raises(engine.ModelError, match="reference of 'angle' is nan"):
        replace(model, reference={"angle": np.nan})


def test_a_zero_that_depends_on_a_parameter_is_not_told():
    """A gyroscope with a bias: the angle stands still at the bias, which is to be estimated."""

    def dynamics(a, u, t, dt, th):
        rate = a[:, 1]
        return [a[:, 0] + dt * (rate - th.bias), 0.9 * rate], np.zeros((2, 0)), 0.01 * np.eye(2)

    model = engine.MixedModel(
        name="gyro",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda th: (engine.Gaussian([0.0, 0.0], np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"angle": "rad", "rate": "rad/s"},
        outputs={"y": "rad"},
        parameters=[engine.Parameter("bias", 0.2, "rad/s")],
    )
    setting = Setting(model)
    assert setting.is_rate("rate")
    assert "rate" not in setting.known_zeros


def test_a_density_of_any_kind_takes_a_memory_and_a_promoted_state():
    shares = GaussianMixture([0.5, 0.5], [19.0, 21.0], [0.3, 0.3])
    plain = room()

    def initial(th):
        return shares, lambda a: 0.5 * a + 9.0, [[0.5]]

    model = replace(plain, initial=initial)
    series = record(plain, ROWS)
    theta = np.asarray(model.theta())
    setting = setting_for(model, series, theta)

    def width(x, extended):
        return norm.logpdf(x[:, 1], 0.0, extended.theta()["hysteresis_air_width"] / np.sqrt(3.0))

    def wall(x, extended):
        """Given the air."""
        z = x[:, 1] - (0.5 * x[:, 0] + 9.0)
        assert z.std() == pytest.approx(np.sqrt(0.5), rel=0.05)
        return norm.logpdf(z, 0.0, np.sqrt(0.5))

    for name, added in (("hysteresis:air", width), ("cubic:masonry->air", wall)):
        extended = make_effect(name, setting).apply(model)
        start = extended.start(extended.record(extended.theta()))
        x = start.density.sample(np.random.default_rng(0), 4000)
        assert x.shape == (4000, 2)
        base = shares.log_density(x[:, :1])
        np.testing.assert_allclose(
            start.density.log_density(x), base + added(x, extended), atol=1e-9
        )
        filtered = moment_filter(extended, np.asarray(extended.theta())[None], series)
        assert np.isfinite(filtered.log_likelihood[0])


def sprung(rest):
    """A mass on a spring that rests anywhere, in linear states, as a differential equation."""
    return engine.continuous(
        name="sprung",
        drift=lambda a, u, t, theta: (np.array([0.0, rest + u[0]]), [[0.0, 1.0], [-1.0, -0.3]]),
        diffusion=lambda a, u, t, theta: np.diag([0.0, 0.01]),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[1e-4]]),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [rest, 0.0], np.eye(2)),
        linear={"position": "m", "velocity": "m/s"},
        inputs={"force": "m/s^2"},
        outputs={"laser": "m"},
        parameters=[],
        reference={"position": rest, "velocity": 0.0, "laser": rest, "force": 0.0},
    )


AT_REST = ("position", "lag_position", "mode_position", "played_laser")  # and what the laser read


@pytest.mark.long
def test_what_an_effect_does_has_nothing_to_do_with_where_linear_states_count_from():
    """Each at a size that counts, in steps that are long beside the motion."""
    force = np.repeat(np.random.default_rng(7).uniform(-1.0, 1.0, 10), 4)
    scale = {"position": 1.0, "velocity": 1.0, "laser": 1.0, "force": 1.0}
    runs = {}
    for rest in (0.0, 1000.0):
        model = sprung(rest)
        series = engine.Series(np.zeros(40), force, dt=0.4)
        setting = Setting(model, scale=scale, span=(0.0, 16.0), dt=0.4)
        for effect in some(setting):
            extended = effect.apply(model)
            own = [0.2, *effect.probes[0]]
            first = []
            for state in [*extended.nonlinear, *extended.linear]:
                at_rest = state in AT_REST or state.startswith("last_laser")
                first.append(rest if at_rest else 0.0)
            y, _ = noise_free(extended, np.asarray(own), series, np.array(first))
            runs.setdefault(effect.name, []).append(y[:, 0] - rest)
    assert len(runs) > 30
    still = runs["level:laser"][0]
    assert sum(np.abs(one - still).max() > 0.05 for one, _ in runs.values()) > 20
    for name, (one, other) in runs.items():
        until = np.argmax([*(np.abs(one) > 10.0), True])  # some run away
        np.testing.assert_allclose(other[:until], one[:until], atol=1e-5, err_msg=name)
