"""The family-wise p-value by parametric bootstrap, beside the one by multiplier draws."""

import numpy as np
import pytest

from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.bootstrap import bootstrap_p
from engine.diagnose.refits.calibration import Question
from engine.diagnose.search.search import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import DRIVE, hidden

KINDS = ["coulomb", "drag", "bias", "gain", "force", "level"]
N = 39


def both(effects, values, seed):
    """p-values by multipliers and by bootstrap."""
    series = hidden(effects, values, seed, n=150)
    fit = quasi_ml(DRIVE, series)
    setting = setting_for(DRIVE, series, fit.theta)
    silent = lambda stage, fraction: None  # noqa: E731
    seen = screen_effects(fit, series, setting, KINDS, 0.05, seed, silent)
    return seen.p_value, bootstrap_p(Question(fit, series, setting, KINDS), seen, N, seed).p_value


@pytest.mark.slow
def test_a_large_effect_is_beyond_all_bootstrap_series():
    multiplier, bootstrap = both(["coulomb:speed"], {"coulomb_speed": 0.6}, 1)
    assert multiplier < 0.01
    assert bootstrap == pytest.approx(1.0 / (N + 1))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_on_clean_series_both_say_about_the_same(seed):
    """Within three standard errors of the bootstrap's share of N."""
    multiplier, bootstrap = both([], {}, seed)
    assert abs(multiplier - bootstrap) < 3.0 * np.sqrt(0.25 / N)
