"""What is left beside a named effect, and depends on the states, is seen whatever its shape."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect, add_to_state
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging import lack_of_fit as lack_of_fit_module
from engine.diagnose.judging.lack_of_fit import LEVEL, lack_of_fit
from engine.diagnose.refits.calibration import drawn_from, several_drawn
from engine.diagnose.screening.noise_parameters import apart, noise_only
from engine.diagnose.screening.score_columns import parameter_columns
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_path
from engine.simulation.simulate import simulate
from tests.engine.hidden_effects import DRIVE, DT, levels
from tests.engine.other_units import Units
from tests.studies.design.systems import SYSTEMS

SPRING = SYSTEMS[
    "spring"
].model  # process noise on its velocity alone, of which a record tells little
N = 400
STATES = ["speed", "load"]
SHAPES = {
    "speed times force": lambda v, own: -own[0] * v["speed"] * v["force"],
    "square of the force": lambda v, own: own[0] * (v["force"] ** 2 - 1.0),
}


def with_shape(term):
    size = engine.Parameter("shape_size", 0.5, "1")
    shape = Effect(
        "shape", "speed", "state", "", "", (size,), lambda m: add_to_state(m, "speed", term)
    )
    return shape.apply(DRIVE)


def series(model, seed):
    rng = np.random.default_rng(seed)
    return simulate(model, None, N, rng, u=levels(rng, N), dt=DT).series


def lacking(record, seed=0):
    return lack_of_fit(quasi_ml(DRIVE, record), record, STATES, STATES, seed)


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_that_no_name_has_is_seen(shape):
    found = lacking(series(with_shape(SHAPES[shape]), 1))
    assert found.target == "speed"
    assert found.p_value <= LEVEL
    assert set(found.largest) <= {"speed", "force"}
    assert "another shape" in found.sentence


@pytest.mark.slow
def test_a_right_model_lacks_nothing():
    """Of 40 series at a level of 0.1, ten or more have probability 0.5 %."""
    p_values = [lacking(series(DRIVE, 100 + k)).p_value for k in range(40)]
    assert sum(p <= 0.1 for p in p_values) < 10


def test_the_p_value_is_that_of_as_many_equations_as_were_asked():
    """The first equation is asked the same alone and before another one; here it lacks more."""
    record = series(DRIVE, 102).part(0, 150)
    fit = quasi_ml(DRIVE, record)
    both = lack_of_fit(fit, record, ["speed", "load"], STATES)
    alone = lack_of_fit(fit, record, ["speed"], STATES)
    assert both.target == "speed"
    assert both.statistic == pytest.approx(alone.statistic)
    assert both.p_value == pytest.approx(2.0 * alone.p_value)


def few_steps():
    return np.repeat([1.5, -0.5, 3, -3, 0.8, -1.5, 2.2, 0.3], [50, 20, 45, 40, 30, 45, 40, 30])


def multisine():
    t = np.arange(300) / 300.0
    waves = [np.sin(2.0 * np.pi * f * t + p) for f, p in ((2, 0.3), (5, 1.0), (9, 4.0), (14, 2.0))]
    return 2.5 * np.sum(waves, axis=0) / np.abs(np.sum(waves, axis=0)).max()


@pytest.mark.slow
@pytest.mark.parametrize("force", [few_steps, multisine])
def test_a_right_name_is_rejected_no_more_often_than_said(force):
    """Of 60 series at a level of 0.02, five or more have probability 0.7 %.

    With noise as estimated, and what its gain happens to have in common with the shapes projected out, seven
    of the 60 with steps were rejected.
    """
    base, rejected = SPRING, 0
    for name, size in (("coulomb:velocity", 0.12), ("cubic:position->velocity", -1.2)):
        model = make_effect(name, Setting(base, dt=0.1)).apply(base)
        theta = [*base.theta(), size]
        for seed in range(30):
            rng = np.random.default_rng(seed)
            record = simulate(model, theta, 300, rng, u=force()[:, None], dt=0.1).series
            fit = quasi_ml(model, record, theta)
            found = lack_of_fit(fit, record, ["velocity"], ["position", "velocity"])
            rejected += found.p_value <= LEVEL
    assert rejected < 5


def road():
    """A car on a road whose slope wanders for a quarter of the record, and where it is."""
    fade = np.exp(-1.0 / 80.0)
    return engine.MixedModel(
        name="road",
        dynamics=lambda a, u, t, dt, th: (
            [a[:, 0] + dt * (u[0] - th.k * a[:, 0] * np.abs(a[:, 0])), dt * a[:, 0], 0.0],
            [[0.0, dt], [1.0, 0.0], [0.0, fade]],
            [[th.q1**2, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, th.q2**2]],
        ),
        measurement=lambda a, u, t, th: (
            [a[:, 0], 0.0],
            [[0.0, 0.0], [1.0, 0.0]],
            [[th.r1**2, 0.0], [0.0, th.r2**2]],
        ),
        initial=lambda th: (
            engine.Gaussian([25.0], [[0.25]]),
            [0.0, 0.0],
            [[1.0, 0.0], [0.0, 1e-3]],
        ),
        nonlinear={"speed": "m/s"},
        linear={"position": "m", "slope": "m/s^2"},
        inputs={"force": "m/s^2"},
        outputs={"speedometer": "m/s", "satellite": "m"},
        parameters=[
            engine.Parameter("k", 3e-4, "1/m", (0.0, 1.0)),
            engine.Parameter("q1", 7e-3, "m/s", (1e-5, 1.0)),
            engine.Parameter("q2", 0.02, "m/s^2", (1e-5, 1.0)),
            engine.Parameter("r1", 0.3, "m/s", (1e-3, 9.0)),
            engine.Parameter("r2", 3.0, "m", (1e-2, 99.0)),
        ],
    )


@pytest.mark.slow
def test_states_that_wander_do_not_look_like_a_shape():
    """Of 12 series at a level of 0.02, three or more have probability 0.2 %.

    Of 20 such series four were rejected by the statistic alone.
    """
    model, rejected = road(), 0
    for seed in range(12):
        rng = np.random.default_rng([7, seed])
        u = np.repeat(0.31 + rng.uniform(-0.7, 0.7, 40), 10)[:, None]
        record = simulate(model, None, 400, rng, u=u, dt=0.5).series
        fit, states = quasi_ml(model, record), ["speed", "position", "slope"]
        found = lack_of_fit(fit, record, ["speed", "slope"], states)
        rejected += found.p_value <= LEVEL
    assert rejected < 3


def test_noise_parameters_are_known_and_share_no_innovations_with_others():
    model = SPRING
    theta = np.asarray(model.theta())
    record = simulate(model, None, 60, np.random.default_rng(1), u=np.ones((60, 1)), dt=0.1).series
    every = np.arange(5)
    noise = noise_only(model, theta, every, record, moment_path(model, theta, record))
    assert noise.tolist() == [False, False, False, True, True]
    columns = parameter_columns(model, theta, every, record)
    split = np.array([one.v for one in apart(columns, noise, 60)])
    before = np.array([one.v for one in columns])
    both, own = split @ split.T, before @ before.T
    np.testing.assert_allclose(both[:3, :3], own[:3, :3])
    np.testing.assert_allclose(both[3:, 3:], own[3:, 3:])
    assert np.abs(own[:3, 3:]).min() > 1e-6  # chance
    assert np.abs(both[:3, 3:] - (before[:3, 60:] @ before[3:, 60:].T)).max() < 1e-9


@pytest.mark.slow
def test_the_same_in_other_units():
    record = series(with_shape(SHAPES["speed times force"]), 2).part(0, 160)
    rng = np.random.default_rng(3)
    units = Units.of(DRIVE, lambda: rng.integers(-20, 20))
    model, there = units.model(DRIVE), units.series(record)
    fits = [quasi_ml(DRIVE, record), quasi_ml(model, there)]
    one, other = (
        lack_of_fit(fit, own, STATES, STATES)
        for fit, own in zip(fits, (record, there), strict=True)
    )
    assert (one.terms, one.largest) == (other.terms, other.largest)
    assert other.statistic == pytest.approx(one.statistic, rel=1e-3)


@pytest.mark.slow
def test_a_name_whose_shape_is_wrong_is_not_said():
    record = series(with_shape(SHAPES["speed times force"]), 1)
    kinds = ["drag", "cubic", "quadratic", "coulomb", "force"]
    found = engine.diagnose(DRIVE, record, effects=kinds, seed=1)
    assert found.verdict is Verdict.UNKNOWN
    assert any("another shape" in note for note in found.notes)


def test_records_to_compare_with_are_drawn_together(monkeypatch):
    """One by one they took minutes on a record of 8000 steps, most of the time of a diagnosis."""
    seen = lack_of_fit_module.LackOfFit("v", 50.0, 4, 1e-4, ("v",))
    less = replace(seen, statistic=0.0)
    sizes = []

    def drawn(fit, series, n, rng):
        sizes.append(n)
        return (series,) * n

    monkeypatch.setattr(lack_of_fit_module, "several_drawn", drawn)
    monkeypatch.setattr(lack_of_fit_module, "_lacking", lambda *_: less)
    fit = SimpleNamespace(free=("k",))
    p = lack_of_fit_module._by_simulation(fit, None, seen, ["v"], ["v"], 1)
    assert p == 1.0 / (1.0 + lack_of_fit_module.SIMULATED) == 1.0 / 50.0
    assert len(sizes) < 6
    sizes.clear()
    monkeypatch.setattr(lack_of_fit_module, "_lacking", lambda *_: seen)
    assert lack_of_fit_module._by_simulation(fit, None, seen, ["v"], ["v"], 1) == 1.0
    assert sizes == [1]


def test_records_drawn_together_are_as_those_drawn_alone():
    """One is the same as before; of many each has its own first state and noise, and gaps as given."""
    model = engine.get_model("oscillator")
    u = np.ones((40, model.nu)) if model.nu else None
    gone = np.zeros((40, model.ny))
    gone[7] = np.nan
    like = engine.Series(gone, u, dt=0.1, y_names=[*model.outputs], u_names=[*model.inputs])
    fit = SimpleNamespace(model=model, theta=model.theta())
    rng = np.random.default_rng
    alone = engine.simulate(model, model.theta(), 40, rng(1), u=u, dt=0.1).y
    np.testing.assert_array_equal(drawn_from(fit, like, rng(1)).y[:7], alone[:7])
    many = np.array([one.y for one in several_drawn(fit, like, 400, rng(2))])
    each = np.array([drawn_from(fit, like, rng(k)).y for k in range(100)])
    assert np.isnan(many[:, 7]).all()
    at = [0, 1, 20, 39]
    spread = each[:, at].std(axis=0)
    np.testing.assert_allclose(many[:, at].std(axis=0), spread, rtol=0.35)
    assert (np.abs(many[:, at].mean(axis=0) - each[:, at].mean(axis=0)) < 0.5 * spread).all()
