"""The whole of it: limits are kept, twins are said to be such, the same seed gives the same design."""

import csv
import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import engine
from engine.design.candidates import before_any
from engine.design.criterion import adapted, precision
from engine.design.inputs import LEAK, leakage
from engine.design.runs import Experiments, simulated
from engine.diagnose.search.pipeline import find_causes
from engine.errors import OptionError
from service.designs import between_samples
from tests.engine.design.models_for_design import BOUNDS, CAUSES, drive

engine_design = importlib.import_module("engine.design")


def _designed(**options):
    given = {"causes": CAUSES, "inputs": 48, "seed": 1, **options}
    bounds, length = given.pop("bounds", BOUNDS), given.pop("length", 200)
    return engine.design_experiment(drive(), bounds, length, **given)


@pytest.fixture(scope="module")
def made():
    return _designed()


@pytest.mark.long
def test_the_design_tells_what_it_is_for(made):
    assert made.causes == tuple(CAUSES)
    assert made.u.shape == (200, 1)
    assert np.abs(made.u).max() <= 6.0
    assert made.D == min(made.experiment.D[0, 1], made.experiment.D[1, 0]) > 14.0
    assert made.probability > 0.95
    assert made.shortest is not None
    assert made.shortest.least >= 0.95
    assert len(made.shortest) <= 200
    assert made.predictions.shape == (2, 200, 1)
    assert not made.undecided


@pytest.mark.slow
def test_a_diagnosis_of_the_new_record_ends_in_the_right_name(made):
    model, right = drive(), 0
    for true in before_any(model, CAUSES, None, 0.1, None).candidates:
        for k in range(5):
            rng = np.random.default_rng(100 + k)
            s = engine.simulate(true.model, true.theta, 200, rng, u=made.u, dt=0.1).series
            found = find_causes(model, s, model.theta(), effects=list(CAUSES), seed=k)
            named = [r for r in found.search.rounds if r.equivalent]
            right += bool(named) and [r.effect.name for r in named[0].equivalent] == [true.name]
    assert right >= 9  # of 10; each is missed with a probability below 0.05


@pytest.mark.long
def test_it_does_better_than_a_random_binary_input(made):
    u = np.random.default_rng(2).choice([-6.0, 6.0], size=(1, 200, 1))
    e = Experiments.of(u, 0.1, "zoh", 1)
    q = before_any(drive(), CAUSES, None, 0.1, None)

    y, _ = simulated(q.candidates[0].model, q.candidates[0].theta, e)
    rival = q.candidates[1]
    D = adapted(y, rival, precision(rival, True), e, np.ones((200, 1), dtype=bool))[2]
    assert made.D > 2.0 * D


@pytest.mark.slow
def test_the_same_seed_gives_the_same_design(made):
    again = _designed()
    assert np.array_equal(again.u, made.u)
    assert np.array_equal(again.growth, made.growth)
    first, other = (_designed(seed=seed, inputs=8, length=60).u for seed in (1, 2))
    assert not np.array_equal(first, other)


@pytest.mark.slow
def test_limits_on_states_and_outputs_are_kept_whichever_cause_is_true():
    bounds = {
        "inputs": {"voltage": {"low": -6.0, "high": 6.0, "rate": 20.0}},
        "states": {"velocity": (-1.0, 1.5)},
        "outputs": {"tacho": (None, 1.4)},
        "dt": 0.1,
    }
    made = _designed(bounds=bounds)
    q = before_any(drive(), CAUSES, None, 0.1, None)
    for true in q.candidates:
        for one in (made.experiment, made.shortest):
            if one is None:
                continue
            y, x = simulated(true.model, true.theta, Experiments.of(one.u[None], 0.1, "zoh", 1))
            assert x.min() >= -1.0
            assert max(x.max(), y.max() + 0.1) <= 1.5
            assert np.abs(np.diff(one.u[:, 0])).max() <= 2.0 + 1e-9
        rng = np.random.default_rng(3)
        runs = [
            engine.simulate(true.model, true.theta, 200, rng, u=made.u, dt=0.1) for _ in range(40)
        ]
        inside = [(r.a[:, 0] >= -1.0) & (r.a[:, 0] <= 1.5) for r in runs]
        assert np.mean(inside) > 0.97  # two standard deviations off at the worst time


