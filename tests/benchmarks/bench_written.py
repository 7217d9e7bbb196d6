"""One model, two tanks, written as different people write: ``python -m tests.benchmarks.bench_written``.

The moment filter with a function on tape beside the same with calls of it, in turn in one run. Writes
``results/written.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, interp1d

import engine
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.sigma_point import moment_filter, run_on_tape
from tests.benchmarks.bench_free_run import paired
from tests.benchmarks.bench_tape import by_calls
from tests.benchmarks.machine import Watch

RESULTS = Path(__file__).parent / "results"
ROWS, REPEATS = 400, 5
Step = Callable[..., Any]

LEVELS = np.linspace(1e-3, 20.0, 41)
SPLINE = CubicSpline(LEVELS, np.sqrt(LEVELS))
LINES = interp1d(LEVELS, np.sqrt(LEVELS), fill_value="extrapolate")
BY_HOUR = [1.0 + 0.01 * hour for hour in range(8)]


def flows(a: Any, root: Callable[[Any], Any], inflow: Any, k1: Any, k2: Any) -> Any:
    """The rates of both levels (M, 2)."""
    upper, lower = k1 * root(a[:, 0]), k2 * root(a[:, 1])
    return np.stack([inflow - upper, upper - lower], axis=1)


def safe(h: Any) -> Any:
    return np.sqrt(np.maximum(h, 1e-3))


def formulas(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    return a + dt * flows(a, safe, u[0], th.k1, th.k2)


def if_of_an_input(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    k = th.k1 if u[0] > 0.3 else th.k2
    return a + dt * flows(a, safe, u[0], k, th.k2)


def table_by_the_hour(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    return a + dt * flows(a, safe, u[0] * BY_HOUR[int(t) % 8], th.k1, th.k2)


def loop_over_particles(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    out = np.empty_like(a)
    for i, (upper, lower) in enumerate(a):
        first = th.k1 * math.sqrt(upper) if upper > 1e-3 else 0.0
        second = th.k2 * math.sqrt(lower) if lower > 1e-3 else 0.0
        out[i] = upper + dt * (u[0] - first), lower + dt * (first - second)
    return out


def cubic_spline(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    return a + dt * flows(a, SPLINE, u[0], th.k1, th.k2)


def interpolated(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    return a + dt * flows(a, LINES, u[0], th.k1, th.k2)


def implicit_step(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    x = a.copy()
    for _ in range(20):
        missed = x - a - dt * flows(x, safe, u[0], th.k1, th.k2)
        slopes = 0.5 * dt / safe(x) * np.array([th.k1, th.k2])
        zero = np.zeros(len(x))
        J = np.stack(
            [
                np.stack([1.0 + slopes[:, 0], zero], 1),
                np.stack([-slopes[:, 0], 1.0 + slopes[:, 1]], 1),
            ],
            1,
        )
        step = np.linalg.solve(J, missed[:, :, None])[:, :, 0]
        x = x - step
        if np.abs(step).max() < 1e-10:
            break
    return x


def by_solve_ivp(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    def rates(t: Any, x: Any) -> Any:
        return flows(x[None], safe, u[0], th.k1, th.k2)[0]

    return np.array([solve_ivp(rates, (0.0, dt), x).y[:, -1] for x in a])


WRITTEN: dict[str, Step] = {
    "formulas": formulas,
    "`if u[0] > 0.3`": if_of_an_input,
    "list at `int(t) % 8`": table_by_the_hour,
    "loop over particles, with `if`": loop_over_particles,
    "`CubicSpline`": cubic_spline,
    "`interp1d`": interpolated,
    "implicit step, until it converges": implicit_step,
    "`solve_ivp`": by_solve_ivp,
}


def model_of(step: Step) -> engine.MixedModel:
    """Two tanks, of which the lower level is read."""
    return engine.MixedModel(
        name="two tanks",
        dynamics=lambda *given: (step(*given), np.zeros((2, 0)), given[-1].q * np.eye(2)),
        measurement=lambda a, u, t, th: (a[:, 1:], np.zeros((1, 0)), [[0.01]]),
        initial=lambda th: (engine.Gaussian([4.0, 4.0], np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"upper": "m", "lower": "m"},
        inputs={"pump": "m/min"},
        outputs={"level": "m"},
        parameters=[
            engine.Parameter("k1", 0.15, bounds=(1e-3, 1.0)),
            engine.Parameter("k2", 0.13, bounds=(1e-3, 1.0)),
            engine.Parameter("q", 1e-4, bounds=(1e-8, 1.0)),
        ],
    )


def record() -> engine.Series:
    """What the formulas give with a pump at two levels."""
    rng = np.random.default_rng(5)
    u = np.repeat(0.3 + 0.2 * (rng.random(ROWS // 20) > 0.5), 20)
    return engine.simulate(model_of(formulas), None, ROWS, rng, u=u[:, None], dt=1.0).series


def main() -> None:
    """Measure, and write the page."""
    lines, series = [], record()
    with Watch() as watch:
        for name, step in WRITTEN.items():
            model = model_of(step)
            theta = np.asarray(model.theta())[None]
            calls, tape, ratio, a, b = paired(
                lambda m=model, x=theta: moment_filter(m, x, series).log_likelihood,
                REPEATS,
                by_calls,
            )
            assert run_on_tape(FilterSteps(model, Thetas(model, theta), series)) is not None, name
            apart = float(np.abs(a - b).max() / np.abs(a).max())
            lines.append(f"| {name} | {calls:.1f} | {tape:.2f} | {ratio:.0f} | {apart:.0e} |")
            print(lines[-1], flush=True)
    figures = watch.figures()
    head = [
        "# One model in different ways of writing",
        "",
        f"A moment filter of two tanks, {ROWS} samples; processor time on one core, medians of {REPEATS} pairs",
        "in turn (`make bench-written`). *Apart*: the log-likelihoods, as a share. Other programs used "
        f"{figures['cores used by foreign processes']:.1f} of {figures['cores']:.0f} cores meanwhile.",
        "",
        "| written with | calls, ms | tape, ms | times faster | apart |",
        "| --- | --- | --- | --- | --- |",
    ]
    (RESULTS / "written.md").write_text("\n".join([*head, *lines]) + "\n")


if __name__ == "__main__":
    main()
