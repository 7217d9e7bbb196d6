"""The log-likelihood's error and the bootstrap's, against their spread; losses are counted exactly."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import engine
from service import stages
from service.computations import LIKELIHOOD_RUNS, describe, log_likelihood, mean_error
from service.validation import load

MODEL = engine.get_model("linear-2")
SERIES = engine.simulate(MODEL, None, 60, np.random.default_rng(4)).series
JOB = SimpleNamespace(model=MODEL, series=[SERIES])


@pytest.mark.long
@pytest.mark.parametrize(("n", "scatter"), [(40, (0.3, 2.5)), (2, (4.0, 80.0))])
def test_the_stated_error_is_the_spread_over_seeds(n, scatter):
    """40 seeds know a standard deviation to 11 %, and its own estimate from five runs adds noise.

    Outside these limits less than 1 time in 1000, both where the runs agree and where they scatter by
    many nats; the error may be far above 1.
    """
    theta = MODEL.theta()
    found = [log_likelihood(JOB, theta, n, np.random.default_rng(s), "") for s in range(40)]
    low, high = scatter
    assert low < np.mean([one["spread"] for one in found]) < high
    spread = np.std([one["value"] for one in found], ddof=1)
    stated = np.sqrt(np.mean([one["standard_error"] ** 2 for one in found]))
    assert 0.6 < spread / stated < 1.6


def test_the_error_of_a_mean_of_likelihoods():
    """Small spread: that of a mean; large: that of the largest of five normal numbers, 0.669."""
    assert mean_error(0.05, 5) == pytest.approx(0.05 / np.sqrt(5.0), rel=0.05)
    assert mean_error(500.0, 5) == pytest.approx(0.669 * 500.0, rel=0.05)
    assert mean_error(0.0, 5) == 0.0
    assert mean_error(22.6, LIKELIHOOD_RUNS) > 10.0


def test_a_poor_log_likelihood_is_told(estimation):
    """Two particles: passes of the filter scatter by many nats, and the page says it."""
    request = estimation(method="rbps-em", iterations=2, particles=2)
    job = load(request)
    options = job.request.options
    theta = job.theta.tolist()
    found = {
        "theta": theta, "trace": [theta], "log_likelihood": [], "ess": [], "seconds": [],
        "free": ["theta"], "outcome": "converged", "success": True, "message": "Done.",
    }  # fmt: skip
    document = describe(job, options, found, Mock())
    told = document["log_likelihood"]
    assert ("known poorly" in document["message"]) == (told["spread"] >= 3.0)
    assert told["standard_error"] > 0.3 * told["spread"]


def test_the_bootstrap_states_the_spread_of_its_estimates(estimation):
    thetas = np.random.default_rng(0).normal(0.3, 0.05, 9)
    job = load(estimation(method="rts-em", bootstrap=9))
    left = [{"estimate": {"theta": {}}, "message": ""}]
    left += [{"success": True, "theta": [v]} for v in thetas.tolist()]
    progress = SimpleNamespace(left=lambda i: left[i])
    found = stages._summarize(job, job.request, range(1, 10), 0, progress)
    assert found["estimate"]["theta"]["standard_error"] == pytest.approx(
        np.sqrt(((thetas - thetas.mean()) ** 2).sum() / 8.0)
    )
    assert (
        found["estimate"]["theta"]["interval"]
        == np.quantile(thetas, [0.025, 0.975], method="weibull").tolist()
    )
