"""Large effects bend the fit of the model without them: what they are is found from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.search.elsewhere import bent
from tests.engine.plain_models import absorption


@pytest.fixture(scope="module")
def found():
    """A drug that is gone when its sensor is knocked by 0.5 mg/L: rates go to bounds to explain it."""
    truth = {"ka": 0.35, "ke": 1.2, "V": 12.0}
    series = engine.simulate(absorption(), truth, 60, np.random.default_rng(0), dt=0.5).series
    knocked = replace(series, y=series.y + 0.5 * (series.t > 8.0)[:, None])
    kinds = ["step", "pole", "saturation", "mode"]
    return engine.diagnose(absorption(), knocked, seed=1, effects=kinds)


@pytest.mark.slow
def test_the_step_is_named_that_the_bent_fit_does_not_lead_to(found):
    assert bent(found.search.rounds[0].refits, found.series)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "step:concentration"
    assert abs(cause.size - 0.5) < 3.0 * cause.standard_error < 0.3
    assert cause.parameters["step_concentration_time"] == pytest.approx(8.5, abs=0.5)
    best, *others = found.search.rounds[0].refits
    assert best.gain > max(other.gain for other in others) + 10.0


def test_gains_from_elsewhere_are_those_over_the_same_fit(found):
    base = found.search.base.log_likelihood
    for one in found.search.rounds[0].refits:
        assert one.gain == pytest.approx(2.0 * (one.fit.log_likelihood - base), abs=0.1)


def test_small_effects_bend_nothing(found):
    refits = found.search.rounds[0].refits
    small = [replace(one, gain=0.5 * found.series.n_measured) for one in refits]
    assert not bent(small, found.series)
