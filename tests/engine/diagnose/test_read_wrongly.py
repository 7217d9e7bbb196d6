"""A record whose inputs are read wrongly, where noise takes the errors that this makes."""

from dataclasses import replace

import pytest

from engine import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.search.between_samples import read_wrongly
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.reservoir import RESERVOIR, record

HOLDS = ("foh", "past")
pytestmark = pytest.mark.long


def searched(series, gain, kind="heavy-tails:store"):
    """A fit of the model, and a search that found an effect beside it, of so much 2 x log-likelihood."""
    model = RESERVOIR
    base = quasi_ml(model, series)
    effect = make_effect(kind, setting_for(model, series, base.theta))
    final = replace(base, log_likelihood=base.log_likelihood + 0.5 * gain)
    led = Refit(effect, final, gain, gain)
    return Search(base, final, (Round(None, (led,), None, (led,)),), False)


def nothing_more(fit, series):
    return Search(fit, fit, (), False)


@pytest.fixture(scope="module")
def rain():
    """Rain of a day in the row of the flow at its end."""
    one = record(3, 121, 0.05)
    return Series(one.y[1:], u=one.u[:-1], t=one.t[:-1], time_unit="d")


def test_noise_is_no_name_where_the_record_read_otherwise_explains_more(rain):
    said = read_wrongly(searched(rain, 40.0), rain, HOLDS, nothing_more)
    assert said.startswith("Read with hold='past' the model as it is gains")
    assert "explains more than heavy-tails:store" in said


def test_it_is_where_noise_explains_more_or_nothing_is_gained_by_reading(rain):
    assert read_wrongly(searched(rain, 900.0), rain, HOLDS, nothing_more) == ""
    assert "rain one row earlier" in read_wrongly(searched(rain, 40.0), rain, (), nothing_more)
    assert read_wrongly(searched(rain, 40.0, "drag:store"), rain, HOLDS, nothing_more) == ""
    right = rain.replace(hold="past")
    assert read_wrongly(searched(right, 40.0), right, ("zoh", "foh"), nothing_more) == ""
