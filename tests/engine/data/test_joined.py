"""A test that goes on where a record ended is filtered from there, not from the model's beginning."""

import numpy as np
import pytest

import engine
from engine.data.joined import joined, past_of
from engine.diagnose import diagnose
from engine.diagnose.gain.gain import measure_gain
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_filter
from engine.presentation.held_out import held_out

MODEL = engine.get_model("oscillator")


def record(T=240, seed=1, dt=0.05):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(T // 8 + 1), 8)[:T]
    return engine.simulate(MODEL, None, T, rng, u=u, dt=dt).series


@pytest.mark.parametrize("hold", ["zoh", "foh", "past"])
@pytest.mark.parametrize("k", [1, 3])
def test_two_parts_joined_are_the_whole(hold, k):
    whole = record().replace(hold=hold)
    parts = whole.part(0, 100), whole.part(100, 240)
    again = joined(*(one.refined(k) for one in parts))
    expected = whole.refined(k)
    for name in ("y", "u", "t"):
        np.testing.assert_allclose(getattr(again, name), getattr(expected, name), atol=1e-12)
    assert again.substeps == expected.substeps


@pytest.mark.parametrize("cut", [5, 9])
def test_parts_of_a_refined_record_at_irregular_times_are_the_whole(cut):
    """The step where it is cut, far longer than the usual one, had its rows twice, and a search ended."""
    t = np.cumsum([0.0, 1.0, 1.0, 1.0, 1.0, 9.0, 1.0, 1.0, 1.0, 4.0, 1.0, 1.0])
    whole = record(len(t)).replace(t=t).refined(4)
    for one in (
        whole.part(0, 4 * cut),
        whole.part(0, 4 * (cut - 1) + 1),
    ):  # with the rows between, without
        again = joined(one, whole.part(4 * cut, len(whole)))
        np.testing.assert_allclose(again.t, whole.t)
        np.testing.assert_array_equal(again.y, whole.y)
    later = joined(whole.part(0, 4 * (cut - 1) + 1), whole)  # on a clock of its own
    assert np.diff(later.t).min() > 0.0
    assert len(later) == len(whole) + 4 * cut


def test_what_follows_is_told_by_the_times():
    whole = record()
    one, other = whole.part(0, 100), whole.part(100, 240)
    assert other.follows(one)
    assert other.refined(4).follows(one.refined(4))
    assert not one.follows(other)
    assert not whole.part(103, 240).follows(one)  # a gap
    assert not other.replace(t=other.t - other.t[0]).follows(one)  # a clock of its own
    assert not other.replace(hold="foh").follows(one)  # one step could not be both
    assert not other.refined(2).follows(one)
    rain = one.replace(extra=np.ones((100, 1)), extra_names=("rain",))
    assert not other.follows(rain)  # its filter would not know the channel
    milliseconds = [part.replace(t=1e3 * part.t) for part in (one, other)]
    assert milliseconds[1].follows(milliseconds[0])
    assert past_of(other, [other, one]) is one
    assert past_of(one, [other, one]) is None


def test_the_gain_on_what_follows_is_that_of_one_run_through_both():
    whole = record()
    train, test = whole.part(0, 160), whole.part(160, 240)
    base = quasi_ml(MODEL, train)
    extended = engine.get_model("oscillator", ["bias:y"])
    fit = quasi_ml(extended, train)
    found = measure_gain(base, fit, [test], records=[train])
    terms = [f.log_terms(whole)[160:] for f in (base, fit)]
    assert found.log_density == pytest.approx(float(np.sum(terms[1] - terms[0])))
    alone = measure_gain(base, fit, [test])
    terms = [f.log_terms(test) for f in (base, fit)]
    assert alone.log_density == pytest.approx(float(np.sum(terms[1] - terms[0])))


@pytest.mark.slow
def test_so_are_an_estimate_s_predictions_and_a_diagnosis_gain():
    whole = record()
    biased = whole.replace(y=whole.y + 0.3)
    train, test = biased.part(0, 160), biased.part(160, 240)
    found = held_out(MODEL, None, [test], [train])
    own = moment_filter(MODEL, np.asarray(MODEL.theta())[None], biased).log_terms[160:, 0]
    assert found["log_density"] == pytest.approx(float(own.sum()))
    asked = diagnose(MODEL, train, test=test, seed=1, effects=["bias", "gain"])
    terms = [fit.log_terms(biased)[160:] for fit in (asked.before, asked.after)]
    assert asked.gain.log_density == pytest.approx(float(np.sum(terms[1] - terms[0])))
