"""Inputs that are totals of the time up to their row, as in tables of rain and flow by day."""

import numpy as np
import pytest

import engine

pytestmark = pytest.mark.long


def reservoir():
    """A store that rain fills and the flow empties."""
    own = engine.Parameter
    return engine.continuous(
        name="reservoir",
        drift=lambda a, u, t, theta: ([theta.c * u[0]], [[-1.0 / theta.k]]),
        diffusion=lambda a, u, t, theta: [[theta.q]],
        measurement=lambda a, u, t, theta: ([0.0], [[1.0 / theta.k]], [[theta.r]]),
        initial=lambda theta: (None, [5.0], [[4.0]]),
        nonlinear={},
        linear={"store": "mm"},
        inputs={"rain": "mm/day"},
        outputs={"flow": "mm/day"},
        parameters=[
            own("c", 0.5, "", (0.0, 2.0)),
            own("k", 5.0, "day", (0.3, 200.0)),
            own("q", 0.1, "mm^2/day", (1e-8, 1e3)),
            own("r", 1e-3, "(mm/day)^2", (1e-6, 1e2)),
        ],
    )


def rained(seed, hold):
    """Two hundred days, half of them dry, of a store that answers the rain as ``hold`` says."""
    rng = np.random.default_rng(seed)
    rain = rng.exponential(6.0, 200) * (rng.random(200) < 0.5)
    flow, store, fine = np.zeros(200), 5.0, 50
    for day in range(200):
        flow[day] = store / 6.0 + 0.02 * rng.standard_normal()
        now, later = rain[day], rain[min(day + 1, 199)]
        for k in range(fine):
            share = {"zoh": 0.0, "foh": (k + 0.5) / fine, "past": 1.0}[hold]
            store += (0.4 * (now + share * (later - now)) - store / 6.0) / fine
        store += 0.2 * rng.standard_normal()
    return engine.Series(y=flow[:, None], u=rain[:, None], dt=1.0, time_unit="day")


@pytest.mark.parametrize(("hold", "seed"), [("foh", 3), ("past", 1)])
def test_the_record_is_read_as_its_rows_mean(hold, seed):
    kinds = ["hold", "delay", "lag", "input-gain"]
    found = engine.diagnose(reservoir(), rained(seed, hold), effects=kinds, held_out=0, processes=1)
    assert [cause.effect for cause in found.causes] == ["hold:rain"]
    assert any(f"hold='{hold}'" in note for note in found.notes)


def test_a_record_that_is_held_is_left_so():
    kinds = ["hold", "delay", "lag", "input-gain"]
    found = engine.diagnose(reservoir(), rained(2, "zoh"), effects=kinds, held_out=0, processes=1)
    assert found.verdict.value == "nothing"
