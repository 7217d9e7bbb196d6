"""Several records where parameters say how far apart they begin."""

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.first_states import begins_as_expected, begins_as_said
from tests.engine.plain_models import dose

START, HOURS = 2.0, np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0])


pytestmark = pytest.mark.long


def person(first, seed):
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(HOURS))
    return Series(y=(first * np.exp(-0.5 * HOURS) + noise)[:, None], t=HOURS)


def test_a_spread_fitted_to_one_record_shuts_no_other_out():
    model = dose()
    of_one = model.theta({"k": 0.5, "c0": 1.5, "s0": 1e-3, "q": 1e-4, "r": 4e-4})
    other, odd = person(2.3, 1), person(9.0, 2)
    assert not begins_as_expected(model, np.asarray(of_one), other)
    assert begins_as_said(model, model.theta(), of_one, other)
    assert begins_as_said(model, model.theta(), of_one, person(1.5, 3))
    assert not begins_as_said(model, model.theta(), of_one, odd)


def test_records_that_begin_apart_are_searched_together():
    firsts = [1.5, 2.0, 2.7, 1.9, 2.3]
    records = [person(first, seed) for seed, first in enumerate(firsts)]
    found = engine.diagnose(dose(), records, effects=["drag", "cubic"], held_out=0, processes=1)
    assert any("all 5 records together" in note for note in found.notes)
    assert found.verdict.value == "nothing"
