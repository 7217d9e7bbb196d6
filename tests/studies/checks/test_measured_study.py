"""The study of measured data, on the one set that comes with the engine."""

import json

import numpy as np
import pytest

from engine.data import nile
from engine.data.series import Series
from tests.studies import diagnose_measured as study
from tests.studies.study import Table


def test_thinning_averages_the_input_that_is_held():
    u = np.arange(10.0)
    thin = study.thinned(Series(np.arange(10.0) ** 2, u, dt=0.1), 4)
    np.testing.assert_allclose(thin.y[:, 0], [0.0, 16.0])
    np.testing.assert_allclose(thin.u[:, 0], [1.5, 5.5])
    assert thin.dt == pytest.approx(0.4)


def test_one_data_set_from_diagnosis_to_report_and_picture(monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    options = {"effects": ["step", "pulse", "ramp", "latent"]}
    case = study.Case("nile", "", lambda folder: ("local-level", nile(), None, options))
    monkeypatch.setitem(study.CASES, "nile", case)
    row = study.work("nile", 0, 0)
    assert row["verdict"] in ("named", "set", "unknown")
    assert str(row["causes"]).startswith("step:")
    found = json.loads(str(row["document"]))
    assert found["causes"][0]["parameters"]["step_flow_time"] == pytest.approx(1899.0, abs=1.0)
    assert max(len(str(value)) for value in row.values()) < 131072  # what a CSV field may hold
    tables = {"measured.nile": Table([row], {"data": "nile"}, 1.0, 1)}
    text = study.report(tables)
    assert "| nile | local-level |" in text
    assert "Skipped" in text
    assert "fitted by simulation error" in text
    study.plot(tables, tmp_path / "measured.png")
    assert (tmp_path / "measured.png").stat().st_size > 10_000


def test_an_error_of_the_diagnosis_is_a_row(monkeypatch):
    flows = nile()
    short = study.Case("nile", "", lambda folder: ("local-level", flows.part(0, 20), None, {}))
    monkeypatch.setitem(study.CASES, "nile", short)
    row = study.work("nile", 0, 0)
    assert row["verdict"] == "error"
    assert "30" in str(row["causes"])
