"""A parameter that depends on an input: the loss of a panel that grows with the wind."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, extend, make_effect
from engine.diagnose.effects.kinds.odds import only_drives
from engine.diagnose.effects.kinds.parameters import stopped_share
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.spare_inputs import with_inputs

T, DT, FINE = 500, 60.0, 20
LOSS, CAPACITY, ABSORBED, SLOPE = 22.0, 12000.0, 0.7, 1.0


def drift(a, u, t, theta):
    return [(theta.absorbed * u[0] + theta.loss * u[1]) / theta.capacity], [
        [-theta.loss / theta.capacity]
    ]


PANEL = engine.continuous(
    name="panel",
    drift=drift,
    diffusion=lambda a, u, t, theta: [[theta.q**2]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
    initial=lambda theta: (None, [25.0], [[25.0]]),
    nonlinear={},
    linear={"cell": "degC"},
    inputs={"sun": "W/m^2", "ambient": "degC"},
    outputs={"probe": "degC"},
    parameters=[
        engine.Parameter("absorbed", 0.8, "1", (0.01, 2.0)),
        engine.Parameter("loss", 20.0, "W/m^2/K", (1.0, 200.0)),
        engine.Parameter("capacity", 10000.0, "J/m^2/K", (500.0, 1e6)),
        engine.Parameter("q", 0.01, "K/s^0.5", (0.0, 1.0)),
        engine.Parameter("r", 0.3, "K", (1e-3, 5.0)),
    ],
)
FREE = ["absorbed", "loss", "q", "r"]  # all four terms may be twice as large: the capacity is held
KINDS = ["parameter-slope", "product", "path", "direct", "extra-input", "step", "input-gain"]


def record(slope, seed=1):
    """By Euler's rule at a twentieth of the sample; the wind was recorded, and the panel does not use it."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) * DT
    sun = (
        900.0 * np.abs(np.sin(2.0 * np.pi * t / 86400.0)) * np.repeat(rng.uniform(0.3, 1.0, 50), 10)
    )
    ambient = 20.0 + np.repeat(rng.normal(0.0, 2.0, 25), 20)
    wind = np.abs(np.repeat(rng.normal(3.0, 2.0, 25), 20))
    cell, y = 25.0, np.zeros((T, 1))
    for k in range(T):
        y[k] = cell + 0.3 * rng.standard_normal()
        loss = LOSS + slope * (wind[k] - 3.0)
        for _ in range(FINE):
            power = ABSORBED * sun[k] - loss * (cell - ambient[k])
            cell += (
                DT / FINE * power / CAPACITY + 0.008 * np.sqrt(DT / FINE) * rng.standard_normal()
            )
    return engine.Series(
        y, u=np.column_stack([sun, ambient]), dt=DT, extra=wind[:, None], extra_names=["wind"]
    )


def asked(model, **options):
    """The record in which the loss grows with the wind, looked at in whole."""
    return diagnose(model, record(SLOPE), effects=KINDS, processes=1, held_out=0, **options)


@pytest.mark.long
def test_a_loss_that_grows_with_a_wind_nobody_modelled_is_named_with_its_slope():
    """Without the kind it was a path, a product and an input of its own, one after another."""
    found = asked(PANEL, theta={"capacity": CAPACITY}, free=FREE)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "parameter-slope:wind->loss"
    assert cause.size == pytest.approx(SLOPE, abs=3.0 * cause.standard_error + 0.02)
    assert cause.standard_error < 0.05


@pytest.mark.long
def test_a_size_that_is_tied_as_the_whole_model_is_keeps_its_name():
    """The panel's own parameters show in ratios only, and the slope with them: that it is none is ruled out."""
    found = asked(PANEL)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "parameter-slope:wind->loss"
    assert not np.isfinite(cause.standard_error)
    assert any("Only determined together" in note for note in found.notes)
    after = found.search.final.theta
    assert cause.size / after["loss"] == pytest.approx(SLOPE / LOSS, rel=0.15)


