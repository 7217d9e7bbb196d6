"""What a page says in place of numbers that mean nothing, and of units that are none."""

from __future__ import annotations

import copy
import re
from dataclasses import asdict, replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose import Cause, LookAlike, diagnose, extend, make_effect
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.extended import at_bounds, in_the_library
from engine.diagnose.judging.findings import AS_LIKELY, LESS_LIKELY, SAME
from engine.diagnose.refits.latent_force import UnnamedForce, unnamed_force
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.symptoms.residuals import autocorrelation
from engine.estimation.quasi_ml import quasi_ml
from engine.models.linear_2 import MODEL as LINEAR
from engine.presentation.cause_sentences import (
    experiment,
    headline,
    late,
    not_told_apart,
    phrased,
    sample_step,
    standing,
    when,
)
from engine.presentation.report import diagnosis_summary, report_html
from engine.presentation.report.parts import pretty, prose, with_time
from engine.simulation.simulate import simulate
from engine.words import (
    bounds,
    estimate,
    fit_quality,
    hardly_told,
    held_by_bounds,
    number,
    percent,
    tidy,
)


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("", ""), ("1", ""), ("(1)", ""), ("1^2", ""), ("()^2", ""), ("1/1", ""), ("(^2)", ""),
        ("/s", "1/s"), ("/s/(^2)", "1/s"), ("1/s/(1^2)", "1/s"), ("/s/()^3", "1/s"), ("1/(1 s)", "1/s"),
        ("(/s)^2", "(1/s)^2"), ("V/()", "V"), ("s 1", "s"), ("m^1", "m"), ("(degC)^2", "degC^2"),
        ("degC/s/(degC^2)", "degC/s/degC^2"), ("m/s/s/(m/s)^2", "m/s/s/(m/s)^2"), ("1e8 m^3", "1e8 m^3"),
        ("1/(kg m^2)", "1/(kg m^2)"), ("m^10", "m^10"), ("m^1.5", "m^1.5"), ("N s/m", "N s/m"),
        ("%^2/s", "%^2/s"),
        ("1/(%^2)", "1/%^2"),
        ("1/(°C)", "1/°C"),
    ],
)  # fmt: skip
def test_units_without_what_says_nothing(unit, said):
    assert tidy(unit) == said
    assert tidy(tidy(unit)) == said


def test_powers_are_raised_and_brackets_kept():
    assert pretty("1e-08/m^3/year") == "10⁻⁸/m³/year"
    assert prose("From 2 m^3 to 5 x 1e8 m^3. Or V^1.5.") == "From 2 m³ to 5 × 10⁸ m³. Or V^1.5."
    assert pretty("1/(kg m^2)") == "1/(kg m²)"
    assert pretty("(m/s)^(-1)") == "(m/s)⁻¹"
    assert prose("3 +- 1 rad/s/(rad/s)^2") == "3 ± 1 rad/s/(rad/s)²"


@pytest.mark.parametrize(
    ("value", "error", "numbers"),
    [
        (0.52, 0.03, ["0.52", "0.03"]),
        (3.93123e-5, 5.2e-8, ["3.931e-05", "5.2e-08"]),  # as many digits as the error calls for
        (-5.0, 1.0, ["-5", "1"]),
        (0.0, 1122.0, ["1122"]),  # the standard error, and no size
        (0.4, 0.5, ["0.5"]),
        (2.0, np.inf, ["2"]),
        (2.0, np.nan, ["2"]),
        (2.0, 0.0, ["2"]),
        (2.0, None, ["2"]),
        (np.nan, 1.0, []),
        (1e300, np.inf, ["1e+300"]),
    ],
)
def test_an_estimate_holds_the_numbers_that_the_data_determine(value, error, numbers):
    said = estimate(value, error, "N")
    assert re.findall(r"-?\d[\d.]*(?:e[+-]\d+)?", said) == numbers
    assert ("+-" in said) == (len(numbers) == 2)


def test_what_a_bound_has_stopped_is_named_with_what_to_do():
    assert held_by_bounds([]) == ""
    one, two = held_by_bounds(["k"]), held_by_bounds(["k", "q"])
    assert one.startswith("Stopped by a bound: k. The data draw it there")
    assert two.startswith("Stopped by a bound: k, q. The data draw them there")
    for said in (one, two):
        assert "Parameter(bounds=)" in said
        assert "(free=)" in said


