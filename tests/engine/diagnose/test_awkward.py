"""Data and starts as they come: an honest verdict or a clear error, never a crash."""

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict, diagnose
from tests.engine.hidden_effects import DRIVE, hidden

FAR = {"damping": 9.0, "load": 0.01}
SEEDS = (0, 1, 2)
SHORT = 240


def clean(seed, n=SHORT, constant=False):
    force = (lambda rng, n: np.ones(n)) if constant else None
    return hidden([], {}, seed, n=n, **({} if force is None else {"force": force}))


def with_y(series, y):
    return engine.Series(y, series.u, t=series.t)


def gaps(seed):
    series = clean(seed)
    y = series.y.copy()
    y[60:100] = np.nan
    y[np.random.default_rng(seed).random(len(y)) < 0.2] = np.nan
    return with_y(series, y)


def outliers(seed):
    """Two readings in a hundred are off by thirty standard deviations of the noise."""
    rng = np.random.default_rng(seed + 100)
    series = clean(seed, n=400)
    y = series.y.copy()
    bad = rng.random(len(y)) < 0.02
    y[bad] += rng.standard_normal((int(bad.sum()), 1))
    return with_y(series, y)


def clipped(seed):
    series = clean(seed)
    return with_y(series, np.clip(series.y, -0.6, 0.6))


def sparse(seed):
    series = clean(seed, n=400)
    y = np.full_like(series.y, np.nan)
    y[::9] = series.y[::9]
    return with_y(series, y)


NOTHING_IN_THEM = {
    "gaps": gaps,
    "short": lambda seed: clean(seed, n=60),
    "unexcited": lambda seed: clean(seed, constant=True),
    "sparse": sparse,
}


def looked_at(series, theta=None, effects=None):
    """A diagnosis whose page and document can be made."""
    found = diagnose(DRIVE, series, theta=theta, seed=1, effects=effects)
    assert found.verdict.value.upper() in str(found)
    assert found.to_dict()["verdict"] == found.verdict.value
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTHING_IN_THEM)
def test_poor_data_in_which_nothing_is_hidden(name):
    assert looked_at(NOTHING_IN_THEM[name](0)).verdict is Verdict.NOTHING


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTHING_IN_THEM)
def test_poor_data_raise_no_more_alarms_than_good_data(name):
    """Of ten series at a family-wise 5 %, three or more alarms have probability 1.2 %."""
    verdicts = [looked_at(NOTHING_IN_THEM[name](seed)).verdict for seed in range(10)]
    assert sum(verdict is not Verdict.NOTHING for verdict in verdicts) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("effects", [None, ["heavy-tails", "bias", "gain"]], ids=["all", "few"])
def test_two_outliers_in_a_hundred_are_seen_as_such(effects):
    """Seven outliers; with twelve as large the verdict is unknown, with notes but without the name."""
    found = looked_at(outliers(0), effects=effects)
    assert "heavy-tails:reading" in found.causes[0].equivalent
    assert any("robust standard deviations" in note for note in found.notes)


@pytest.mark.slow
def test_a_clipped_sensor_is_named_or_unknown():
    for seed in range(3):
        found = looked_at(clipped(seed))
        assert found.verdict in (Verdict.NAMED, Verdict.SET, Verdict.UNKNOWN)
        assert any(cause.effect == "saturation-sensor:reading" for cause in found.causes)
        assert any("clipped" in note for note in found.notes)


def test_without_a_reading_there_is_a_clear_error():
    series = clean(0)
    with pytest.raises(engine.SeriesError, match="every value of y is missing"):
        diagnose(DRIVE, with_y(series, np.full_like(series.y, np.nan)))
    y = series.y.copy()
    y[29:] = np.nan
    with pytest.raises(
        engine.SeriesError,
        match=r"only 29 rows hold a measurement; .* at least 30",
    ):
        diagnose(DRIVE, with_y(series, y))
