"""Every kind of effect: nothing at size zero, hidden at a given size, found."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import engine
from engine.data.lattice import lattice_step
from engine.diagnose import all_effects, diagnose, effect_kinds, extend, make_effect
from engine.diagnose.effects import catalogue
from engine.diagnose.effects.catalogue import shadowed
from engine.diagnose.effects.free_function import free_function
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.spare_inputs import with_inputs
from engine.diagnose.judging.verdict import set_of
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.rounds import MARGIN
from engine.diagnose.screening.score_columns import static_column
from engine.diagnose.screening.screen import Score
from engine.diagnose.search.pipeline import find_causes
from engine.diagnose.symptoms.runs import noise_free
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.filters.sigma_point import moment_filter, moment_path
from tests.engine.hidden_effects import (
    CASES,
    DRIVE,
    DT,
    OF_RECORDS,
    ON_SWING,
    SEVERAL_MASSES,
    T,
    case,
    hidden,
    levels,
    smooth,
)

BY_NAME_ONLY = {"offset", "held"}  # another word for bias; for parameters that are not estimated
BESIDE_DRIFTS = {"bend", "parameter-bend"}  # looked for where a drift was found
QUICK = {  # one of each way to enter a model, and what test_diagnose has not; make test-all has all
    "force", "mode", "bias", "quantisation", "variance", "colored", "input-offset", "extra-input",
    "parameter-step",
}  # fmt: skip


def test_every_kind_has_a_case():
    assert set(CASES) == set(effect_kinds())


def mixed_case():
    """A model with an input that it does not use, and all effects it can have."""
    model = with_inputs(DRIVE, ["temperature"])
    setting = Setting(
        model,
        span=(0.0, 5.0),
        dt=DT,
        extra=("temperature",),
        resolution={"reading": 0.1},
        found=("drift_reading", "parameter_drift_damping"),
    )
    rng = np.random.default_rng(2)
    u = np.column_stack([smooth(rng, 50), rng.standard_normal(50)])
    return model, setting, engine.simulate(model, None, 50, rng, u=u, dt=DT).series


@pytest.mark.long
def test_at_size_zero_the_extended_model_is_the_model():
    model, setting, series = mixed_case()
    x1 = np.array([0.3, -0.2])
    y, _ = noise_free(model, np.asarray(model.theta()), series, x1)
    base = moment_filter(model, np.asarray(model.theta())[None], series).log_likelihood[0]
    effects = all_effects(setting)
    elsewhere = BY_NAME_ONLY | ON_SWING | SEVERAL_MASSES | OF_RECORDS
    assert {e.kind for e in effects} == set(effect_kinds()) - elsewhere
    for effect in effects:
        extended = effect.apply(model)
        theta = np.asarray(extended.theta())
        assert theta[len(DRIVE.parameters)] == pytest.approx(0.0, abs=1e-5)
        states = [*extended.nonlinear, *extended.linear]
        start = np.zeros(extended.nx)
        start[states.index("speed")], start[states.index("load")] = x1
        run, _ = noise_free(extended, theta, series, start)
        np.testing.assert_allclose(run, y, rtol=1e-12, atol=1e-12, err_msg=effect.name)
        if effect.kind == "heavy-tails":
            continue  # its likelihood is the particle filter's
        likelihood = moment_filter(extended, theta[None], series).log_likelihood[0]
        assert likelihood == pytest.approx(base, abs=1e-7), effect.name


@pytest.mark.parametrize("samples", [10, 25, 40, 200])
def test_what_an_effect_begins_with_is_within_its_bounds_however_short_the_record(samples):
    model, _, series = mixed_case()
    series = engine.simulate(
        model, None, samples, 1, u=np.resize(series.u, (samples, 2)), dt=DT
    ).series
    for effect in all_effects(setting_for(model, series, np.asarray(model.theta()))):
        extended = effect.apply(model)
        further = extended.parameter_names[-len(effect.parameters) :][1:]
        for probe in effect.probes:
            extended.theta(dict(zip(further, probe, strict=False)))  # those of outliers are none


@pytest.mark.slow
def test_two_effects_with_states_of_their_own_have_as_many_names_as_states():
    """Bouc-Wen's hysteresis beside a plain one of the same signal: both remember where it was."""
    model = engine.get_model("mixed-4")
    series = engine.simulate(model, None, 50, np.random.default_rng(3)).series
    own = all_effects(setting_for(model, series, np.asarray(model.theta())))
    own = [effect for effect in own if effect.apply(model).nx > model.nx]
    assert {"hysteresis:z1", "boucwen:z1", "slow-sensor:y1"} <= {effect.name for effect in own}
    for one, other in combinations(own, 2):
        extended = other.apply(one.apply(model))
        a = np.zeros((1, extended.na))
        f, A, Q = extended.transition(a, np.zeros(0), 0.0, 1.0, extended.record(extended.theta()))
        assert f.shape == (1, extended.nx), (one.name, other.name)
        assert A.shape[-2:] == (extended.nx, extended.nz)
        assert Q.shape[-2:] == (extended.nx, extended.nx)
        assert extended.nx == one.apply(model).nx + other.apply(model).nx - model.nx


