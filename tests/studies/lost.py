"""Lost runs: no estimate, or one far less likely than what EM finds from the true parameters."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.estimation.outcome import Outcome
from tests.studies import em_arms as arms
from tests.studies.plots import axes, save
from tests.studies.problems import PARTICLES, REPEATS
from tests.studies.report import made_with, markdown
from tests.studies.statistics import mean, rate_bound, rate_interval
from tests.studies.study import Study, Table, Tables

MARGIN = 5.0  # nats below EM from the true parameters
NO_ESTIMATE = {arms.FAILED} | {outcome.name for outcome in Outcome if not outcome.success}
RULE = (
    f"Lost: no estimate (the outcome says that the run failed), or a log-likelihood more than "
    f"{MARGIN:g} below that of the default estimation started at the true parameters on the same "
    f"data; log-likelihoods are the mean of {REPEATS} filters of {PARTICLES} particles, independent "
    "of the estimation. No run was removed by hand."
)


@dataclass(frozen=True)
class Judged:
    """Runs judged: the mask of lost ones, and the gap to the reference in log-likelihood (n,)."""

    runs: list[int]
    lost: NDArray[np.bool_]
    gap: NDArray[np.float64]
    outcomes: list[str]


def judge(table: Table, reference: Table) -> Judged:
    """Judge every run of a table that the reference has too."""
    best = dict(
        zip(reference.numbers("run").astype(int), reference.numbers("log_likelihood"), strict=True)
    )
    rows = [k for k, run in enumerate(table.numbers("run").astype(int)) if run in best]
    runs = [int(table.rows[k]["run"]) for k in rows]
    outcomes = [table.texts("outcome")[k] for k in rows]
    value = table.numbers("log_likelihood")[rows]
    with np.errstate(invalid="ignore"):
        gap = value - np.array([best[run] for run in runs])
    bad = np.array([outcome in NO_ESTIMATE for outcome in outcomes], dtype=bool)
    return Judged(runs, bad | ~(gap >= -MARGIN), gap, outcomes)


def not_lost(table: Table, reference: Table) -> Table:
    """The rows of a table whose runs are not lost."""
    judged = judge(table, reference)
    return table.of_runs(
        run for run, lost in zip(judged.runs, judged.lost, strict=True) if not lost
    )


def summary(cases: list[tuple[str, Table, Table]]) -> str:
    """One line per (label, table, reference): how many were lost, with bounds, and how."""
    lines = []
    for label, table, reference in cases:
        judged = judge(table, reference)
        n, k = len(judged.runs), int(judged.lost.sum())
        low, high = rate_interval(k, n)
        outcomes = Counter(judged.outcomes)
        without = sum(outcomes[name] for name in NO_ESTIMATE)
        lines.append(
            [
                label,
                f"{k} of {n}",
                f"{100 * rate_bound(k, n):.1f} %",
                f"{100 * low:.1f} - {100 * high:.1f} %",
                f"{without} no estimate, {k - int(_reported(judged))} with an outcome of success",
                ", ".join(f"{count} {name.lower()}" for name, count in outcomes.most_common()),
                f"{np.nanmin(judged.gap):.1f}" if np.isfinite(judged.gap).any() else "-",
                f"{mean(table.numbers('iterations')).value:.0f}",
                f"{mean(table.numbers('seconds')).value:.1f}",
            ]
        )
    head = [
        "settings",
        "lost",
        "95 % upper bound",
        "95 % interval",
        "how",
        "outcomes",
        "largest gap (nats)",
        "iterations",
        "seconds per run",
    ]
    return markdown(head, lines)


def _reported(judged: Judged) -> int:
    flagged = np.array([outcome in NO_ESTIMATE for outcome in judged.outcomes], dtype=bool)
    return int((judged.lost & flagged).sum())


def details(table: Table, reference: Table, parameters: tuple[str, ...]) -> str:
    """One line per lost run: start, estimate, outcome and gap."""
    judged = judge(table, reference)
    by_run = {int(row["run"]): row for row in table.rows}
    lines = []
    for run, gap, lost in zip(judged.runs, judged.gap, judged.lost, strict=True):
        if not lost:
            continue
        row = by_run[run]
        cells = [_vector(row, kind, parameters) for kind in ("start", "theta")]
        lines.append([str(run), *cells, str(row["outcome"]).lower(), f"{gap:.1f}"])
    if not lines:
        return "None was lost.\n"
    return markdown(["run", "start", "estimate", "outcome", "gap (nats)"], lines)


def _vector(row: dict[str, float | str], kind: str, parameters: tuple[str, ...]) -> str:
    return ", ".join(f"{float(row[f'{kind}.{name}']):.3f}" for name in parameters)


THETA_2 = ("theta_2",)
ALL_FIVE = tuple(f"theta_{k}" for k in range(1, 6))


def report(tables: Tables) -> str:
    """Both problems, default and paper's settings."""
    cases = [
        ("theta_2, default settings", "theta-2.default", "theta-2.truth", THETA_2),
        ("theta_2, paper's settings", "theta-2.rbps-em", "theta-2.truth", THETA_2),
        ("all five, default settings", "all-five.default", "all-five.truth", ALL_FIVE),
        ("all five, paper's settings", "all-five.rbps-em", "all-five.truth", ALL_FIVE),
    ]
    text = [RULE + "\n", summary([(c[0], tables[c[1]], tables[c[2]]) for c in cases])]
    for label, name, reference, parameters in cases:
        text.append(f"## Lost: {label}\n\n" + details(tables[name], tables[reference], parameters))
    text.append(made_with(tables))
    return "\n".join(text)


