"""``tanks`` on the cascaded-tanks benchmark: three estimates of one model, judged on the test record.

    python -m engine.studies.tanks FOLDER        FOLDER holds estimation.csv and test.csv (u_V, y_V)

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

from engine.ekf import ekf
from engine.em import rbps_em
from engine.errors import EngineError
from engine.free_run import free_run
from engine.model import Array, MixedModel, Theta, ThetaLike
from engine.rbpf import rbpf
from engine.registry import get_model
from engine.series import Series
from engine.series_files import read_series
from engine.simulation_fit import fit_simulation

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
    """The estimates side by side as a Markdown text."""
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
    for name, fixed in (("EKF", {}), ("EKF, no inflow", {"sigma_inflow": 0.0})):
        began = time.perf_counter()
        free = [p for p in model.parameter_names if p not in fixed]
        theta, note = ekf_maximum_likelihood(model, series, fixed, free)
        lines.append(Line(f"maximum likelihood, {name}", theta, time.perf_counter() - began, note))
    em = rbps_em(model, series, n_particles=n_particles, n_iterations=n_iterations, seed=seed)
    note = f"M = {n_particles}, {len(em.log_likelihood)} iterations. {em.message}"
    seconds = float(np.sum(em.seconds))
    return [*lines, Line("maximum likelihood, RBPS-EM", em.theta, seconds, note)]


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


TEXT = ""


def main(arguments: list[str] | None = None) -> None:
    """Print the table; with ``--out`` also write it."""
    parser = argparse.ArgumentParser(prog="python -m engine.studies.tanks", description=__doc__)
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
