"""The likelihood's answer is judged from where the likelihood has it, too."""

from __future__ import annotations

import numpy as np
import pytest

from engine.diagnose import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.search import refits
from engine.diagnose.free_run_fits.fitted import Pick, Rival, fit_runs
from engine.diagnose.free_run_fits.linear import Linear
from tests.engine.diagnose.free_run.cubic import FREE, MODEL, fit_beside_cubic

STRANDED = {"omega": 0.5, "zeta": 0.02}  # on another hill of the squared error


@pytest.fixture(scope="module")
def stranded():
    """A fit that has gone astray, and a good one."""
    good = fit_beside_cubic(3)
    start = MODEL.theta({**good.theta.asdict(), **STRANDED})
    return fit_runs(MODEL, good.records, start, FREE, np.zeros((1, 2))), good


@pytest.mark.long
def test_an_answer_is_reached_from_its_own_parameters(stranded):
    fit, good = stranded
    assert fit.cost > 2.0 * good.cost  # it does not come back by itself
    effect = make_effect("cubic:position->velocity", Setting(MODEL))
    costs = []
    for beside in ({}, good.theta.asdict()):
        rival = Rival((Pick(effect, -4.0),), beside)
        found = refits(fit, Linear(fit, []), [], [rival], lambda *_: None)
        costs.append(min((one.cost for one in found), default=np.inf))
    assert costs[1] < 0.01 * good.cost < costs[0]


def test_only_what_the_free_run_estimates_begins_elsewhere(stranded):
    fit, _ = stranded
    noise = next(name for name in MODEL.parameter_names if name not in FREE)
    moved = fit.begun_at({"omega": 3.0, noise: 9.0})
    assert moved.theta["omega"] == 3.0
    assert moved.theta[noise] == fit.theta[noise]
