"""The study of measured records: its loaders, and one record from the diagnosis to the page."""

import json
import sys

import numpy as np
import pytest

from engine.data import nile
from engine.data.series import Series
from engine.diagnose import diagnose, hide
from engine.diagnose.records import HELD_OUT, records_of
from engine.models.registry import get_model
from engine.simulation.free_run import free_run
from tests.studies.measured import alone, by_sindy, models, records, report, runs, side_by_side
from tests.studies.measured.errors import simulated
from tests.studies.measured.known import KNOWN
from tests.studies.study import StudyError, Table


def test_the_table_of_a_cell_is_a_line_between_its_knots():
    theta = models.CELL.record(models.CELL.theta(None))
    q = np.array([-0.1, 0.0, 0.5, 0.99, 1.1])
    expected = models.EMPTY + (models.FULL - models.EMPTY) * q
    np.testing.assert_allclose(models.open_circuit(q, theta), expected)


def test_the_season_returns_after_twelve_months():
    theta = models.SEASONAL.record(models.SEASONAL.theta({"s_2": 1.0, "s_12": 2.0}))
    assert [float(models.season(t, theta)) for t in (0.0, 1.0, 11.0, 12.0, 13.0)] == [0, 1, 2, 0, 1]


@pytest.mark.long
@pytest.mark.parametrize("name", records.RECORDS)
def test_every_record_is_read_and_its_model_runs_on_it(name):
    record = records.RECORDS[name]
    if not record.there:
        pytest.skip(record.reason)
    data = record.load(record.path)
    theta = data.options.get("theta")
    for part in (data.train, *data.tests.values()):
        part.check(data.model)
        short = part.part(0, 60)
        assert np.isfinite(free_run(data.model, theta, short).y).all()
    test = next(iter(data.tests.values()), None)
    _, asked = records_of(data.model, data.train, test, data.options.get("held_out", HELD_OUT))
    assert data.blocks is not bool(data.tests)
    assert len(asked.train) == len(data.train) or name == "nile"  # whose step is in its first part
    assert set(KNOWN) == set(records.RECORDS)


@pytest.mark.slow
def test_the_law_is_found_although_it_is_in_the_last_fifth():
    record = records.RECORDS["seatbelts"]
    if not record.there:
        pytest.skip(record.reason)
    data = record.load(record.path)
    kinds = ["step", "pulse", "ramp", "drift"]  # of the whole catalogue the alarm is p = 0.06
    found = diagnose(data.model, data.train, seed=0, effects=kinds, **data.options)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "step:drivers"
    assert cause.parameters["step_drivers_time"] == pytest.approx(169.0, abs=1.0)
    assert abs(cause.size + 0.24) < 0.05
    assert found.gain is not None


def test_the_law_is_hidden_and_pulses_take_turns():
    missing = [name for name in ("seatbelts", "battery") if not records.RECORDS[name].there]
    if missing:
        pytest.skip(records.RECORDS[missing[0]].reason)
    law, cell = (records.RECORDS[name] for name in ("seatbelts", "battery"))
    assert law.load(law.path).train.u_names == ("price",)
    data = cell.load(cell.path)
    train, test = data.train.observed[:, 0], data.tests["even pulses"].observed[:, 0]
    assert (train ^ test).all()
    assert np.diff(train).sum() == 10  # into and out of each of five pulses