@pytest.mark.long
def test_many_sizes_at_once_are_what_each_is_alone():
    model, setting, series = mixed_case()
    k = len(model.parameters)
    for effect in all_effects(setting):
        if effect.kind == "heavy-tails":
            continue
        extended = effect.apply(model)
        thetas = np.repeat(np.asarray(extended.theta())[None], 3, axis=0)
        thetas[:, 0] = [0.8, 1.0, 1.2]
        thetas[1:, k] += 0.02 * np.array([1.0, 2.0])
        thetas = np.clip(thetas, extended.lower, extended.upper)
        together = moment_filter(extended, thetas, series).log_likelihood
        alone = [moment_filter(extended, row[None], series).log_likelihood[0] for row in thetas]
        np.testing.assert_allclose(together, alone, rtol=1e-9, err_msg=effect.name)
        assert np.ptp(together) > 0.0, effect.name


def rivals(name, model):
    """The kinds the effect may be taken for, and the force nobody named."""
    alike = make_effect(name, Setting(model)).look_alikes
    return [name, *(kind for kind in alike if kind in effect_kinds()), "latent"]


def explains(found):
    """The stated set, and what says the same in other words (a force through an input)."""
    best = found.refits[0].score if found.refits else 0.0
    return {*set_of(found), *(r.effect.name for r in found.refits if r.score >= best - MARGIN)}


def sought(quick=()):
    """The kinds that are looked for."""
    elsewhere = BY_NAME_ONLY | BESIDE_DRIFTS | SEVERAL_MASSES | OF_RECORDS | {"latent"}
    kinds = sorted(set(CASES) - elsewhere)
    return [pytest.param(kind, marks=[pytest.mark.slow] * (kind not in quick)) for kind in kinds]


@pytest.mark.parametrize("kind", sorted(set(CASES) - BY_NAME_ONLY - OF_RECORDS))
def test_every_kind_can_be_hidden(kind):
    model, series, name = case(kind, seed=5)
    assert make_effect(name, Setting(model)).name == name
    assert series.check(model).observed.all()
    assert np.ptp(series.y) > 0.0


def in_two_of_three(is_found):
    """Whether a thing is found in at least two of the series 5, 6, 7: by chance one may look like a rival."""
    hits = misses = 0
    for seed in (5, 6, 7):
        if max(hits, misses) == 2:
            break
        hit = is_found(seed)
        hits, misses = hits + hit, misses + (not hit)
    return hits == 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", sought(QUICK))
