"""Effects of somebody else's: registered, listed, found, refused where they do not belong."""

import numpy as np
import pytest

import engine
from engine.diagnose import Course, Effect, Traits, diagnose, effect_kinds, register_effect
from engine.diagnose.effects import catalogue
from engine.diagnose.effects.effect import add_to_state
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.refitting import refit_swallowed
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from engine.statespace.model import Parameter
from tests.engine.hidden_effects import DRIVE, DT, T, hidden, levels

KIND = "magnet"


def magnet(setting, channel):
    """A detent: a force that is periodic in a state."""
    if channel not in setting.model.nonlinear:
        return None
    return Effect(
        KIND,
        channel,
        "state",
        f"detent of {channel}",
        f"{channel}' = ... + dt * magnet_{channel} * sin(6 {channel})",
        (Parameter(f"magnet_{channel}", 0.0, setting.rate(channel)),),
        lambda model: add_to_state(
            model, channel, lambda v, own: own[0] * np.sin(6.0 * v[channel])
        ),
        look_alikes={"cubic": "has no period"},
    )


@pytest.fixture
def registered():
    engine.register_effect(KIND, magnet, lambda setting: iter(setting.model.nonlinear))
    yield
    del catalogue._makers[KIND]


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_a_registered_effect_is_found_by_its_name():
    assert KIND in effect_kinds()
    series = hidden([f"{KIND}:speed"], {"magnet_speed": 1.2}, seed=3)
    found = diagnose(DRIVE, series, seed=1, effects=[KIND, "cubic", "coulomb", "drag", "latent"])
    assert [cause.effect for cause in found.causes] == [f"{KIND}:speed"]
    assert abs(found.causes[0].size - 1.2) < 4.0 * found.causes[0].standard_error
    assert "detent of speed" in str(found).lower()
    assert found.to_dict()["causes"][0]["effect"] == f"{KIND}:speed"
    again = engine.simulate(
        found.extended,
        found.theta,
        T,
        np.random.default_rng(1),
        u=levels(np.random.default_rng(2)),
        dt=DT,
    )
    assert np.isfinite(again.y).all()


@pytest.mark.usefixtures("registered")
def test_a_kind_is_not_replaced_by_accident():
    with pytest.raises(engine.OptionError, match="already registered"):
        register_effect(KIND, magnet, lambda setting: iter(()))
    register_effect(KIND, magnet, lambda setting: iter(()), replace=True)
    with pytest.raises(engine.OptionError, match="cannot enter model 'drive' at 'load'"):
        diagnose_at_load()


def diagnose_at_load():
    from engine.diagnose.effects.catalogue import extend

    return extend(DRIVE, [f"{KIND}:load"])


def test_kinds_nobody_registered_are_refused():
    with pytest.raises(engine.OptionError, match=f"effect '{KIND}' is not known"):
        diagnose(DRIVE, hidden([], {}, seed=1), effects=[KIND])


def dam(traits):
    """A maker of one's own: something starts at a time that is to be found."""

    def make(setting, channel):
        if channel not in setting.states:
            return None
        first, last = setting.span
        name = f"dam_{channel}"
        return Effect(
            "dam",
            channel,
            "time",
            f"something built on {channel}",
            f"{channel}' = ... + dt * {name} * [t >= begun]",
            (
                Parameter(name, 0.0, setting.rate(channel)),
                Parameter(f"{name}_begun", 0.5 * (first + last), "s", (first, last)),
            ),
            lambda model: add_to_state(model, channel, lambda v, own: own[0] * (v.t >= own[1])),
            probes=((0.5 * (first + last),),),
            traits=traits,
        )

    return make


@pytest.fixture
def make_dam():
    def register(traits):
        register_effect("dam", dam(traits), lambda setting: iter(setting.states), replace=True)

    yield register
    del catalogue._makers["dam"]


@pytest.mark.slow
def test_an_effect_over_time_is_sought_at_every_time(make_dam):
    make_dam(Traits(Course.STEP))
    values = {"dam_speed": 0.9, "dam_speed_begun": 23.0}
    series = hidden(["dam:speed"], values, seed=4)
    found = diagnose(DRIVE, series, seed=1, effects=["dam", "cubic", "drag", "latent"])
    assert [cause.effect for cause in found.causes] == ["dam:speed"]
    assert abs(found.causes[0].parameters["dam_speed_begun"] - 23.0) <= 5 * DT
    assert "blocks" in found.gain.how or "every fifth block" in found.gain.how


@pytest.mark.parametrize("swallowed", [True, False])
def test_an_effect_that_process_noise_swallows_is_refitted_all_the_same(make_dam, swallowed):
    make_dam(Traits(Course.STEP, swallowed=swallowed))
    series = hidden([], {}, seed=5)
    fit = quasi_ml(DRIVE, series)
    setting = setting_for(DRIVE, series, fit.theta)
    seen = screen_effects(fit, series, setting, ["dam"], 0.05, 0, nobody)
    refitted = {r.effect.kind for r in refit_swallowed(fit, series, seen, nobody)}
    assert refitted == ({"dam"} if swallowed else set())


def nobody(stage, fraction):
    """Is not told of progress."""


def test_a_plainer_effect_of_ones_own_stands_for_the_same_thing(make_dam, monkeypatch):
    from types import SimpleNamespace

    from engine.diagnose.effects.setting import Setting
    from engine.diagnose.refits import likeness

    monkeypatch.setattr(likeness, "held_out_terms", lambda fit, series: np.ones(4))
    setting = Setting(DRIVE)
    said = {}
    for plainness in (0, 50):
        make_dam(Traits(Course.STEP, plainness=plainness))
        both = [
            SimpleNamespace(effect=catalogue.make_effect(name, setting), score=40.0, fit=None)
            for name in ("dam:speed", "step:reading")
        ]
        said[plainness] = [r.effect.name for r in likeness.distinct(both, None, setting)]
    assert said == {0: ["dam:speed"], 50: ["step:reading"]}
