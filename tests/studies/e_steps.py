"""How many E steps maximum likelihood takes: the quasi-Newton method and EM on Table II's data sets.

Data sets and starts are those of Table II, each with three seeds of the method's random numbers. An E step is
counted wherever it was made: at points that were given up, and at both starts where there are two.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from engine.estimation.em import rbps_em
from engine.estimation.outcome import Outcome
from engine.statespace.model import Array
from tests.studies import em_arms as arms
from tests.studies.estimates import COLUMNS, HOW, rows
from tests.studies.lost import MARGIN
from tests.studies.plots import axes, save
from tests.studies.problems import PARTICLES, PROBLEMS, REPEATS, log_likelihood, model_named
from tests.studies.realisation import METHOD, realisation, stream
from tests.studies.report import made_with, markdown
from tests.studies.statistics import wilson
from tests.studies.study import Arm, Row, Study, Table, Tables

DATA_SETS, SEEDS = 70, 3
E_STEPS = 25
NEAR = 1.0  # nats below the maximum
PROBLEM = PROBLEMS["all-five"]
MANY: dict[str, Any] = {
    "n_particles": 500,
    "n_trajectories": 100,
    "n_iterations": 60,
    "tolerance": 3e-4,
}


def judged(method: str, warm_start: bool, iterations: int, seeds: int, seed: int, run: int) -> Row:
    """One estimation of data set ``run // seeds``, judged by a filter of many particles."""
    data_set, draw = divmod(run, seeds)
    model = model_named(PROBLEM.model)
    series = realisation(model, seed, data_set).series
    start = dict(PROBLEM.started(seed, data_set))
    random = stream(seed, data_set, METHOD).generate_state(SEEDS)[draw]
    began = time.perf_counter()
    found = rbps_em(
        model, series, start, PROBLEM.free, n_iterations=iterations, seed=int(random),
        warm_start=warm_start, method=method,
    )  # fmt: skip
    seconds = time.perf_counter() - began
    value, error = log_likelihood(PROBLEM.model, found.theta, series, seed, data_set)
    row: Row = {"data_set": str(data_set), "outcome": found.outcome.name}
    row |= {"e_steps": len(found.log_likelihood) + warm_start, "seconds": seconds}
    row |= {"log_likelihood": value, "log_likelihood_se": error}
    return row | {f"theta.{name}": found.theta[name] for name in PROBLEM.free}


def maximum(seed: int, run: int) -> Row:
    """Where many particles end that start at the true parameters."""
    model = model_named(PROBLEM.model)
    series = realisation(model, seed, run).series
    found = rbps_em(model, series, None, PROBLEM.free, seed=run, warm_start=False, **MANY)
    value, error = log_likelihood(PROBLEM.model, found.theta, series, seed, run)
    row: Row = {"data_set": str(run), "outcome": found.outcome.name}
    row |= {"log_likelihood": value, "log_likelihood_se": error}
    return row | {f"theta.{name}": found.theta[name] for name in PROBLEM.free}


def judged_arm(label: str, method: str, warm_start: bool, iterations: int, seeds: int) -> Arm:
    """An arm of :func:`judged`."""
    settings = {"method": method, "warm_start": warm_start, "n_iterations": iterations}
    settings |= {"seeds": seeds, "n_particles": 50}
    return Arm(f"e-steps.{label}", partial(judged, method, warm_start, iterations, seeds), settings)


LIMITED = {
    "moment filter's start, quasi-Newton": judged_arm(
        "warm", "quasi-newton", True, E_STEPS - 1, SEEDS
    ),
    "paper's start, quasi-Newton": judged_arm("cold", "quasi-newton", False, E_STEPS, 1),
    "paper's start, EM": judged_arm("cold-em", "em", False, E_STEPS, 1),
    "moment filter's start, EM": judged_arm("warm-em", "em", True, E_STEPS - 1, 1),
}
MAXIMUM = Arm("e-steps.maximum", maximum, {**MANY, "start": "truth"})
BESIDE = {
    "table-I": (arms.RBPS_I, arms.em_arm("table-I", "quasi-newton", "newton")),
    "theta-2": (arms.RBPS_THETA_2, arms.em_arm("theta-2", "quasi-newton", "newton")),
}


def losses(table: Table, tables: Tables) -> Array:
    """Log-likelihood (n,) below the maximum of the data set: the highest that any arm has reached."""
    best = dict.fromkeys(range(DATA_SETS), -np.inf)
    for arm in (MAXIMUM, *LIMITED.values()):
        one = tables[arm.name]
        sets = one.numbers("data_set").astype(int)
        for k, value in zip(sets, one.numbers("log_likelihood"), strict=True):
            best[k] = max(best[k], value)
    highest = np.array([best[k] for k in table.numbers("data_set").astype(int)])
    return np.asarray(highest - table.numbers("log_likelihood"))


