"""The share of the longest record that is held out: what is in it is found only where nothing is."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.free_run.second_opinion import SecondOpinion, heeding
from engine.diagnose.gain.adoption import NOT_MEASURED
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.records import Records, records_of
from engine.errors import OptionError
from engine.models.local_level import MODEL as LEVEL
from service.diagnoses import in_a_line
from tests.engine.hidden_effects import DRIVE, hidden


def late_step():
    """150 readings of a level; from the 136th on, in the last fifth, they are too high."""
    series = engine.simulate(
        LEVEL, {"q": 20.0, "r": 400.0, "level": 0.0}, 150, np.random.default_rng(1)
    ).series
    y = series.y.copy()
    y[135:] += 80.0
    return Series(y, dt=1.0, y_names=series.y_names)


@pytest.mark.slow
def test_a_step_in_the_last_fifth_is_found_where_nothing_is_held_out(tmp_path):
    asked = {"effects": ["step"], "seed": 1}
    before = engine.diagnose(LEVEL, late_step(), **asked)
    assert before.verdict is Verdict.NOTHING
    assert any("from t = 120 s on was held out and not searched" in note for note in before.notes)
    event = before.unsearched  # which the head of the page, the report and the list of jobs tell
    assert event.since == 120.0
    assert abs(event.time - 135.0) <= 5.0
    assert event.p_value <= 0.01
    report = before.report(tmp_path / "late.html").read_text(encoding="utf-8")
    for text in (" ".join(str(before).split()), report, in_a_line(before)):
        assert "something seems to happen there, near t = 13" in text
        assert "held_out=0 searches all of the record" in text
    json.dumps(before.to_dict(), allow_nan=False)
    found = engine.diagnose(LEVEL, late_step(), **asked, held_out=0)
    (cause,) = found.causes
    assert found.verdict is Verdict.NAMED
    assert cause.parameters["step_flow_time"] == 135.0
    assert found.gain.samples == 150
    assert "blocks" in found.gain.how
    assert not any("held out" in note for note in found.notes)
    assert found.unsearched is None
    y = late_step().y.copy()
    y[135:] -= 80.0
    assert engine.diagnose(LEVEL, Series(y, dt=1.0), **asked).unsearched is None


@pytest.fixture(scope="module")
def bias():
    series = hidden(["bias:reading"], {"bias_reading": 0.5}, 1, 200)
    return engine.diagnose(DRIVE, series, effects=["bias"], seed=1, held_out=0.0)


@pytest.mark.long
def test_what_is_named_without_held_out_data_has_no_gain_and_says_so(bias, tmp_path):
    assert bias.verdict is Verdict.NAMED
    assert bias.gain is None
    assert bias.notes.count(NOT_MEASURED) == 1
    assert len(bias.symptoms.series) == len(bias.series) == 200  # all of it was looked at
    assert any("particle filter" in note for note in bias.notes)  # which needs no other data
    page = " ".join(str(bias).split())
    assert page.count(NOT_MEASURED) == 2  # the gain, the notes
    assert "Not judged, as 4 says" in page
    report = bias.report(tmp_path / "bias.html").read_text(encoding="utf-8")
    for text in (page, report):
        assert "Nothing was added" not in text
        assert "Not adopted" not in text
    assert "Nothing was held out" in report
    assert in_a_line(bias).endswith("No data were held out to judge it.")
    json.dumps(bias.to_dict(), allow_nan=False)
    assert "bias:reading" in bias._repr_html_()


@pytest.mark.long
def test_a_diagnosis_of_the_whole_record_is_kept(bias):
    assert bias.asked.options["held_out"] == 0.0
    asked = bias.asked
    parts = json.loads(json.dumps(dict(asked.parts)))
    found = engine.diagnose(DRIVE, asked.series, test=[], **asked.options, kept=parts)
    assert np.array_equal(found.theta, bias.theta)
    assert found.gain is None
    with pytest.raises(OptionError, match="other options"):
        engine.diagnose(DRIVE, asked.series, **{**asked.options, "held_out": 0.2}, kept=parts)


@pytest.mark.parametrize("share", [-0.1, 0.6, float("nan")])
def test_a_share_that_is_none_is_refused(share):
    with pytest.raises(OptionError, match="is not within 0 to") as error:
        engine.diagnose(LEVEL, late_step(), held_out=share)
    assert error.value.field == "held_out"


def test_a_share_beside_a_test_is_refused():
    test = Series(np.arange(40.0), dt=1.0, y_names=["flow"])
    with pytest.raises(OptionError, match="beside test") as error:
        engine.diagnose(LEVEL, late_step(), test=test, held_out=0.0)
    assert error.value.field == "held_out"
    _, records = records_of(LEVEL, late_step(), test, 0.2)
    assert (len(records.train), len(records.held_out[0])) == (150, 40)


@pytest.mark.parametrize(("share", "kept"), [(0.0, 0), (0.001, 2), (0.2, 20), (0.5, 50)])
def test_train_and_held_out_are_the_record(share, kept):
    whole = Records(Series(np.arange(100.0), dt=1.0), share=share)
    for records, k in ((whole, 1), (whole.refined(3), 3)):
        assert len(records.train.samples) == 100 - kept
        assert sum(len(one.samples) for one in records.held_out) == kept
        assert records.keeps_back is (kept > 0)
        assert records.main.substeps == k


@pytest.mark.parametrize(("rows", "kept"), [(30, 8), (36, 8), (16, 8), (12, 2), (60, 12)])
def test_of_a_short_record_so_much_is_held_out_that_it_can_tell(rows, kept):
    """A fifth of 30 rows are 6: whatever they show, nothing is adopted on fewer than 8."""
    records = Records(Series(np.arange(float(rows)), dt=1.0))
    assert len(records.held_out[0]) == kept


def test_a_whole_record_is_held_out_where_the_end_of_one_can_tell_nothing():
    """Six patients, eleven readings each: two of them told nothing, and nothing could ever be adopted."""
    _, records = records_of(LEVEL, [short(level, 11) for level in LEVELS], None)
    assert len(records.kept_back) == 1
    assert len(records.others) == 4


def test_what_only_the_free_run_sees_needs_data_that_it_has_not_seen():
    """That none were held out is another reason than that it gains nothing on them."""
    asked = SecondOpinion(Verdict.NOTHING, (), True, "", search=SimpleNamespace(found=("drag",)))
    said, verdict = heeding(asked, Verdict.NAMED, None)
    assert (said.decides, verdict) == (False, Verdict.NOTHING)
    assert "nothing was held out" in said.reason


def short(level, n=40, seed=0):
    rng = np.random.default_rng([seed, int(10 * level)])
    return Series(level + rng.standard_normal(n), dt=1.0)


LEVELS = [3.0, 1.0, 5.0, 2.0, 4.0, 6.0]


def test_of_many_records_one_in_five_is_held_out_whole():
    """From the middle of their levels, in whatever order they come, and never the longest."""
    given = [short(level, 60 if level == 3.0 else 40) for level in LEVELS]
    _, records = records_of(LEVEL, given, None)
    assert records.kept_back == (LEVELS.index(4.0),)
    assert [np.nanmean(one.y) for one in records.held_out] == [given[4].y.mean()]
    assert records.train is records.main
    assert len(records.others) == 4
    _, again = records_of(LEVEL, given[::-1], None)
    assert again.held_out[0].y.tolist() == records.held_out[0].y.tolist()
    _, two = records_of(LEVEL, given, None, 0.4)
    assert len(two.kept_back) == 2
    for series, test, share in (
        (given, None, 0.0),
        (given[:4], None, 0.2),
        (given[1:], given[0], 0.2),
    ):
        _, other = records_of(LEVEL, series, test, share)
        assert other.kept_back == ()


def test_a_record_that_tells_less_than_the_last_part_of_the_longest_is_not_held_out():
    given = [short(3.0, 400), *(short(level, 40) for level in LEVELS[1:])]
    _, records = records_of(LEVEL, given, None)
    assert records.kept_back == ()
    assert len(records.held_out[0]) == 80
    few = [short(level, 7) for level in LEVELS]  # one of them tells as little as the last rows
    assert records_of(LEVEL, few, None)[1].kept_back == ()


@pytest.mark.long
@pytest.mark.parametrize(("begins", "used"), [(120.0, True), (0.0, False), (1e5, False)])
def test_tests_that_do_not_follow_the_record_do_not_judge_what_comes_with_time(begins, used):
    """A drift that would have gone on for a day is none of them; it is said that they were not used."""
    theta = {"q": 20.0, "r": 400.0, "level": 0.0}
    y = engine.simulate(LEVEL, theta, 180, np.random.default_rng(3)).series.y.copy()
    y[60:] += 150.0
    main, later = Series(y[:120], dt=1.0), Series(y[120:], t=begins + np.arange(60.0))
    found = engine.diagnose(LEVEL, main, test=later, effects=["step"], seed=1)
    assert found.verdict is Verdict.NAMED
    assert found.gain.samples == (60 if used else 120)
    assert any("test data were not used" in note for note in found.notes) is not used
