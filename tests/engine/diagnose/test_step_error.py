"""What the steps of an extended model get wrong is no further effect; a further effect is."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine import Gaussian, MixedModel, Parameter, Series
from engine.diagnose import Effect, diagnose, extend, register_effect
from engine.diagnose.effects import catalogue
from engine.diagnose.effects.effect import Split, on_base, pushed
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.checkpoint import NOTHING
from engine.diagnose.refits.rounds import Round
from engine.diagnose.search.pipeline import find_causes
from engine.diagnose.steps import step_error
from engine.diagnose.steps.step_error import steps_for_sizes
from engine.diagnose.steps.substeps import are_too_long, can_be_finer
from engine.estimation.quasi_ml import quasi_ml
from engine.statespace.promotion import promote
from tests.engine.other_units import Units

DT = 0.05
KINDS = ["drag", "cubic", "coulomb", "cubic-sensor", "gain", "saturation-sensor"]


def dynamics(a, u, t, dt, th):
    """v' = k u - b v, exact at any step."""
    kept = math.exp(-th.b * dt)
    moved = th.k / th.b * (1.0 - kept)
    return [moved * u[0]], [[kept]], [[th.q**2 * dt]]


DRIVE = MixedModel(
    name="exact drive",
    dynamics=dynamics,
    measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r**2]]),
    initial=lambda th: (Gaussian([], np.zeros((0, 0))), [0.0], [[1e-4]]),
    linear={"speed": "m/s"},
    inputs={"voltage": "V"},
    outputs={"tacho": "m/s"},
    reference={"speed": 0.0, "tacho": 0.0},
    continuous=True,
    parameters=[
        Parameter("k", 1.0, "m/s^2/V", (0.01, 10.0)),
        Parameter("b", 1.0, "1/s", (0.01, 50.0)),
        Parameter("q", 0.01, "m/s^1.5", (1e-5, 1.0)),
        Parameter("r", 1e-3, "m/s", (1e-5, 1.0)),
    ],
)


