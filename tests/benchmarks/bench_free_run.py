"""Free runs found as a whole, beside the loop over time: ``python -m tests.benchmarks.bench_free_run``.

Each pair is measured in turn in one run and told as a ratio, the median over repetitions: free runs of
registered models and of models that are left to the loop, derivatives by all parameters and first states
beside differences of runs, fits of the free run, the choice of sub-steps in a diagnosis; of the search beside
a fit, runs begun from the fit's own and derivatives kept, beside neither. Writes ``results/free-run.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import importlib
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run_fits.candidates import candidates
from engine.diagnose.free_run_fits.folds import folds_of, losses
from engine.diagnose.steps.substeps import choose
from engine.simulation import problem, whole_record
from engine.simulation.free_run import first_state
from engine.simulation.problem import FreeRunProblem
from engine.simulation.simulate import propagate
from tests.benchmarks.machine import Watch
from tests.engine.simulation.free_run_models import (
    logistic,
    lorenz,
    pendulum,
    unstable,
    van_der_pol,
)

columns, fitted = (
    importlib.import_module(f"engine.diagnose.free_run_fits.{name}")
    for name in ("columns", "fitted")
)

RESULTS = Path(__file__).parent / "results"
SIZES = (500, 1000, 2000, 10_000)
STIFF, WEAK = (-100.0, 0.05), (-2.0, 0.1)  # size and width of a hysteresis
REPEATS = {500: 15, 1000: 15, 2000: 9, 10_000: 3}
FIRST = {"mixed-4": [0.5, 0.0, 1.0, 0.0]}  # its initial mean is at rest


@contextmanager
def the_loop() -> Any:
    """No run is tried as a whole."""
    shortest, whole_record.SHORTEST = whole_record.SHORTEST, np.inf
    try:
        yield
    finally:
        whole_record.SHORTEST = shortest


@contextmanager
def from_nothing() -> Any:
    """No run begins at that of the fit beside it."""
    before, fitted.extended_run = fitted.extended_run, lambda *of: None
    columns.extended_run = fitted.extended_run
    try:
        yield
    finally:
        fitted.extended_run = columns.extended_run = before


@contextmanager
def derivatives_anew() -> Any:
    """Derivatives are taken again after each step of a fit."""
    bent, problem.BENT = problem.BENT, 0.0
    try:
        yield
    finally:
        problem.BENT = bent


def paired(
    work: Callable[[], Any], repeats: int, before: Callable[[], Any] = the_loop
) -> tuple[float, float, float, Any, Any]:
    """Milliseconds of loop (or as ``before``) and whole, how often the whole goes into it; results of both."""
    seconds = []
    with before():
        work()
    work()
    for _ in range(repeats):
        started = time.process_time()
        with before():
            loop = work()
        between = time.process_time()
        whole = work()
        seconds.append((between - started, time.process_time() - between))
    pairs = np.array(seconds)
    ratio = float(np.median(pairs[:, 0] / pairs[:, 1]))
    return *(1e3 * np.median(pairs, axis=0)).tolist(), ratio, loop, whole


def series_for(model: engine.MixedModel, n: int, dt: float, size: float) -> engine.Series:
    rng = np.random.default_rng(n)
    u = np.repeat(rng.uniform(0.1, 1.0, n // 25 + 1), 25)[:n, None] * size
    return engine.Series(np.zeros((n, model.ny)), u * np.ones(model.nu), dt=dt)


def sine(model: engine.MixedModel, n: int, dt: float, size: float) -> engine.Series:
    u = size * np.sin(2.0 * np.pi * 0.2 * dt * np.arange(n))
    return engine.Series(np.zeros((n, model.ny)), u[:, None] * np.ones(model.nu), dt=dt)


def one_time() -> engine.MixedModel:
    """A user's model that takes one time in a call."""
    model = engine.get_model("oscillator")

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> Any:
        return model.dynamics(a, u if t < 1e9 else 2.0 * u, t, dt, theta)

    return replace(model, dynamics=dynamics)


