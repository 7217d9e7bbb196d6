"""The estimate of the likelihood is unbiased, whatever the scheme, threshold and proposal."""

from __future__ import annotations

import numpy as np
import pytest

from engine import kalman_smoother, rbpf
from engine.kernels.filtering import draw_prior
from tests.engine.models_for_tests import awkward_series, linear_mixed


def wide(step):
    """A proposal of one's own: the prediction with three times its spread."""
    noise = step.rng.standard_normal((len(step.ancestors), step.model.na))
    a = draw_prior(step.mu, step.L, step.ancestors, 3.0 * noise)
    La = step.L[0, : step.model.na, : step.model.na]
    log_q = -0.5 * (noise**2).sum(axis=1) - np.log(np.diag(3.0 * La)).sum()
    return a, log_q - 0.5 * step.model.na * np.log(2.0 * np.pi)


@pytest.mark.long
@pytest.mark.parametrize(
    ("proposal", "resampling", "threshold"),
    [
        ("adapted", "systematic", 0.5),
        ("bootstrap", "systematic", 0.5),
        ("adapted", "multinomial", 1.0),
        ("adapted", "residual", 0.8),
        ("adapted", "stratified", 0.0),
        (wide, "systematic", 0.5),
    ],
)
def test_likelihood_estimate_is_unbiased(proposal, resampling, threshold):
    """E exp(log-likelihood) = exact, within 4.5 standard errors over 600 runs: rate 1e-5."""
    model = linear_mixed(na=1)
    series = awkward_series(model).part(0, 8)
    exact = kalman_smoother(model, None, series).log_likelihood
    rng = np.random.default_rng(8)
    ratio = np.exp(
        [
            rbpf(model, None, series, 30, rng, proposal, resampling, threshold).log_likelihood
            - exact
            for _ in range(600)
        ]
    )
    error = ratio.std() / np.sqrt(len(ratio))
    assert error < 0.15
    assert abs(ratio.mean() - 1.0) < 4.5 * error