def test_a_variance_at_a_bound_next_to_nothing_needs_no_wider_one():
    """As models are begun with: q from 0.01, not below 1e-8. A stiffness that stops at 5 is another thing."""
    model = replace(
        LINEAR,
        parameters=(
            engine.Parameter("q", 0.01, "", (1e-8, 10.0)),
            engine.Parameter("r", 1e-4, "", (1e-8, 1.0)),
            engine.Parameter("k", 40.0, "", (5.0, 300.0)),
        ),
    )

    def said(**values):
        return model.held_in_words(values, ("q", "r", "k"))

    assert said(q=1e-8) == "The data ask for no q: it is at a bound next to 0."
    assert said(q=1e-8, r=1e-8) == "The data ask for no q and no r: these are at bounds next to 0."
    assert said(k=5.0).startswith("Stopped by a bound: k. The data draw it there")
    both = said(q=1e-8, k=5.0)
    assert both.startswith("Stopped by a bound: k. ")
    assert both.endswith("The data ask for no q: it is at a bound next to 0.")
    assert said(q=10.0).startswith("Stopped by a bound: q.")


def test_a_parameter_whose_error_is_larger_than_its_bounds_is_hardly_told():
    model = replace(
        LINEAR,
        parameters=(
            engine.Parameter("V", 20.0, "l", (1.0, 50.0)),
            engine.Parameter("k", 40.0, "", (5.0, np.inf)),
        ),
    )

    def said(**errors):
        return hardly_told(model.hardly_known({"V": 20.0}, errors))

    assert said(V=364.0).startswith("These data hardly tell V: its standard error is larger")
    assert said(V=29.0) == ""  # an end of its bounds is further away than that
    assert said(k=1e9) == ""  # whose bounds leave it everything
    assert said(V=np.inf) == ""  # tied to others, which is told elsewhere


def test_neighbouring_bounds_and_small_shares_can_be_told_apart():
    assert bounds(26.68, 26.73, "g/L") == ("26.68 g/L", "26.73 g/L")
    assert bounds(1.0, 2.0, "V") == ("1 V", "2 V")
    assert bounds(1000.0001, 1000.0002)[0] != bounds(1000.0001, 1000.0002)[1]
    assert bounds(173.4, 174.4, "m") == ("173.4 m", "174.4 m")  # no 173 to 174 m
    assert bounds(3.0, 3.0) == ("3", "3")
    assert percent(0.0003) == "less than 0.1 %"
    assert percent(0.0) == "0 %"
    assert fit_quality(-1e17) == fit_quality(-0.1) != fit_quality(0.1)
    assert fit_quality(None) == fit_quality(float("nan"))


# ---- the unnamed force -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def forced():
    """A refitted unnamed force, and the series it acts in."""
    values, rng = {"latent_z": 1.0, "latent_z_time": 20.0}, np.random.default_rng(3)
    series = hide(LINEAR, ["latent:z"], values, 200, rng).series
    effect = make_effect("latent:z", setting_for(LINEAR, series, LINEAR.theta()))
    return Refit(effect, quasi_ml(effect.apply(LINEAR), series), 50.0, 50.0), series


@pytest.mark.long
def test_a_force_is_shown_where_the_data_determine_it(forced):
    refit, series = forced
    force = unnamed_force(refit, series)
    assert force is not None
    assert np.abs(force.mean).max() < 5.0 * np.sqrt(refit.size)
    clear = np.abs(force.mean) > 2.0 * force.sd
    assert f"{number(float(np.sqrt(np.mean(force.mean**2))))} 1/s rms" in force.sentence
    assert percent(float(clear.mean())) in force.sentence


def test_a_force_without_variance_is_none(forced):
    refit, series = forced
    theta = np.asarray(refit.fit.theta).copy()
    theta[refit.fit.model.index("latent_z")] = 0.0
    fit = replace(refit.fit, theta=engine.Theta(theta, refit.fit.model.parameter_names))
    assert unnamed_force(replace(refit, fit=fit), series) is None


