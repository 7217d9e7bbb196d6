"""A channel that the model leaves out may act on the reading alone, on no state."""

import math

import numpy as np
import pytest

import engine
from engine.diagnose.effects.spare_inputs import with_inputs
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.taped import filter_by_tape
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


def test_a_channel_that_is_not_used_leaves_the_model_on_its_tape():
    """What math makes of an input is recorded with one beside it, too: else each step is a call of its own."""
    cell = engine.MixedModel(
        name="cell",
        dynamics=lambda a, u, t, dt, th: ([0.1 * u[0]], [[math.exp(-dt / th.tau)]], [[0.1]]),
        measurement=lambda a, u, t, th: ([th.b * math.log(u[0])], [[-1.0]], [[1.0]]),
        initial=lambda th: (None, [0.0], [[1.0]]),
        linear={"loss": "mV"},
        inputs={"current": "A"},
        outputs={"voltage": "mV"},
        parameters=[engine.Parameter("tau", 9.0, "s"), engine.Parameter("b", 5.0, "mV")],
    )
    wide = with_inputs(cell, ["room"])
    rng = np.random.default_rng(1)
    series = engine.Series(rng.standard_normal(60), u=rng.uniform(1.0, 9.0, (60, 2)), dt=1.0)
    narrow = series.replace(u=series.u[:, :1], u_names=series.u_names[:1])
    found = []
    for model, one in ((cell, narrow), (wide, series)):
        thetas = np.array([[9.0, 5.0], [8.0, 4.0]])
        taped = filter_by_tape(FilterSteps(model, Thetas(model, thetas), one), None)
        assert taped is not None
        found.append(taped[2])
    np.testing.assert_array_equal(*found)
