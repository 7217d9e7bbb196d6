"""Effects that are large and rare are asked for by the free run: their scores one step ahead are small."""

import importlib

import numpy as np
import pytest

from engine.diagnose.judging.findings import Verdict
from engine.diagnose.search.pipeline import find_causes
from tests.engine.diagnose import clipped

search = importlib.import_module("engine.diagnose.search.search")
refitting = importlib.import_module("engine.diagnose.refits.refitting")


@pytest.mark.slow
def test_clipped_readings_are_not_taken_for_noise():
    found, y = clipped.found(), clipped.series().y
    (named,) = [r for r in found.search.rounds if r.equivalent]
    assert found.verdict is Verdict.NAMED
    assert named.refits[0].effect.name == "saturation-sensor:y"
    limit = found.search.final.theta["saturation_sensor_y_limit"]
    assert limit == pytest.approx(y.max(), abs=0.01 * np.std(y))


@pytest.mark.slow
@pytest.mark.parametrize("beside", [False, True])
def test_without_the_free_run_their_scores_would_not_call_for_it(monkeypatch, beside):
    """What it looks like does, where outliers lead, or a screen anew, where scores are bent."""
    monkeypatch.setattr(search, "leading", lambda *_: {})
    if not beside:
        monkeypatch.setattr(refitting, "bent", lambda *_: False)
        monkeypatch.setattr(refitting, "_look_alikes", lambda *_: False)
    found = find_causes(
        clipped.MODEL, clipped.series(), effects=clipped.KINDS, seed=1, max_effects=1
    )
    refitted = [r.effect.name for r in found.search.rounds[0].refits]
    assert refitted
    assert ("saturation-sensor:y" in refitted) is beside
