"""What Approximations 1 and 2 of the report cost: ``python -m tests.benchmarks.bench_approximations``.

Algorithm 3 against the exact moments given whole trajectories, each with bias and spread over
replicated runs, on paper, eq. (35), and on linear models built to hurt, where the Kalman smoother is
the truth; on eq. (35) the truth is a long run of the exact smoother. For each quantity, averaged over
time: its true value, and the ratio of estimate to truth, mean and standard deviation over the runs.
Then the EM estimate of one parameter with either smoother. Writes ``results/approximations.csv`` and
``results/approximations.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import csv
from pathlib import Path
from typing import Any

import numpy as np

import engine

RESULTS = Path(__file__).parent / "results"
SIZES = (100, 1000)
RUNS = {100: 40, 1000: 10}
QUANTITIES = ("var z", "cov z_t z_t+1", "cov z_t a_t+1")


def linear(name: str, A_a: float, Q_a: float, Q_z: float, R: float) -> engine.MixedModel:
    """a' = 0.7 a + A_a z + w_a, z' = pole z + w_z, y = a + e, with a small Q_az."""
    Q_az = 0.1 * np.sqrt(Q_a * Q_z)

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [0.7 * a[:, 0], 0.0], [[A_a], [theta.pole]], [[Q_a, Q_az], [Q_az, Q_z]]

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0]], [[0.0]], [[R]]

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return engine.Gaussian([0.0], [[1.0]]), np.zeros(1), np.eye(1)

    return engine.MixedModel(
        name=name,
        nonlinear={"a": "1"},
        linear={"z": "1"},
        outputs={"y": "1"},
        parameters=[engine.Parameter("pole", 0.95, bounds=(-2.0, 2.0))],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


CASES = {
    "eq. (35)": (engine.get_model("mixed-4"), "theta_2"),
    "eq. (34)": (engine.get_model("linear-2"), "theta"),
    "strong A_a, small Q_az": (linear("strong", 3.0, 0.1, 0.1, 1.0), "pole"),
    "weak A_a, slow z": (linear("slow", 0.3, 0.1, 0.01, 1.0), "pole"),
}


def moments(s: engine.Smoothed) -> dict[str, Any]:
    """Smoothed covariances, averaged over time and the components of z."""
    a, z = s.a, s.z
    residual = z - z.mean(axis=1, keepdims=True)
    next_a = a[1:] - a[1:].mean(axis=1, keepdims=True)
    P, M = (np.diagonal(m, axis1=2, axis2=3).mean(axis=1) for m in (s.P, s.M))
    return {
        "mean": s.mean(),
        "var z": float(((residual**2).mean(axis=1) + P).mean()),
        "cov z_t z_t+1": float(((residual[:-1] * residual[1:]).mean(axis=1) + M).mean()),
        "cov z_t a_t+1": float(np.abs((residual[:-1, :, :1] * next_a).mean(axis=1).mean())),
    }


def truth(model: engine.MixedModel, series: engine.Series) -> dict[str, Any]:
    if model.name == "mixed-4":
        runs = []
        for k in range(4):
            rng = np.random.default_rng([7, k])
            filtered = engine.rbpf(model, None, series, 4000, rng)
            draws = engine.rb_ffbsi(filtered, 2000, rng, joint=True)
            runs.append(moments(engine.condition_on_trajectories(draws)))
        return {name: np.mean([run[name] for run in runs], axis=0) for name in runs[0]}
    k = engine.kalman_smoother(model, None, series)
    return {
        "mean": k.x,
        "var z": k.P[:, 1, 1].mean(),
        "cov z_t z_t+1": k.M[:, 1, 1].mean(),
        "cov z_t a_t+1": abs(k.M[:, 1, 0].mean()),
    }


def estimate(
    model: engine.MixedModel, series: engine.Series, parameter: str, smoother: str
) -> float:
    """Mean of the last 20 of 60 EM iterates, from the true value on."""
    run = engine.rbps_em(
        model,
        series,
        free=[parameter],
        n_particles=SIZES[0],
        n_iterations=60,
        smoother=smoother,
        tolerance=None,
        warm_start=False,
        method="em",
    )
    return float(run.trace[-20:, model.index(parameter)].mean())


def main() -> None:
    RESULTS.mkdir(exist_ok=True)
    rows = []
    for case, (model, parameter) in CASES.items():
        series = engine.simulate(model, None, 100, np.random.default_rng(1)).series
        want = truth(model, series)
        longer = engine.simulate(model, None, 300, np.random.default_rng(1)).series
        exact = float("nan")
        if model.name != "mixed-4":
            run = engine.rts_em(model, longer, free=[parameter], n_iterations=80, method="em")
            exact = run.theta[parameter]
        for M in SIZES:
            for smoother in ("algorithm-3", "exact"):
                runs = []
                for k in range(RUNS[M]):
                    rng = np.random.default_rng([M, k])
                    filtered = engine.rbpf(model, None, series, M, rng)
                    draws = engine.rb_ffbsi(filtered, M, rng, joint=smoother == "exact")
                    if smoother == "exact":
                        draws = engine.condition_on_trajectories(draws)
                    runs.append(moments(draws))
                row: dict[str, Any] = {"case": case, "M": M, "smoother": smoother, "runs": RUNS[M]}
                error = np.mean([(run["mean"] - want["mean"]) ** 2 for run in runs])
                row["rms error of means"] = float(np.sqrt(error))
                for name in QUANTITIES:
                    ratio = np.array([run[name] for run in runs]) / want[name]
                    row[name] = float(want[name])
                    row[f"{name}: ratio"] = float(ratio.mean())
                    row[f"{name}: sd"] = float(ratio.std(ddof=1))
                row["EM estimate"] = row["exact EM"] = float("nan")
                if SIZES[0] == M:
                    row["EM estimate"] = estimate(model, longer, parameter, smoother)
                    row["exact EM"] = exact
                rows.append(row)
                print(line(row), flush=True)
    with (RESULTS / "approximations.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    text = [
        "Algorithm 3 of the report, with Approximations 1 and 2, against the exact moments of z given",
        "whole trajectories of a; T = 100, N = M. Ratios of estimate to truth, mean (s.d. over the runs);",
        "a ratio that stays away from 1 as M grows is the bias of the approximations. The last column",
        "is the EM estimate from T = 300 with that smoother / with the exact Kalman smoother",
        "(`python -m tests.benchmarks.bench_approximations`).",
        "",
        "| model | M | smoother | rms error of means | "
        + " | ".join(QUANTITIES)
        + " | EM / exact EM |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *map(line, rows),
        "",
    ]
    (RESULTS / "approximations.md").write_text("\n".join(text))


def line(row: dict[str, Any]) -> str:
    cells = [row["case"], str(row["M"]), row["smoother"], f"{row['rms error of means']:.4f}"]
    cells += [f"{row[f'{name}: ratio']:.3f} ({row[f'{name}: sd']:.3f})" for name in QUANTITIES]
    values = [row["EM estimate"], row["exact EM"]]
    cells.append(" / ".join(f"{value:.4f}" for value in values if not np.isnan(value)))
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