def test_a_force_that_rounding_errors_made_is_none(forced, monkeypatch):
    refit, series = forced

    def lost(path):
        means = np.zeros((len(series), 3))
        means[:, -1] = 1.58e15
        return means, np.broadcast_to(np.eye(3), (len(series), 3, 3))

    monkeypatch.setattr(import_module("engine.diagnose.refits.latent_force"), "smoothed", lost)
    assert unnamed_force(refit, series) is None


def test_a_force_that_is_nowhere_clear_has_no_size():
    t = np.arange(5.0)
    force = UnnamedForce("c2", "g/L/s", t, np.array([0.0, 1.0, -1.0, 0.5, 0.1]), np.ones(5))
    assert not re.search(r"\d", force.sentence.replace("c2", ""))
    assert "nan" not in UnnamedForce("x", "", t, np.zeros(5), np.zeros(5)).sentence


def test_a_force_that_acts_in_one_row_has_no_stretch():
    """Of a quarterly record it was 'within a stretch from 1981 to 1981 year'."""
    t = 1980.0 + 0.25 * np.arange(6)
    for course, said in (
        ([1.0, -1.0, 1.0, -1.0, 4.0, -1.0], "at t = 1981 year."),
        (
            [1.0, -1.0, 1.0, 3.0, 4.0, -1.0],
            "at t = 1981 year, within a stretch from 1980.5 to 1981",
        ),
    ):
        force = UnnamedForce("level", "m/year", t, np.array(course), np.full(6, 0.1), "year")
        assert said in force.sentence


# ---- causes ------------------------------------------------------------------------------------


def cause(equivalent, look_alikes=(), size=1.0, error=0.1):
    return Cause(
        "linear:air", "linear damping", "state", "air' = ...", size, "/s", error, {}, 0.01, 40.0,
        equivalent, look_alikes,
    )  # fmt: skip


def test_advice_is_given_on_what_is_in_the_set_only():
    same = LookAlike("saturation:air", 0.9, 41.0, False, "says the same in other words here")
    other = LookAlike("cubic:air", 0.9, 40.0, False, "an odd function")
    assert experiment(cause(("linear:air",), (same, other))) == ""
    said = experiment(cause(("linear:air", "quadratic:air"), (same,)))
    assert said
    assert "saturation" not in said
    assert "same in other words" not in said
    assert "cubic:air is an odd function" in experiment(
        cause(("linear:air", "cubic:air"), (other,))
    )
    force = LookAlike("latent:air", 0.9, 40.0, False, "moves the state")
    again = experiment(cause(("linear:air", "latent:air"), (force,)))
    assert "same inputs" in again
    assert "excite" not in again


def test_a_headline_has_no_size_within_its_error():
    assert "0 +-" not in headline(cause(("linear:air",), size=0.0, error=1122.0))
    assert "inf" not in headline(cause(("linear:air",), error=np.inf))
    assert "1 +- 0.1 1/s" in headline(cause(("linear:air",)))


def test_a_delay_is_told_in_time_too_where_samples_are_evenly_apart():
    delay = replace(
        cause(("delay:u",), size=2.0), effect="delay:u", unit="samples", where="input",
        parameters={"delay_u": 2.0, "delay_u_samples": 2.0},
        units={"delay_u": "samples", "delay_u_samples": "samples"},
    )  # fmt: skip
    assert "2 +- 0.1 samples (0.02 s), p = 0.01" in headline(delay, 0.01, "s")
    assert "2 +- 0.1 samples (10 min), p" in headline(delay, 5.0, "min")
    assert "2 +- 0.1 samples, p" in headline(delay)
    assert "(0" not in late(replace(delay, size=0.05), 0.01, "s")  # of no certain size
    assert late(cause(("linear:air",)), 0.01, "s") == ""
    shown = with_time({**asdict(delay), "late": late(delay, 0.01, "s")})
    assert shown.replace("\u202f", " ").endswith("samples (0.02 s)")
    assert with_time(asdict(delay)).endswith("samples")  # as earlier versions wrote it


def test_noise_that_is_estimated_as_a_square_is_told_as_a_share_of_the_reading():
    noise = replace(
        cause(("relative-noise:y",), size=4.2e-4, error=5e-5), effect="relative-noise:y", unit="1"
    )
    assert "0.00042 +- 5e-05 (2.0 % of the reading), p = 0.01" in headline(noise, 0.01, "s")
    grown = replace(noise, effect="relative-noise:stock", size=0.04, unit="1/year")
    assert "(20 % of stock in 1 year), p = 0.01" in headline(grown, 1.0, "year")


