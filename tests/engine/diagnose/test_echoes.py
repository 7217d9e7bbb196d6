"""Of a reading that comes late all comes late; a share of it, long after, is an echo and no delay."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.echoes import without_echoes
from engine.diagnose.refits.refitted import Refit
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import oven

T = 100

OVEN = oven()


def refit(late, samples=8.0, evenly=0.0):
    """Half of the reading some samples late, estimated where ``late`` of the true readings is read.

    ``evenly`` 1: all of it between now and then, at half of which is its mean.
    """
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0.0, 30.0, T // 20), 20)
    x = np.zeros(T)
    for t in range(1, T):
        x[t] = x[t - 1] * np.exp(-1 / 20.0) + 2.0 * (1 - np.exp(-1 / 20.0)) * u[t - 1]
    series = engine.Series(y=late(x) + 0.3 * rng.standard_normal(T), u=u, dt=1.0)
    fit = quasi_ml(OVEN, series)
    effect = make_effect("delay:reading", setting_for(OVEN, series, np.asarray(fit.theta)))
    known = {
        "delay_reading": samples / 2.0,
        "delay_reading_samples": samples,
        "delay_reading_evenly": evenly,
    }
    theta = effect.apply(OVEN).theta({**fit.theta.asdict(), **known})
    found = quasi_ml(effect.apply(OVEN), series, theta, [*fit.free, "delay_reading"])
    gain = 2.0 * (found.log_likelihood - fit.log_likelihood)
    return Refit(effect, found, gain, gain), series


def shifted(x, d):
    return np.concatenate([np.full(d, x[0]), x[: len(x) - d]])


@pytest.mark.long
def test_half_of_twice_as_late_is_told_as_all_of_it():
    """As the search may find it, from a probe that is too long; this one is less likely than the truth."""
    found, series = refit(lambda x: shifted(x, 4))
    assert found.size < 6.0
    (told,) = without_echoes([found], series)
    assert told.size == pytest.approx(4.0, abs=0.5)
    assert told.gain > found.gain - 4.0


@pytest.mark.long
def test_an_echo_is_no_delay():
    """Half of the reading as it is, half of it long after: no delay reads so, and the next best leads."""
    found, series = refit(lambda x: 0.5 * x + 0.5 * shifted(x, 8))
    assert found.size == pytest.approx(4.0, abs=0.8)
    assert without_echoes([found], series) == []


@pytest.mark.long
def test_a_moving_average_is_no_echo():
    """Its mean comes midway, and may come a little earlier by chance."""
    found, series = refit(lambda x: np.mean([shifted(x, d) for d in range(9)], axis=0), evenly=1.0)
    assert found.size == pytest.approx(4.0, abs=0.5)
    (told,) = without_echoes([found], series)
    assert told is found