def test_a_hidden_effect_is_found_among_its_look_alikes(kind):
    def is_found(seed):
        model, series, name = case(kind, seed)
        found = find_causes(model, series, effects=rivals(name, model), seed=1, max_effects=1)
        first = found.search.rounds[0]
        return first.screen.p_value <= 0.05 and name in explains(first)

    assert in_two_of_three(is_found)


@pytest.mark.slow
def test_a_hidden_force_that_nobody_named_is_seen_and_not_named():
    """The detector of "something" is no cause."""
    model, series, name = case("latent", seed=5)
    found = find_causes(model, series, effects=rivals(name, model), seed=1, max_effects=1)
    first = found.search.rounds[0]
    assert first.screen.p_value <= 0.05
    assert first.generic is not None
    assert found.verdict.value in ("unknown", "set")


@pytest.mark.slow
@pytest.mark.parametrize("kind", sought())
def test_a_hidden_effect_is_found_in_the_whole_catalogue(kind):
    """Alone or in the stated set."""

    def is_found(seed):
        model, series, name = case(kind, seed)
        found = find_causes(model, series, seed=1)
        return any(name in explains(r) for r in found.search.rounds if r.equivalent)

    assert in_two_of_three(is_found)


@pytest.mark.slow
def test_a_hidden_force_is_unknown_or_found_in_the_whole_catalogue():
    """In at least two of three series."""
    hits = 0
    for seed in (5, 6, 7):
        model, series, name = case("latent", seed)
        found = find_causes(model, series, seed=1)
        seen = any(name in explains(r) for r in found.search.rounds if r.equivalent)
        hits += seen or found.verdict.value == "unknown"
    assert hits >= 2


def test_rounding_is_asked_for_only_where_readings_lie_on_a_lattice():
    _, series, name = case("quantisation", seed=5)
    assert lattice_step(series.y[:, 0]) == pytest.approx(0.15)
    setting = setting_for(DRIVE, series, np.asarray(DRIVE.theta()))
    assert setting.resolution == {"reading": pytest.approx(0.15)}
    effect = make_effect(name, setting)
    assert effect.size.bounds == (0.0, pytest.approx(2.0 * 0.15**2 / 12.0))
    plain = hidden([], {}, seed=5)
    assert lattice_step(plain.y[:, 0]) is None
    theirs = setting_for(DRIVE, plain, np.asarray(DRIVE.theta()))
    assert "quantisation" not in {e.kind for e in all_effects(theirs)}


def test_a_step_that_the_readings_show_is_no_parameter():
    """Noise that grows with something may fit a little better; rounding is there, and its variance is known."""
    _, series, name = case("quantisation", seed=5)
    base = quasi_ml(DRIVE, series)
    shown = make_effect(name, setting_for(DRIVE, series, np.asarray(DRIVE.theta())))
    unknown = replace(shown, shown=None)
    far = replace(shown, shown=1.9 * shown.shown)
    known, free, wrong = (
        refit(base, series, Score(effect, 1.0, 0.1 * shown.shown, 0.1, 0.1, 1.0, ()))
        for effect in (shown, unknown, far)
    )
    assert known.gain == pytest.approx(free.gain, abs=0.1)
    assert free.score == pytest.approx(free.gain, abs=1e-9)
    assert free.score + 1.0 < known.score <= free.score + np.log(series.n_measured)
    assert free.score <= wrong.score < known.score


def test_a_lattice_is_seen_through_gaps_offsets_and_rounded_numbers():
    rng = np.random.default_rng(0)
    values = 0.02 * np.round(50.0 * np.cumsum(rng.standard_normal(500)) * 0.1) + 0.007
    assert lattice_step(values) == pytest.approx(0.02)
    assert lattice_step(values.astype(np.float32).astype(float)) == pytest.approx(0.02, rel=1e-3)
    assert lattice_step(rng.standard_normal(500)) is None
    assert lattice_step(np.repeat([0.0, 1.0, np.pi], 50)) is None


