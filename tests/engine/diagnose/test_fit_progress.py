"""The first fit of a diagnosis tells how far it is, all the way."""

import numpy as np
import pytest

import engine
from engine.data import nile


def shares(model, series, **more):
    """What the callback is told of the fit; the run is left when the search begins."""
    told = []

    class EnoughError(Exception):
        pass

    def callback(stage, share):
        if stage != "fit":
            raise EnoughError
        told.append(share)

    try:
        engine.diagnose(model, series, callback=callback, **more)
    except EnoughError:
        return told
    raise AssertionError


def test_the_search_for_a_start_and_the_fit_move_it():
    told = shares(engine.get_model("local-level"), nile())
    assert told[0] == 0.0
    assert all(0.0 <= share <= 1.0 for share in told)
    assert len({round(share, 3) for share in told}) > 8
    assert max(np.diff(np.maximum.accumulate(told))) <= 0.35  # no long leap
    assert max(told) >= 0.6  # what is left is the fit from there, which is at its end at once


@pytest.mark.slow
def test_a_continuous_model_is_fitted_twice():
    model = engine.get_model("oscillator")
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-2, 2, 30), 10)
    series = engine.simulate(model, {"omega": 7.0}, 300, rng, u=u, dt=0.05).series
    told = shares(model, series)
    assert max(told) >= 0.5
    assert len({round(share, 3) for share in told}) > 8
    given = shares(model, series, theta={"omega": 7.0})
    assert len(given) > 2
