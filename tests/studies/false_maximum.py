"""Is the end of a lost run a maximum of the likelihood, or an artefact of few particles?

EM is run from the same start with ten times the particles, the adapted proposal and the exact smoother.
Where it is at the end, the observed information tells a maximum (all its eigenvalues are positive) from
a saddle or a slope.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.errors import NotSettledWarning
from engine.estimation.uncertainty import standard_errors
from engine.estimation.uncertainty.score import Score
from engine.statespace.model import Array, MixedModel, Theta
from tests.studies.em_arms import FAILURES, estimate
from tests.studies.problems import PROBLEMS, model_named
from tests.studies.realisation import METHOD, realisation, stream
from tests.studies.study import Arm, Row

PROBLEM = PROBLEMS["all-five"]
OPTIONS: dict[str, Any] = {
    "n_particles": 500,
    "n_trajectories": 50,
    "n_iterations": 300,
    "proposal": "adapted",
    "resampling": "systematic",
    "ess_threshold": 0.5,
    "smoother": "exact",
}
PARTICLES = 200  # and trajectories, of the smoothers that give the score
REPLICATES = 8
HALF = 0.5  # of a standard error: how far to either side the score is taken


def many_particles(seed: int, run: int) -> Row:
    """A row of :func:`tests.studies.em_arms.estimate`, and the curvature at the averaged iterates.

    ``gain`` is what a Newton step from there promises in nats, ``se.`` the standard errors, ``curvature``
    the least eigenvalue of the observed information in their unit, 1 in every direction at a maximum
    whose standard errors are right, with ``curvature_se``, its Monte Carlo standard error.
    """
    row = estimate(PROBLEM.name, "rbps-varied", OPTIONS, False, False, False, seed, run)
    model = model_named(PROBLEM.model)
    theta = model.theta({name: float(row[f"average.{name}"]) for name in PROBLEM.free})
    series = realisation(model, seed, run).series
    row.update({"gain": np.nan, "curvature": np.nan, "curvature_se": np.nan})
    row.update({f"se.{name}": np.nan for name in PROBLEM.free})
    try:
        row.update(curvature(model, theta, series, stream(seed, run, METHOD)))
    except FAILURES as error:  # at a bound there is no information: the row says so
        row["message"] = f"{type(error).__name__}: {error}"
    return row


def curvature(
    model: MixedModel, theta: Theta, series: Series, numbers: np.random.SeedSequence
) -> Row:
    """The columns on the likelihood's curvature at theta. Raises ModelError where there is none."""
    with warnings.catch_warnings():  # "gain" is how far the maximum is
        warnings.simplefilter("ignore", NotSettledWarning)
        found = standard_errors(
            model, theta, series, PROBLEM.free, PARTICLES, PARTICLES, replicates=REPLICATES
        )
    L = np.asarray(np.linalg.cholesky(found.covariance), dtype=float)
    indices = model.free_indices(found.names)
    score = Score.of(model, theta, [series], indices, PARTICLES, PARTICLES, exact=False)
    each = np.array([_information(score, L, which) for which in numbers.spawn(REPLICATES)])
    values, vectors = np.linalg.eigh(each.mean(axis=0))
    least = np.einsum("i,rij,j->r", vectors[:, 0], each, vectors[:, 0])
    row: Row = {
        "gain": float(0.5 * found.score @ found.covariance @ found.score),
        "curvature": float(values[0]),
        "curvature_se": float(least.std(ddof=1) / np.sqrt(REPLICATES)),
    }
    for name in PROBLEM.free:
        row[f"se.{name}"] = float(found.values[model.index(name)])
    return row


def _information(score: Score, L: Array, which: np.random.SeedSequence) -> Array:
    """L' I L (n, n) by central differences of the score, the same random numbers on either side."""
    sides = [
        np.array([score.at(score.x + sign * HALF * step, which)[0] for step in L.T])
        for sign in (-1.0, 1.0)
    ]
    G = (sides[0] - sides[1]) @ L / (2.0 * HALF)
    out: Array = 0.5 * (G + G.T)
    return out


FALSE_MAXIMUM = Arm(
    "all-five.many-particles",
    many_particles,
    {
        "method": "rbps-varied",
        **OPTIONS,
        "start": "paper's",
        "curvature": {"n_particles": PARTICLES, "replicates": REPLICATES},
    },
)
