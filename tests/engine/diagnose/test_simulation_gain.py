"""Free-run errors before and after an extension, by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine import Series
from engine.diagnose.gain.adoption import runs_changed
from engine.diagnose.gain.gain import measure_gain
from engine.diagnose.gain.simulation_gain import bootstrap_means, output_gains
from engine.estimation.quasi_ml import quasi_ml

T = 1000
BASE = SimpleNamespace(model=SimpleNamespace(outputs={"near": "m", "far": "K", "silent": "V"}))


@pytest.fixture(scope="module")
def made():
    """Readings of three outputs, one nearly without any, and two runs; every fourth row is held out."""
    rng = np.random.default_rng(3)
    y = rng.standard_normal((T, 3)) * [2.0, 5.0, 1.0]
    y[rng.random(T) < 0.1, 0] = np.nan
    y[3:, 2] = np.nan
    rows = np.arange(T) % 4 != 1
    runs = [np.nan_to_num(y) + size * rng.standard_normal((T, 3)) for size in (0.5, 0.3)]
    floor = np.array([0.1, 0.6, 0.1])
    return y, rows, runs, output_gains(BASE, Series(y, dt=1.0), rows, *runs, floor, seed=1)


def test_errors_are_those_of_the_rows_held_out_that_have_a_reading(made):
    y, rows, runs, found = made
    assert [(one.output, one.unit) for one in found][:2] == [("near", "m"), ("far", "K")]
    for i, one in enumerate(found[:2]):
        kept = rows & np.isfinite(y[:, i])
        before, after = (np.sqrt(np.mean((y[kept, i] - run[kept, i]) ** 2)) for run in runs)
        assert (one.rmse_before, one.rmse_after) == pytest.approx((before, after))
        assert one.difference == pytest.approx(after - before)
        spread = np.std(y[kept, i])
        assert one.fit_before == pytest.approx(100.0 * (1.0 - before / spread))
        assert one.fit_after == pytest.approx(100.0 * (1.0 - after / spread))


def test_the_share_that_is_gone_is_of_what_stands_above_the_noise(made):
    near, far = made[3][:2]
    gone = near.rmse_before**2 - near.rmse_after**2
    assert near.share_gone == pytest.approx(gone / (near.rmse_before**2 - 0.1**2))
    assert far.share_gone is None  # there was nothing above it


def test_intervals_are_those_of_a_mean_of_independent_squares(made):
    """Of n normal errors the rms has the standard error rms / sqrt(2 n); 95 % lie within 1.96 of them."""
    y, rows, _, found = made
    for i, one in enumerate(found[:2]):
        n = int((rows & np.isfinite(y[:, i])).sum())
        for rms, (low, high) in (
            (one.rmse_before, one.interval_before),
            (one.rmse_after, one.interval_after),
        ):
            assert low < rms < high
            assert high - low == pytest.approx(2 * 1.96 * rms / np.sqrt(2.0 * n), rel=0.2)
        low, high = one.interval_difference
        width = 2 * 1.96 * np.hypot(one.rmse_before, one.rmse_after) / np.sqrt(2.0 * n)
        assert low < one.difference < high
        assert high - low == pytest.approx(width, rel=0.2)  # the two runs' errors are independent


def test_an_output_with_a_single_reading_held_out_has_no_error(made):
    y, _, runs, found = made
    assert [one.output for one in found] == ["near", "far", "silent"]  # rows 0 and 2
    only = np.arange(T) == 0
    assert output_gains(BASE, Series(y, dt=1.0), only, *runs, np.ones(3), seed=1) == []


def wandering():
    """A level that wanders about zero, for a hundred samples at a time."""

    def dynamics(a, u, t, dt, th):
        return [0.0], [[0.98]], [[0.04]]

    def measurement(a, u, t, th):
        return [th.offset], [[1.0]], [[1e-2]]

    return engine.MixedModel(
        name="wandering",
        dynamics=dynamics,
        measurement=measurement,
        initial=lambda th: (None, [0.0], [[1.0]]),
        linear={"level": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("offset", 0.0, "m")],
    )


@pytest.mark.long
def test_a_run_that_noise_took_further_off_is_no_worse():
    """Of 60 records of the extended model itself, 120 rows each, about a run that is 0.4 m off before."""
    model = wandering()
    after = quasi_ml(
        model, engine.simulate(model, None, 400, np.random.default_rng(0)).series, free=[]
    )
    before = replace(after, theta=model.theta({"offset": 0.4}))
    seemed = worse = 0
    for seed in range(60):
        series = engine.simulate(model, None, 140, np.random.default_rng([9, seed])).series
        gain = measure_gain(before, after, [series.part(20, 140)], series.part(0, 20), seed)
        (one,) = gain.outputs
        seemed += one.interval_difference[0] > 0.0
        worse += bool(runs_changed(gain.outputs)[1])
        assert (one.as_worse is None) == (one.interval_difference[0] <= 0.0)
    assert seemed >= 8  # by blocks of the record alone
    assert worse <= 6  # of 60, where 5 % are wanted


def test_a_run_that_is_off_beyond_what_noise_does_is_worse():
    model = wandering()
    before = quasi_ml(
        model, engine.simulate(model, None, 400, np.random.default_rng(0)).series, free=[]
    )
    after = replace(before, theta=model.theta({"offset": 8.0}))
    series = engine.simulate(model, None, 140, np.random.default_rng(3)).series
    gain = measure_gain(before, after, [series.part(20, 140)], series.part(0, 20))
    assert gain.outputs[0].as_worse == 0.0
    assert runs_changed(gain.outputs)[1]


def test_excursions_that_dwarf_both_runs_excuse_neither():
    """As of outliers of a state: by the difference half of them excused a run four times as far off."""
    base = SimpleNamespace(model=SimpleNamespace(outputs={"y": "m"}))
    rng, rows = np.random.default_rng(5), np.ones(80, dtype=bool)
    part = engine.Series(y=0.3 * rng.standard_normal((80, 1)), dt=1.0)
    before, after = np.zeros((80, 1)), np.full((80, 1), 1.2)
    far = 30.0 * rng.choice([-1.0, 1.0], (200, 1, 1)) * np.ones((1, 80, 1))
    (one,) = output_gains(base, part, rows, before, after, np.ones(1), 0, lambda: far)
    assert one.interval_difference[0] > 0.0
    assert one.as_worse < 0.05
    near = 0.2 * rng.standard_normal((200, 80, 1))  # where the run before was
    (one,) = output_gains(base, part, rows, before, after, np.ones(1), 0, lambda: near)
    assert one.as_worse > 0.05


def test_resampled_means_of_a_run_that_all_but_runs_away_are_those_in_other_units():
    values = np.exp(np.random.default_rng(1).standard_normal((2, 60)))
    usual, large = (bootstrap_means(k * values, np.random.default_rng(2)) for k in (1.0, 1e250))
    np.testing.assert_allclose(large, 1e250 * usual, rtol=1e-12)
