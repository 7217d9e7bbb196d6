"""Effects that are large and rare are asked for by the free run: their scores one step ahead are small."""

import importlib

import numpy as np
import pytest

import engine
from engine.diagnose.search.findings import Verdict
from engine.diagnose.search.pipeline import find_causes
from engine.simulation.simulate import simulate

MODEL = engine.get_model("oscillator")
KINDS = ["saturation-sensor", "variance", "heavy-tails", "pulse", "step", "cubic-sensor", "lag"]
search = importlib.import_module("engine.diagnose.search.search")


@pytest.fixture(scope="module")
def clipped():
    """A sensor that is nearly free of noise and clips 3 % of its readings."""
    rng = np.random.default_rng(3)
    T = 300
    u = np.convolve(rng.standard_normal(T + 20), np.ones(20) / 5.0)[20 : T + 20]
    theta = MODEL.theta({"sigma_y": 2e-4, "sigma_v": 0.02})
    series = simulate(MODEL, theta, T, rng, u=u, dt=0.05).series.replace(y_names=("y",))
    return series.replace(y=np.minimum(series.y, np.quantile(series.y, 0.97)))


def test_clipped_readings_are_not_taken_for_noise(clipped):
    found = find_causes(MODEL, clipped, effects=KINDS, seed=1)
    (named,) = [r for r in found.search.rounds if r.equivalent]
    assert found.verdict is Verdict.NAMED
    assert named.refits[0].effect.name == "saturation-sensor:y"
    limit = found.search.final.theta["saturation_sensor_y_limit"]
    assert limit == pytest.approx(clipped.y.max(), abs=0.01 * np.std(clipped.y))


def test_without_the_free_run_their_scores_would_not_call_for_it(clipped, monkeypatch):
    monkeypatch.setattr(search, "leading", lambda *_: {})
    found = find_causes(MODEL, clipped, effects=KINDS, seed=1, max_effects=1)
    refitted = [r.effect.name for r in found.search.rounds[0].refits]
    assert refitted
    assert "saturation-sensor:y" not in refitted
