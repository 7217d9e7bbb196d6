"""Blocks, folds and the comparison of losses."""

import numpy as np
import pytest
from scipy.stats import ttest_ind, ttest_rel

from engine.data.series import Series
from engine.diagnose.free_run.windows import windows
from engine.diagnose.free_run_fits.folds import BLOCKS, FOLDS, folds_of, p_better, times


def _record(T, seed=0, gap=slice(0, 0)):
    rng = np.random.default_rng(seed)
    y = rng.standard_normal(T)
    y[3 * T // 4 : 3 * T // 4 + 20] *= 30.0
    y[gap] = np.nan
    return Series(y, rng.standard_normal(T), dt=1.0)


def test_every_reading_is_left_out_once_and_the_extreme_ones_together():
    record = _record(800, gap=slice(100, 140))
    folds = folds_of([record])
    assert folds.blocks == BLOCKS
    assert len(folds.block) == record.observed.sum()
    assert np.sum([folds.out(k) for k in range(FOLDS)], axis=0).tolist() == [1] * len(folds.block)
    rows = np.flatnonzero(record.observed[:, 0])
    assert folds.out(0)[rows == 605].all()
    sizes = np.bincount(folds.fold, minlength=FOLDS)
    assert sizes.min() >= BLOCKS // FOLDS


def test_folds_do_not_depend_on_units_nor_on_a_shift():
    record = _record(500)
    other = record.replace(y=1e9 * record.y + 3.0, u=1e-6 * record.u - 5.0)
    np.testing.assert_array_equal(folds_of([record]).fold, folds_of([other]).fold)


def test_a_large_slow_swing_is_as_extreme_as_a_quick_one_however_long_the_blocks_are():
    """Blocks of 50 and of 500 rows: two with a swing of twenty, fourteen with noise of one."""
    for rows in (50, 500):
        y = np.random.default_rng(1).standard_normal(BLOCKS * rows)
        swing = 20.0 * np.hanning(rows)
        for k in (3, 9):
            y[k * rows : (k + 1) * rows] = swing
        fold = folds_of([Series(y, dt=1.0)]).fold
        assert fold[3] == fold[9] == 0


def test_several_records_share_the_blocks():
    folds = folds_of([_record(600), _record(200, 1)])
    assert folds.blocks == BLOCKS
    assert set(np.unique(folds.block[:600])) == set(range(12))


def test_no_record_is_left_out_as_a_whole():
    """Its first state would be told by nothing."""
    loud = _record(300, 2)
    records = [_record(300), loud.replace(y=40.0 * loud.y), _record(300, 3)]
    folds = folds_of(records)
    begin = 0
    for record in records:
        own = folds.fold[folds.block[begin : begin + len(record)]]
        assert len(set(own)) > 1
        begin += len(record)


def test_losses_are_compared_as_pairs():
    rng = np.random.default_rng(5)
    a, b = rng.standard_normal((2, BLOCKS - 1))
    few = p_better(a, b + 0.4)
    assert few == pytest.approx(ttest_rel(a, b + 0.4, alternative="less").pvalue)
    a, b = rng.standard_normal((2, BLOCKS))
    least = ttest_ind(b - a + 0.4, np.zeros(BLOCKS), equal_var=False, trim=1 / BLOCKS)
    assert p_better(a, b + 0.4) == pytest.approx(least.pvalue / 2.0)
    assert p_better(a, a) == 0.5
    a[3] = np.nan
    assert 0.0 < p_better(a, b) < 1.0
    assert times(a, a + 2.0 * np.log(3.0)) == pytest.approx(1.0 / 3.0)


def test_one_block_decides_nothing_but_a_fold_of_extreme_ones_does():
    """The first effect halves the error of every block but one, of which the other rows say nothing."""
    rng = np.random.default_rng(3)
    without = rng.standard_normal(BLOCKS)
    halved = without - 2.0 * np.log(2.0) + 0.1 * rng.standard_normal(BLOCKS)
    halved[5] = without[5] + 8.0
    assert p_better(halved, without) < 1e-6
    assert times(halved, without) == pytest.approx(0.5, rel=0.05)
    halved[: BLOCKS // FOLDS] = (
        without[: BLOCKS // FOLDS] + 8.0
    )  # another range: it does not carry there
    assert p_better(halved, without) > 0.5
    assert times(halved, without) > 1.0


def test_p_values_without_the_ends_are_those_of_chance():
    """Of 4000 pairs of losses that differ by chance, normal or with heavy tails."""
    rng = np.random.default_rng(9)
    for draw in (rng.standard_normal, lambda size: rng.standard_t(3.0, size)):
        p = np.array([p_better(a, b) for a, b in draw((4000, 2, BLOCKS))])
        assert 0.04 < np.mean(p <= 0.05) < 0.06
        assert 0.004 < np.mean(p <= 0.01) < 0.016


def test_a_long_record_is_searched_on_windows_that_differ():
    record = _record(40_000)
    parts = windows([record], 4000)
    assert [len(part) for part in parts] == [1000] * 4
    assert any(part.t[0] <= 30_005.0 <= part.t[-1] for part in parts)  # where it moves most
    assert windows([record], 50_000) == [record]
