"""Several records of one model: in any order, each from its own first state."""

import re

import numpy as np
import pytest

import engine
from engine.data.joined import together
from engine.data.series import Series
from engine.diagnose import extend
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.windows import windows
from engine.diagnose.gain.gain import measure_gain, measure_gain_interleaved
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.records import ELSEWHERE, OTHER_STEPS, TOO_LONG, others_left
from engine.diagnose.refits.calibration import drawn_from
from engine.errors import SeriesError
from engine.estimation.quasi_ml import quasi_ml
from engine.presentation.diagnosis_document import as_dict
from service.schemas import SettingIn
from tests.engine.diagnose.free_run.test_other_models import cart

KINDS = ["drag", "cubic", "quadratic"]
DT = 0.05


def record(T, seed, drag=0.8):
    """The cart's own equations, with a drag that it does not know; it begins elsewhere each time."""
    rng = np.random.default_rng(seed)
    u = 4.0 * np.repeat(rng.standard_normal((-(-T // 10), 1)), 10, axis=0)[:T]
    y, x, v = np.zeros(T), rng.uniform(-1.5, 1.5), 0.0
    for i in range(T):
        y[i] = x
        rate = v + DT * (-9.0 * x - 0.3 * v + u[i, 0])
        x, v = x + DT * rate, rate - DT * drag * v * abs(v)  # an effect acts after the step
    return Series(y + 1e-3 * rng.standard_normal(T), u, dt=DT)


def ask(series, test=None):
    return engine.diagnose(cart(inputs=1), series, test=test, effects=KINDS, seed=1)


@pytest.fixture(scope="module")
def parts():
    return [record(200, 1), record(120, 2), record(140, 3)]


@pytest.fixture(scope="module")
def found(parts):
    return ask(parts, [record(80, 4), record(90, 5)])


@pytest.mark.slow
def test_the_cause_is_named_and_the_gain_is_of_all_that_is_held_out(found):
    assert [cause.effect for cause in found.causes] == ["drag:rate"]
    assert abs(found.causes[0].size - 0.8) < 4.0 * found.causes[0].standard_error < 0.8
    assert found.gain.samples == 80 + 90
    assert found.gain.adopt
    assert "2 records" in found.gain.how
    assert found.records == 3
    assert len(found.series) == 200
    assert any("the longest" in note for note in found.notes)
    assert "and 2 more records" in str(found)


@pytest.mark.slow
def test_records_may_come_in_any_order(found, parts):
    again = ask(parts[::-1], [record(80, 4), record(90, 5)])
    assert again.verdict is found.verdict
    assert [c.effect for c in again.causes] == [c.effect for c in found.causes]
    assert again.causes[0].size == pytest.approx(found.causes[0].size, rel=1e-6)
    assert again.gain.log_density == pytest.approx(found.gain.log_density, rel=1e-6)


@pytest.mark.slow
def test_one_record_is_the_same_in_a_list_and_alone(parts):
    alone, listed = ask(parts[1]), ask([parts[1]])
    assert np.array_equal(alone.theta, listed.theta)
    assert alone.gain.log_density == listed.gain.log_density
    assert str(alone).splitlines()[0] == str(listed).splitlines()[0]


@pytest.mark.slow
def test_the_gain_of_two_records_is_that_of_both(found):
    one, other = record(80, 4), record(90, 5)
    before, after = found.before, found.after
    both = measure_gain(before, after, [one, other])
    each = [measure_gain(before, after, [part]) for part in (one, other)]
    assert both.log_density == pytest.approx(sum(g.log_density for g in each))
    mean = np.average([g.outputs[0].rmse_after ** 2 for g in each], weights=[80, 90])
    assert both.outputs[0].rmse_after == pytest.approx(np.sqrt(mean))
    assert (np.diff(both.t) > 0.0).all()


def test_of_several_long_records_each_has_its_share(parts):
    kept = windows(parts, 230)
    assert [len(one) for one in kept] == [100, 60, 70]
    assert windows(parts) == parts


def test_records_need_the_same_channels(parts):
    odd = parts[1].replace(extra=np.zeros((120, 1)), extra_names=["temperature"])
    with pytest.raises(SeriesError, match="record 1 has the extra channels temperature"):
        ask([parts[0], odd])
    with pytest.raises(SeriesError, match="no series"):
        ask([])


def test_which_of_many_records_is_wrong_is_said(parts):
    with pytest.raises(SeriesError, match=r"^record 2: every value of y is missing"):
        ask([*parts[:2], parts[2].replace(y=np.full((140, 1), np.nan))])
    with pytest.raises(SeriesError, match=r"^test 1: u has 0 channels"):
        ask(parts[0], [parts[1], Series(parts[2].y, dt=DT)])
    with pytest.raises(SeriesError, match=r"^every value of y is missing"):
        ask(parts[0].replace(y=np.full((200, 1), np.nan)))


@pytest.mark.long
def test_a_test_on_another_clock_is_refused(parts):
    hours = parts[1].replace(time_unit="h")
    with pytest.raises(SeriesError, match="in s, of another in h"):
        ask(parts[0], hours)
    model = cart(inputs=1)
    fit = engine.rbps_em(model, parts[0], n_iterations=1)
    with pytest.raises(SeriesError, match="in s, of another in h"):
        engine.examine(fit, parts[0], test=hours)


@pytest.mark.parametrize(
    ("series", "test", "message"),
    [
        (lambda a, b: [a, b, a], None, "records 0 and 2 are the same"),
        (lambda a, b: a, lambda a, b: [b, b], "tests 0 and 1 are the same"),
        (lambda a, b: [b, a], lambda a, b: a, "test is record 1, which the model is fitted to"),
    ],
)
def test_a_record_counts_once(series, test, message):
    a, b = record(60, 1), record(60, 2)
    with pytest.raises(SeriesError, match=message):
        ask(series(a, b), None if test is None else test(a, b))


OSCILLATOR = engine.get_model("oscillator")
STIFF = {"cubic_position__velocity": -8.0}


def short_records(own, seed, n=8, T=25):
    rng, out = np.random.default_rng(seed), []
    for _ in range(n):
        u = np.repeat(rng.uniform(-1.0, 1.0, T // 8 + 1), 8)[:T]
        names = ["cubic:position->velocity"] if own else []
        out.append(hide(OSCILLATOR, names, own, T, rng, u=u, dt=DT).series)
    return out


def asked(records):
    kinds = ["cubic:position->velocity", "bias", "linear", "drag", "cubic-sensor"]
    return engine.diagnose(OSCILLATOR, records, effects=kinds, seed=1)


@pytest.mark.slow
def test_many_short_records_tell_together_what_none_could_alone():
    """25 samples each: fewer than a diagnosis of one needs."""
    found = asked(short_records(STIFF, 3))
    (cause,) = found.causes
    assert cause.effect == "cubic:position->velocity"
    assert abs(cause.size + 8.0) < 3.0 * cause.standard_error < 1.0
    assert found.substeps == 4  # with one the size is off by several of its errors
    assert any("searched all 7 records together" in note for note in found.notes)
    assert any(re.search(r"counted from 0, \d was held out", note) for note in found.notes)
    assert found.gain.samples == 25
    assert found.gain.adopt
    with pytest.raises(SeriesError, match="only 25 rows hold a measurement"):
        asked(short_records(STIFF, 3, n=1))


@pytest.mark.slow
def test_many_short_records_of_a_right_model_show_nothing():
    assert asked(short_records({}, 4)).causes == ()


@pytest.mark.slow
def test_a_record_that_begins_where_the_model_does_not_is_left_to_the_free_run():
    records = short_records({}, 5, n=4, T=40)
    records[2] = records[2].replace(y=records[2].y + 30.0)
    found = asked(records)
    assert any("Of 4 records the likelihood searched 3 together" in note for note in found.notes)


def test_records_of_which_too_few_rows_are_searched_together_are_refused():
    """55 rows in all, and eleven to name a cause by: each begins where the model cannot be."""
    dose = engine.continuous(
        name="dose",
        drift=lambda a, u, t, theta: ([0.0], [[-theta.k]]),
        diffusion=lambda a, u, t, theta: [[1e-4]],
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1e-3]]),
        initial=lambda theta: (None, [theta.first], [[1e-6]]),
        linear={"c": "mg/l"},
        outputs={"y": "mg/l"},
        parameters=[
            engine.Parameter("k", 1.0, "1/h", (0.0, 10.0)),
            engine.Parameter("first", 2.0, "mg/l", (0.0, 20.0)),
        ],
    )
    t, rng = (
        np.array([0.2, 0.5, 0.8, 1.0, 1.2, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0]),
        np.random.default_rng(1),
    )
    records = [
        Series(first * np.exp(-t) + 0.03 * rng.standard_normal(11), t=t)
        for first in (1, 2, 3, 4, 5)
    ]
    with pytest.raises(
        SeriesError, match=r"search 1 together, with 11 rows .* at least 30"
    ) as told:
        engine.diagnose(dose, records, effects=["bias"], held_out=0, processes=1)
    assert "The others are elsewhere at first than the covariance" in str(told.value)


def test_why_records_are_not_searched_is_counted():
    assert others_left({TOO_LONG: 3}) == "The others are too long for that."
    assert others_left({OTHER_STEPS: 1, ELSEWHERE: 2}) == (
        f"Of the others 1 is {OTHER_STEPS} and 2 are {ELSEWHERE}."
    )


@pytest.mark.slow
def test_simulations_of_many_records_begin_each_anew():
    """They say how bold p-values are; where none can be made nothing would be said."""
    whole = together(short_records({}, 6))
    fit = quasi_ml(OSCILLATOR, whole)
    drawn = drawn_from(fit, whole, np.random.default_rng(1))
    assert drawn.begins == whole.begins
    np.testing.assert_array_equal(drawn.observed, whole.observed)
    assert quasi_ml(OSCILLATOR, drawn).log_likelihood == pytest.approx(
        fit.log_likelihood, abs=8.0 * np.sqrt(0.5 * len(whole))
    )
    found = engine.diagnose(OSCILLATOR, short_records(STIFF, 3), effects=["drag"], bootstrap=9)
    assert found.p_bootstrap == pytest.approx(0.1)


@pytest.mark.slow
def test_what_one_short_record_cannot_tell_does_not_spoil_the_fit_to_all():
    """Its estimate lies far along a ridge, from which the fit to all of them did not come back."""
    servo, rng, records = engine.get_model("servo"), np.random.default_rng(3021), []
    for _ in range(6):
        T = int(rng.integers(40, 80))
        u = np.repeat(rng.uniform(-1.0, 1.0, T // 8 + 1), 8)[:T]
        records.append(engine.simulate(servo, None, T, rng, u=u, dt=DT).series)
    found = engine.diagnose(servo, records, effects=["cubic-sensor", "linear", "force"], seed=1)
    assert found.causes == ()
    assert not any("did not settle" in note for note in found.notes)


LEVEL = engine.get_model("local-level")


def levels(n, seed, begins, step=0.0):
    """Readings of a level from a time on; from the 60th on they are too high by ``step``."""
    theta = {"q": 20.0, "r": 400.0, "level": 1000.0}
    series = engine.simulate(LEVEL, theta, n, np.random.default_rng(seed)).series
    y = series.y + step * (np.arange(n) >= 60)[:, None]
    return Series(y, t=begins + np.arange(float(n)), y_names=series.y_names)


@pytest.mark.long
def test_a_step_in_one_record_is_judged_where_it_acts():
    """On the longest record alone, which knows nothing of it, it could gain nothing."""
    records = [levels(120, 1, 1000.0), levels(100, 2, 2000.0, 150.0)]
    found = engine.diagnose(LEVEL, records, effects=["step"], seed=1)
    (cause,) = found.causes
    assert cause.parameters["step_flow_time"] == 2060.0
    assert found.gain.samples == 220
    assert "2 records" in found.gain.how
    assert found.gain.log_density > 10.0
    assert found.gain.adopt


@pytest.mark.long
def test_a_gain_on_blocks_of_refined_records_is_that_of_their_samples():
    records = [levels(60, 1, 0.0), levels(50, 2, 500.0)]
    fit = quasi_ml(LEVEL, records)
    fine = [one.refined(2) for one in records]
    gain = measure_gain_interleaved(fit, fit, fine)
    assert gain.samples == len(gain.t) == len(gain.y) == len(gain.d) == 110
    assert gain.log_density == 0.0


@pytest.mark.slow
def test_a_step_may_end_with_its_record():
    """Where times tell records apart; once the next one, in which it was gone, called for another step."""
    records = [levels(120, 1, 1000.0), levels(100, 2, 2000.0, 150.0), levels(90, 3, 3000.0)]
    found = engine.diagnose(LEVEL, records, effects=["step"], seed=1)
    assert found.verdict is Verdict.NAMED
    (cause,) = found.causes
    assert cause.parameters["step_flow_time"] == 2060.0
    assert cause.parameters["step_flow_stays"] == 0.0
    assert "time 2060 s" in " ".join(str(found).split())
    assert "in the record of that time only" in " ".join(str(found).split())
    assert "to the end of that record where stays = 0" in cause.equation
    # what its effects were told goes with the result: without it the extension is another model
    reference = as_dict(found)["extension"]["model"]
    told = SettingIn(**reference["setting"])
    times = {"later": tuple(told.later), "starts": tuple(told.starts)}
    assert times == {"later": (2000.0, 3000.0), "starts": (1000.0, 2000.0, 3000.0)}
    again = extend(
        LEVEL, reference["with"], Setting(LEVEL, told.scale, (1000.0, 3089.0), told.dt, **times)
    )
    assert again.parameter_names == found.extended.parameter_names


@pytest.mark.parametrize(("begins", "later"), [((0.0, 500.0), (500.0,)), ((500.0, 0.0), (500.0,))])
def test_only_times_that_tell_records_apart_end_a_step(begins, later):
    model, theta = LEVEL, np.asarray(LEVEL.theta())
    apart = together([levels(60, k, begin) for k, begin in enumerate(begins)])
    assert setting_for(model, apart, theta).later == later
    whole = levels(60, 1, 0.0)  # a record that was cut in two is one
    assert setting_for(model, together([whole.part(0, 30), whole.part(30, 60)]), theta).later == ()
    overlapping = together([levels(60, k, 0.0) for k in range(2)])
    assert setting_for(model, overlapping, theta).later == ()
    assert setting_for(model, levels(60, 1, 0.0), theta).later == ()