def measured(drag, bent, T=400, fine=20, seed=3, friction=0.0):
    """By another program: Euler steps twenty times shorter, a nearly noise-free sensor, ``bent`` or not."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6.0, 6.0, T), rng.integers(5, 30, T))[:T]
    v, y, h = 0.0, np.empty(T), DT / fine
    for t in range(T):
        y[t] = v - bent * v**3
        for _ in range(fine):
            force = drag * v * abs(v) + friction * np.sign(v)
            v += h * (u[t] - v - force) + 0.01 * math.sqrt(h) * rng.standard_normal()
    return Series(y + 1e-3 * rng.standard_normal(T), u=u, dt=DT)


def names(found):
    return [r.refits[0].effect.name for r in found.search.rounds if r.equivalent]


def early(kind, rate):
    """As a user may write it: the whole push of a step before it, so that it is seen half a push early."""

    def make(setting, channel):
        name = f"{kind}_{channel}".replace("-", "_")

        def extend(model):
            base, split = promote(model, (channel,)), Split(model)
            row = [*base.nonlinear, *base.linear].index(channel)

            def dynamics(a, u, t, dt, theta):
                record, own = split(theta)
                return pushed(base, {row: -dt * own[0] * rate(a[:, row])}, a, u, t, dt, record)

            return on_base(base, split, dynamics=dynamics)

        size = Parameter(name, 0.0, setting.rate(channel))
        return Effect(kind, channel, "state", kind, "", (size,), extend)

    return make


EARLY = {"early-drag": lambda v: v * np.abs(v), "early-coulomb": np.sign}


@pytest.fixture
def registered():
    for kind, rate in EARLY.items():
        register_effect(kind, early(kind, rate), lambda setting: iter(setting.states))
    yield
    for kind in EARLY:
        del catalogue._makers[kind]


@pytest.mark.slow
def test_an_effect_beside_a_model_that_is_exact_leaves_nothing_behind():
    """Drag comes half before a step, half after it; once a sensor with a cubic error was seen, too."""
    found = find_causes(DRIVE, measured(0.1, 0.0), None, effects=KINDS, seed=1)
    assert names(found) == ["drag:speed"]
    assert found.verdict.value == "named"
    assert not found.search.of_the_steps
    assert not found.coarse


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_what_shorter_steps_explain_is_not_named():
    kinds = ["early-drag", *KINDS[1:]]
    found = find_causes(DRIVE, measured(0.1, 0.0), None, effects=kinds, seed=1)
    assert names(found) == ["early-drag:speed"]
    assert found.search.of_the_steps == "cubic-sensor:tacho"
    assert any("what the steps get wrong" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_names_between_which_the_steps_may_decide_are_a_set():
    """Friction that turns within a step, written as it turns at its ends."""
    kinds = ["early-coulomb", "stribeck", "drag"]
    found = find_causes(DRIVE, measured(0.0, 0.0, friction=0.5), None, effects=kinds, seed=1)
    assert found.coarse
    assert "early-coulomb:speed" in [r.effect.name for r in found.search.rounds[0].equivalent]
    assert found.verdict.value in ("set", "unknown")
    assert any("those within it are not told apart" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_no_further_effect_is_looked_for_where_shorter_steps_may_decide_the_first():
    """What the steps of a name that only they keep ahead get wrong would be found beside it, at length."""
    kinds = ["early-coulomb", "stribeck", "drag"]
    series = measured(0.0, 0.0, friction=0.5)
    found = find_causes(DRIVE, series, None, effects=kinds, seed=1, finer=True)
    assert found.search.by_the_steps
    assert len(found.search.rounds) == 1


@pytest.mark.slow
def test_friction_needs_no_shorter_steps():
    """It was a set with friction that fades, or was named after two searches with shorter steps."""
    found = diagnose(
        DRIVE,
        measured(0.0, 0.0, friction=0.5),
        effects=["coulomb", "stribeck", "drag"],
        seed=1,
    )
    assert found.verdict.value == "named"
    assert [cause.effect for cause in found.causes] == ["coulomb:speed"]
    assert abs(found.causes[0].size - 0.5) < 4.0 * found.causes[0].standard_error
    assert found.substeps == 1


@pytest.mark.parametrize(
    ("steps", "outliers", "worth", "ends"),
    [
        (4, False, 5.0, True),
        (4, False, 0.0, False),
        (8, False, 5.0, False),  # short enough
        (4, True, 5.0, False),  # judged by a filter of their own
    ],
)
def test_a_first_round_is_left_to_shorter_steps(steps, outliers, worth, ends, monkeypatch):
    monkeypatch.setattr(step_error, "decides", lambda *_: worth)
    effect = SimpleNamespace(name="drag:x", traits=SimpleNamespace(outliers=outliers))
    best: Any = SimpleNamespace(effect=effect, fit=None)
    found = Round(SimpleNamespace(), (best,), None, ())  # type: ignore[arg-type]
    series: Any = SimpleNamespace(substeps=steps)
    setting: Any = None
    assert step_error.decided_by_steps(found, series, setting, NOTHING, 8) is ends


@pytest.mark.slow
def test_a_second_effect_is_named_beside_the_first():
    found = find_causes(DRIVE, measured(0.02, 2e-3), None, effects=KINDS, seed=1)
    assert {"drag:speed", "cubic-sensor:tacho"} == {*names(found)}
    assert found.search.of_the_steps == ""


def test_steps_are_halved_only_where_that_means_something():
    """Not for a step that is none in time; samples need no common step."""
    series = measured(0.02, 0.0, T=60)
    theta = np.asarray(DRIVE.theta())

    def fine(model, one):
        return can_be_finer(setting_for(model, one, theta), one, theta)

    assert fine(DRIVE, series)
    counted = replace(DRIVE, dynamics=lambda a, u, t, dt, th: dynamics(a, u, t, DT, th))
    assert not fine(counted, series)
    assert not fine(replace(DRIVE, continuous=False), series)
    assert fine(DRIVE, Series(series.y, u=series.u, t=series.t + 1e-2 * (series.t > 1.0)))


def test_what_counts_samples_is_not_asked_of_shorter_steps_at_irregular_times():
    """Beside a late sensor, on a record with one longer step, the search ended in an error."""
    series = measured(0.02, 0.0, T=60)
    apart = Series(series.y, u=series.u, t=series.t + 1e-2 * (series.t > 1.0))
    setting = setting_for(DRIVE, apart, np.asarray(DRIVE.theta()))
    late = extend(DRIVE, ["delay:tacho"], setting)
    fit: Any = SimpleNamespace(model=late, theta=late.theta(), log_likelihood=0.0)
    other: Any = SimpleNamespace(
        effect=SimpleNamespace(
            name="lag:tacho", traits=SimpleNamespace(outliers=False, unnamed=False)
        ),
        score=9.0,
        gain=9.0,
        fit=fit,
    )
    found = Round(SimpleNamespace(), (other,), None, ())  # type: ignore[arg-type]
    names = ["delay:tacho"]
    assert step_error.by_shorter_steps(9.0, setting, names, fit, apart, NOTHING) == 0.0
    assert step_error.decides(found, names, fit, apart, setting, NOTHING, 4) == 0.0
    assert steps_for_sizes(names, fit, apart, setting, 4, NOTHING) == 1
    # nor the free run: it said that it had not been asked, for want of samples at a common step
    at = np.asarray(late.theta({"delay_tacho": 1.5}))
    assert not are_too_long(DRIVE, names, at, apart, np.zeros(late.nx))


@pytest.mark.parametrize(("drag", "steps"), [(1.5, 2), (0.3, 1)])
def test_as_many_steps_in_units_far_apart(drag, steps):
    """Small numbers were lost beside large ones in the information: any move was more than the error."""
    mm, mv, one = np.array([1e3]), np.array([1e3]), 1.0 / 3600.0  # mm, mV, h
    units = Units(mm, mm, mv, one, np.array([1e-6, 1e6, 1e-6, 1e6]))
    model, series = units.model(DRIVE), units.series(measured(drag, 0.0))
    setting = setting_for(model, series, model.theta())
    size = drag / (1e3 * one)
    fit = quasi_ml(extend(model, ["drag:speed"], setting), series, {"drag_speed": size})
    assert steps_for_sizes(["drag:speed"], fit, series, setting, 4, NOTHING) == steps


@pytest.mark.long
@pytest.mark.parametrize(("drag", "steps"), [(1.5, 2), (0.3, 1)])
def test_sizes_need_steps_of_which_shorter_ones_move_nothing(drag, steps):
    """A strong drag on a nearly noise-free record; one whose error of the step is none."""
    series = measured(drag, 0.0)
    setting = setting_for(DRIVE, series, DRIVE.theta())
    extended = extend(DRIVE, ["drag:speed"], setting)
    fit = quasi_ml(extended, series, {"drag_speed": drag})
    asked = (["drag:speed"], fit, series, setting, 4, NOTHING)
    assert steps_for_sizes(*asked) == steps
    finer = series.refined(steps_for_sizes(*asked))
    again = quasi_ml(extend(DRIVE, ["drag:speed"], setting_for(DRIVE, finer, DRIVE.theta())), finer)
    error = np.sqrt(np.linalg.inv(again.information)[-1, -1])
    assert abs(np.asarray(again.theta)[-1] - drag) < 3.0 * error


@pytest.mark.parametrize(
    ("scores", "worths", "gains", "substeps", "worth"),
    [
        # a dead zone of the input has no error of the steps, friction that turns within one has
        ((500.0, 390.0), (0.0, 80.0), ((0.0,), (150.0,)), 2, 110.0),
        ((500.0, 300.0), (0.0, 80.0), ((0.0,), (60.0, 80.0)), 1, 200.0),  # near by two halvings
        ((500.0, 390.0), (0.0, 80.0), ((0.0,), (20.0,)), 2, 0.0),  # not near by shorter ones
        ((500.0, 390.0), (0.0, 10.0), ((0.0,), (150.0,)), 2, 0.0),  # so small an error cannot
        ((500.0, 390.0), (200.0, 0.0), ((50.0,), (0.0,)), 2, 200.0),  # looked for again
        ((500.0, 390.0), (200.0, 0.0), ((50.0,), (0.0,)), 4, 0.0),  # the last ones: it lasts
        ((500.0, 390.0), (200.0, 0.0), ((-110.0,), (0.0,)), 4, 200.0),
    ],
)
def test_what_the_steps_decide(scores, worths, gains, substeps, worth, monkeypatch):
    traits = SimpleNamespace(outliers=False, unnamed=False)
    refits: Any = [
        SimpleNamespace(
            effect=SimpleNamespace(name=str(k), traits=traits, parameters=("size",)),
            score=score,
            fit=SimpleNamespace(k=k, theta=np.zeros(1), log_likelihood=0.0, halved=0),
        )
        for k, score in enumerate(scores)
    ]

    def refitted(extended, fit, finer, kept):
        """Likelier by so much with steps half as long."""
        gained = 0.5 * gains[fit.k][fit.halved]
        return SimpleNamespace(
            k=fit.k,
            theta=fit.theta,
            log_likelihood=fit.log_likelihood + gained,
            halved=fit.halved + 1,
        )

    found: Any = SimpleNamespace(refits=refits, equivalent=refits[:1])
    setting: Any = SimpleNamespace(model=SimpleNamespace(parameters=()))

    def halves(model, names, fit, series):
        return SimpleNamespace(substeps=2 * series.substeps), None

    monkeypatch.setattr(step_error, "can_be_finer", lambda *_: True)
    monkeypatch.setattr(step_error, "_finer", halves)
    monkeypatch.setattr(step_error, "_worth", lambda model, names, fit, series: worths[fit.k])
    monkeypatch.setattr(step_error, "_refitted", refitted)
    series: Any = SimpleNamespace(substeps=substeps)
    asked = found, ["0"], refits[0].fit, series, setting, NOTHING, 4
    assert step_error.decides(*asked) == worth


@pytest.mark.parametrize("held", [[], ["force:speed"], ["force:speed", "step:speed"]])
def test_a_rival_is_asked_beside_what_its_own_fit_holds(held):
    """Of three effects a rival of the first may have been weighed beside one: a diagnosis ended there."""
    series = measured(0.5, 0.0, T=80)
    setting = setting_for(DRIVE, series, DRIVE.theta())

    def refit(name, score):
        model = extend(DRIVE, [name, *held], setting)
        fit = SimpleNamespace(model=model, theta=model.theta(), log_likelihood=0.0)
        return SimpleNamespace(effect=catalogue.make_effect(name, setting), score=score, fit=fit)

    refits: Any = [refit("drag:speed", 50.0), refit("coulomb:speed", 10.0)]
    found: Any = SimpleNamespace(refits=refits, equivalent=refits[:1])
    every = extend(DRIVE, ["drag:speed", "force:speed", "step:speed"], setting)
    fit: Any = SimpleNamespace(model=every, theta=every.theta(), log_likelihood=0.0)
    asked = found, ["drag:speed", "force:speed", "step:speed"], fit, series, setting, NOTHING, 4
    assert step_error.decides(*asked) == 0.0


def test_a_size_at_a_bound_that_another_setting_sees_elsewhere_is_compared_within_it():
    """Once a diagnosis ended there: a width of hysteresis is bounded by how fast the fit's states move."""
    series = measured(0.0, 0.0, T=120, friction=0.5)
    setting = setting_for(DRIVE, series, DRIVE.theta())
    name = catalogue.all_effects(setting, ["hysteresis"])[0].name
    extended = extend(DRIVE, [name], setting)
    theta = np.where(np.isfinite(extended.upper), extended.upper, extended.theta())
    theta[: len(DRIVE.parameters)] = DRIVE.theta({"k": 0.3, "r": 0.3})
    finer, other = step_error._finer(DRIVE, [name], SimpleNamespace(theta=theta), series)
    assert (other.upper < theta).any()
    fit = SimpleNamespace(model=extended, theta=extended.theta(theta))
    assert np.isfinite(step_error.apart(fit, other, series, finer))
