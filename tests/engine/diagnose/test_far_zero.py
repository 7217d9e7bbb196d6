"""Effects that are proportional to the distance from a zero that nobody declares, out of the record's range."""

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits import forms as module
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import cost
from engine.diagnose.screening.screen import Score
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import Units, mixer, referred

WORDS = {"linear:second", "linear:first", "coupling:second->first", "coupling:first->second"}
KINDS = ["linear", "coupling", "gain", "force", "bias", "input-offset"]
CHANNELS = ("first", "second", "feed", "probe")


@pytest.fixture(scope="module")
def decaying():
    """What is in the second tank decays towards nothing; the record never comes near that."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(1.0, 9.0, 20), 20)
    hidden = {"linear_second": -0.01}
    return hide(referred(mixer()), ["linear:second"], hidden, 400, rng, u=u, dt=1.0).series


def found_from(zero, series):
    """The diagnosis where all concentrations count from elsewhere."""
    units = Units(mixer(), dict.fromkeys(CHANNELS, (1.0, -zero)))
    return diagnose(units.converted(), units.series(series), effects=KINDS, seed=1)


@pytest.mark.slow
def test_a_decay_is_one_effect_wherever_concentrations_count_from(decaying):
    here, there = found_from(0.0, decaying), found_from(50.0, decaying)
    (cause,) = here.causes
    assert "linear:second" in cause.equivalent
    assert set(cause.equivalent) <= WORDS | {"gain:probe"}
    (zero,) = (value for name, value in cause.parameters.items() if name.endswith("_zero"))
    assert abs(zero) < 1.5
    (moved,) = there.causes
    assert there.verdict is here.verdict
    assert moved.equivalent == cause.equivalent
    assert moved.size == pytest.approx(cause.size, rel=1e-3)
    (other,) = (value for name, value in moved.parameters.items() if name.endswith("_zero"))
    assert other == pytest.approx(zero - 50.0, abs=1e-2)


def seen(effect, size, place):
    """A score as a screen makes it, best with the zero at this place."""
    return Score(effect, 100.0, size, 0.1 * size, 1e-9, 1.0, (place,))


@pytest.mark.long
def test_a_zero_elsewhere_is_estimated_whichever_side_it_was_seen_from(decaying):
    model = mixer()
    fit = quasi_ml(model, decaying)
    effect = make_effect("linear:second", setting_for(model, decaying, np.asarray(fit.theta)))
    middle, *outside = (probe[-1] for probe in effect.probes)
    low, high = decaying.y.min(), decaying.y.max()
    assert len(outside) == 6
    assert all(place < low or place > high for place in outside)
    ends = [refit(fit, decaying, seen(effect, -0.05 / (middle - p), p)) for p in outside[:2]]
    for end in ends:
        assert "linear_second_zero" in end.fit.free
        assert "linear_second_zero" not in end.effect.held
        assert end.gain - end.score == pytest.approx(np.log(decaying.n_measured))
    assert ends[0].gain == pytest.approx(ends[1].gain, abs=0.2)
    held = refit(fit, decaying, seen(effect, -0.01, middle))
    assert held.gain < ends[0].gain + 0.1


def test_a_declared_zero_is_looked_at_alone(decaying):
    model = referred(mixer())
    effect = make_effect("linear:second", setting_for(model, decaying, np.asarray(model.theta())))
    assert effect.probes == ((),)
    assert effect.zero is None


@pytest.mark.long
def test_the_search_for_a_zero_is_told_what_it_has_to_gain(decaying, monkeypatch):
    """Else each effect of which the data tell no zero is followed to the last digit, with one that is free."""
    model, series = mixer(), decaying.part(0, 120)
    fit = quasi_ml(model, series)
    effect = make_effect("drag:second", setting_for(model, series, np.asarray(fit.theta)))
    targets = []

    def searched(*args, target=-np.inf, **options):
        free = args[3] if len(args) > 3 else options["free"]
        if effect.zero in free:
            targets.append(target)
        return quasi_ml(*args, target=target, **options)

    monkeypatch.setattr(module, "quasi_ml", searched)
    found = refit(fit, series, seen(effect, 1e-3, effect.probes[0][-1]))
    (target,) = targets
    freed = cost(effect.with_free_zero(), series)
    # as much more as the parameter costs, log T
    null = found.fit.log_likelihood - 0.5 * found.gain
    assert target <= null + 0.5 * (found.score + freed) + 1e-9
    assert target > fit.log_likelihood


def reaction(unit, per_kelvin, zero):
    """A cooled reaction whose rate counts from absolute zero, with temperatures in a unit of one's own."""

    def kelvin(x):
        return (x - zero) / per_kelvin

    def dynamics(a, u, t, dt, theta):
        T = kelvin(a[:, 0])
        T = T + dt * (theta.a * (kelvin(u[0]) - T) + 1e5 * np.exp(-4000.0 / T))
        return [per_kelvin * T + zero], np.zeros((1, 0)), [[0.01 * per_kelvin**2]]

    return engine.MixedModel(
        name="reaction",
        nonlinear={"T": unit},
        inputs={"coolant": unit},
        outputs={"thermometer": unit},
        parameters=[engine.Parameter("a", 0.05, "1/s", (1e-3, 1.0))],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: (
            [a[:, 0]],
            np.zeros((1, 0)),
            [[0.04 * per_kelvin**2]],
        ),
        initial=lambda theta: (
            engine.Gaussian([per_kelvin * 350.0 + zero], [[per_kelvin**2]]),
            [],
            np.zeros((0, 0)),
        ),
    )


@pytest.mark.parametrize(
    ("unit", "per_kelvin", "zero"), [("degC", 1.0, -273.15), ("degF", 1.8, -459.67)]
)
def test_a_temperature_counts_from_where_there_is_none_in_whatever_unit(unit, per_kelvin, zero):
    """A gain of the coolant was another effect in degF: its zero was that of the scale."""
    rng = np.random.default_rng(3)
    u = 340.0 + np.repeat(rng.uniform(-9.0, 9.0, 20), 20)
    plain = reaction("K", 1.0, 0.0)
    here = engine.simulate(plain, plain.theta(), len(u), rng, u=u).series
    other = reaction(unit, per_kelvin, zero)
    there = engine.Series(per_kelvin * here.y + zero, per_kelvin * here.u + zero, dt=here.dt)
    settings = [
        setting_for(model, series, np.asarray(model.theta()))
        for model, series in ((plain, here), (other, there))
    ]
    for name in ("T", "coolant", "thermometer"):
        assert settings[0].zero(name) == 0.0
        assert settings[1].zero(name) == pytest.approx(zero)
        assert Setting(other).zero(name) == pytest.approx(zero)  # as an effect is hidden by
    gains = []
    for model, series, one in zip((plain, other), (here, there), settings, strict=True):
        effect, fit = make_effect("input-gain:coolant", one), quasi_ml(model, series, model.theta())
        assert effect.probes[0][-1] == pytest.approx(one.zero("coolant"))
        gains.append(refit(fit, series, seen(effect, 1e-4, effect.probes[0][-1])).gain)
    assert gains[1] == pytest.approx(gains[0], abs=1e-3)
