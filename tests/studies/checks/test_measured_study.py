"""The study of measured records: its loaders, and one record from the diagnosis to the page."""

import json

import numpy as np
import pytest

from engine.data import nile
from engine.data.series import Series
from engine.simulation.free_run import free_run
from tests.studies.measured import models, records, report, runs
from tests.studies.measured.known import KNOWN
from tests.studies.study import Table


def test_thinning_averages_the_input_that_is_held():
    u = np.arange(10.0)
    thin = records.thinned(Series(np.arange(10.0) ** 2, u, dt=0.1), 4)
    np.testing.assert_allclose(thin.y[:, 0], [0.0, 16.0])
    np.testing.assert_allclose(thin.u[:, 0], [1.5, 5.5])
    assert thin.dt == pytest.approx(0.4)


def test_the_table_of_a_cell_is_a_line_between_its_knots():
    theta = models.CELL.record(models.CELL.theta(None))
    q = np.array([-0.1, 0.0, 0.5, 0.99, 1.1])
    expected = models.EMPTY + (models.FULL - models.EMPTY) * q
    np.testing.assert_allclose(models.open_circuit(q, theta), expected)


def test_the_season_returns_after_twelve_months():
    theta = models.SEASONAL.record(models.SEASONAL.theta({"s_2": 1.0, "s_12": 2.0}))
    assert [float(models.season(t, theta)) for t in (0.0, 1.0, 11.0, 12.0, 13.0)] == [0, 1, 2, 0, 1]


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
    assert set(KNOWN) == set(records.RECORDS)


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
    _replace_nile(monkeypatch, nile(), options)
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
    _replace_nile(monkeypatch, nile().part(0, 20), {})
    row = runs.work("nile", 0, 0)
    assert row["verdict"] == "error"
    assert "30" in str(row["causes"])
    assert "| error | - |" in report.report({"measured.nile": Table([row], {}, 1.0, 1)})


def _replace_nile(monkeypatch, series, options):
    model = records.get_model("local-level")
    data = records.Data(model, series, {}, options, 0, True)
    monkeypatch.setitem(
        records.RECORDS, "nile", records.Record("nile", "", lambda folder: data, unit="1e8 m^3")
    )
