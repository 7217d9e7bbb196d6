"""Noise that is named one step ahead is not, where it does not explain what the free run gets wrong."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import engine
from engine.diagnose.free_run import second_opinion
from engine.diagnose.free_run.null import Alarm
from engine.diagnose.judging.findings import Verdict


def discharge():
    """A capacitor through a resistor, as its model is written by hand."""
    return engine.continuous(
        name="discharge",
        drift=lambda a, u, t, th: ([-a[:, 0] / th.tau], np.zeros((1, 0))),
        diffusion=lambda a, u, t, th: [[th.q]],
        measurement=lambda a, u, t, th: ([a[:, 0] + th.offset], np.zeros((1, 0)), [[th.r]]),
        initial=lambda th: (engine.Gaussian([th.V0], [[1e-4]]), [], np.zeros((0, 0))),
        nonlinear={"V": "V"},
        outputs={"volts": "V"},
        parameters=[
            engine.Parameter("tau", 0.44, "s", (0.01, 10.0)),
            engine.Parameter("V0", 8.9, "V", (0.0, 20.0)),
            engine.Parameter("offset", 0.3, "V", (-2.0, 2.0)),
            engine.Parameter("q", 1e-3, "V^2/s", (1e-10, 10.0)),
            engine.Parameter("r", 1e-4, "V^2", (1e-10, 10.0)),
        ],
    )


def smoothed(seed):
    """Readings of which each is half the one before: what that gets wrong is large at the beginning."""
    rng, t = np.random.default_rng(seed), 0.04 * np.arange(50)
    y = 0.3 + 8.9 * np.exp(-t / 0.42) + 0.004 * rng.standard_normal(50)
    for k in range(1, 50):
        y[k] = 0.5 * (y[k - 1] + y[k])
    return engine.Series(y, t=t, y_names=("volts",))


@pytest.mark.long
def test_it_is_left_open(monkeypatch):
    asked = []

    def alarm(self, seed, level):
        named = "variance_V_V" in self.start.model.parameter_names
        asked.append(named)
        p = 1.0 / 300.0 if named else 1.0
        return Alarm(p / 3.0, 1.0, 1.0, 0.05, 0.04, 3.0)

    model, series = discharge(), smoothed(1)
    named = engine.diagnose(model, series, effects=["variance"])
    assert named.verdict is Verdict.NAMED  # nothing else is looked for
    assert named.causes[0].effect.startswith("variance:")
    monkeypatch.setattr(second_opinion._Beside, "alarm", alarm)
    found = engine.diagnose(model, series, effects=["variance"])
    assert asked == [False, True] * (len(asked) // 2)
    assert found.verdict is Verdict.UNKNOWN
    assert "so it is not named" in str(found)
    assert "NOT adopted" in str(found)


@pytest.mark.long
@pytest.mark.parametrize(("by_name", "holds"), [(0.06, True), (0.04, False)])
def test_noise_of_readings_is_asked_by_its_name_before_a_pattern_counts(
    monkeypatch, by_name, holds
):
    """The noisiest readings had a pattern that noise of one size does not have, and so a sensor was named."""

    def alarm(self, seed, level):
        p = by_name if "relative_noise_volts" in self.start.model.parameter_names else 0.003
        return Alarm(p / 3.0, 1.0, 1.0, 0.05, 0.04, 3.0)

    monkeypatch.setattr(second_opinion._Beside, "alarm", alarm)
    rng, t = np.random.default_rng(4), 0.04 * np.arange(80)
    v = 8.9 * np.exp(-t / 0.6) + 0.3
    y = v * (1.0 + 0.05 * rng.standard_normal(80)) + 0.01 * rng.standard_normal(80)
    series = engine.Series(y, t=t, y_names=("volts",))
    found = engine.diagnose(discharge(), series, effects=["relative-noise"])
    assert found.free_run.likelihood is Verdict.NAMED
    assert (found.free_run.search is None) is holds
    assert [cause.effect for cause in found.causes] == ["relative-noise:volts"]


@pytest.mark.parametrize(
    ("effects", "of_readings"),
    [
        (["level:y"], True),
        (["relative-noise:y", "variance:y->x"], True),
        (["relative-noise:y", "variance:x->u"], False),
        (["colored:y"], False),  # adds up
    ],
)
def test_which_noise_is_of_readings(effects, of_readings):
    refits = [
        SimpleNamespace(
            effect=SimpleNamespace(
                channel=name.partition(":")[2],
                traits=SimpleNamespace(noise_level=not name.startswith("colored")),
            )
        )
        for name in effects
    ]
    causes: Any = SimpleNamespace(
        search=SimpleNamespace(rounds=[SimpleNamespace(equivalent=refits)])
    )
    model: Any = SimpleNamespace(outputs={"y": "m"})
    assert second_opinion._is_of_readings(causes, model) is of_readings


@pytest.mark.parametrize(
    ("families", "outliers", "verdict", "asked"),
    [
        (["noise"], False, Verdict.NAMED, True),
        (["noise", "noise"], False, Verdict.SET, True),
        (["noise", "state"], False, Verdict.SET, False),  # the set has a cause
        (["noise"], True, Verdict.NAMED, False),  # outliers come at times of their own
        (["noise"], False, Verdict.UNKNOWN, False),
        ([], False, Verdict.NOTHING, False),
    ],
)
def test_of_what_it_is_asked(families, outliers, verdict, asked):
    traits = SimpleNamespace(outliers=outliers)
    refits = [SimpleNamespace(effect=SimpleNamespace(family=f, traits=traits)) for f in families]
    rounds = [SimpleNamespace(equivalent=refits)]
    causes: Any = SimpleNamespace(search=SimpleNamespace(rounds=rounds), verdict=verdict)
    assert second_opinion._is_noise_alone(causes) is asked
