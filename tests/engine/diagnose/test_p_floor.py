"""The least p-value that draws or simulated series can give is an upper limit, and is said to be one."""

from dataclasses import replace

import numpy as np
import pytest

from engine.data.series import Series
from engine.diagnose import LEAST_ALPHA, diagnose
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run.null import SERIES, Alarm
from engine.diagnose.free_run.second_opinion import SETTLED, _noise_explains, _too_far
from engine.diagnose.judging.findings import Cause
from engine.diagnose.judging.lack_of_fit import LackOfFit
from engine.diagnose.refits import bootstrap, calibration
from engine.diagnose.refits.bootstrap import bootstrap_p
from engine.diagnose.refits.calibration import sequential_floor, sequential_p
from engine.diagnose.screening.screening import screen_effects
from engine.diagnose.search.search import FIRST, LATER
from engine.errors import OptionError
from engine.estimation.quasi_ml import quasi_ml
from engine.models.local_level import MODEL as LEVEL
from engine.presentation.cause_sentences import headline
from engine.presentation.report.parts import p_value
from engine.words import probability
from tests.engine.diagnose.test_calibration import ALPHA, a_screen, silent

CAUSE = Cause(
    "coulomb:v", "Coulomb friction", "state", "v' = ...", 0.5, "N", 0.1, {}, 1.0 / 350.0, 40.0, ("coulomb:v",),
    (), at_floor=True,
)  # fmt: skip


def test_words():
    assert probability(0.0028571, at_floor=True) == "p <= 0.0029"
    assert probability(0.0028571) == "p = 0.0029"
    assert probability(1e-9, at_floor=True) == "p < 0.0001"
    assert probability(float("nan"), at_floor=True) == "p = ?"


def test_a_screen_is_at_its_floor_where_no_draw_is_as_extreme():
    far = a_screen(statistic=500.0).sharing(0.7)
    assert far.p_value == pytest.approx(1.0 / 350.0)
    assert far.at_floor
    assert not a_screen().at_floor
    assert not replace(far, p_value=1e-5).at_floor  # of refits, by their limiting distribution


def test_simulated_refits_are_at_their_floor_where_none_is_as_extreme(monkeypatch):
    monkeypatch.setattr(calibration, "swallowed_of_simulated", lambda *a: 0.5)
    p = sequential_p(0.001, None, ALPHA, 0, silent)
    assert p == sequential_floor(ALPHA)
    seen = replace(a_screen(), refits_floor=sequential_floor(ALPHA))
    assert replace(seen, p_value=p).at_floor
    assert not replace(seen, p_value=2.0 * p).at_floor


def test_the_bootstrap_is_at_its_floor_where_none_is_as_extreme(monkeypatch):
    seen = a_screen(statistic=500.0)
    monkeypatch.setattr(bootstrap, "_one", lambda *a: 0.5)
    found = bootstrap_p(None, seen, 99, 0)
    assert found.p_value == 0.01
    assert found.at_floor
    monkeypatch.setattr(bootstrap, "_one", lambda *a: 0.0)
    assert not bootstrap_p(None, seen, 99, 0).at_floor


def test_the_free_run_s_alarm():
    least = 1.0 / (SERIES + 1)
    floor, above = (Alarm(1.0, p, 1.0, 1.0, 2.0, 0.0) for p in (least, 2.0 * least))
    assert "(p <= 0.01)" in _too_far(floor)
    assert "(p = 0.02)" in _too_far(above)
    said = _noise_explains(above, 0.01)
    assert "noise may explain what the free run gets wrong (p = 0.02, where 0.01 is asked)" in said
    likely = _noise_explains(Alarm(1.0, 0.2, 1.0, 1.0, 2.0, 0.0), 0.01)
    assert "noise explains what the free run gets wrong (p = 0.6)" in likely


def test_a_cause_says_it_everywhere():
    assert "p <= 0.0029" in headline(CAUSE)
    assert "p = 0.0029" in headline(replace(CAUSE, at_floor=False))
    assert p_value({"p_value": 0.01, "at_floor": True}) == "p <= 0.01"
    assert p_value({"p_value": 0.01}) == "p = 0.01"  # as earlier versions wrote it
    assert p_value({"p_value": None, "at_floor": True}) == "p = ?"


def test_what_is_left_says_it():
    left = LackOfFit("v", 40.0, 5, 0.02, ("v", "v"))
    assert "p = 0.02;" in left.sentence
    assert "p <= 0.02;" in replace(left, at_floor=True).sentence


@pytest.mark.parametrize("alpha", [0.05, 0.01, LEAST_ALPHA])
def test_a_level_can_be_reached_in_every_round_and_by_the_free_run(alpha):
    """With fewer draws a later round could never raise an alarm, however much was to be seen."""
    rng = np.random.default_rng(1)
    series = Series(rng.standard_normal(400) + np.where(np.arange(400) < 190, 0.0, 3.0))
    fit = quasi_ml(LEVEL, series, {"q": 1e-6, "r": 1.0, "level": 0.0}, ["r", "level"])
    setting = setting_for(LEVEL, series, fit.theta)
    level = LATER * alpha
    seen = screen_effects(fit, series, setting, ["step"], level, 1, silent)
    assert seen.p_value <= level
    assert seen.at_floor
    assert seen.sharing(FIRST).family_wise(0.0) <= alpha
    most = int(np.ceil(3.0 / (SETTLED * alpha))) - 1
    assert Alarm(1.0 / (most + 1), 1.0, 1.0, 1.0, 2.0, 0.0, most).p_value <= SETTLED * alpha


def test_a_level_that_simulation_does_not_tell_is_refused():
    with pytest.raises(OptionError, match=r"alpha = 0.001; from 0.005"):
        diagnose(LEVEL, Series(np.arange(50.0)), alpha=0.001)
