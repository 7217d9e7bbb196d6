"""Where EM leaves from: a distant start in another basin, and who decides."""

from __future__ import annotations

import numpy as np
import pytest

from engine import get_model, rbps_em, simulate
from engine.estimation.start import WarmStart

# a start from which plain EM ends at theta_4 = 0, about 40 below in log-likelihood
LOST = {"theta_1": 1.86, "theta_2": 0.47, "theta_3": 0.57, "theta_4": 0.17, "theta_5": 0.22}


@pytest.fixture(scope="module")
def series():
    return simulate(get_model("mixed-4"), None, 120, np.random.default_rng(16)).series


def test_a_start_in_another_basin_is_left_and_the_trace_begins_with_it(series):
    model = get_model("mixed-4")
    options = {"n_particles": 50, "n_iterations": 5}
    warm = rbps_em(model, series, LOST, **options)
    cold = rbps_em(model, series, LOST, warm_start=False, **options)
    truth = rbps_em(model, series, None, warm_start=False, **options)
    assert np.allclose(warm.trace[0], list(LOST.values()))
    assert warm.log_likelihood[0] == cold.log_likelihood[0]
    assert warm.log_likelihood[-1] > truth.log_likelihood[-1] - 5.0
    assert cold.log_likelihood[-1] < truth.log_likelihood[-1] - 20.0


@pytest.mark.slow
def test_resuming_a_warm_started_run_gives_the_same_bits(series):
    model = get_model("mixed-4")
    whole = rbps_em(model, series, LOST, n_particles=8, n_iterations=3)
    first = rbps_em(model, series, LOST, n_particles=8, n_iterations=1)
    again = rbps_em(model, series, LOST, n_particles=8, n_iterations=3, resume=first.checkpoint)
    assert np.array_equal(whole.trace, again.trace)


def test_only_free_parameters_move(series):
    model = get_model("mixed-4")
    start = model.theta({"theta_2": 0.1, "theta_3": 0.31})
    found = WarmStart(model, [series], model.free_indices(["theta_2"]))(start)
    assert found[0]["theta_3"] == 0.31
    assert 0.5 < found[0]["theta_2"] < 1.6