@pytest.mark.slow
def test_stop_bands_are_left_alone_in_every_record_that_is_offered(made):
    band = {"low": -6.0, "high": 6.0, "stopbands": [[0.2, 0.5], [2.0, 4.0]]}
    quiet = _designed(bounds={"inputs": {"voltage": band}, "dt": 0.1})
    limits = quiet.bounds.inputs["voltage"]
    for one in (quiet.experiment, quiet.shortest):
        assert one is not None
        assert leakage(one.u[:, 0], limits, 0.1) <= LEAK
        assert np.ptp(one.u) > 1.0
    assert leakage(made.u[:, 0], limits, 0.1) > LEAK


@pytest.mark.long
def test_limits_that_no_input_keeps_are_named():
    with pytest.raises(OptionError, match="inputs keeps the limit") as refused:
        _designed(bounds={**BOUNDS, "states": {"velocity": (-0.01, 0.01)}})
    assert refused.value.field == "bounds.states.velocity"


@pytest.mark.long
def test_twins_are_said_to_be_such():
    made = _designed(causes={"force:velocity": 0.2, "input-offset:voltage": 0.4})
    (one,) = made.undecided
    assert one.hopeless
    assert one.D < 0.01
    assert made.shortest is None
    assert made.probability == 0.0
    assert "no input within these bounds tells them apart" in str(made)
    assert "Nor would a sensor" in " ".join(str(made).split())


@pytest.mark.slow
def test_a_third_cause_is_told_apart_from_twins():
    made = _designed(
        causes={"force:velocity": 0.6, "input-offset:voltage": 1.2, "drag:velocity": 0.4}
    )
    assert [set(one.causes) for one in made.undecided if one.hopeless] == [
        {"force:velocity", "input-offset:voltage"}
    ]
    assert made.probability > 0.9
    assert "drag:velocity" in made.smallest[0]


def two_tanks():
    """Two tanks in a row; the lower one's level is measured, and where both begin is not known."""

    def dynamics(a, u, t, dt, th):
        upper, lower = a[:, 0], a[:, 1]
        ahead = [upper + dt * (u[0] - upper), lower + dt * (upper - lower)]
        return ahead, np.zeros((2, 0)), 1e-4 * dt * np.eye(2)

    return engine.MixedModel(
        name="two-tanks",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 1]], np.zeros((1, 0)), [[th.r**2]]),
        initial=lambda th: (engine.Gaussian([0.0, 0.0], np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"upper": "m", "lower": "m"},
        inputs={"pump": "m/s"},
        outputs={"gauge": "m"},
        parameters=[engine.Parameter("r", 0.02, "m", (1e-3, 1.0))],
    )


@pytest.mark.long
def test_the_sensor_that_tells_twins_apart_is_the_best_of_those_named():
    """Water that leaves either tank lowers the lower level alike: a gauge on the upper one decides."""
    causes = {"force:upper": -0.2, "force:lower": -0.2}
    bounds = {"inputs": {"pump": [0.0, 2.0]}, "dt": 0.2}
    made = engine.design_experiment(two_tanks(), bounds, 150, causes=causes, inputs=32, seed=1)
    (one,) = made.undecided
    assert one.hopeless
    upper, lower = one.sensors
    assert (upper.channel, upper.unit, lower.channel) == ("upper", "m", "lower")
    assert upper.D > 14.5 > 1.0 > lower.D
    assert upper.noise > 0.0
    assert "upper" in str(made)


@pytest.mark.long
def test_another_sensor_is_named_where_one_helps():
    spring = engine.get_model("oscillator")
    bounds = {"inputs": {"drive": [-0.02, 0.02]}, "dt": 0.05, "sigmas": 0}
    causes = {"coulomb:velocity": 0.02, "drag:velocity": 0.02}
    made = engine.design_experiment(spring, bounds, 60, causes=causes, inputs=32)
    (one,) = made.undecided
    assert {s.channel for s in one.sensors} <= {"position", "velocity"}
    if one.hopeless:
        assert [s.D for s in one.sensors] == sorted((s.D for s in one.sensors), reverse=True)