def cases() -> list[tuple[str, engine.MixedModel, Callable[[int], engine.Series]]]:
    """What converges, then what is left to the loop."""
    names = {"oscillator": (0.1, 1.0), "mixed-4": (1.0, 0.0), "tanks": (4.0, 5.0)}
    names |= {"structure": (0.05, 1.0)}
    out = []
    for name, (dt, size) in names.items():
        model = engine.get_model(name)
        out.append((name, model, lambda n, m=model, dt=dt, u=size: series_for(m, n, dt, u)))
    servo, tanks = engine.get_model("servo"), engine.get_model("tanks")
    drag = engine.get_model("servo", effects=["drag:velocity"])
    return [
        *out,
        ("servo, one direction", servo, lambda n: series_for(servo, n, 0.02, 8.0)),
        ("servo, back and forth", servo, lambda n: sine(servo, n, 0.02, 6.0)),
        ("servo with drag", drag, lambda n: sine(drag, n, 0.02, 6.0)),
        (
            "tanks, 4 steps a sample",
            tanks,
            lambda n: series_for(tanks, n // 4, 4.0, 5.0).refined(4),
        ),
        ("pendulum", pendulum(), lambda n: series_for(pendulum(), n, 0.05, 1.0)),
        ("unstable, 1 % a step", unstable(1.01), lambda n: series_for(unstable(1.01), n, 1.0, 1.0)),
        ("van der Pol, dt 0.05", van_der_pol(), lambda n: series_for(van_der_pol(), n, 0.05, 0.0)),
        (
            "van der Pol, dt 0.2",
            van_der_pol(2.0),
            lambda n: series_for(van_der_pol(2.0), n, 0.2, 0.0),
        ),
        ("Lorenz, dt 0.01", lorenz(), lambda n: series_for(lorenz(), n, 0.01, 0.0)),
        ("logistic map", logistic(), lambda n: series_for(logistic(), n, 1.0, 0.0)),
        ("unstable, factor 1.5", unstable(1.5), lambda n: series_for(unstable(1.5), n, 1.0, 1.0)),
        ("one time in a call", one_time(), lambda n: series_for(one_time(), n, 0.1, 1.0)),
    ]


def free_runs() -> list[str]:
    lines = [
        "| model | rows | loop, ms | whole, ms | times faster | rows found as a whole | difference |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, model, record in cases():
        for n in SIZES:
            series = record(n)
            theta = model.record(model.theta())
            x1 = np.array(FIRST.get(model.name, first_state(model, model.theta())[0]))

            def work(
                model: Any = model, series: Any = series, theta: Any = theta, x1: Any = x1
            ) -> Any:
                na = model.na
                _, a, z = propagate(model, theta, series, x1[None, :na], x1[None, na:])
                return np.concatenate((a[:, 0], z[:, 0]), axis=1)

            loop_ms, whole_ms, ratio, loop, whole = paired(work, REPEATS[n])
            found = len(whole_record.whole_record(model, theta, series, x1))
            with np.errstate(all="ignore"):
                moved = np.abs(loop - loop[0]).max(axis=0)
                off = np.where(loop == whole, 0.0, np.abs(loop - whole)) / moved
                apart = f"{np.nanmax(np.where(loop == whole, 0.0, off)):.0e}"
            if not np.isfinite(loop).all():
                apart = "runs away"
            lines.append(
                f"| {name} | {len(series)} | {loop_ms:.2f} | {whole_ms:.2f} | {ratio:.2f} | {found} | {apart} |"
            )
            print(lines[-1], flush=True)
    return lines


def first_runs() -> list[str]:
    """A model object that was never called: its functions are tested too."""
    lines = [
        "| model | rows | loop, ms | as a whole, ms | times faster |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, model, record in cases()[:6]:
        series = record(1000)

        def work(model: Any = model, series: Any = series) -> Any:
            return engine.free_run(replace(model), None, series)

        loop_ms, whole_ms, ratio, *_ = paired(work, REPEATS[1000])
        lines.append(f"| {name} | 1000 | {loop_ms:.2f} | {whole_ms:.2f} | {ratio:.1f} |")
        print(lines[-1], flush=True)
    return lines


def derivatives() -> list[str]:
    lines = [
        "| model | rows | columns | differences of runs, ms | at once, ms | times faster |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, model, record in cases()[:6]:
        series = record(1000)
        series = series.replace(y=np.random.default_rng(0).standard_normal(series.y.shape))
        theta = model.theta()
        asked = FreeRunProblem(model, [series], theta, np.arange(len(theta)))

        def work(asked: Any = asked) -> Any:
            asked._last, asked._ahead, asked.runs = None, None, [None]
            return asked.evaluate(asked.start())

        loop_ms, whole_ms, ratio, *_ = paired(work, 7)
        count = asked.start().size
        lines.append(f"| {name} | 1000 | {count} | {loop_ms:.1f} | {whole_ms:.1f} | {ratio:.1f} |")
        print(lines[-1], flush=True)
    return lines


def fits() -> list[str]:
    lines = [
        "| what | rows | loop, s | as a whole, s | times faster | parameters differ by |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    settings = {
        "tanks": (4.0, 5.0, {"sigma_level": 1e-3, "sigma_inflow": 0.0}, ["k1", "k3", "k4"]),
        "oscillator": (0.05, 1.0, {}, ["omega", "zeta", "gain"]),
        "structure": (0.02, 1.0, {}, None),
        "servo": (
            0.02,
            6.0,
            {"sigma_v": 1e-3, "sigma_load": 1e-3},
            ["M", "Fv", "Fc", "offset"],
        ),
    }
    rng = np.random.default_rng(0)
    for name, (dt, size, theta, free) in settings.items():
        model = engine.get_model(name)
        frame = (
            sine(model, 1500, dt, size) if name == "servo" else series_for(model, 1500, dt, size)
        )
        series = engine.simulate(model, theta, 1500, rng, u=frame.u, dt=dt).series

        def work(model: Any = model, series: Any = series, free: Any = free) -> Any:
            return engine.fit_simulation(model, series, free=free)

        loop_ms, whole_ms, ratio, loop, whole = paired(work, 3)
        values = np.asarray(loop.theta)
        apart = np.max(np.abs(np.asarray(whole.theta) - values) / np.maximum(np.abs(values), 1e-9))
        lines.append(
            f"| fit_simulation, {name} | 1500 | {1e-3 * loop_ms:.2f} | {1e-3 * whole_ms:.2f} | {ratio:.1f} "
            f"| {apart:.0e} |"
        )
        print(lines[-1], flush=True)
    for name, dt, size in (("oscillator", 0.2, 1.0), ("tanks", 16.0, 5.0)):
        model = engine.get_model(name)
        frame = series_for(model, 1500, dt, size)
        series = engine.simulate(model, None, 1500, rng, u=frame.u, dt=dt).series
        theta = np.asarray(model.theta())

        def sub(model: Any = model, series: Any = series, theta: Any = theta) -> Any:
            return choose(setting_for(model, series, theta), series, theta)

        loop_ms, whole_ms, ratio, loop, whole = paired(sub, 3)
        lines.append(
            f"| steps a sample of a diagnosis, {name} | 1500 | {1e-3 * loop_ms:.2f} | {1e-3 * whole_ms:.2f} "
            f"| {ratio:.1f} | {loop} and {whole} |"
        )
        print(lines[-1], flush=True)
    return lines


def beside_a_fit() -> list[str]:
    """What a round of the search makes beside a fit that has a hysteresis."""
    lines = [
        "| what | rows | before, s | now, s | times faster | largest difference |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    effects = ["hysteresis:velocity"]
    hidden, free = engine.get_model("oscillator", effects), ("omega", "zeta", "gain")
    size, width = (p.name for p in hidden.parameters[-2:])
    for kind, n, loop in ((", stiff", 1000, STIFF), ("", 1000, WEAK), ("", 4000, WEAK)):
        frame = series_for(hidden, n, 0.1, 1.0)
        told = {size: loop[0], width: loop[1], "sigma_v": 1e-3, "sigma_y": 1e-3}
        record = engine.simulate(
            hidden, told, n, np.random.default_rng(0), u=frame.u, dt=0.1
        ).series
        fit = fitted.fit_runs(
            hidden, [record], hidden.theta(told), (*free, size, width), np.zeros((1, hidden.nx))
        )
        beside = candidates(fit, setting_for(hidden, record, np.asarray(fit.theta)), None)

        def screened(fit: Any = fit, beside: Any = beside) -> Any:
            return columns.columns(fit, beside)

        was, now, ratio, one, other = paired(screened, 3, from_nothing)
        apart = max(
            np.linalg.norm(a.g - b.g) / np.linalg.norm(a.g) for a, b in zip(one, other, strict=True)
        )
        what = f"{len(one)} columns of {len(beside)} effects{kind}"
        lines.append(_seconds(what, n, was, now, ratio, apart))

        def judged(fit: Any = fit) -> Any:
            return losses(fit, folds_of(fit.records))

        was, now, ratio, one, other = paired(judged, 3, derivatives_anew)
        apart = float(np.nanmax(np.abs(one - other)))
        lines.append(_seconds(f"fits that leave a fold out{kind}", n, was, now, ratio, apart))
    return lines


def _seconds(what: str, n: int, was: float, now: float, ratio: float, apart: float) -> str:
    line = f"| {what} | {n} | {1e-3 * was:.2f} | {1e-3 * now:.2f} | {ratio:.1f} | {apart:.0e} |"
    print(line, flush=True)
    return line


def main() -> None:
    RESULTS.mkdir(exist_ok=True)
    with Watch() as watch:
        parts = {
            "Free runs": free_runs(),
            "The first run of a model, its functions tested": first_runs(),
            "Residuals and their derivatives by all parameters and uncertain first states": derivatives(),
            "What is made of free runs": fits(),
            "Beside a fit: runs begun from its own, derivatives kept while they foretell": beside_a_fit(),
        }
    figures = watch.figures()
    foreign, cores = figures["cores used by foreign processes"], figures["cores"]
    text = [
        "Free runs without noise found as a whole (Newton's method on the trajectory) beside the loop over",
        "time, in turn in one run (`make bench-free-run`). Processor time on one core, medians; other programs",
        f"used {foreign:.1f} of {cores:.0f} cores meanwhile. Ratios are medians of those of pairs. Models",
        "below the first unstable one are left to the loop: their ratio is what trying costs. Differences",
        "of the two trajectories as a share of what a state moves.",
        "",
    ]
    for title, lines in parts.items():
        text += [f"## {title}", "", *lines, ""]
    (RESULTS / "free-run.md").write_text("\n".join(text))


if __name__ == "__main__":
    main()
