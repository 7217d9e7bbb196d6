"""Records that have parameters of their own: persons, batches, machines."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.data.joined import together
from engine.data.series import Series
from engine.diagnose.judging import by_record
from engine.diagnose.judging.by_record import (
    OwnValues,
    of_gain,
    own_values,
    values_told,
    word_of_records,
)
from engine.diagnose.screening.noise_parameters import moves_on
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


def straight():
    """A weight that grows as much each day."""
    return engine.continuous(
        name="animal",
        drift=lambda a, u, t, theta: ([theta.g + 0.0 * a[:, 0]], np.zeros((1, 0))),
        diffusion=lambda a, u, t, theta: [[theta.q]],
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[theta.r]]),
        initial=lambda theta: (engine.Gaussian([350.0], [[1e5]]), [], np.zeros((0, 0))),
        nonlinear={"w": "g"},
        outputs={"y": "g"},
        parameters=[
            engine.Parameter("g", 1.0, "g/d", (-50, 50)),
            engine.Parameter("q", 0.1, "g^2/d", (1e-6, 1e4)),
            engine.Parameter("r", 1.0, "g^2", (1e-4, 1e4)),
        ],
    )


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
def test_where_records_begin_moves_nothing_on(differing):
    """Nor does a step from the end of one record to the beginning of the next."""
    fit, series = differing
    moved = moves_on(fit, series)
    assert [name for name, on in zip(fit.free, moved, strict=True) if on] == ["k"]


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


def test_a_size_that_is_above_zero_here_and_below_there_is_no_cause():
    """Animals of three breeds that grow at rates of their own, the heavy one fastest: no growth by weight."""
    values = np.array([[-0.017, 2.0], [0.007, 3.0], [-0.001, -4.0]])
    errors = np.array([[0.003, 0.1], [0.001, 0.1], [0.002, 0.1]])
    own = OwnValues(("linear_w", "g"), ("1/d", "kg/d"), values, errors, 1e-6, 40.0, 4)
    assert own.of_both_signs(["linear_w"]) == "linear_w"
    assert own.of_both_signs([]) == own.of_both_signs(["drag_w"]) == ""  # g is the model's own
    assert replace(own, errors=3.0 * errors).of_both_signs(["linear_w"]) == ""


def test_a_name_beside_which_records_differ(monkeypatch):
    """Signs that differ refute a name, as does more that the records' own values explain without it."""
    own = OwnValues(
        ("linear_w",), ("1/d",), np.array([[-0.02], [0.01]]), np.full((2, 1), 0.001), 1e-6, 30.0, 1
    )
    before = SimpleNamespace(free=["g"], log_likelihood=0.0)
    after = SimpleNamespace(free=["g", "linear_w"], log_likelihood=10.0)
    series = SimpleNamespace(n_measured=100)

    def word(beside, without, sizes=("linear_w",), frequencies=()):
        said = {"before": without, "after": beside}
        monkeypatch.setattr(
            by_record, "own_values", lambda fit, _: said["before" if fit is before else "after"]
        )
        named = ["linear:w"]
        return word_of_records(before, after, series, [0, 1], named, [], sizes, frequencies)

    assert "surely above 0, in others below" in word(own, None).sentence
    assert word(own, None).refutes
    assert not word(own, None, ()).refutes
    assert word(own, None, (), ["linear_w"]).refutes  # a wave has one frequency in all
    assert word(None, None) is None
    assert word(None, replace(own, names=("g",))).refutes  # 30 gained without it, 20 by it
    assert word(None, replace(own, gain=20.0)) is None


@pytest.mark.long
def test_noise_hides_that_records_differ_from_a_score():
    """As long as one rate is to hold for all, noise takes the rest, and no score asks for others."""
    rng, days = np.random.default_rng(3), 7.0 * np.arange(12)
    light = [(250.0, 0.9, -0.02), (260.0, 0.8, -0.015), (270.0, 1.0, -0.02)]  # g, g/d, 1/d
    heavy = [(500.0, 1.6, 0.006), (520.0, 1.8, 0.005), (540.0, 2.4, 0.006)]
    ys = [first + rate * np.expm1(k * days) / k for first, rate, k in light + heavy]
    records = [Series(y=(y + rng.standard_normal(12))[:, None], t=days) for y in ys]
    series = together(records)
    own = own_values(quasi_ml(straight(), series), series)
    assert own.names == ("g",)
    assert own.gain > 100.0
    assert own.values[:3].max() < 0.7 < 1.9 < own.values[3:].min()


def test_what_many_rows_gain_is_chi_squared_and_what_few_gain_is_less_sure():
    assert of_gain(20.0, 5, 100_000, 99_990) == pytest.approx(float(chi2_sf(20.0, 5)), rel=0.01)
    assert of_gain(20.0, 5, 40, 30) > 3.0 * float(chi2_sf(20.0, 5))
    assert of_gain(-1.0, 5, 40, 30) == of_gain(9.0, 5, 6, 0) == 1.0
    assert of_gain(1e6, 5, 40, 30) == 0.0  # without a warning of NumPy


def test_what_shared_parameters_make_up_for_is_no_value_of_a_record():
    """Of three records two values more; one less where another parameter does to all what one of these does."""
    H = np.array([[[2.0, 1.0], [1.0, 1.0]], [[3.0, 2.0], [2.0, 4.0]], [[1.0, 0.0], [0.0, 2.0]]])
    none = np.zeros(2, dtype=bool)
    assert values_told(H, 0, none) == 2
    tied = H.copy()  # in the first record alone, and there the other does the same
    tied[:, 1, 0] = tied[:, 0, 1] = [2.0, 0.0, 0.0]
    tied[:, 1, 1] = [2.0, 0.0, 0.0]
    assert values_told(tied, 0, none) == 1
    H[1:, 0] = H[1:, :, 0] = 0.0
    assert values_told(H, 0, none) == 0


@pytest.mark.long
def test_a_diagnosis_says_that_persons_differ(tmp_path):
    records = persons(OWN, 4)
    asked = ["drag", "variance", "parameter-drift"]
    found = engine.diagnose(dose(k=0.5, r=4e-4), records, effects=asked, held_out=0, processes=1)
    assert found.verdict.value == "unknown"
    assert any("do not have the same k" in note for note in found.notes)
    assert found.by_record.startswith("The records do not have the same k")
    head = str(found).partition("1. What is wrong")[0]
    assert "do not have the same k" in head  # which the page says before what comes closest
    assert found.report(tmp_path / "a.html").read_text().count("do not have the same k") == 2
    alike = engine.diagnose(
        dose(k=0.5, r=4e-4), persons(SAME, 4), effects=asked, held_out=0, processes=1
    )
    assert alike.verdict.value == "nothing"
    assert not any("do not have the same" in note for note in alike.notes)