def test_the_step_of_a_record_is_that_of_its_samples():
    even = Series(np.zeros((5, 1)), dt=0.1)
    assert sample_step(even) == pytest.approx(0.1)
    assert sample_step(even.refined(4)) == pytest.approx(0.1)
    assert sample_step(Series(np.zeros((3, 1)), t=[0.0, 1.0, 3.0])) is None


def test_a_gain_is_told_beside_what():
    one = cause(("linear:air",))
    assert headline(replace(one, beside=("step:y", "bias:y"))).endswith("beside step:y and bias:y")
    assert headline(replace(one, together=("step:y",))).endswith("together with step:y")


def test_names_that_say_the_same_and_those_not_ruled_out_are_told_apart():
    others = (
        LookAlike("input-offset:u", 1.0, 40.0, False, SAME),
        LookAlike("drag:v", 0.9, 37.0, False, f"{LESS_LIKELY} 4.5, too little to rule it out"),
        LookAlike("cubic:v", 0.9, 39.0, False, AS_LIKELY),
        LookAlike("step:y", 0.1, 3.0, True, ""),
    )
    one = replace(cause(("force:v",)), look_alikes=others)
    assert one.in_other_words == ("input-offset:u",)
    assert one.not_ruled_out == ("drag:v", "cubic:v")


def test_a_headline_has_no_negative_gain():
    """The free run may name what gains nothing one step ahead."""
    assert headline(cause(("linear:air",))).endswith("gained 40")
    assert headline(replace(cause(("linear:air",)), gain=-3.28)).endswith("gain nothing")


def test_what_the_data_say_of_others_is_no_more_than_they_do():
    """Only what was refitted to its end and lost is ruled out; a refit that was left is behind, and no more."""
    chosen = ("linear:air", "cubic:air")
    said = [
        standing(LookAlike(name, 0.9, gain, out, why), chosen)
        for name, gain, out, why in (
            ("cubic:air", 39.0, False, ""),
            ("drag:air", 4.0, True, ""),
            ("colored:room", 12.0, False, ""),
            ("bias:room", None, False, ""),
            ("saturation:air", 41.0, False, SAME),
            ("force:air", 37.0, False, f"{LESS_LIKELY} 4, too little to rule it out"),
            ("mode:air", 39.0, False, AS_LIKELY),
        )
    ]
    assert said == [
        "not told apart", "ruled out", "behind, its refit left early", "not ruled out", "the same here",
        "not ruled out", "not ruled out",
    ]  # fmt: skip


def test_a_headline_says_over_what_time_a_drift_has_its_size():
    values = {"drift_air": 0.5, "drift_air_middle": 100.0, "drift_air_per": 199.5}
    found = replace(cause(("drift:air",)), where="time", unit="K", parameters=values)
    found = replace(found, units={"drift_air_middle": "min", "drift_air_per": "min"})
    assert "1 +- 0.1 K, over 199.5 min, p = 0.01" in headline(
        found
    )  # once like a rate in other units


def test_a_headline_says_at_which_limit_a_signal_saturates():
    values = {"clip_heating": 1.0, "clip_heating_limit": 5.03, "clip_heating_side": 1.0}
    found = replace(cause(("linear:air",)), parameters=values, units={"clip_heating_limit": "kW"})
    assert when(found) == ", limit 5.03 kW"
    assert ", limit 5.03 kW, p = 0.01" in headline(found)
    duty = replace(found, units={"clip_heating_limit": "1"})
    assert when(duty) == ", limit 5.03"  # a pure number has no unit: once "5.03 1"
    crowd = replace(found, units={"clip_heating_limit": "1000 persons"})
    assert when(crowd) == ", limit 5.03 x 1000 persons"


@pytest.mark.parametrize(
    ("side", "zero", "told"),
    [(1.0, 0.0, ", limit 1.25 m/s"), (-1.0, 0.0, ", lower limit 1.25 m/s"),
     (0.0, 3.0, ", limits 1.25 m/s and 4.75 m/s"), (0.0, None, ", limit 1.25 m/s on both sides")],
)  # fmt: skip
def test_a_headline_says_on_which_side_a_signal_saturates(side, zero, told):
    """An anemometer that stands still below 1.25 m/s was told as one that reads no more than that."""
    values = {"clip_wind": 1.0, "clip_wind_limit": 1.25, "clip_wind_side": side}
    values |= {} if zero is None else {"clip_wind_zero": zero}
    found = replace(cause(("linear:air",)), parameters=values, units={"clip_wind_limit": "m/s"})
    assert when(found) == told


