"""Where a state never turns, a loop of it has no way back: it is a curved drift, and not looked for."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import all_effects, make_effect
from engine.diagnose.effects.of_series import setting_for

SALES = engine.MixedModel(
    name="sales",
    dynamics=lambda a, u, t, dt, theta: ([theta.c + u[0]], [[0.8]], [[1e-2]]),
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1e-2]]),
    initial=lambda theta: (None, [0.0], [[1e4]]),
    linear={"level": ""},
    inputs={"lead": ""},
    outputs={"sales": ""},
    parameters=[engine.Parameter("c", 1.0, "", (-1e3, 1e3))],
)


def setting(base):
    u = np.sin(0.2 * np.arange(200.0))
    run = engine.simulate(SALES, {"c": 0.2 * base}, 200, np.random.default_rng(1), u=u)
    return setting_for(SALES, run.series.part(20, 200), np.array([0.2 * base]))


@pytest.mark.parametrize(("base", "loops"), [(230.0, False), (-230.0, False), (0.5, True)])
def test_a_loop_needs_a_state_that_turns(base, loops):
    known = setting(base)
    names = {effect.name for effect in all_effects(known, ["hysteresis", "boucwen", "pole"])}
    assert names == {"pole:level", *(["hysteresis:level", "boucwen:level"] if loops else [])}
    assert make_effect("hysteresis:level", known).name == "hysteresis:level"  # for who knows it