def report(tables: Tables) -> str:
    """Losses and E steps of every arm, and the default method beside the tables of the paper."""
    lines = [_line(label, tables, arm.name, str(E_STEPS)) for label, arm in LIMITED.items()]
    lines.insert(
        0,
        _line(
            f"truth, {MANY['n_particles']} particles",
            tables,
            MAXIMUM.name,
            str(MANY["n_iterations"]),
        ),
    )
    head = ["start, method", "E steps at most", "runs", f"within {NEAR:g} nat", "95 %"]
    head += ["lost", "settled", "settled, more than 1 nat away", "loss: median, 95 %, worst"]
    head += ["E steps: median, most", "s per run"]
    beside: list[list[str]] = []
    for problem, name, reported, unit in (
        ("table-I", "theta", ("9.77", "3.47"), 100.0),
        ("theta-2", "theta_2", ("0.991", "0.059"), 1.0),
    ):
        paper, newton = (tables[arm.name] for arm in BESIDE[problem])
        if not len(newton):
            continue
        decimals = 2 if unit > 1.0 else 3
        label = f"{problem} {name}"
        beside += rows(f"{label}: paper's EM", paper, name, reported, 130, unit, decimals)
        kinds = (("estimate", "theta"),)
        beside += rows(f"{label}: default", newton, name, reported, 130, unit, decimals, kinds)
    return "\n".join(
        [
            "# E steps until the maximum of the likelihood\n",
            f"All five parameters of eq. (35) on the {DATA_SETS} data sets of Table II from the paper's "
            f"starts, {SEEDS} seeds each of the default settings and one of the others, 50 particles and "
            "trajectories. "
            "*Loss* is the log-likelihood below the maximum, the highest of all estimations of the data set, "
            f"among them one with {MANY['n_particles']} particles from the truth; each is the mean of "
            f"{REPEATS} filters of {PARTICLES} particles (standard error {_error(tables):.2f}). "
            f"Lost: more than {MARGIN:g} below. The moment filter's start costs time, which is counted, and "
            "an E step at both starts.\n",
            markdown(head, lines),
            *(_beside(beside, _other_side(tables)) if beside else ()),
            made_with(tables),
        ]
    )


def _beside(lines: list[list[str]], said: str) -> list[str]:
    title = "## Tables of the paper by the default method\n"
    return [title, HOW, markdown(COLUMNS, lines), said]


def _other_side(tables: Tables) -> str:
    """How often the default method leaves the maximum that the paper's EM climbs to in Table I."""
    _, newton = (tables[arm.name] for arm in BESIDE["table-I"])
    if not len(newton):
        return ""
    left = int((newton.numbers("theta.theta") < 0.0).sum())
    return (
        "The likelihood of Table I's theta has a maximum on either side of zero. The paper's EM climbs to the "
        f"one above its start, 0.3; the default method takes the other, in {left} of {len(newton)} runs, where "
        "particles find it clearly likelier, and the start's where they cannot tell. That is why its rows "
        "differ.\n"
    )


def _error(tables: Tables) -> float:
    errors = [tables[arm.name].numbers("log_likelihood_se") for arm in LIMITED.values()]
    return float(np.nanmean(np.concatenate(errors)))


def _line(label: str, tables: Tables, name: str, most: str) -> list[str]:
    table = tables[name]
    loss = losses(table, tables)
    n, near = len(loss), loss <= NEAR
    low, high = wilson(int(near.sum()), n)
    settled = np.array([text == Outcome.CONVERGED.name for text in table.texts("outcome")], bool)
    steps = table.numbers("e_steps") if name != MAXIMUM.name else np.full(n, np.nan)
    seconds = table.numbers("seconds") if name != MAXIMUM.name else steps
    worst = np.quantile(loss, [0.5, 0.95, 1.0]) if n else np.full(3, np.nan)
    return [
        label,
        most,
        str(n),
        f"{int(near.sum())}",
        f"{100 * low:.0f} - {100 * high:.0f} %",
        str(int((~(loss <= MARGIN)).sum())),
        str(int(settled.sum())),
        str(int((settled & ~near).sum())),
        ", ".join(f"{value:.2f}" for value in worst),
        f"{np.median(steps):.0f}, {steps.max():.0f}" if np.isfinite(steps).any() else "-",
        f"{np.mean(seconds):.2f}" if np.isfinite(seconds).any() else "-",
    ]


def plot(tables: Tables, path: Path) -> None:
    """Sorted losses of the arms that may make E_STEPS."""
    figure, (panel,) = axes(1, 1, (6.0, 4.0))
    for label, arm in LIMITED.items():
        loss = np.sort(losses(tables[arm.name], tables))
        panel.plot(np.linspace(0.0, 100.0, len(loss)), loss, label=label)
    panel.axhline(NEAR, color="0.5", linestyle="--", linewidth=1)
    panel.set_yscale("symlog", linthresh=1.0)
    panel.set_xlabel("% of the runs")
    panel.set_ylabel(f"nats below the maximum after {E_STEPS} E steps at most")
    panel.legend(frameon=False)
    save(figure, path)


STUDY = Study(
    "e-steps",
    "E steps until the maximum: the quasi-Newton method beside EM, Table II's data",
    {
        MAXIMUM: DATA_SETS,
        **{arm: DATA_SETS * int(arm.settings["seeds"]) for arm in LIMITED.values()},
        **{arm: 130 for pair in BESIDE.values() for arm in pair},
    },
    report,
    plot,
)
