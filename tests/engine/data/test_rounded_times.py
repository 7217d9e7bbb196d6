"""Times of an even clock that were written with too few digits."""

import numpy as np
import pytest

import engine
from engine.data.faults import about_faults
from engine.data.files import read_series
from engine.data.rounded_times import rounded_times
from engine.diagnose.symptoms.data_checks import check_data
from engine.errors import ReadingWarning, SeriesError


def clock(n, dt, digits, first=0.0, gap=0, cut=False):
    rows = np.arange(n) + gap * (np.arange(n) > n // 2)
    times = first + dt * rows
    return np.floor(times * 10.0**digits + 1e-9) / 10.0**digits if cut else times.round(digits)


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("gap", [0, 37])
@pytest.mark.parametrize("first", [0.0, 0.0123, 1.7e9])
@pytest.mark.parametrize(("dt", "digits"), [(1 / 30, 2), (1 / 60, 3), (10 / 3, 0), (100 / 3, -1)])
def test_an_even_step_is_found_whatever_the_unit_and_the_zero(dt, digits, first, gap, cut):
    said = rounded_times(clock(300, dt, digits, first, gap, cut), "s")
    assert f"rounded to {10.0**-digits:g} s" in said
    step = float(said.partition("dt=")[2].partition(" ")[0])
    assert step == pytest.approx(dt, abs=1.1 * 10.0**-digits / 300.0)


@pytest.mark.parametrize(
    ("written", "size", "dt", "digits"),
    [("h", 3600.0, 10.0, 4), ("min", 60.0, 2.0, 2), ("day", 86400.0, 20.0, 5), ("h", 60.0, 2.0, 2)],
)
def test_digits_show_in_the_unit_in_which_times_were_written(written, size, dt, digits):
    unit = "min" if size == 60.0 and written == "h" else "s"
    said = rounded_times(size * clock(300, dt / size, digits), unit)
    assert f"rounded to {10.0**-digits:g} {written}: one even step of {dt:g} {unit} " in said


def test_dates_to_the_second_are_rounded_in_any_unit(tmp_path):
    path = tmp_path / "logger.csv"
    stamps = (
        f"2024-03-01 08:{s // 60:02d}:{s % 60:02d},{s}"
        for s in np.floor(2.5 * np.arange(200)).astype(int)
    )
    path.write_text("time,y\n" + "\n".join(stamps))
    with pytest.warns(ReadingWarning, match=r"rounded to 1 s: one even step of 0\.041\d* min "):
        read_series(path, ["y"], time_unit="min")


@pytest.mark.parametrize("seed", range(20))
def test_a_clock_that_is_not_even_is_left_alone(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 300))
    by_chance = np.cumsum(rng.uniform(0.5, 1.5, n)).round(1)
    late = (np.arange(n) + rng.uniform(-0.2, 0.2, n)).round(2)
    for unit in ("s", "min", "h", "day"):
        assert not rounded_times(by_chance, unit)
        assert not rounded_times(late, unit)


@pytest.mark.parametrize(
    "times",
    [
        0.1 * np.arange(100),
        np.linspace(0.0, 1.0, 31),
        np.append(np.arange(50.0), 90.0 + np.arange(50.0)),
        60.0 * np.append(np.arange(10), 71 + np.arange(5)),
        np.cumsum(np.tile([31.0, 28.0, 31.0, 30.0, 31.0, 30.0], 6)),  # months, in days
        86400.0 * np.cumsum(np.tile([31.0, 28.0, 31.0, 30.0, 31.0, 30.0], 6)),
    ],
)
def test_nor_one_that_is_even_has_gaps_or_counts_months(times):
    assert not rounded_times(times, "s")


def test_a_table_and_a_diagnosis_say_so(tmp_path):
    t = clock(100, 1 / 30, 2)
    y = np.sin(t)
    path = tmp_path / "camera.csv"
    path.write_text("t,y\n" + "\n".join(f"{a},{b}" for a, b in zip(t, y, strict=True)))
    with pytest.warns(ReadingWarning, match=r"one even step of 0\.0333 "):
        series = read_series(path, ["y"])
    model = engine.get_model("local-level")
    assert any("steps are of 0.03 and 0.04 s" in note for note in check_data(model, series))
    assert "rounded to 0.01 s" in about_faults(model.outputs, model.inputs, [series])
    assert not any("rounded" in note for note in check_data(model, engine.Series(y, dt=1 / 30)))


@pytest.mark.parametrize("gap", [0, 37])
@pytest.mark.parametrize(("size", "dt", "digits"), [(1.0, 1 / 30, 2), (3600.0, 10.0, 4)])
def test_the_step_that_is_told_makes_them_even(size, dt, digits, gap):
    """It was refused as another one than that of the times, which stand in a file."""
    rounded = size * clock(300, dt / size, digits, gap=gap)
    step = float(rounded_times(rounded, "s").partition("dt=")[2].partition(" ")[0])
    t = engine.Series(np.zeros(300), t=rounded, dt=step).t
    assert np.abs(t - rounded).max() <= 1.05 * size * 10.0**-digits
    steps = np.diff(t)
    np.testing.assert_allclose(steps[steps < 1.5 * dt], step, rtol=1e-9)
    with pytest.raises(SeriesError, match="both given and differ"):
        engine.Series(np.zeros(300), t=rounded, dt=1.02 * dt)


def test_times_that_are_not_rounded_stay_as_they_are_beside_their_step():
    late = np.arange(100) + np.random.default_rng(1).uniform(-0.04, 0.04, 100)
    late[-1] = 99.0 + late[0]
    np.testing.assert_array_equal(engine.Series(np.zeros(100), t=late, dt=1.0).t, late)
    even = 0.1 * np.arange(100) + 0.3
    np.testing.assert_array_equal(engine.Series(np.zeros(100), t=even, dt=0.1).t, even)
