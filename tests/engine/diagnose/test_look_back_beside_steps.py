"""What was found in turn is weighed again where shorter steps explain what is left, too."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine import Parameter, Series
from engine.diagnose.judging.verdict import patchwork
from engine.diagnose.search.pipeline import find_causes

CART = engine.continuous(
    name="cart",
    drift=lambda a, u, t, th: (
        [a[:, 1], (1000.0 * u[0] - th.d * a[:, 1]) / th.m],
        np.zeros((2, 0)),
    ),
    diffusion=lambda a, u, t, th: [[0.0, 0.0], [0.0, th.q]],
    measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[th.r]]),
    initial=lambda th: (engine.Gaussian([0.0, 0.0], np.diag([100.0, 1.0])), [], np.zeros((0, 0))),
    nonlinear={"pos": "mm", "vel": "mm/s"},
    kinematic=["pos"],
    inputs={"force": "N"},
    outputs={"enc": "mm"},
    parameters=[
        Parameter("m", 3.0, "kg", (0.2, 50.0)),
        Parameter("d", 5.0, "N s/m", (0.0, 100.0)),
        Parameter("q", 10.0, "mm^2/s^3", (1e-6, 1e6)),
        Parameter("r", 0.01, "mm^2", (1e-6, 10.0)),
    ],
)


def measured(seed, n=800, dt=0.02, fine=40):
    """Dry friction of 1 N and a force of 0.8 N that the model leaves out, by steps forty times shorter."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6.0, 6.0, 32), 25)
    x, v, h, run = 0.0, 0.0, dt / fine, [0.0]
    for k in range(n - 1):
        for push in np.sqrt(20.0 * h) * rng.standard_normal(fine):
            force = 1000.0 * u[k] - 8.0 * v + 800.0
            dry = np.sign(force) * min(abs(force), 1000.0) if v == 0.0 else np.sign(v) * 1000.0
            after = v + h * (force - dry) / 4.0 + push
            after = 0.0 if v * after < 0.0 else after
            x, v = x + 0.5 * h * (v + after), after
        run.append(x)
    y = np.array(run) + 0.1 * rng.standard_normal(n)
    return Series(y[:640], u=u[:640], dt=dt)


@pytest.mark.slow
def test_a_first_name_is_weighed_again_beside_friction_whose_steps_leave_something():
    """A path of the input took some of the friction, and stayed the name of a force once that was known."""
    kinds = ["force", "path", "coulomb", "episode"]
    found = find_causes(CART, measured(2), effects=kinds, seed=1)
    assert found.search.of_the_steps
    assert [r.refits[0].effect.name for r in found.search.rounds if r.equivalent] == [
        "force:vel",
        "coulomb:vel",
    ]
    assert found.verdict.value == "named"
    assert found.search.final.theta["force_vel"] == pytest.approx(200.0, rel=0.05)


@pytest.mark.slow
def test_what_was_not_weighed_again_is_in_the_last_fit_all_the_same(monkeypatch):
    """Where all iterations were spent the last round stays as found, beside a name that is none any more."""
    search = importlib.import_module("engine.diagnose.search.search")
    weigh = search.look_back

    def cut(base, rounds, *args):
        _, weighed, _ = weigh(base, rounds, *args)
        return weighed[0].refits[0].fit, [weighed[0], rounds[1]], ("coulomb:vel",)

    monkeypatch.setattr(search, "look_back", cut)
    kinds = ["force", "path", "coulomb", "episode"]
    found = find_causes(CART, measured(2), effects=kinds, seed=1).search
    assert found.of_the_steps
    assert {one.effect.size.name for one in found.named} <= {*found.final.theta.names}


@pytest.mark.parametrize("of_the_steps", ["", "episode:enc"])
def test_what_the_steps_get_wrong_is_no_patch(of_the_steps):
    """The page said of the same that it is no effect, and that something is still seen."""

    def found(name):
        effect = SimpleNamespace(
            name=name,
            family="state",
            traits=SimpleNamespace(outliers=False, bends=False, foreseen=None, course=None),
        )
        return SimpleNamespace(effect=effect, fit=None)

    left = SimpleNamespace(equivalent=(), screen=SimpleNamespace(p_value=0.002, at_floor=True))
    search = SimpleNamespace(
        named=(found("force:vel"), found("coulomb:vel")),
        at_once=(),
        has_noise_apart=False,
        rounds=(left,),
        of_the_steps=of_the_steps,
    )
    assert bool(patchwork(search, 0.05)) is not bool(of_the_steps)
