"""The paper's estimation problems: which parameters, and where they start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.filters.kalman import kalman_smoother
from engine.filters.rbpf import rbpf
from engine.models.registry import get_model
from engine.statespace.model import MixedModel, ThetaLike
from tests.studies import growth, scalar_linear
from tests.studies.realisation import LIKELIHOOD, START, stream

PARTICLES = 2000  # of a log-likelihood that judges an estimate ...
REPEATS = 4  # ... and how many such filters are averaged


def _from_03(rng: np.random.Generator) -> dict[str, float]:
    """Paper, section V-A."""
    return {"theta": 0.3}


def _theta_2(rng: np.random.Generator) -> dict[str, float]:
    """Paper, section V-B: U[0, 2]."""
    return {"theta_2": rng.uniform(0.0, 2.0)}


def _all_five(rng: np.random.Generator) -> dict[str, float]:
    """Paper, section V-B: +-100 % of nominal; theta_4 in [0, 1], theta_5 in [0, pi/2]."""
    u = rng.random(5)
    high = (2.0, 2.0, 0.6, 1.0, np.pi / 2.0)
    return {f"theta_{k + 1}": float(u[k] * high[k]) for k in range(5)}


def _near(truth: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Every parameter times 2^U[-1, 1], a pole a times 2^U[-1, 0]."""
    return {
        name: value * 2.0 ** rng.uniform(-1.0, 0.0 if name == "a" else 1.0)
        for name, value in truth.items()
    }


SCALAR = {"a": 0.9, "q": 0.1, "r": 0.1}
GROWTH = {"a": 0.5, "b": 25.0, "c": 8.0, "d": 0.05, "q": 0.1, "r": 0.1}
UNREGISTERED = {"scalar-linear": scalar_linear.MODEL, "growth": growth.MODEL}


def model_named(name: str) -> MixedModel:
    """A registered model, or one of the poster's examples."""
    return UNREGISTERED[name] if name in UNREGISTERED else get_model(name)


@dataclass(frozen=True)
class Problem:
    """Estimate ``free`` in model ``model`` from one realisation, started at ``start(rng)``."""

    name: str
    model: str
    free: tuple[str, ...]
    start: Callable[[np.random.Generator], Mapping[str, float]]

    def started(self, seed: int, run: int) -> Mapping[str, float]:
        """The start values of a run."""
        return self.start(np.random.default_rng(stream(seed, run, START)))


PROBLEMS = {
    problem.name: problem
    for problem in (
        Problem("table-I", "linear-2", ("theta",), _from_03),
        Problem("theta-2", "mixed-4", ("theta_2",), _theta_2),
        Problem(
            "all-five",
            "mixed-4",
            ("theta_1", "theta_2", "theta_3", "theta_4", "theta_5"),
            _all_five,
        ),
        Problem("poster-linear", "scalar-linear", tuple(SCALAR), partial(_near, SCALAR)),
        Problem("poster-nonlinear", "growth", tuple(GROWTH), partial(_near, GROWTH)),
    )
}


def log_likelihood(
    model_name: str, theta: ThetaLike, series: Series, seed: int, run: int
) -> tuple[float, float]:
    """Log-likelihood of an estimate and its standard error, independent of how it was found.

    Exact for the linear model, else the log of the mean likelihood of REPEATS filters.
    """
    model = model_named(model_name)
    if model_name in ("linear-2", "scalar-linear"):
        return kalman_smoother(model, theta, series).log_likelihood, 0.0
    rng = np.random.default_rng(stream(seed, run, LIKELIHOOD))
    each = np.array(
        [rbpf(model, theta, series, PARTICLES, rng).log_likelihood for _ in range(REPEATS)]
    )
    if not np.isfinite(each).all():
        return float(each.max()), float("nan")
    value = float(np.logaddexp.reduce(each) - np.log(REPEATS))
    return value, float(each.std(ddof=1) / np.sqrt(REPEATS))
