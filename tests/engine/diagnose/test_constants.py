"""A constant that many effects which count from far away explain as well: it is asked about, too."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.refitting import REFITS, _worth_refitting

P = engine.Parameter


def routed(a, u, t, dt, theta):
    """Two reaches of a river, each a Muskingum routing (Cunge 1969) of the flow into it, an hour late."""
    K, x = 0.5 * theta.K, theta.x
    d = 2.0 * K * (1.0 - x) + dt
    c0, c1, c2 = (dt - 2.0 * K * x) / d, (dt + 2.0 * K * x) / d, (2.0 * K * (1.0 - x) - dt) / d
    f = [c0 * u[0], c0 * c0 * u[0], u[0]]
    A = [[c2, 0.0, c1], [c0 * c2 + c1, c2, c0 * c1], [0.0, 0.0, 0.0]]
    return f, A, np.diag([theta.q, theta.q, 1e-9])


REACH = engine.MixedModel(
    name="reach",
    linear={"upper": "m^3/s", "lower": "m^3/s", "before": "m^3/s"},
    inputs={"inflow": "m^3/s"},
    outputs={"gauge": "m^3/s"},
    parameters=[
        P("K", 10.0, "h", (2.0, 60.0)),
        P("x", 0.2, "", (0.0, 0.5)),
        P("q", 0.5, "(m^3/s)^2", (1e-9, 100.0)),
        P("r", 1.0, "(m^3/s)^2", (1e-6, 100.0)),
    ],
    dynamics=routed,
    measurement=lambda a, u, t, theta: ([0.0], [[0.0, 1.0, 0.0]], [[theta.r]]),
    initial=lambda theta: (None, [40.0] * 3, np.diag([100.0] * 3)),
)


def record(seed: int, lateral: float = 6.0, rows: int = 320) -> engine.Series:
    """Floods of some hours, and a constant flow that joins the lower reach."""
    rng = np.random.default_rng(seed)
    inflow = np.full(rows, 35.0)
    for _ in range(rows // 40):
        s, peak = (
            (np.arange(rows) - rng.integers(rows)) / rng.uniform(4.0, 15.0),
            rng.uniform(15.0, 120.0),
        )
        inflow += np.where(s > 0.0, peak * s * np.exp(1.0 - np.maximum(s, 0.0)), 0.0)
    theta = SimpleNamespace(K=14.0, x=0.25, q=0.25)
    z, y = np.full(3, 35.0), np.zeros(rows)
    for t in range(rows):
        y[t] = z[1] + 0.7 * rng.standard_normal()
        f, A, _ = routed(None, inflow[t : t + 1], 0.0, 1.0, theta)
        z = np.array(f) + np.array(A) @ z + [*(0.5 * rng.standard_normal(2)), 0.0]
        z[1] += lateral * (1.0 - A[1][1])
    return engine.Series(y[:, None], u=inflow, dt=1.0, time_unit="h")


@pytest.mark.parametrize("far", [False, True])
def test_what_counts_from_elsewhere_pays_for_its_zero_before_it_is_refitted(far):
    """Lines and squares are ahead of five constants; counted from far away they are nothing but such."""
    series = record(1)
    setting = setting_for(REACH, series, REACH.theta())
    every = [
        e for e in all_effects(setting, ["linear", "quadratic", "coupling"]) if len(e.probes) > 1
    ]
    ahead = [(e, 100.0 - 0.01 * k, e.probes[1 if far else 0]) for k, e in enumerate(every)]
    assert len(ahead) > REFITS
    assert all(e.from_elsewhere(at) is far for e, _, at in ahead)
    plain = all_effects(setting, ["force", "input-offset", "bias"])
    scores = [
        SimpleNamespace(effect=effect, statistic=statistic, p_value=1e-9, at=at)
        for effect, statistic, at in [*ahead, *((e, 98.0, e.probes[0]) for e in plain)]
    ]
    chosen = _worth_refitting(SimpleNamespace(scores=scores), series, ())
    kinds = {score.effect.kind for score in chosen}
    assert ({"force", "input-offset", "bias"} <= kinds) is far


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_constant_flow_is_among_what_counts_from_far_away(seed):
    kinds = [
        "force",
        "input-offset",
        "bias",
        "linear",
        "input-gain",
        "quadratic",
        "cubic",
        "coupling",
    ]
    found = engine.diagnose(REACH, record(seed), effects=kinds)
    first = found.causes[0]
    names = {first.effect, *(one.effect for one in first.look_alikes)}
    assert {"force:lower", "input-offset:inflow"} <= names
    assert found.verdict.value in ("set", "named")
