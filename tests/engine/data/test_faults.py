"""Faults of a record that an estimate is told of: marks in place of readings, dead channels, spikes."""

from dataclasses import replace

import numpy as np
import pytest

from engine import fit_simulation, get_model, ps_em, rbps_em, rts_em
from engine.data.faults import about_faults, faults_of, marks_in
from engine.data.series import Series
from engine.simulation.simulate import simulate

LEVEL, TANKS = get_model("local-level"), get_model("tanks")


def noisy(seed=0, n=300):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.standard_normal(n)) + rng.standard_normal(n)


def marks(y):
    return [(mark, often) for mark, often, *_ in marks_in(np.asarray(y, dtype=float))]


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_marks_in_place_of_readings_are_found_in_any_unit(scale):
    y = noisy()
    y[[0, 1, 40, 90, 91, 92]] = -999.0
    assert marks(scale * y) == [(-999.0 * scale, 6)]
    y[[17, 200]] = 9999.0
    assert sorted(marks(scale * y)) == [(-999.0 * scale, 6), (9999.0 * scale, 2)]


def told(y):
    return faults_of({"y": ""}, {}, Series(y=y[:, None]))


def test_what_is_no_mark():
    y = noisy()
    assert marks(y) == []
    off, first, last, levels = (
        y.copy() + 1e3,
        y.copy(),
        y.copy(),
        np.repeat([0.0, 1.0, 50.0, 1.0], 50),
    )
    off[50:90] = 0.0  # switched off
    first[:20], last[-20:] = -500.0, -500.0  # before it begins, after it has ended
    single = y.copy()
    single[77] = -999.0  # an outlier, of which more is said elsewhere
    half = np.where(np.arange(300) % 2, y, 700.0)  # a state of the plant
    for signal in (off, first, last, levels, single, half):
        assert marks(signal) == []
    for seed in range(20):
        heavy = np.round(np.random.default_rng(seed).standard_t(2.0, 500), 1)
        assert marks(heavy) == []


def test_sentences_name_channel_number_and_remedy():
    rng = np.random.default_rng(1)
    u = rng.uniform(1.0, 4.0, 300)
    y = noisy(2)
    y[[50, 51, 120]] = -999.0
    u[[10, 60]] = 1e6
    output, entry = faults_of(TANKS.outputs, TANKS.inputs, Series(y, u))
    (name,) = TANKS.outputs
    assert output.startswith(f"Output {name} is exactly -999 V in 3 samples")
    assert "NaN" in output
    assert entry.startswith("Input pump is exactly 1e+06 V in 2 samples")
    (dead,) = faults_of(LEVEL.outputs, {}, Series(np.full(50, 3.0)))
    assert "3 throughout: the channel is dead" in dead


def test_of_many_records_a_few_sentences_are_told():
    y = noisy()
    y[[50, 51, 120]] = -999.0
    records = [Series(noisy(3)), *5 * [Series(y)]]
    said = about_faults(LEVEL.outputs, {}, records)
    assert said.startswith("Look at the record first. Record 1: Output")
    assert said.count("Record ") == 3
    assert said.endswith("5 in all.")
    assert about_faults(LEVEL.outputs, {}, records[:1], outliers=True) == ""


@pytest.mark.long
def test_estimates_tell_of_faults():
    """Of marks, and of single readings far off where the noise is Gaussian; of clean records none."""
    rng = np.random.default_rng(4)
    clean = simulate(LEVEL, None, 120, rng).series
    marked, spiked = clean.y.copy(), clean.y.copy()
    marked[[20, 21, 70]] = -9999.0
    spiked[50] += 30.0 * np.std(np.diff(clean.y[:, 0]))
    for y, word in ((clean.y, ""), (marked, "a mark for"), (spiked, "1 single reading")):
        series = Series(y)
        for found in (
            rts_em(LEVEL, series, n_iterations=2),
            rbps_em(LEVEL, series, n_iterations=1, n_particles=5, warm_start=False),
            ps_em(LEVEL, series, n_iterations=1, n_particles=5),
        ):
            assert ("Look at the record first" in found.message) == bool(word)
            assert word in found.message


def test_a_fit_of_the_simulation_tells_of_faults():
    series = simulate(TANKS, None, 150, np.random.default_rng(5), np.full((150, 1), 3.0)).series
    y = series.y.copy()
    y[[20, 21, 70]] = -999.0
    fit = fit_simulation(TANKS, replace(series, y=y), n_starts=1, max_evaluations=3)
    assert "a mark for 'no reading'" in fit.message


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rounded_readings_of_a_slow_signal_are_not_stuck(seed):
    rng, t = np.random.default_rng(seed), np.arange(400)
    for slow in (np.sin(t / 50.0), 5.0 * np.exp(-t / 60.0), np.cumsum(rng.normal(0.0, 0.03, 400))):
        for step in (0.1, 0.2, 0.5):
            rounded = step * np.round((slow + rng.normal(0.0, 0.01, 400)) / step)
            assert not any("stuck" in said for said in told(rounded))


@pytest.mark.parametrize("step", [0.0, 1e-3, 0.1])
def test_a_stuck_reading_is_told_rounded_or_not(step):
    """Once, and twice in one record."""
    t, rng = np.arange(400), np.random.default_rng(0)
    y = 10.0 * np.sin(t / 8.0) + rng.normal(0.0, 0.05, 400)
    y = step * np.round(y / step) if step else y
    for places in ([90], [90, 250]):
        stuck = y.copy()
        for row in places:
            stuck[row : row + 40] = stuck[row]
        (said,) = told(stuck)
        assert "for 40 samples" in said
        assert said.endswith("a stuck reading?")


def test_an_output_that_was_never_read_and_a_mark_alone_are_no_fault():
    y = np.column_stack([noisy(), np.full(300, np.nan)])
    outputs = {"a": "m", "b": "m"}
    assert about_faults(outputs, {}, [Series(y)], outliers=True) == ""
    y[5, 1] = -999.0
    assert marks(y[:, 1]) == []