@pytest.mark.slow
def test_one_record_from_diagnosis_to_page_and_picture(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    options = {"effects": ["step", "pulse", "ramp", "latent"]}
    _replace_nile(monkeypatch, _levels(nile(), options))
    row = runs.work("nile", 0, 0)
    assert row["verdict"] in ("named", "set", "unknown")
    cause = json.loads(str(row["causes"]))[0]
    assert cause["effect"].startswith("step:")
    assert cause["values"]["step_flow_time"] == pytest.approx(1899.0, abs=1.0)
    text = report.report({"measured.nile": Table([row], {"data": "nile"}, 1.0, 1)})
    assert "| nile | all |" in text
    assert "Skipped" in text
    report.plot({"measured.nile": Table([row], {}, 1.0, 1)}, tmp_path / "measured.png")
    for picture in ("measured.png", "measured-nile.png"):
        assert (tmp_path / picture).stat().st_size > 10_000


def test_an_error_of_the_diagnosis_is_a_row(monkeypatch):
    _replace_nile(monkeypatch, _levels(nile().part(0, 20), {}))
    row = runs.work("nile", 0, 0)
    assert row["verdict"] == "error"
    assert "30" in str(row["causes"])
    assert "| error | - |" in report.report({"measured.nile": Table([row], {}, 1.0, 1)})


STIFF = "cubic:position->velocity"
SWING = {"omega": 2.0, "zeta": 0.05, "gain": 1.0, "sigma_v": 0.02, "sigma_y": 0.02}


def _swings(stiffness, rows=300):
    """An oscillator whose spring may be cubic: a record to fit, and one to judge on."""
    model = get_model("oscillator")
    series = []
    for k in (1, 2):
        rng = np.random.default_rng([5, k])
        u = np.repeat(rng.uniform(-1.0, 1.0, rows // 10), 10)
        own = {**SWING, "cubic_position__velocity": stiffness}
        series.append(hide(model, [STIFF], own, rows, rng, u=u, dt=0.1).series)
    options = {"theta": SWING, "effects": ["cubic"]}
    return records.Data(model, series[0], {"test": series[1]}, options, settled=20)


@pytest.mark.slow
def test_the_free_run_is_asked_of_the_base_where_the_likelihood_has_named_the_cause():
    data = _swings(-1.0)
    found = diagnose(data.model, data.train, test=data.tests["test"], **data.options)
    assert found.decided_by == "likelihood"
    assert found.free_run.search is None  # it was asked of the extension only
    said = alone.alone(found, data, simulated(found, data))
    for criterion in ("likelihood", "free run"):
        assert said[criterion]["names"][0][0] == STIFF
        before, after = said[criterion]["errors"]["test"]
        assert after < 0.5 * before
    assert said["free run"]["p"] < found.free_run.alarm.p_value


@pytest.mark.slow
def test_a_criterion_that_is_silent_ends_with_the_base():
    data = _levels(nile(), {"effects": ["step"]})
    found = diagnose(data.model, data.train, **data.options)
    runs_of_both = simulated(found, data)
    said = alone.alone(found, data, runs_of_both)
    assert said["likelihood"]["verdict"] == found.verdict.value
    assert said["likelihood"]["names"] == [["step:flow"]]
    free = said["free run"]
    assert (free["verdict"], free["names"]) == ("nothing", [])
    assert free["p"] > 0.05
    (part, (before, after)), *_ = free["errors"].items()
    assert before == after > 1.2 * said["likelihood"]["errors"][part][1]


@pytest.mark.slow
def test_pysindy_names_a_cubic_spring_and_simulates_it(monkeypatch):
    pytest.importorskip("pysindy")
    _replace_nile(monkeypatch, _swings(-1.0))
    row = by_sindy.work("nile", 0, 0)
    assert row["reason"] == ""
    base = json.loads(str(row["base"]))["test"]
    for label in by_sindy.SETTINGS:
        said = json.loads(str(row[label]))
        assert said["names"] == [STIFF]
        assert said["left_out"] == []
        assert said["errors"]["test"] < 0.3 * base


@pytest.mark.slow
def test_where_pysindy_finds_nothing_its_error_is_that_of_the_base(monkeypatch):
    pytest.importorskip("pysindy")
    _replace_nile(monkeypatch, _swings(0.0))
    row = by_sindy.work("nile", 0, 0)
    said = json.loads(str(row["careful"]))
    assert said["names"] == []
    assert said["errors"] == json.loads(str(row["base"]))


@pytest.mark.slow
def test_a_term_that_the_model_cannot_take_is_left_out():
    data = _swings(-1.0)
    known = by_sindy.estimated(data)
    parts = [known.train]
    base = by_sindy.fit_simulation(known.fit.model, parts, known.fit.theta, known.fit.free, 0)
    said = by_sindy.extended(known, base, parts, ["cubic:nowhere->velocity", STIFF], data, 0)
    assert said["left_out"] == ["cubic:nowhere->velocity"]
    assert said["errors"]["test"] < 0.3 * by_sindy.judge(base, data, 1)["test"]


@pytest.mark.long
def test_terms_count_from_the_zeros_of_the_effects_of_their_names(monkeypatch):
    pytest.importorskip("pysindy")
    model, rows = get_model("servo"), 200
    u = np.repeat(np.random.default_rng(3).uniform(2.0, 6.0, rows // 20), 20)
    series = hide(model, ["drag:velocity"], {}, rows, np.random.default_rng(4), u=u, dt=0.02).series
    known = by_sindy.Estimated(
        by_sindy.fit_base(model, series, model.theta(), ["Fv", "sigma_v", "sigma_y"]),
        series,
        series,
        1,
    )
    seen = []
    equation = by_sindy.equation
    monkeypatch.setattr(
        by_sindy, "equation", lambda x, *rest: (seen.append(x), equation(x, *rest))[1]
    )
    by_sindy.answers(known, 0)
    (x,) = seen  # the velocity's equation, no other
    position = x[:, list(known.setting.states).index("position")]
    assert np.median(series.y) > 0.5  # m: the drive goes one way
    assert abs(np.median(position)) < 0.01


def test_states_of_a_nonlinear_model_come_from_particles():
    model, rows = get_model("tanks"), 120
    u = np.repeat(np.random.default_rng(5).uniform(0.5, 4.0, rows // 20), 20)
    made = hide(model, ["cubic:lower"], {}, rows, np.random.default_rng(6), u=u, dt=4.0)
    known = by_sindy.Estimated(
        by_sindy.fit_base(model, made.series, model.theta(), ["sigma_y"]),
        made.series,
        made.series,
        1,
    )
    with pytest.raises(by_sindy.ModelError):
        by_sindy.kalman_smoother(model, known.fit.theta, known.part)
    x = by_sindy.smoothed(known, 0)
    assert x.shape == (rows, model.nx)
    assert np.sqrt(np.mean((x[:, 1] - made.series.y[:, 0]) ** 2)) < 0.1  # V: the level is measured


@pytest.mark.long
def test_without_pysindy_no_row_is_made(monkeypatch):
    _replace_nile(monkeypatch, _swings(-1.0, 100))
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(StudyError, match="PySINDy"):
        by_sindy.work("nile", 0, 0)


def test_each_equation_has_its_constant_once():
    assert by_sindy.constants(["drag:v", "cubic:x->v", "cubic:w"]) == ["force:v", "force:w"]


@pytest.mark.parametrize(
    ("model", "t", "blocks", "reason"),
    [
        ("local-level", np.arange(40.0), False, by_sindy.STILL),
        ("oscillator", np.arange(40.0) ** 1.1, False, by_sindy.IRREGULAR),
        ("oscillator", np.arange(40.0), True, by_sindy.NO_OTHER),
        ("oscillator", np.arange(40.0), False, ""),
    ],
)
def test_a_record_without_a_regression_says_why(model, t, blocks, reason):
    model = get_model(model)
    series = Series(np.zeros(40), np.zeros((40, model.nu)), t=t)
    data = records.Data(model, series, {"test": series}, blocks=blocks)
    assert by_sindy.cannot(data) == reason


ROW = {
    "verdict": "named",
    "errors": json.dumps({"test": [0.004, 0.001], "sweep": [0.005, None]}),
    "causes": json.dumps([{"effect": "drag:v", "others": ["cubic:v"]}]),
}
ALONE = {
    "likelihood": {
        "verdict": "unknown",
        "names": [],
        "p": 0.01,
        "errors": {"test": [0.004, 0.002]},
    },
    "free run": {
        "verdict": "set",
        "names": [["drag:v", "cubic:v"], ["bias:y"]],
        "p": 0.01,
        "errors": {"test": [0.004, None]},
    },
}
SPARSE = {
    "reason": "",
    "most right": json.dumps({"names": ["drag:v"], "left_out": [], "errors": {"test": 0.003}}),
    "careful": json.dumps({"names": [], "left_out": ["drag:w"], "errors": {"test": None}}),
}


def test_a_line_has_what_each_brings():
    record = records.Record("one", "", lambda folder: None, scale=1e3)
    cells = side_by_side.line(record, ROW | {"alone": json.dumps(ALONE)}, SPARSE)
    assert len(cells) + 2 == len(side_by_side.HEAD)
    assert cells == [
        *("4 / 5", "unknown (p = 0.01)", "2", "set: drag:v or cubic:v; bias:y", "lost"),
        *("named: drag:v or cubic:v", "1 / lost", "drag:v", "3"),
        *("nothing (no effect of the catalogue: drag:w)", "lost"),
    ]
    older = side_by_side.line(record, ROW, None)
    assert older[1:5] == ["made before", "-", "made before", "-"]
    assert older[7:] == ["not run", "-", "not run", "-"]
    assert older[5:7] == cells[5:7]


def test_the_page_says_why_a_record_has_no_regression(monkeypatch):
    row = ROW | {"decided": "likelihood", "causes": "", "seconds": 1.0}
    other = dict.fromkeys(SPARSE, "") | {"reason": "it is still"}
    tables = {"measured.nile": [row], "measured.nile.sindy": [other], "measured.emps": []}
    text = report.report({name: Table(rows, {}, 1.0, 1) for name, rows in tables.items()})
    assert "- PySINDy cannot be applied to nile: it is still." in text
    assert "measured.emps.csv" not in text  # nothing was run


def _replace_nile(monkeypatch, data):
    record = records.Record("nile", "", lambda folder: data, unit="1e8 m^3")
    monkeypatch.setitem(records.RECORDS, "nile", record)


def _levels(series, options):
    return records.Data(records.get_model("local-level"), series, {}, options, 0, True)