@pytest.mark.slow
def test_an_extra_channel_is_diagnosed_and_becomes_an_input():
    model, wide, name = case("extra-input", seed=5)
    series = engine.Series(
        wide.y, wide.u[:, :1], dt=DT, extra=wide.extra, extra_names=["temperature"]
    )
    found = diagnose(DRIVE, series, seed=1, effects=["extra-input", "force", "step"])
    assert [cause.effect for cause in found.causes] == [name]
    assert found.extended.inputs == {"force": "m/s^2", "temperature": "1"}
    truth = CASES["extra-input"][1]["extra_input_temperature_speed"]
    assert abs(found.causes[0].size - truth) < 4.0 * found.causes[0].standard_error
    again = extend(DRIVE, [name])
    assert again.inputs == found.extended.inputs
    assert again.parameter_names == found.extended.parameter_names
    filtered = moment_filter(again, np.asarray(found.theta)[None], wide)
    assert np.isfinite(filtered.log_likelihood[0])
    with pytest.raises(engine.SeriesError, match="name of a channel"):
        diagnose(
            DRIVE, engine.Series(wide.y, wide.u[:, :1], extra=wide.u, extra_names=["speed", "b"])
        )
    assert model.inputs == found.model.inputs


def test_extra_channels_stay_with_their_rows():
    y, extra = np.arange(8.0), np.arange(8.0) ** 2
    series = engine.Series(y, None, extra=extra, extra_names=["t2"])
    np.testing.assert_array_equal(series.part(2, 5).extra[:, 0], extra[2:5])
    np.testing.assert_array_equal(series.masked([1]).extra[:, 0], extra)
    assert series.with_extra_inputs().u_names == ("t2",)
    with pytest.raises(engine.SeriesError, match="extra has 3 rows"):
        engine.Series(y, None, extra=extra[:3])
    with pytest.raises(engine.SeriesError, match="extra is not finite at row 2, channel 't2'"):
        engine.Series(y, None, extra=np.where(extra == 4.0, np.nan, extra), extra_names=["t2"])


def test_a_held_input_and_its_trapezoid():
    """With size one the extended model is the trapezoid u_t + (u_(t+1) - u_t) / 2, states shifted."""
    rng = np.random.default_rng(4)
    u = smooth(rng, 60)
    model = extend(DRIVE, ["hold:force"], Setting(DRIVE, dt=DT))
    series = engine.Series(np.zeros(60), u, dt=DT)
    middle = engine.Series(np.zeros(60), u + 0.5 * np.append(np.diff(u), 0.0), dt=DT)
    theta = np.asarray(model.theta({"hold_force": 1.0}))
    start = np.array([0.3 - 0.5 * DT * u[0], 0.1])
    one, _ = noise_free(model, theta, series, start)
    other, _ = noise_free(DRIVE, np.asarray(DRIVE.theta()), middle, np.array([0.3, 0.1]))
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_delay_of_the_sensor_is_that_of_the_reading():
    rng = np.random.default_rng(4)
    model = extend(DRIVE, ["delay:reading"])
    series = engine.Series(np.zeros(60), levels(rng, 60), dt=DT)
    theta = np.asarray(model.theta({"delay_reading": 3.0, "delay_reading_samples": 3.0}))
    late, _ = noise_free(model, theta, series, np.array([0.3, 0.1, *np.zeros(model.nx - 2)]))
    now, _ = noise_free(DRIVE, np.asarray(DRIVE.theta()), series, np.array([0.3, 0.1]))
    np.testing.assert_allclose(late[3:], now[:-3], atol=1e-12)


