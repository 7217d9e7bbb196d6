"""A position that is counted from a wall, its model at rest elsewhere, and nobody declares where."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.rates import Points
from engine.diagnose.effects.rest import at_rest

DT, ROWS, FINE = 0.02, 300, 10


def spring(rest):
    """A mass on a spring that is at ``rest`` in mm from the wall."""
    return engine.continuous(
        name="spring",
        drift=lambda a, u, t, theta: (
            [0.0, 10.0 * u[0] - theta.k * (a[:, 0] - rest)],
            [[1.0], [-1.5]],
        ),
        diffusion=lambda a, u, t, theta: [[0.0, 0.0], [0.0, theta.q**2]],
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[theta.r**2]]),
        initial=lambda theta: (engine.Gaussian([rest], [[0.01]]), [0.0], [[0.1]]),
        nonlinear={"x": "mm"},
        linear={"v": "mm/s"},
        inputs={"current": "A"},
        outputs={"laser": "mm"},
        parameters=[
            engine.Parameter("k", 40.0, "1/s^2", (1.0, 500.0)),
            engine.Parameter("q", 0.3, "mm/s^1.5", (0.0, 10.0)),
            engine.Parameter("r", 0.02, "mm", (1e-4, 1.0)),
        ],
    )


def hardening(x):
    return 25.0 * x**3


def stop(x):
    return 60.0 * np.sign(x) * max(abs(x) - 0.4, 0.0)


def readings(rest, force=hardening):
    """Of one that pushes back more away from there."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-3.0, 3.0, ROWS // 10), 10)
    x, v, y = 0.0, 0.0, np.empty(ROWS)
    for k in range(ROWS):
        y[k] = rest + x + 0.02 * rng.standard_normal()
        for _ in range(FINE):
            v += DT / FINE * (10.0 * u[k] - 45.0 * x - 1.5 * v - force(x))
            x += DT / FINE * v
        v += 0.05 * rng.standard_normal()
    return engine.Series(y, u, dt=DT)


@pytest.mark.slow
@pytest.mark.parametrize(("force", "name"), [(hardening, "cubic"), (stop, "saturation")])
def test_a_force_has_its_name_wherever_positions_count_from(force, name):
    asked = [f"{kind}:x->v" for kind in ("cubic", "quadratic", "saturation", "deadzone")]
    found = [
        diagnose(spring(rest), readings(rest, force), effects=asked, seed=1) for rest in (0.0, 30.0)
    ]
    here, there = (one.causes[0] for one in found)
    assert name in {one.partition(":")[0] for one in here.equivalent}
    assert set(there.equivalent) == set(here.equivalent)
    assert there.effect == here.effect
    assert there.size == pytest.approx(here.size, rel=0.1)
    (zero,) = (value for of, value in there.parameters.items() if of.endswith("_zero"))
    assert zero == pytest.approx(30.0, abs=0.1)


def test_where_the_model_is_at_rest_is_looked_at_too_and_the_middle_away_from_zero():
    for rest, expected in ((0.0, [0.0]), (0.5, [0.0, 0.5]), (30.0, [0.0, 30.0, 30.0])):
        model, series = spring(rest), readings(rest)
        setting = setting_for(model, series, np.asarray(model.theta()))
        places = [probe[-1] for probe in make_effect("cubic:x->v", setting).probes]
        assert places == pytest.approx(expected, abs=0.2)
        assert places[-1] == pytest.approx(rest, abs=1e-6)


def test_what_goes_on_by_itself_or_runs_away_is_at_rest_nowhere():
    points = Points(
        np.ones((3, 1)), np.ones((3, 0)), np.arange(3.0), np.ones(3), np.ones(1), np.ones(0)
    )
    for moved in (lambda x: x, lambda x: x + 1.0, lambda x: np.sqrt(x - 2.0)):
        model = engine.MixedModel(
            name="walk",
            dynamics=lambda a, u, t, dt, theta, moved=moved: (
                [moved(a[:, 0])],
                np.zeros((1, 0)),
                [[1.0]],
            ),
            measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
            initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
            nonlinear={"x": "m"},
            outputs={"y": "m"},
            parameters=[],
        )
        assert at_rest(model, np.empty(0), points, np.empty(0)) is None


def test_the_extended_model_keeps_the_places():
    model, series = spring(30.0), readings(30.0)
    setting = setting_for(model, series, np.asarray(model.theta())).keeping_zeros()
    pushed = make_effect("force:v", setting).apply(model)
    alone, beside = (
        make_effect("saturation:x->v", replace(setting, model=of)) for of in (model, pushed)
    )
    assert beside.probes == alone.probes
    assert [p.bounds for p in beside.parameters] == [p.bounds for p in alone.parameters]
