"""``tanks`` on the cascaded-tanks benchmark: estimates of one model, judged on the test record.

    python -m tests.studies.tanks FOLDER        FOLDER holds estimation.csv and test.csv (u_V, y_V)

Simulation error (``fit_simulation``), maximum likelihood by an extended Kalman filter, and maximum
likelihood by RBPS-EM. The test record is run without noise from a first state that is estimated on
its first 50 samples, as the benchmark prescribes (M. Schoukens, J.P. Noel, "Three benchmarks
addressing open challenges in nonlinear system identification", 2017).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from engine.data.files import read_series
from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.em import rbps_em
from engine.filters.rbpf import rbpf
from engine.models.registry import get_model
from engine.simulation.fit import fit_simulation
from engine.simulation.free_run import free_run
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from tests.studies.ekf import ekf

STEP = 4.0  # s
FIRST = 50  # samples that give the first state and are not scored
NOISE = ("sigma_level", "sigma_inflow", "sigma_y")


@dataclass(frozen=True)
class Line:
    """One estimate and how it was made."""

    name: str
    theta: Theta
    seconds: float
    note: str = ""


def run(
    folder: str | Path,
    n_particles: int = 100,
    n_iterations: int = 300,
    seed: int = 1,
    likelihood_particles: int = 1000,
    likelihood_runs: int = 5,
) -> str:
    """The estimates beside each other as a Markdown text."""
    model = get_model("tanks")
    estimation = read_series(Path(folder) / "estimation.csv", dt=STEP)
    test = read_series(Path(folder) / "test.csv", dt=STEP)
    lines = estimates(model, estimation, n_particles, n_iterations, seed)
    header = (
        "| estimate | k1 | k3 | k4 | sigma_level | sigma_inflow | sigma_y | log-likelihood, EKF "
        f"| log-likelihood, RBPF (M = {likelihood_particles}) | RMSE estimation [V] | RMSE test [V] "
        f"| RMSE test from sample {FIRST} [V] | seconds |"
    )
    table = [header, "| --- |" + " --- |" * 12]
    for line in lines:
        p_hat = [
            rbpf(
                model,
                line.theta,
                estimation,
                likelihood_particles,
                np.random.default_rng([seed, i]),
            ).log_likelihood
            for i in range(likelihood_runs)
        ]
        runs = [free_run(model, line.theta, one, initial_rows=FIRST) for one in (estimation, test)]
        table.append(
            f"| {line.name} | "
            + " | ".join(f"{value:.4g}" for value in line.theta)
            + f" | {ekf(model, line.theta, estimation).log_likelihood:.1f}"
            + f" | {np.mean(p_hat):.1f} +- {np.std(p_hat, ddof=1):.1f}"
            + f" | {runs[0].rmse:.3f} | {runs[1].rmse:.3f} | {runs[1].rmse_from(FIRST):.3f}"
            + f" | {line.seconds:.1f} |"
        )
    notes = [f"- {line.name}: {line.note}" for line in lines if line.note]
    return "\n".join([f"# {model.description}", "", *table, "", *notes, "", TEXT, ""])


def estimates(
    model: MixedModel, series: Series, n_particles: int, n_iterations: int, seed: int
) -> list[Line]:
    """Simulation error, EKF maximum likelihood and RBPS-EM, from the model's default parameters."""
    lines = []
    fit = fit_simulation(model, series)
    theta, _ = ekf_maximum_likelihood(model, series, fit.theta, NOISE)
    note = (
        f"RMSE {fit.rmse:.4f} V on the estimation record with the first state fitted to all of it. "
        "A noise-free run says nothing about the noise; the three sigmas shown maximise the EKF's "
        "likelihood at its k1, k3, k4."
    )
    lines.append(Line("simulation error", theta, fit.seconds, note))
    began = time.perf_counter()
    theta, note = ekf_maximum_likelihood(model, series, None, model.parameter_names)
    lines.append(Line("maximum likelihood, EKF", theta, time.perf_counter() - began, note))
    for name, start, iterations in (
        ("RBPS-EM", None, n_iterations),
        ("RBPS-EM started there", theta, n_iterations // 3),
    ):
        em = rbps_em(
            model, series, start, n_particles=n_particles, n_iterations=iterations, seed=seed,
            method="em",
        )  # fmt: skip
        note = f"M = {n_particles}, {len(em.log_likelihood)} iterations. {em.message}"
        seconds = float(np.sum(em.seconds))
        lines.append(Line(f"maximum likelihood, {name}", em.theta, seconds, note))
    return lines


def ekf_maximum_likelihood(
    model: MixedModel, series: Series, theta0: ThetaLike, free: Sequence[str]
) -> tuple[Theta, str]:
    """Maximise the extended Kalman filter's likelihood over positive parameters, in logarithms."""
    start = np.array(model.theta(theta0))
    where = model.free_indices(free)
    low = np.log(np.maximum(model.lower[where], 1e-7))
    high = np.log(model.upper[where])

    def theta(p: Array) -> Array:
        out = start.copy()
        out[where] = np.exp(p)
        return np.clip(out, model.lower, model.upper)

    def cost(p: Array) -> float:
        try:
            return -ekf(model, theta(p), series).log_likelihood
        except EngineError:  # the filter is lost there
            return 1e8

    first = np.clip(np.log(np.maximum(start[where], 1e-7)), low, high)
    bounds = list(zip(low, high, strict=True))
    end = minimize(cost, first, method="L-BFGS-B", bounds=bounds, options={"maxiter": 100})
    return model.theta(theta(end.x)), f"{end.nfev} likelihoods, {end.message}".capitalize() + "."


TEXT = """## What differs and why

(Said of the table with M = 100.)

- *What is minimised.* The simulation error is what the test scores, over the whole record. Likelihood
  scores predictions one step (4 s) ahead. This model leaves out the overflow of the tanks, so it is
  wrong by 0.6 V in simulation whatever its parameters are; process noise takes that over, and the
  likelihood then chooses k1, k3, k4 for the fast part of the response. Its maximum therefore need not
  simulate best, and does not: 0.73 V for the extended Kalman filter's, 0.67 V for least squares.
- *Where RBPS-EM stands.* Along the direction in which the time constants of the tanks are exchanged
  (k3 / k1 from 1.7 by least squares to 0.45 by the EKF's likelihood) the likelihood is flat, and plain
  EM moves slowly there: from the defaults it was 25 below the EKF's maximum after 240 iterations. It
  now leaves for the maximum of the moment filter's likelihood first, and ends as high as the EKF within
  the Monte Carlo error, in a fifth of the time; it simulates as the EKF's estimate does, no better.
  Started at the EKF's estimate EM goes on in the same direction, to an upper tank that is nearly empty.
- *The likelihoods.* At one theta EKF and RBPF agree within the Monte Carlo error and its bias (the
  logarithm of an estimate with standard deviation s is s^2 / 2 low) where the levels are well above
  zero: over a step of 4 s the square roots are nearly straight. Where the upper tank is nearly empty
  they are not, and the EKF is lower (last line: the RBPF gives 10 more).
- *The noise.* sigma_y goes to its floor of 5 mV: the record is nearly free of measurement noise, and
  what the model gets wrong is put into sigma_level and sigma_inflow. Without the upper bound of
  sigma_inflow the likelihood rises further and the simulation error goes beyond 3 V.
"""


def main(arguments: list[str] | None = None) -> None:
    """Print the table; with ``--out`` also write it."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.tanks", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the cascaded-tanks records")
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    options = parser.parse_args(arguments)
    text = run(options.folder, options.particles, options.iterations)
    print(text)
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
