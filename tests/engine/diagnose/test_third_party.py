"""Effects of somebody else's: registered, listed, found, refused where they do not belong."""

import numpy as np
import pytest

import engine
from engine.diagnose import Effect, diagnose, effect_kinds, register_effect
from engine.diagnose.effects import catalogue
from engine.diagnose.effects.effect import add_to_state
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