def test_a_missing_mode_is_its_differential_equation():
    """Against the exact solution of q'' = w^2 (x - q) - 2 zeta w q' for a held x."""
    still = replace(
        DRIVE,
        dynamics=lambda a, u, t, dt, theta: ([a[:, 0], 0.0], [[0.0], [1.0]], np.zeros((2, 2))),
    )
    model = extend(still, ["mode:speed"])
    f, zeta = 0.7, 0.15
    theta = np.asarray(
        model.theta({"mode_speed": 1e-9, "mode_speed_frequency": f, "mode_speed_damping": zeta})
    )
    series = engine.Series(np.zeros(80), np.zeros(80), dt=DT)
    _, x = noise_free(model, theta, series, np.array([2.0, 0.0, 0.0, 0.0]))
    w = 2.0 * np.pi * f
    wd = w * np.sqrt(1.0 - zeta**2)
    t = series.t
    q = 2.0 - 2.0 * np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))
    np.testing.assert_allclose(x[:, 2], q, atol=1e-6)


def test_what_is_hidden_is_labelled_in_the_models_time():
    effects, values = ["step:flow", "drift:flow"], {"step_flow": -200.0, "step_flow_time": 20.0}
    level = engine.get_model("local-level")
    runs = [
        hide(level, effects, values, 40, np.random.default_rng(0), **clock)
        for clock in ({}, {"time_unit": "year"})
    ]
    np.testing.assert_array_equal(runs[0].y, runs[1].y)  # a label changes no number
    units = {p.name: p.unit for p in runs[1].model.parameters}
    assert (units["step_flow_time"], units["drift_flow"]) == ("year", "1e8 m^3/year")
    assert [run.series.time_unit for run in runs] == ["s", "year"]


def test_an_effect_may_act_on_a_state_that_an_earlier_one_brought():
    """A lag that nothing feels, and a force on it."""
    runs = [
        hide(
            DRIVE,
            ["pole:speed", "force:lag_speed"],
            {"pole_speed": 0.0, "pole_speed_time": 0.5, "force_lag_speed": force},
            40,
            np.random.default_rng(1),
            u=np.ones(40),
            dt=DT,
        )
        for force in (0.0, 2.0)
    ]
    place = list(runs[0].model.linear).index("lag_speed")
    off = runs[1].z[:, place] - runs[0].z[:, place]
    kept = np.exp(-DT / 0.5)
    np.testing.assert_allclose(off, 2.0 * DT * (1.0 - kept ** np.arange(40)) / (1.0 - kept))
    np.testing.assert_allclose(runs[1].y, runs[0].y)


def test_what_hides_says_what_it_does_not_know():
    rng = np.random.default_rng(0)
    with pytest.raises(engine.OptionError, match="no parameter of bias:reading"):
        hide(DRIVE, ["bias:reading"], {"bias": 1.0}, T, rng, u=np.zeros(T), dt=DT)


def test_a_score_is_the_slope_of_the_likelihood_however_well_the_states_are_seen():
    """The footprint's covariance recursion once amplified rounding on precisely measured states."""
    model = engine.get_model("structure")
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 125), 8)
    series = engine.simulate(model, None, 1000, rng, u=u, dt=0.05).series
    theta = np.asarray(model.theta())
    path = moment_path(model, theta, series)
    for name in ("gain:y2", "coulomb:v1", "level:y1"):
        effect = make_effect(name, setting_for(model, series, theta))
        extended = effect.apply(model)
        point = np.asarray(extended.theta(dict(zip(model.parameter_names, theta, strict=True))))
        column = static_column(effect, extended, point, len(theta), model, series, path)
        step = 1e-4
        ends = np.array([point, point])
        ends[:, len(theta)] = -step, step
        ends = np.clip(ends, extended.lower, extended.upper)
        values = log_likelihoods(extended, [series], ends)
        slope = (values[1] - values[0]) / (ends[1, len(theta)] - ends[0, len(theta)])
        size = float(np.linalg.norm(column.v))
        assert abs(column.s.sum() - slope) < 0.05 * size, name


def test_a_model_without_effects_is_not_called():
    calls = []

    def watched(*arguments):
        calls.append(arguments)
        raise ValueError

    model = replace(
        engine.get_model("servo"), dynamics=watched, measurement=watched, initial=watched
    )
    assert extend(model, ()) is model
    assert calls == []