@pytest.mark.slow
def test_times_are_in_the_unit_of_the_bounds(made, tmp_path):
    assert made.time_unit == "s"
    hours = _designed(bounds={**BOUNDS, "time_unit": "h"}, length=60, inputs=16)
    assert hours.time_unit == hours.to_dict()["time_unit"] == "h"
    assert "60 samples every 0.1 h" in str(hours)
    assert "time [h]" in Path(hours.report(tmp_path / "h.html")).read_text("utf-8")
    with pytest.raises(OptionError, match="time_unit"):
        _designed(bounds={**BOUNDS, "time_unit": ""})


@pytest.mark.slow
def test_a_design_takes_the_unit_of_the_diagnosed_record(made):
    rng = np.random.default_rng(5)
    true = before_any(drive(), CAUSES, None, 0.1, None).candidates[0]
    series = engine.simulate(
        true.model, true.theta, 200, rng, u=made.u, dt=0.1, time_unit="min"
    ).series
    found = engine.diagnose(drive(), series, effects=list(CAUSES), max_effects=1)
    asked = engine_design.asked_of(found, BOUNDS, 60, list(CAUSES))
    assert asked.task.bounds.time_unit == "min"
    assert between_samples(found.to_dict())["time_unit"] == "min"


@pytest.mark.parametrize("unit", ["min", "µs", "shift"])
def test_a_file_of_the_input_tells_the_unit_of_its_times(made, tmp_path, unit):
    other = replace(made, bounds=replace(made.bounds, time_unit=unit))
    path = other.to_csv(tmp_path / "u.csv")
    assert (f"t [{unit}],voltage" in path.read_text()) == (unit != "shift")
    read = engine.Series.read(path, y=["voltage"])
    assert (read.time_unit, read.dt) == (unit, pytest.approx(made.dt))


def test_what_is_written(made, tmp_path):
    rows = list(csv.reader(made.to_csv(tmp_path / "u.csv").read_text().splitlines()))
    assert rows[0] == ["t", "voltage"]
    np.testing.assert_allclose(np.array(rows[1:], dtype=float)[:, 1], made.u[:, 0], rtol=1e-9)
    short = made.to_csv(tmp_path / "s.csv", shortest=True).read_text().splitlines()
    assert len(short) == 1 + len(made.shortest)
    document = made.to_dict()
    assert document["probability"] == made.probability
    assert document["experiment"]["u"]["voltage"] == made.u[:, 0].tolist()
    text = made.report(tmp_path / "d.html").read_text()
    assert "What it tells apart" in text
    assert "<svg" in text
    pytest.importorskip("matplotlib")
    assert list(made.plot()) == ["input", "predictions", "probability"]


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"length": 5}, "length"),
        ({"length": 10.5}, "length"),
        ({"inputs": 0}, "inputs"),
        ({"causes": None}, "causes"),
        ({"causes": ["drag:velocity", "coulomb:velocity"]}, "causes"),
        ({"causes": {"drag:velocity": 0.1}}, "causes"),
        ({"causes": {"drag:velocity": 0.0, "coulomb:velocity": 1.0}}, "causes.drag:velocity"),
        ({"causes": {"drag:velocity": "big", "coulomb:velocity": 1.0}}, "causes.drag:velocity"),
        (
            {"causes": {"drag:velocity": {"width": 1.0}, "coulomb:velocity": 1.0}},
            "causes.drag:velocity.width",
        ),
        ({"causes": {"drag:velocity": 0.1, "heavy-tails:tacho": 0.1}}, "causes"),
        ({"causes": {"drag:nothing": 0.1, "coulomb:velocity": 1.0}}, "effects"),
        ({"bounds": {"inputs": {"voltage": [-6.0, 6.0]}}}, "bounds.dt"),
        ({"free": ["speed"]}, "speed"),
    ],
)
def test_what_cannot_be_asked(options, field):
    with pytest.raises(OptionError) as refused:
        _designed(**options)
    assert refused.value.field == field


@pytest.mark.slow
def test_events_are_left_out_with_a_reason():
    causes = {**CAUSES, "step:velocity": {"step_velocity": 1.0}}
    made = _designed(causes=causes, inputs=16, length=80)
    assert made.causes == tuple(CAUSES)
    assert any("step:velocity was left out" in note for note in made.notes)