@pytest.mark.parametrize("kind", ["play", "input-deadzone"])
def test_a_title_says_of_which_half_a_slack_the_size_is(kind):
    """A valve with 5 % of backlash was told to have 2.5 %: sizes are half of what data sheets give."""
    effect = make_effect(f"{kind}:drive", Setting(engine.get_model("servo")))
    assert "half" in effect.size.description
    assert effect.title.endswith("of the input drive, to either side")


def test_what_stands_in_for_several_is_not_told_of_each():
    """A slow sensor beside two other causes was "not told apart from" a drift, which stood in for all three."""
    names = ("slow-sensor:tc", "path:duty->gas", "drift:tc")
    assert not_told_apart(names[:1], ("cubic:gas",)) == ""
    assert not_told_apart(names, ()) == "not told apart from path:duty->gas or drift:tc"
    assert not_told_apart(names, ("cubic:gas",)) == (
        "not told apart, by itself or together with cubic:gas, from path:duty->gas or drift:tc"
    )
    shown = diagnosis_summary._headline(asdict(replace(cause(names), together=("cubic:gas",))))
    assert "by itself or together with cubic:gas" in str(shown)


def test_a_headline_says_when_it_happens():
    parameters = {"step_y": 3.0, "step_y_time": 1899.0}
    once = replace(
        cause(("step:y",)), where="time", parameters=parameters, units={"step_y_time": "year"}
    )
    assert "time 1899 year" in headline(once)
    lasting = replace(once, where="noise", parameters={"variance_y_time": 18.4})
    assert "18.4" not in headline(lasting)


# ---- whole pages -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def named():
    """A user's own model with a force that it does not know, gaps in the readings, a parameter at its bound."""

    def dynamics(a, u, t, dt, theta):
        loss = dt * theta.loss
        return [a[:, 0] - loss * a[:, 0] + dt * u[0]], np.zeros((1, 0)), [[theta.q]]

    def measurement(a, u, t, theta):
        return [a[:, 0]], np.zeros((1, 0)), [[theta.r]]

    def initial(theta):
        return engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))

    model = engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"level": ""},
        inputs={"pump": "1/s"},
        outputs={"gauge": ""},
        parameters=[
            engine.Parameter("loss", 0.1, "1/s", (0.0, 2.0)),
            engine.Parameter("q", 1e-3, "", (1e-4, 1.0)),
            engine.Parameter("r", 0.01, "", (1e-8, 1.0)),
        ],
    )
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(0.0, 1.0, 20), 15)
    y, level = [], 0.0
    for pump in u:
        y.append(level + 0.1 * rng.standard_normal())
        level += 0.2 * (pump - 0.3 * level + 0.5)
    y = np.array(y)
    y[40:47] = np.nan
    y[60:200:3] = np.nan
    return diagnose(model, Series(y, u, dt=0.2), effects=["force", "bias", "cubic"], seed=1)


@pytest.mark.slow
def test_a_model_that_is_not_registered_is_not_got_by_its_name(named):
    assert named.causes
    assert not in_the_library(named).count("get_model")
    assert "get_model" not in str(named)
    assert "get_model" not in report_html(named.to_dict())
    effects = [c.effect for c in named.causes]
    assert repr(effects) in in_the_library(named)
    again = extend(named.model, effects)
    assert again.parameter_names == named.extended.parameter_names
    registered = SimpleNamespace(model=LINEAR, causes=named.causes, substeps=1)
    assert "get_model('linear-2', effects=" in in_the_library(registered)
    renamed = replace(named.model, name="linear-2")
    own = SimpleNamespace(model=renamed, causes=named.causes, substeps=1)
    assert "get_model" not in in_the_library(own)  # a name alone is not enough
    finer = SimpleNamespace(model=renamed, causes=named.causes, substeps=4)
    assert "series.refined(4)" in in_the_library(finer)


