"""What is put into measured records is what it is called, and as strong as it was asked to be."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.data.series import Series
from engine.diagnose import extend
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import quasi_ml
from tests.studies.plasmodes.planted import PUTS, Place, put_in
from tests.studies.plasmodes.report import in_set, right, wrong
from tests.studies.plasmodes.runs import NOTHING, answer, cells, work
from tests.studies.plasmodes.sizes import measure_of, searched, size_for
from tests.studies.plasmodes.windows import WINDOWS, Base, base_of
from tests.studies.study import Row

PLACE = Place(0.4, 0.3, 7)


def record() -> Base:
    """A driven resonance with 300 readings."""
    model = engine.get_model("oscillator")
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal((30, 1)), 10, axis=0)
    series = engine.simulate(model, model.theta(), 300, rng, u=u, dt=0.1).series
    window = next(w for w in WINDOWS if w.record == "tanks")
    return Base(window, model, series, model.theta(), tuple(model.parameter_names))


BASE = record()


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in PUTS if not PUTS[name].scatter])
def test_an_effect_is_as_strong_as_wanted(name: str) -> None:
    put = PUTS[name]
    size, there = size_for(BASE, put, PLACE, 40.0)
    changed = put_in(put, BASE.series, size, PLACE)
    part = replace(BASE, series=searched(BASE.series))
    again = measure_of(part)(searched(changed))
    assert again.value == pytest.approx(there.value)
    assert 0.0 < there.own <= 1.0
    # a channel with nothing put in has no strength; half the size has less
    assert measure_of(part)(part.series).value < 1e-9
    half = measure_of(part)(searched(put_in(put, BASE.series, 0.5 * size, PLACE)))
    assert half.value < there.value
    if size < put.most:
        assert there.value == pytest.approx(40.0, rel=0.1)


def test_noise_that_grows_is_worth_to_a_refit_what_was_wanted() -> None:
    """The likelihood ratio of the extended model, less what the record shows of it by itself."""
    put, base = PUTS["variance:{y}->time"], base_of(next(w for w in WINDOWS if w.record == "nile"))
    size, there = size_for(base, put, PLACE, 40.0)
    assert there.value == pytest.approx(40.0, rel=0.1)
    part = searched(base.series)
    setting = setting_for(base.model, part, np.asarray(base.theta))
    extended = extend(base.model, ["variance:flow->time"], setting)
    free = [*base.free, extended.parameter_names[-3]]
    ratios = []
    for series in (part, searched(put_in(put, base.series, size, PLACE))):
        start = quasi_ml(base.model, series, base.theta, base.free)
        values = dict(zip(base.theta.names, start.theta.tolist(), strict=True))
        found = quasi_ml(extended, series, extended.theta(values), free).log_likelihood
        ratios.append(2.0 * (found - start.log_likelihood))
    assert ratios[1] - ratios[0] == pytest.approx(40.0, rel=0.3)


def test_one_reading_is_put_off() -> None:
    series = Series(np.where(np.arange(50) % 3, np.sin(np.arange(50.0)), np.nan), dt=1.0)
    moved = put_in(PUTS["pulse:{y}"], series, 4.0, PLACE).y - series.y
    (row,) = np.flatnonzero(np.nan_to_num(moved))
    assert 15 <= row <= 36
    assert moved[row, 0] == pytest.approx(4.0 * np.nanstd(series.y))


@pytest.mark.parametrize("shift", [0.0, 273.15])
def test_readings_are_put_late_by_the_samples_that_are_said(shift: float) -> None:
    t = np.arange(200.0)
    series = Series(np.sin(0.1 * t) + shift, np.cos(0.07 * t), dt=1.0)
    late = put_in(PUTS["delay:{y}"], series, 3.0, PLACE).y[:, 0]
    assert np.isnan(late[:3]).all()
    np.testing.assert_allclose(late[3:], series.y[:-3, 0])
    early = put_in(PUTS["delay:{u}"], series, 3.0, PLACE).u[:, 0]
    np.testing.assert_allclose(early[:-3], series.u[3:, 0])


def test_a_lag_of_first_order_answers_a_ramp_by_its_time() -> None:
    series = Series(0.5 * np.arange(100.0), dt=1.0)
    slow = put_in(PUTS["slow-sensor:{y}"], series, 4.0, PLACE).y[:, 0]
    np.testing.assert_allclose(series.y[60:, 0] - slow[60:], 4.0 * 0.5, rtol=1e-5)


def test_play_is_as_wide_as_said() -> None:
    t = np.arange(400.0)
    series = Series(np.sin(0.05 * t), dt=1.0)
    y = put_in(PUTS["play:{y}"], series, 0.2, PLACE).y[100:, 0]
    width = 0.2 * np.std(series.y)
    assert y.max() == pytest.approx(1.0 - 0.5 * width, abs=2e-3)
    assert np.abs(y - series.y[100:, 0]).max() <= 0.5 * width + 1e-12


@pytest.mark.long
def test_scores_count_words_for_the_truth_as_right() -> None:
    row: Row = {
        "verdict": "set",
        "causes": "bias:y",
        "set": "bias:y step:y",
        "words": "step:y bias:y",
    }
    assert right(row)
    assert not wrong(row)
    assert in_set(row)
    row |= {"verdict": "named", "causes": "drift:y", "set": "drift:y"}
    assert wrong(row)
    assert not in_set(row)
    row |= {"causes": "step:y drift:y", "set": "step:y"}  # one name too many
    assert wrong(row)
    assert in_set(row)


@pytest.mark.slow
def test_a_record_that_may_be_shipped_gives_rows() -> None:
    there = cells("nile")
    names = [name for _, name, _ in there]
    assert NOTHING in names
    assert "delay:{y}" not in names  # there is nothing but noise to delay
    taken = {window.first for window, name, _ in there if name == "step:{y}"}
    assert taken == {28}  # the other window begins before the step of 1899, which its model has
    run = next(i for i, (_, name, k) in enumerate(there) if name == "heavy-tails:{y}" and k == 0)
    row = work("nile", 0, run)
    assert row["counts"] == "hidden"
    assert row["strength"] == pytest.approx(40.0, rel=0.1)
    assert row["verdict"] in ("named", "set", "unknown", "nothing")
    assert row["note"] == ""


@pytest.mark.slow
def test_the_words_for_a_truth_hold_it() -> None:
    found = engine.diagnose(
        engine.get_model("local-level"), nile(), max_effects=1, effects=["step"]
    )
    row = answer(found, ("step:flow",))
    assert "step:flow" in str(row["words"]).split()
    assert right(row)
