"""The test of a gain on held-out rows, where its numbers are known by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student

import engine
from engine.diagnose import extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.gain.adoption import Decision, in_full
from engine.diagnose.gain.gain import (
    diebold_mariano,
    every_fifth,
    lags_for,
    measure_gain,
    measure_gain_interleaved,
)
from engine.estimation.quasi_ml import quasi_ml


def test_few_differences_without_correlation_are_judged_as_by_student():
    d = np.array([1.7, 0.7, -0.3])
    mean, error, p = diebold_mariano(d, np.ones(3, dtype=bool))
    assert (mean, error) == (pytest.approx(0.7), pytest.approx(1.0 / np.sqrt(3.0)))
    assert p == pytest.approx(student.sf(mean / error, 2))


def test_rows_that_are_not_held_out_do_not_count():
    d = np.array([1.7, 50.0, 0.7, -8.0, -0.3, 9.0])
    rows = np.array([True, False] * 3)
    mean, error, _ = diebold_mariano(d, rows)
    assert (mean, error) == (pytest.approx(0.7), pytest.approx(1.0 / np.sqrt(3.0)))


def test_steps_between_samples_hide_no_correlation():
    """Once every second row was nothing, and a standard error half as large as it was."""
    rng = np.random.default_rng(2)
    d = np.convolve(rng.standard_normal(204), np.ones(5), "valid")
    rows = rng.random(200) < 0.9
    finer, marked = np.zeros(4 * 200), np.zeros(4 * 200, dtype=bool)
    finer[::4], marked[::4] = d, rows
    np.testing.assert_allclose(diebold_mariano(finer, marked), diebold_mariano(d, rows))


@pytest.mark.parametrize(
    ("d", "p"), [([0.25, 0.25, 0.25], 0.0), ([-0.25, -0.25, -0.25], 1.0), ([0.0, 0.0, 0.0], 0.5)]
)
def test_differences_that_do_not_scatter_leave_no_doubt(d, p):
    found = diebold_mariano(np.array(d), np.ones(3, dtype=bool))
    assert found[2] == p


@pytest.mark.parametrize("rows", [2, 7, 8, 40])
def test_a_few_neighbours_adopt_nothing(rows):
    """Of an extension that is right, however sure two nearly equal differences look."""
    model = engine.get_model("local-level")
    series = engine.simulate(model, None, 100, np.random.default_rng(1)).series
    after = quasi_ml(model, series.part(0, 60))
    before = replace(after, theta=model.theta(np.asarray(after.theta) * [100.0, 100.0, 1.0]))
    gain = measure_gain(before, after, [series.part(60, 60 + rows)], series.part(0, 60))
    assert gain.samples == rows
    if rows < 8:
        assert (gain.decision, gain.p_value) == (Decision.NO_EVIDENCE, 0.5)
        assert f"{rows} rows are held out" in in_full(gain)
    if rows == 40:
        assert gain.decision is Decision.ADOPTED


def test_one_difference_says_nothing():
    assert diebold_mariano(np.array([5.0]), np.ones(1, dtype=bool))[2] == 0.5


@pytest.mark.parametrize("r", [0.5, 0.8, 0.9])
def test_lags_are_those_that_andrews_advises(r):
    """For the Bartlett weights and an autoregression of the correlation that is seen."""
    d = lfilter([1.0], [1.0, -r], np.random.default_rng(1).standard_normal(2000))
    seen = (d[1:] @ d[:-1]) / (d @ d)
    alpha = 4.0 * seen**2 / ((1.0 - seen) ** 2 * (1.0 + seen) ** 2)
    assert lags_for(d) == int(1.1447 * (alpha * 2000) ** (1.0 / 3.0))


def test_lags_are_at_least_newey_and_wests_and_at_most_a_third():
    white = np.tile([1.0, -1.0], 200)
    assert lags_for(white) == int(4.0 * (400 / 100.0) ** (2.0 / 9.0))
    slow = np.linspace(-1.0, 1.0, 30)
    assert lags_for(slow) == 10
    assert lags_for(np.zeros(2)) == 1


@pytest.mark.parametrize("T", [12, 49, 50, 1003])
def test_every_row_is_left_out_once_in_blocks(T):
    folds = np.array([every_fifth(T, k) for k in range(5)])
    assert (folds.sum(axis=0) == 1).all()
    starts = np.flatnonzero(np.diff(folds.argmax(axis=0))) + 1
    lengths = np.diff([0, *starts, T])
    assert lengths[:-1].min() >= (T // 25 if T >= 50 else 2)
    assert len(lengths) == (25 if T >= 50 else -(-T // 2))


@pytest.mark.long
@pytest.mark.parametrize("row", [48, 49, 50, 51, 52])
def test_a_step_gains_wherever_it_falls_among_rows_left_out(row):
    """Of a step among rows left out the others do not tell at which; once it was put behind them all."""
    model = engine.get_model("local-level")
    theta = {"q": 100.0, "r": 400.0, "level": 1000.0}
    plain = engine.simulate(model, theta, 120, np.random.default_rng(row)).series
    series = plain.replace(y=plain.y + 250.0 * (np.arange(120) >= row)[:, None])
    base = quasi_ml(model, series)
    name = f"step:{series.y_names[0]}"
    extended = extend(model, [name], setting_for(model, series, np.asarray(base.theta)))
    size, time = extended.parameter_names[-2:]
    start = [*np.asarray(base.theta), 250.0, series.t[row]]
    fit = quasi_ml(extended, series, start, [*base.free, size])
    gain = measure_gain_interleaved(base, fit, [series], [time])
    assert gain.log_density > 10.0
    assert np.nanmin(gain.d) > -5.0
