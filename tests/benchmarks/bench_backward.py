"""Backward simulation with all weights, O(M^2), against O(M): ``python -m tests.benchmarks.bench_backward``.

M = N = 50 ... 5000 on paper, eqs. (34) and (35), T = 100. Processor time of the backward pass alone, and
the error of the smoothed means in units of the smoothed standard deviation: against the exact
answer on eq. (34), against the mean of long runs on eq. (35). All methods go through the same
filters. Writes ``results/backward.csv``, ``results/backward.md`` and ``results/backward.png``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import engine
from engine.smoothers.linear_cost import backward_draws

RESULTS = Path(__file__).parent / "results"
T = 100
SIZES = (50, 100, 200, 500, 1000, 2000, 5000)
MODELS = ("linear-2", "mixed-4")
LONG = 4  # runs of the reference, M = N = 5000 with all weights

Draw = Callable[[engine.Filtered, int, np.random.Generator], engine.Smoothed]
METHODS: dict[str, Draw] = {
    "all weights": lambda f, n, rng: engine.rb_ffbsi(f, n, rng, joint=True),
    "MCMC, 1 move": lambda f, n, rng: backward_draws(f, n, rng, "mcmc", 1, condition=False)[0],
    "MCMC, 3 moves": lambda f, n, rng: backward_draws(f, n, rng, "mcmc", 3, condition=False)[0],
    "rejection": lambda f, n, rng: backward_draws(f, n, rng, "rejection", condition=False)[0],
}


def reference(model: engine.MixedModel, series: engine.Series) -> tuple[Any, Any]:
    """Smoothed mean and standard deviation (T, nx)."""
    if model.name == "linear-2":
        exact = engine.kalman_smoother(model, None, series)
        return exact.x, np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    runs = []
    for k in range(LONG):
        rng = np.random.default_rng([9, k])
        filtered = engine.rbpf(model, None, series, SIZES[-1], rng)
        runs.append(
            engine.condition_on_trajectories(METHODS["all weights"](filtered, SIZES[-1], rng))
        )
    mean = np.mean([run.mean() for run in runs], axis=0)
    return mean, np.maximum(np.mean([run.std() for run in runs], axis=0), 1e-6)


def main() -> None:
    RESULTS.mkdir(exist_ok=True)
    rows = []
    for name in MODELS:
        model = engine.get_model(name)
        series = engine.simulate(model, None, T, np.random.default_rng(1)).series
        mean, std = reference(model, series)
        for M in SIZES:
            seconds: dict[str, list[float]] = {method: [] for method in METHODS}
            errors: dict[str, list[float]] = {method: [] for method in METHODS}
            for replicate in range(-1, min(20, 5000 // M + 2)):
                filtered = engine.rbpf(
                    model, None, series, M, np.random.default_rng([M, replicate + 1])
                )
                for method, draw in METHODS.items():
                    if M > 1000 and replicate > 1 and method == "all weights":
                        continue
                    rng = np.random.default_rng([M, replicate + 1, 1])
                    started = time.process_time()
                    draws = draw(filtered, M, rng)
                    spent = time.process_time() - started
                    if replicate < 0 and min(SIZES) == M:
                        continue  # compiles
                    seconds[method].append(spent)
                    moments = engine.condition_on_trajectories(draws)
                    # the first row of eq. (35) is known exactly
                    error = ((moments.mean() - mean) / std)[1:]
                    errors[method].append(float(np.mean(error**2)))
            for method in METHODS:
                rows.append(
                    {
                        "model": name,
                        "M": M,
                        "method": method,
                        "seconds": float(np.median(seconds[method])),
                        "error": float(np.sqrt(np.mean(errors[method]))),
                        "runs": len(errors[method]),
                    }
                )
                print(rows[-1], flush=True)
    with (RESULTS / "backward.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    (RESULTS / "backward.md").write_text(table(rows))
    plot(rows)


def table(rows: list[dict[str, Any]]) -> str:
    """Milliseconds and error of each method, one line for each model and M."""
    text = [
        f"Backward simulation, T = {T}, N = M: processor milliseconds on one core / error of the",
        "smoothed means in smoothed standard deviations (`python -m tests.benchmarks.bench_backward`).",
        "",
        "| model | M | " + " | ".join(METHODS) + " |",
        "| --- | --- |" + " --- |" * len(METHODS),
    ]
    for name in MODELS:
        for M in SIZES:
            cells = [
                f"{1e3 * row['seconds']:.1f} / {row['error']:.3f}"
                for row in rows
                if row["model"] == name and row["M"] == M
            ]
            text.append(f"| {name} | {M} | " + " | ".join(cells) + " |")
    return "\n".join([*text, ""])


def plot(rows: list[dict[str, Any]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, len(MODELS), figsize=(10, 7), sharex=True)
    for column, name in zip(axes.T, MODELS, strict=True):
        for method in METHODS:
            those = [row for row in rows if row["model"] == name and row["method"] == method]
            x = [row["M"] for row in those]
            column[0].loglog(x, [row["seconds"] for row in those], "o-", label=method)
            column[1].loglog(x, [row["error"] for row in those], "o-", label=method)
        x0 = np.array([SIZES[2], SIZES[-1]], dtype=float)
        base = next(
            row["seconds"]
            for row in rows
            if row["model"] == name and row["M"] == SIZES[2] and row["method"] == "MCMC, 1 move"
        )
        column[0].loglog(x0, 0.5 * base * x0 / x0[0], "k:", label="slope 1")
        column[0].loglog(x0, 2.5 * base * (x0 / x0[0]) ** 2, "k--", label="slope 2")
        column[0].set(title=name, ylabel="backward pass, CPU s")
        column[1].set(xlabel="M = N", ylabel="error / smoothed s.d.")
        for axis in column:
            axis.grid(True, which="both", alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(RESULTS / "backward.png", dpi=120)


if __name__ == "__main__":
    main()
