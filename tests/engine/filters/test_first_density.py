"""Filters that begin from a density that is no Gaussian, against integrals over it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import gamma

import engine


class Wide:
    """A gamma density, as a model may bring one along."""

    def sample(self, rng: np.random.Generator, n: int) -> Any:
        return rng.gamma(4.0, 1.0, (n, 1))

    def log_density(self, a: Any) -> Any:
        return gamma.logpdf(a[:, 0], 4.0)


def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [0.9 * a[:, 0], 0.0], [[0.0], [1.0]], [[1e-4, 0.0], [0.0, 0.0]]


def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [a[:, 0]], [[1.0]], [[0.005]]


def initial(theta: Any) -> tuple[Any, Any, Any]:
    return Wide(), lambda a: [0.1 * a[:, 0]], lambda a: [[0.001 * (1.0 + a[:, 0])]]


MODEL = engine.MixedModel(
    name="wide",
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    nonlinear={"a": "1"},
    linear={"offset": "1"},
    outputs={"y": "1"},
    parameters=[],
)


def first_of(y: float) -> tuple[float, float, float]:
    """Log-likelihood of the first reading, and mean and variance of a_1 given it."""
    a = np.linspace(1e-3, 25.0, 200_001)
    variance = 0.001 * (1.0 + a) + 0.005
    log_p = gamma.logpdf(a, 4.0) - 0.5 * (y - 1.1 * a) ** 2 / variance
    p = np.exp(log_p) / np.sqrt(2.0 * np.pi * variance)
    total = p.sum()
    mean = float(a @ p / total)
    return float(np.log(total * (a[1] - a[0]))), mean, float((a - mean) ** 2 @ p / total)


@pytest.mark.parametrize("resampling", ["systematic", "multinomial", "sorted"])
def test_a_wide_first_density(resampling: str) -> None:
    y = 4.2
    series = engine.Series([y, 4.0])
    exact, mean, variance = first_of(y)
    runs = [
        engine.rbpf(MODEL, None, series, 50, seed, resampling=resampling) for seed in range(100)
    ]
    terms = np.array([run.log_likelihood_terms[0] for run in runs])
    # draws of the density alone scatter by 0.6, and leave one particle at a time
    assert terms.std() < 0.25
    assert abs(np.log(np.mean(np.exp(terms))) - exact) < 4.0 * terms.std() / 10.0
    means = np.array([run.mean()[0, 0] for run in runs])
    assert abs(means.mean() - mean) < 4.0 * means.std() / 10.0
    spread = np.mean([run.a[0].var() for run in runs])
    assert 0.7 * variance < spread < 1.2 * variance


def test_a_first_row_without_a_reading() -> None:
    run = engine.rbpf(MODEL, None, engine.Series([np.nan, 3.0, 2.8]), 400, 1)
    assert abs(run.a[0].mean() - 4.0) < 0.4
    assert np.isfinite(run.log_likelihood)
    smoothed = engine.rb_ffbsi(run, 100, 2)
    assert abs(smoothed.mean()[0, 0] - smoothed.mean()[1, 0] / 0.9) < 0.05