@pytest.mark.long
def test_parameters_that_a_bound_has_stopped_have_no_standard_error(named):
    for fit in (named.search.base, named.search.final):
        theta = fit.theta.asdict()
        stopped = [p.name for p in fit.model.parameters if theta[p.name] in p.bounds]
        assert at_bounds(fit) == stopped
    assert named.to_dict()["extension"]["at_bounds"]["after"] == at_bounds(named.search.final)
    assert at_bounds(named.search.final)  # q: the process is without noise
    row = next(line for line in str(named).splitlines() if line.startswith("  q "))
    assert row.endswith("at bound")


@pytest.mark.long
def test_the_page_of_a_unitless_model_has_no_broken_unit(named):
    text = str(named) + " ".join(re.findall(r">([^<]*)<", report_html(named.to_dict())))
    assert not re.search(r"(?<![\w.)])/s|\(\^|\(\)|\bnan\b|\binf\b", text)


def test_the_page_says_the_decision_with_its_numbers(named):
    gain = named.gain
    document = named.to_dict()["gain"]
    assert document["adopt"] is gain.adopt
    assert document["decision"]["outcome"] == gain.decision.value
    page = " ".join(str(named).split())
    assert document["decision"]["in_full"] in page
    assert document["decision"]["in_short"] in page
    assert ("Not adopted" in page) != gain.adopt
    refused = copy.deepcopy(named.to_dict())
    refused["gain"]["adopt"] = False
    refused["gain"]["decision"] = {
        "outcome": "no evidence", "in_short": "NOT adopted: so.", "in_full": "Not adopted, so.",
    }  # fmt: skip
    html = report_html(refused)
    assert html.count("the model stays as it is") == 2  # at a glance, and beside the extension
    assert 'class="warn">Not adopted, so.' in html


@pytest.mark.long
def test_pictures_and_data_show_the_same_autocorrelation(named):
    pytest.importorskip("matplotlib")
    z = named.symptoms.z[:, 0]
    assert np.isnan(z).any()
    drawn = named.figures()["residuals"].axes[1].patches
    heights = np.array([bar.get_height() for bar in drawn])
    data = named.to_dict()["symptoms"]["residuals"]["autocorrelation"]["gauge"]["r"]
    np.testing.assert_array_equal(heights, data)
    np.testing.assert_allclose(heights, autocorrelation(z, len(heights))[0], atol=1e-6)


def test_nothing_found_leaves_one_column_of_estimates():
    series = simulate(LINEAR, None, 200, np.random.default_rng(8)).series
    clean = diagnose(LINEAR, series, effects=["bias", "cubic"], seed=1)
    assert clean.verdict.value == "nothing"
    rows = [line.split() for line in str(clean).splitlines() if line.startswith("  theta ")]
    error = clean.search.final.standard_errors[0]
    assert rows == [["theta", number(float(clean.theta["theta"]), 4), number(error, 2)]]


def test_no_estimate_has_more_digits_than_a_number_holds():
    """A share that is at its bound; a time since 1970 keeps its tenths."""
    assert estimate(0.99999999999979, 1.7e-13) == "1 +- 1.7e-13"
    assert estimate(1700000123.4, 0.5, "s") == "1700000123.4 +- 0.5 s"


def test_what_tells_look_alikes_apart_is_said_with_one_verb():
    """``it is a constant force through the same equation looks alike`` was said once."""
    verbs = re.compile(r"\b(is|does|looks|rings|stays|acts|moves|decays|goes|comes)\b")
    for model in (LINEAR, engine.get_model("servo"), engine.get_model("tanks")):
        for effect in all_effects(Setting(model)):
            for kind, difference in effect.look_alikes.items():
                said = phrased(difference)
                article = difference.startswith(("a ", "an "))
                assert not (article and verbs.search(difference)), (effect.kind, kind, said)


def test_what_tells_a_look_alike_apart_reads_on_after_it():
    """A verb first, as in ``; it is one of its terms only``: of two kinds there was none."""
    settings = [
        Setting(engine.get_model(name), span=(0.0, 10.0), dt=0.1) for name in ("servo", "tanks")
    ]
    differences = {
        phrased(text)
        for setting in settings
        for effect in all_effects(setting)
        for text in effect.look_alikes.values()
        if text
    }
    assert len(differences) > 30
    assert [text for text in differences if not re.match(r"\w+s\b", text)] == []
