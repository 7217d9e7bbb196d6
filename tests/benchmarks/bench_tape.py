"""Moment filters and free runs through tapes beside those by calls: ``python -m tests.benchmarks.bench_tape``.

Models of the package and one written as differential equations, as they are and with effects, one parameter
vector and eight side by side, each pair in turn in one run; filters of outliers, the way of one filter and free
runs; then whole diagnoses with and without tapes. Writes ``results/tape.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import engine
import engine.filters.sigma_point
import engine.filters.strata
import engine.simulation.simulate
from engine.diagnose import diagnose
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.filters.sigma_point import _path, moment_filter
from engine.simulation.simulate import propagate, simulate, states_of
from tests.benchmarks.bench_diagnose import series_of
from tests.benchmarks.bench_free_run import paired
from tests.benchmarks.machine import Watch
from tests.engine.filters.test_taped import pendulum

RESULTS = Path(__file__).parent / "results"
ROWS, REPEATS = 1000, 7
BY_TAPE = (
    (engine.filters.sigma_point, "filter_by_tape"),
    (engine.filters.strata, "tapes_of"),
    (engine.simulation.simulate, "run_by_tape"),
)
EFFECTS = {
    "mixed-4": ("", "drag:z1", "coulomb:z2->z3", "hysteresis:z1"),
    "oscillator": (
        "",
        "coulomb:velocity",
        "boucwen:velocity",
        "delay:drive",
        "parameter-step:omega",
    ),
    "pendulum": ("", "coulomb:rate", "boucwen:rate", "parameter-step:c"),
}


@contextmanager
def by_calls() -> Iterator[None]:
    """No filter and no free run goes through a tape."""
    own = [(module, name, getattr(module, name)) for module, name in BY_TAPE]
    for module, name in BY_TAPE:
        setattr(module, name, lambda *_: None)
    try:
        yield
    finally:
        for module, name, function in own:
            setattr(module, name, function)


def series_for(model: engine.MixedModel) -> engine.Series:
    """A simulated record, inputs that stay for a while."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal((ROWS // 20, len(model.inputs))), 20, axis=0)
    return simulate(model, None, ROWS, rng, u=u if model.inputs else None, dt=0.05).series


def filters() -> Iterator[str]:
    """A line of the table for each model and effect."""
    for name, effects in EFFECTS.items():
        model = pendulum() if name == "pendulum" else engine.get_model(name)
        series = series_for(model)
        setting = setting_for(model, series, np.asarray(model.theta()))
        for effect in effects:
            extended = make_effect(effect, setting).apply(model) if effect else model
            theta = np.asarray(extended.theta()).copy()
            n = len(model.parameters)
            theta[n:] = np.where(theta[n:] == 0.0, 0.01, theta[n:])
            for K in (1, 8):
                thetas = theta * (1.0 + 1e-6 * np.arange(K))[:, None]
                calls, tape, ratio, a, b = paired(
                    lambda m=extended, x=thetas, s=series: moment_filter(m, x, s).log_likelihood,
                    REPEATS,
                    by_calls,
                )
                apart = float(np.abs(a - b).max() / np.abs(a).max())
                yield (
                    f"| {name} | {effect or '-'} | {K} | {calls:.1f} | {tape:.2f} | {ratio:.1f} | {apart:.0e} |"
                )
                print(name, effect, K, f"{ratio:.1f}", flush=True)


def others(name: str) -> Iterator[str]:
    """Lines of a model: eight filters of outliers, the way of one filter, one free run and eight."""
    model = pendulum() if name == "pendulum" else engine.get_model(name)
    series = series_for(model)
    where, theta = next(iter(model.nonlinear)), np.asarray(model.theta())
    tails = engine.with_mixture(model, "dynamics", channels=[where])
    thetas = np.asarray(tails.theta()) * (1.0 + 1e-6 * np.arange(8))[:, None]
    x1 = np.full((8, model.nx), 0.1)
    first = x1[:, : model.na], x1[:, model.na :]
    one, eight = model.record(theta), model.records(np.tile(theta, (8, 1)))
    for what, work in (
        ("outliers, 8", lambda: moment_filter(tails, thetas, series).log_likelihood),
        ("way of one filter", lambda: _path(model, theta, series).filtered),
        ("free run", lambda: states_of(model, one, series, x1[0])),
        ("free runs, 8", lambda: np.dstack(propagate(model, eight, series, *first)[1:])),
    ):
        calls, tape, ratio, a, b = paired(work, REPEATS, by_calls)
        apart = float(np.abs(a - b).max() / np.abs(a).max())
        yield f"| {name} | {what} | {calls:.1f} | {tape:.2f} | {ratio:.1f} | {apart:.0e} |"
        print(name, what, f"{ratio:.1f}", flush=True)


def diagnoses() -> Iterator[str]:
    """A line for each whole diagnosis."""
    swing = pendulum()
    for name, model, series in (
        ("mixed-4, 1000 samples", engine.get_model("mixed-4"), series_of(ROWS)),
        ("pendulum, 1000 samples", swing, series_for(swing)),
    ):
        calls, tape, ratio, a, b = paired(
            lambda m=model, s=series: diagnose(m, s, seed=1, processes=1), 1, by_calls
        )
        same = a.verdict is b.verdict and [x.effect for x in a.causes] == [
            x.effect for x in b.causes
        ]
        yield f"| {name} | {calls / 1e3:.1f} | {tape / 1e3:.1f} | {ratio:.2f} | {'yes' if same else 'NO'} |"


def main() -> None:
    """Measure, and write the page."""
    with Watch() as watch:
        of_filters, of_others, of_diagnoses = (
            list(filters()),
            [line for name in EFFECTS for line in others(name)],
            list(diagnoses()),
        )
    figures = watch.figures()
    lines = [
        "# Moment filters and free runs through tapes",
        "",
        f"{ROWS} samples; processor time on one core, medians of {REPEATS} pairs in turn (`make bench-tape`);",
        "a diagnosis is one pair. *Apart*: the log-likelihoods, as a share. Other programs used "
        f"{figures['cores used by foreign processes']:.1f} of {figures['cores']:.0f} cores meanwhile.",
        "",
        "| model | effect | parameter vectors | calls, ms | tape, ms | times faster | apart |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *of_filters,
        "",
        "| model | what | calls, ms | tape, ms | times faster | apart |",
        "| --- | --- | --- | --- | --- | --- |",
        *of_others,
        "",
        "| diagnosis | calls, s | tape, s | times faster | the same names |",
        "| --- | --- | --- | --- | --- |",
        *of_diagnoses,
    ]
    (RESULTS / "tape.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
