"""False alarms of the free run's criterion: series without any hidden effect, asked of it alone.

Models with integrators, drifting loads and sensors that are nearly free of noise, which run away from their
own simulation by their process noise. The likelihood is not asked; the alarm is at the level that a diagnosis
gives the free run where the likelihood settles nothing.
"""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path

import numpy as np

from engine.diagnose.free_run.answer import search_free_runs
from engine.diagnose.free_run.windows import windows
from engine.diagnose.search.pipeline import fit_base
from engine.errors import EngineError
from engine.models.registry import get_model
from engine.simulation.simulate import simulate
from engine.statespace.model import Array
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.statistics import wilson
from tests.studies.study import Arm, Row, Study, Tables

ALPHA = 0.05
RUNS = 50
SAMPLES = 500

# name -> (model, seconds between samples, parameters other than the defaults, held ones)
CLEAN: dict[str, tuple[str, float, dict[str, float], tuple[str, ...]]] = {
    "servo": ("servo", 0.01, {}, ("gtau",)),
    "servo, quiet": ("servo", 0.01, {"sigma_v": 5e-4, "sigma_load": 0.01}, ("gtau",)),
    "oscillator": ("oscillator", 0.1, {}, ()),
    "oscillator, quiet": ("oscillator", 0.1, {"sigma_v": 1e-3, "sigma_y": 2e-4}, ()),
    "tanks": ("tanks", 4.0, {}, ()),
    "mixed-4": ("mixed-4", 1.0, {}, ()),
}


def inputs(name: str, rng: np.random.Generator, nu: int) -> Array | None:
    """Levels that change every 20 samples; a pump's are positive."""
    if not nu:
        return None
    levels = np.repeat(rng.standard_normal((SAMPLES // 20 + 1, nu)), 20, axis=0)[:SAMPLES]
    return 3.0 + 0.8 * levels if name == "tanks" else levels


def work(case: str, seed: int, run: int) -> Row:
    """One clean series: the alarm, and what was named if there was one."""
    name, dt, values, held = CLEAN[case]
    model = get_model(name)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, *case.encode())))
    theta = model.theta(values)
    series = simulate(model, theta, SAMPLES, rng, u=inputs(name, rng, model.nu), dt=dt).series
    free = [p for p in model.parameter_names if p not in held]
    began = time.perf_counter()
    row: Row = {"verdict": "", "p_value": "", "names": "", "gain": "", "error": ""}
    try:
        base = fit_base(model, series, theta, free)
        found = search_free_runs(
            base,
            windows([series]),
            theta,
            levels=(ALPHA, ALPHA / 5.0),
            kinds=None,
            seed=run,
            progress=lambda stage, fraction: None,
        )
    except EngineError as error:
        return row | {"error": str(error), "seconds": time.perf_counter() - began}
    first = found.rounds[0].alarm
    return row | {
        "verdict": found.verdict.value,
        "p_value": first.p_value,
        "p_gain": first.p_gain,
        "p_size": first.p_size,
        "p_near": first.p_near,
        "names": json.dumps([c.names for c in found.found]),
        "gain": first.gain,
        "seconds": time.perf_counter() - began,
    }


def report(tables: Tables) -> str:
    """False alarms by model and in all."""
    rows, alarms, named, n = [], 0, 0, 0
    for case in CLEAN:
        table = tables[arm_name(case)]
        own = [v != "nothing" for v in table.texts("verdict")]
        names = [text not in ("[]", "") for text in table.texts("names")]
        seconds = float(np.nanmean(table.numbers("seconds")))
        rows.append(_line(case, len(own), sum(own), sum(names), f"{seconds:.1f}"))
        alarms, named, n = alarms + sum(own), named + sum(names), n + len(own)
    rows.append(_line("all", n, alarms, named, ""))
    head = ("model", "series", "alarms", "95 %", "with a name", "s each")
    return (
        "# Clean series asked of the free run alone\n\n"
        f"Simulated from shipped models, {SAMPLES} samples, all parameters estimated again, alarm at "
        f"{100 * ALPHA:.0f} %. A diagnosis asks at a fifth of that where the likelihood sees nothing. An "
        "error counts as an alarm. Seeds 0 to 2 were looked at while the rule for errors too small for their "
        "noise was made.\n\n" + markdown(head, rows) + made_with(tables)
    )


def _line(case: str, n: int, alarms: int, named: int, seconds: str) -> list[str]:
    low, high = (f"{100.0 * x:.0f}" for x in wilson(alarms, n))
    return [case, str(n), str(alarms), f"{low} - {high} %", str(named), seconds]


def plot(tables: Tables, path: Path) -> None:
    """The p-values of clean series: evenly spread where the alarm keeps its level."""
    figure, (ax,) = axes(1, 1, (6.0, 4.0))
    values = np.sort(np.concatenate([table.numbers("p_value") for table in tables.values()]))
    ax.plot(values, (np.arange(len(values)) + 1) / len(values))
    ax.plot([0, 1], [0, 1], linewidth=0.8)
    ax.set_xlabel("p-value of the alarm")
    ax.set_ylabel("share of clean series")
    save(figure, path)


def arm_name(case: str) -> str:
    """Of the CSV file."""
    return "free-run-clean." + case.replace(", ", "-")


FREE_RUN_CLEAN = Study(
    "free-run-clean",
    "False alarms of the free run's criterion",
    {
        Arm(arm_name(case), partial(work, case), {"samples": SAMPLES, "alpha": ALPHA}): RUNS
        for case in CLEAN
    },
    report,
    plot,
)
