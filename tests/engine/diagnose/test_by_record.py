"""Records that have parameters of their own: persons, batches, machines."""

import numpy as np
import pytest

import engine
from engine.data.joined import together
from engine.data.series import Series
from engine.diagnose.judging.by_record import asked_for, of_gain, own_values, word_of_records
from engine.distributions import chi2_sf
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import dose

HOURS = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0])
FIRSTS = (1.5, 2.0, 2.7, 1.9, 2.3, 2.1)
SAME, OWN = (0.5,) * 6, (0.5, 0.42, 0.62, 0.55, 0.4, 0.5)


def persons(rates, seed=0):
    rng = np.random.default_rng(seed)
    pairs = zip(FIRSTS, rates, strict=True)
    clean = [first * np.exp(-k * HOURS) for first, k in pairs]
    return [Series(y=(y + 0.02 * rng.standard_normal(12))[:, None], t=HOURS) for y in clean]


def fitted(rates, seed=0):
    series = together(persons(rates, seed))
    return quasi_ml(dose(k=0.5, r=4e-4), series), series


@pytest.fixture(scope="module")
def differing():
    return fitted(OWN)


@pytest.mark.long
def test_rates_of_their_own_are_told_with_their_values(differing):
    own = own_values(*differing)
    assert own.names == ("k",)  # where each begins is its own anyhow
    assert own.further == 5
    assert own.p_value < 1e-6
    assert np.abs(own.values[:, 0] - OWN).max() < 0.05
    words = own.in_words([0, 1, 2, 3, 5, 4])
    assert words.startswith("in records 0, 1, 2, 3, 4 and 5, counted from 0, k = ")
    assert words.endswith("1/h")


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_one_rate_for_all_is_enough_where_there_is_one(seed):
    assert own_values(*fitted(SAME, seed)) is None


@pytest.mark.long
def test_one_record_alone_is_not_asked():
    one = persons(SAME)[0]
    assert own_values(quasi_ml(dose(k=0.5, r=4e-4), one), one) is None


@pytest.mark.long
def test_noise_is_no_name_where_records_differ(differing):
    fit, series = differing
    word = word_of_records(
        fit, fit, series, range(6), ["variance:conc->time"], ["variance:conc->time"]
    )
    assert word.refutes
    assert "looks like variance:conc->time, so no cause is named" in word.sentence
    nameless = word_of_records(fit, fit, series, range(6), [], [])
    assert nameless.refutes
    assert "do not have the same k (p < 0.0001" in nameless.sentence


@pytest.mark.long
def test_a_cause_that_explains_less_than_differing_records_is_none(differing):
    fit, series = differing
    word = word_of_records(fit, fit, series, range(6), ["drag:conc"], [])
    assert word.refutes
    assert "beside" not in word.sentence  # the values are those without it
    assert "explains more than drag:conc" in word.sentence


def test_what_many_rows_gain_is_chi_squared_and_what_few_gain_is_less_sure():
    assert of_gain(20.0, 5, 100_000, 99_990) == pytest.approx(float(chi2_sf(20.0, 5)), rel=0.01)
    assert of_gain(20.0, 5, 40, 30) > 3.0 * float(chi2_sf(20.0, 5))
    assert of_gain(-1.0, 5, 40, 30) == of_gain(9.0, 5, 6, 0) == 1.0


def test_what_shared_parameters_make_up_for_asks_for_nothing():
    """Scores that are what another parameter, moved for all records, would make of them."""
    H = np.array([[[2.0, 1.0], [1.0, 1.0]], [[3.0, 2.0], [2.0, 4.0]], [[1.0, 0.0], [0.0, 2.0]]])
    none = np.zeros(2, dtype=bool)
    statistic, freedom = asked_for(H[:, :, 1] * 0.7, H, 0, none)
    assert freedom == 2
    assert statistic == pytest.approx(0.0, abs=1e-12)
    assert asked_for(H[:, :, 1] * [[1.0], [-1.0], [0.0]], H, 0, none)[0] > 0.1


@pytest.mark.long
def test_a_diagnosis_says_that_persons_differ():
    records = persons(OWN, 4)
    asked = ["drag", "variance", "parameter-drift"]
    found = engine.diagnose(dose(k=0.5, r=4e-4), records, effects=asked, held_out=0, processes=1)
    assert found.verdict.value == "unknown"
    assert any("do not have the same k" in note for note in found.notes)
    alike = engine.diagnose(
        dose(k=0.5, r=4e-4), persons(SAME, 4), effects=asked, held_out=0, processes=1
    )
    assert alike.verdict.value == "nothing"
    assert not any("do not have the same" in note for note in alike.notes)
