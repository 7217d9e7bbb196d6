"""An estimate looked at: its documents hold what the engine's own functions say."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.symptoms.curves import residuals_of, rounded
from engine.diagnose.symptoms.residuals import autocorrelation
from engine.diagnose.symptoms.symptoms import SIMULATED_SAMPLES, find_symptoms
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.mixed_4 import MODEL as MIXED
from engine.presentation.examination import examination
from engine.simulation.simulate import simulate


@pytest.fixture(scope="module")
def series():
    y = simulate(LINEAR, None, 150, np.random.default_rng(1)).y
    y[20:25] = np.nan
    return Series(y)


@pytest.fixture(scope="module")
def found(series):
    return engine.rts_em(LINEAR, series, n_iterations=20)


@pytest.mark.long
def test_the_document_of_an_estimate(series, found):
    errors = engine.standard_errors(LINEAR, found.theta, series, exact=True)
    document = json.loads(
        json.dumps(engine.examine(found, series, errors).to_dict(), allow_nan=False)
    )
    theta = document["estimate"]["theta"]
    assert theta["value"] == found.theta["theta"]
    assert theta["standard_error"] == pytest.approx(errors.values[0])
    np.testing.assert_allclose(theta["interval"], errors.interval()[0])
    assert document["trace"]["theta"]["theta"] == found.trace[:, 0].tolist()
    exact = engine.kalman_smoother(LINEAR, found.theta, series)
    mean = np.array([document["states"]["series"][0]["mean"][name] for name in ("a", "z")]).T
    sd = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    assert np.abs((mean - exact.x) / sd).mean() < 0.3  # 100 particles
    one = document["examination"]["series"][0]
    assert one["one_step"]["curves"]["measured"]["y"][20:25] == [None] * 5
    assert one["residuals"]["z"]["y"][22] is None


@pytest.mark.long
def test_what_is_printed_tells_what_was_found(series, found):
    looked_at = engine.examine(found, series, test=Series(np.nan_to_num(series.y)))
    text = " ".join(str(looked_at).split())
    for sentence in looked_at.document["examination"]["series"][0]["sentences"]:
        assert " ".join(sentence.split()) in text
    assert found.message in text
    error = looked_at.document["held_out"]["outputs"][0]["rmse"]
    assert f"{error:.4g}" in text
    assert "document" not in text


def test_curves_are_those_of_the_kalman_filter(series, found):
    (one,) = examination(LINEAR, found.theta, [series])["series"]
    exact = engine.kalman_smoother(LINEAR, found.theta, series)
    z = np.array(one["residuals"]["z"]["y"], dtype=float)
    logs = -0.5 * np.nansum(z**2)
    half = np.array(one["one_step"]["curves"]["upper"]["y"], dtype=float) - np.array(
        one["one_step"]["curves"]["y"]["y"], dtype=float
    )
    seen = np.isfinite(z)
    logs -= np.log(half[seen] / 1.959964).sum() + 0.5 * seen.sum() * np.log(2.0 * np.pi)
    assert logs == pytest.approx(exact.log_likelihood, abs=1e-3)  # curves have seven digits


@pytest.mark.long
def test_uncertain_parameters_widen_the_free_run(series, found):
    errors = engine.standard_errors(LINEAR, found.theta, series, exact=True)
    wide = engine.examine(found, series, errors).document["examination"]["series"][0]
    narrow = engine.examine(found, series).document["examination"]["series"][0]

    def width(one):
        curves = one["free_run"]["curves"]
        return np.mean(np.subtract(curves["upper"]["y"], curves["lower"]["y"]))

    assert width(wide) > width(narrow)


def test_a_lost_filter_is_told_and_fails_nothing():
    series = simulate(MIXED, None, 50, np.random.default_rng(3)).series
    y = series.y.copy()
    y[10] = 1e200
    (one,) = examination(MIXED, None, [Series(y)])["series"]
    assert "filter is lost at row 1" in one["problem"]


def test_long_series_get_fewer_simulations(monkeypatch):
    drawn = []

    def draws(model, theta, series, mean, P, covariance, n, rng):
        drawn.append(n)
        return np.zeros((n, len(series), model.ny))

    module = importlib.import_module("engine.diagnose.symptoms.symptoms")
    monkeypatch.setattr(module, "draws", draws)
    monkeypatch.setattr(module, "SIMULATED_SAMPLES", 100 * 60)
    for n in (30, 100, 1000):
        find_symptoms(LINEAR, None, simulate(LINEAR, None, n, np.random.default_rng(1)).series)
    assert drawn == [200, 60, 40]
    assert SIMULATED_SAMPLES // 20_000 == 200


def test_residuals_as_pictures_need_them():
    rng = np.random.default_rng(5)
    e = rng.standard_normal(4001)
    z = (e[1:] + 0.5 * e[:-1])[:, None] / np.sqrt(1.25)  # r_1 = 0.5 / 1.25
    z[100:110] = np.nan
    blank = np.full((4000, 1), np.nan)
    out = residuals_of(np.arange(4000.0), z, blank, blank[1:], {"y": "V"}, ["x"])
    found = out["autocorrelation"]["y"]
    assert found["r"][0] == pytest.approx(0.4, abs=3 * found["limit"])
    assert max(map(abs, found["r"][1:])) < 3.5 * found["limit"]
    q = out["quantiles"]["y"]
    assert len(q["sample"]) == len(q["normal"]) == 200
    np.testing.assert_allclose(q["sample"], q["normal"], atol=0.3)
    h = out["histogram"]["y"]
    assert np.dot(h["density"], np.diff(h["edges"])) == pytest.approx(1.0, abs=1e-5)
    assert len(out["of_states"]["x"]) == len(out["t"])


def test_autocorrelation_leaves_missing_values_out():
    z = np.array([1.0, -1.0, np.nan, 1.0, -1.0, 1.0, -1.0])
    r, pairs = autocorrelation(z, 2)
    assert pairs.tolist() == [4.0, 3.0]
    assert r[0] == pytest.approx(-1.0)


def test_seven_digits_are_kept():
    values = np.array([1.23456789e-5, -98765432.1, 0.0, np.nan, np.inf, 1e-310])
    out = rounded(values)
    assert [repr(v) for v in out[:3].tolist()] == ["1.234568e-05", "-98765430.0", "0.0"]
    assert np.isnan(out[3])
    assert np.isinf(out[4])


@pytest.mark.long
def test_intervals_by_the_likelihood_ratio_replace_symmetric_ones(series, found):
    errors = engine.standard_errors(LINEAR, found.theta, series, exact=True)
    intervals = engine.likelihood_intervals(LINEAR, found.theta, series, errors=errors, exact=True)
    theta = engine.examine(found, series, errors, intervals).to_dict()["estimate"]["theta"]
    assert theta["interval"] == intervals.values[0].tolist()
    assert theta["standard_error"] == pytest.approx(errors.values[0])
