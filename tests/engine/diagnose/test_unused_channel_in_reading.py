"""A channel that the model leaves out may act on the reading alone, on no state."""

import numpy as np
import pytest

import engine
from engine.models.local_level import MODEL as LEVEL


@pytest.mark.long
def test_a_reading_that_depends_on_an_unused_channel():
    """As a sensor of one quantity that another one disturbs: it was offered to states alone, and not seen."""
    rng = np.random.default_rng(4)
    theta = {"q": 1.0, "r": 100.0, "level": 0.0}
    y = engine.simulate(LEVEL, theta, 120, rng).series.y
    wind = rng.standard_normal(120)
    series = engine.Series(
        y + 8.0 * wind[:, None], dt=1.0, y_names=["flow"], extra=wind[:, None], extra_names=["wind"]
    )
    found = engine.diagnose(LEVEL, series, effects=["direct", "extra-input"], seed=1)
    (cause,) = found.causes
    assert cause.effect == "direct:wind->flow"
    assert abs(next(iter(cause.parameters.values())) - 8.0) < 3.5
    assert "which the model leaves out" in cause.title