def plot(tables: Tables, path: Path) -> None:
    """Gap in log-likelihood of every run."""
    figure, panels = axes(1, 2, (9.0, 3.6))
    for panel, problem in zip(panels, ("theta-2", "all-five"), strict=True):
        for label, color in (("rbps-em", "C1"), ("default", "C0")):
            judged = judge(tables[f"{problem}.{label}"], tables[f"{problem}.truth"])
            gap = np.sort(np.nan_to_num(judged.gap, nan=-np.inf, neginf=-np.inf))
            name = "paper's settings" if label == "rbps-em" else "default settings"
            panel.plot(np.arange(len(gap)), np.maximum(gap, -1e4), ".-", color=color, label=name)
        panel.axhline(-MARGIN, color="0.5", linestyle="--", linewidth=1)
        panel.set_yscale("symlog", linthresh=10.0)
        panel.set_xlabel("run, sorted")
        panel.set_title({"theta-2": "theta_2 only", "all-five": "all five"}[problem])
    panels[0].set_ylabel("log-likelihood minus reference")
    panels[0].legend(frameon=False)
    save(figure, path)


LOST_RUNS = Study(
    "lost-runs",
    "Lost runs: the problems of the paper's Fig. 1 and Table II",
    {
        arms.DEFAULT_THETA_2: 200,
        arms.TRUTH_THETA_2: 200,
        arms.RBPS_THETA_2: 130,
        arms.DEFAULT_ALL_FIVE: 100,
        arms.TRUTH_ALL_FIVE: 100,
        arms.RBPS_ALL_FIVE: 70,
    },
    report,
    plot,
)


def report_small(tables: Tables) -> str:
    """Fig. 1 in small: default settings only."""
    table, reference = tables["theta-2.default"], tables["theta-2.truth"]
    estimates = table.numbers("theta.theta_2")
    text = [
        f"theta_2 of paper, eq. (35), from starts in U[0, 2]: {len(table)} realisations with the "
        "engine's default settings.\n",
        f"Mean ± standard deviation of the estimate: **{estimates.mean():.3f} ± "
        f"{estimates.std(ddof=1):.3f}** (paper, Fig. 1: 0.991 ± 0.059).\n",
        RULE + "\n",
        summary([("default settings", table, reference)]),
        details(table, reference, THETA_2),
        made_with(tables),
    ]
    return "\n".join(text)


def plot_small(tables: Tables, path: Path) -> None:
    """Start and estimate of every run."""
    table = tables["theta-2.default"]
    figure, (panel,) = axes(1, 1, (5.0, 3.6))
    panel.plot(table.numbers("start.theta_2"), table.numbers("theta.theta_2"), "o", markersize=4)
    panel.axhline(1.0, color="0.5", linewidth=1)
    panel.set_xlabel("start of theta_2")
    panel.set_ylabel("estimate of theta_2")
    save(figure, path)


FIGURE_1_SMALL = Study(
    "figure-1-small",
    "Paper, Fig. 1 in small: theta_2 of eq. (35), default settings",
    {arms.DEFAULT_THETA_2: 40, arms.TRUTH_THETA_2: 40},
    report_small,
    plot_small,
)