def test_equations_are_of_derivatives_where_those_of_the_model_are():
    """In a model of ``engine.continuous`` x' is the derivative: an extension typed in is the one found."""
    tanks, servo = engine.get_model("tanks"), engine.get_model("servo")
    named = {one.name: one.equation for one in all_effects(Setting(tanks))}
    assert not [text for text in named.values() if re.search(r"\bdt\b", text)]
    assert named["drag:upper"] == "upper' = ... + drag_upper * -upper|upper|"
    assert named["coulomb:upper"] == "upper' = ... - coulomb_upper * sign(upper)"
    assert named["step:upper"] == "upper' = ... + step_upper * [t >= time]"
    assert named["pole:upper"].startswith(
        "l' = (upper - l) / pole_upper_time,  upper' = ... + pole_upper"
    )
    assert named["path:pump->level"].endswith("level = ... + path_pump__level * l")
    extended = extend(tanks, ["drag:upper"])
    assert extended.equations[-1] == f"drag:upper: {named['drag:upper']}"
    knots = free_function(Setting(tanks), "upper", "lower", np.arange(3.0), np.eye(3))
    assert knots.equation == "lower' = ... + function_upper_lower(upper)"
    of_steps = make_effect("drag:velocity", Setting(servo)).equation
    assert of_steps == "velocity' = ... + dt * drag_velocity * -velocity|velocity|"


def test_channels_that_are_spelled_alike_have_effects_of_their_own():
    """A record calls its columns "T 1" and "T_1", a parameter may hold neither blank nor sign."""
    level = engine.get_model("local-level")
    (unit,) = level.outputs.values()

    def twice(a, u, t, theta):
        h, C, R = level.measurement(a, u, t, theta)
        return [*h, *h], [*C, *C], np.diag([R[0][0]] * 2)

    level = replace(level, reference={})
    model = replace(level, measurement=twice, outputs={"T 1": unit, "T_1": unit})
    kinds = ["step", "bias", "drift", "gain", "variance"]
    effects = all_effects(Setting(model), kinds)
    plain = all_effects(Setting(replace(model, outputs={"T_1": unit, "E": unit})), kinds)
    assert len(effects) == len(plain)
    names = [p.name for effect in effects for p in effect.parameters]
    assert len(set(names)) == len(names)
    both = extend(model, ["step:T 1", "step:T_1"])
    assert {"step_T_1", "step_T_1_2", "step_T_1_2_time"} <= set(both.parameter_names)
    assert not shadowed(Setting(both), kinds)


def test_what_is_not_looked_for_as_a_parameter_has_its_name_is_said():
    level = engine.get_model("local-level")
    (output,) = level.outputs
    own = engine.Parameter(f"step_{output}", 0.0)
    model = replace(level, parameters=(*level.parameters, own))
    assert shadowed(Setting(model)) == [f"step:{output}"]
    assert not shadowed(Setting(level))
    rng = np.random.default_rng(0)
    series = engine.Series(y=1000.0 + rng.normal(0.0, 120.0, (60, 1)))
    found = diagnose(model, series, free=level.parameter_names, effects=["step", "bias"])
    assert any(f"Not looked for: step:{output}," in note for note in found.notes)


def test_effects_are_made_once_in_a_setting_and_anew_when_their_kind_is_replaced(monkeypatch):
    setting = Setting(engine.get_model("mixed-4"))
    one, other = (all_effects(setting, ["bias"]) for _ in range(2))
    assert [e is f for e, f in zip(one, other, strict=True)] == [True, True]
    maker, channels = catalogue._makers["bias"]
    monkeypatch.setitem(catalogue._makers, "bias", (lambda *given: maker(*given), channels))
    assert all_effects(setting, ["bias"])[0] is not one[0]