def bounded(most):
    """The panel, its loss at most so much."""
    parameters = [
        replace(p, bounds=(1.0, most)) if p.name == "loss" else p for p in PANEL.parameters
    ]
    return replace(PANEL, parameters=parameters)


@pytest.mark.long
def test_a_bound_that_holds_back_what_changes_is_said():
    """A heat pump's COP went to 4.2 and had the bound 3.5: a second way of its power was named."""
    found = asked(bounded(23.0), theta={"capacity": CAPACITY}, free=FREE)
    assert "parameter-slope:wind->loss" in [cause.effect for cause in found.causes]
    (said,) = [one for one in found.stopped if "parameter-slope:wind->loss a bound" in one]
    assert "Wider bounds" in said
    assert "holds it back" in " ".join(str(found).split())


@pytest.mark.parametrize(("most", "share"), [(200.0, 0.0), (22.0, 0.3)])
def test_the_share_of_a_record_in_which_a_bound_stops_a_parameter(most, share):
    wind = np.arange(10.0)
    model = with_inputs(bounded(most), ["wind"])
    series = engine.Series(
        np.zeros((10, 1)), u=np.column_stack([wind, wind, wind]), dt=DT, u_names=list(model.inputs)
    )
    setting = setting_for(model, series, np.asarray(model.theta()))
    slope, plain = (make_effect(n, setting) for n in ("parameter-slope:wind->loss", "step:cell"))
    extended = slope.apply(model)  # the loss is 20 + wind - 4.5
    theta = extended.theta({slope.size.name: 1.0})
    assert stopped_share(slope, extended, theta, series) == pytest.approx(share)
    assert stopped_share(plain, extended, theta, series) == 0.0


def test_a_slope_is_asked_of_what_moves_means_and_of_channels_that_are_left_out():
    series = record(0.0)
    model = with_inputs(PANEL, ["wind"])
    there = engine.Series(
        series.y, u=np.hstack([series.u, series.extra]), dt=DT, u_names=list(model.inputs)
    )
    setting = setting_for(model, there, np.asarray(model.theta()))
    effects = all_effects(setting, ["parameter-slope"])
    channels = [e.channel for e in effects if e.family == "input"]
    wanted = [f"{u}->{p}" for p in ("absorbed", "loss", "capacity") for u in model.inputs]
    assert channels == wanted  # none of the noises q and r
    odd = {e.channel for e in effects if e.traits.odd}
    assert odd == {name for name in wanted if name.startswith("sun")}  # which drives
    effect = make_effect("parameter-slope:wind->loss", setting)
    assert effect.size.unit == "W/m^2/K"  # nothing says what the wind counts
    middle = effect.parameters[1]
    assert (middle.unit, effect.held) == ("1", (middle.name,))
    assert middle.default == pytest.approx(np.median(series.extra))


@pytest.mark.parametrize("channel", ["loss->loss", "loss->cell", "sun->nothing", "sun", ""])
def test_what_is_no_signal_onto_a_parameter_is_refused(channel):
    with pytest.raises(engine.OptionError, match="cannot enter"):
        extend(PANEL, [f"parameter-slope:{channel}"])


@pytest.mark.parametrize("outside", ["degC", "K", "degF"])
def test_what_is_odd_does_not_depend_on_how_a_temperature_is_counted(outside):
    model = replace(PANEL, inputs={"sun": "kW/m^2", "ambient": outside})
    setting = setting_for(model, record(0.0), np.asarray(model.theta()))
    odd = {source: only_drives(setting, source) for source in model.inputs}
    assert odd == {"sun": True, "ambient": False}
    unknown = replace(PANEL, inputs={"sun": "1", "ambient": "1"})
    setting = setting_for(unknown, record(0.0), np.asarray(unknown.theta()))
    assert not any(only_drives(setting, source) for source in unknown.inputs)  # nothing tells
