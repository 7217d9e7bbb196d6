"""What the likelihood found to be outliers of a reading is no pattern of the free run, whose noise has none."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict
from engine.diagnose.free_run.second_opinion import _part, _without_outliers
from engine.diagnose.search.pipeline import find_causes

MODEL = engine.get_model("oscillator")
second_opinion = import_module("engine.diagnose.free_run.second_opinion")
ROWS = (40, 90, 91, 150, 230)  # of which readings are off by 20 standard deviations


def unasked(*given):
    raise engine.ModelError("not asked here")


@pytest.mark.long
def test_they_are_missing_from_what_it_is_asked_of(monkeypatch):
    rng = np.random.default_rng(3)
    u = np.convolve(rng.standard_normal(320), np.ones(20) / 5.0)[20:320]
    theta = MODEL.theta({"sigma_y": 2e-3, "sigma_v": 0.02})
    series = engine.simulate(MODEL, theta, 300, rng, u=u, dt=0.05).series
    y = series.y.copy()
    y[list(ROWS), 0] += 0.04
    outlying = series.replace(y=y)
    found = find_causes(MODEL, outlying, theta, effects=["heavy-tails"], seed=1, max_effects=1)
    named = [r.refits[0] for r in found.search.rounds if r.equivalent]
    assert [one.effect.name for one in named] == ["heavy-tails:y"]
    asked = _without_outliers(found.base, named, outlying, 1)
    gone = np.flatnonzero(np.isnan(asked.y[:, 0]))
    assert set(ROWS) <= set(gone.tolist())
    assert len(gone) <= len(ROWS) + 5  # and a few of the ordinary tail
    assert _without_outliers(found.base, [], outlying, 1) is outlying
    taken = []
    with monkeypatch.context() as patch:
        patch.setattr(second_opinion, "_without_outliers", lambda *a: taken.append(1) or a[2])
        patch.setattr(second_opinion, "_beside", unasked)
        for verdict in (
            Verdict.UNKNOWN,
            Verdict.NAMED,
        ):  # unsettled, they may be the model's own errors
            second_opinion.second_opinion(
                replace(found, verdict=verdict),
                [outlying],
                theta,
                alpha=0.05,
                kinds=None,
                seed=1,
                progress=lambda stage, share: None,
            )
            assert len(taken) == (verdict is Verdict.NAMED)
    said = _part([asked], [asked], [outlying])
    assert said == f" Outliers, {len(gone)} of 300 readings, were left out."
    assert _part([outlying], [outlying], [outlying]) == ""
