"""Standard errors against the spread of the estimates over the Monte Carlo runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import chi2, norm

from engine.kalman import kalman_smoother
from engine.registry import get_model
from engine.studies import em_arms as arms
from engine.studies.plots import axes, save
from engine.studies.problems import PROBLEMS
from engine.studies.realisation import realisation
from engine.studies.report import made_with, markdown
from engine.studies.statistics import mean, rate_interval, spread
from engine.studies.study import Study, Table, Tables

CLOSE = 0.15  # of the spread, for the average standard error
COVERAGE = (0.90, 0.98)  # of 95 % intervals
CASES = (
    ("Table I, started at 0.3", "table-I", "default", "theta"),
    ("Table I, started at 0.1", "table-I", "truth", "theta"),
    ("Fig. 1", "theta-2", "default", "theta_2"),
)
ABOUT_TABLE_I = (
    "**Table I.** A standard error belongs to the maximum of the likelihood. From the paper's start, "
    "0.3, EM is still on its way after 100 iterations where theta is small, which adds to the spread; "
    "from 0.1 it has arrived. The intervals of Table I cover less than 95 % for a reason that is not "
    "numerical: the information grows as theta falls, so low estimates come with small standard errors. "
)


def case(table: Table, problem: str, parameter: str) -> list[str]:
    """One line of the report."""
    model = get_model(PROBLEMS[problem].model)
    truth = model.parameters[model.parameter_names.index(parameter)].default
    theta, se = table.numbers(f"theta.{parameter}"), table.numbers(f"se.{parameter}")
    there = np.isfinite(se)
    average, width = mean(se), spread(theta)
    ratio = average.value / width.value
    error = ratio * float(np.hypot(average.error / average.value, width.error / width.value))
    inside = np.abs(theta - truth)[there] <= float(norm.ppf(0.975)) * se[there]
    covered, n = int(inside.sum()), int(there.sum())
    low, high = rate_interval(covered, n)
    close = abs(ratio - 1.0) <= CLOSE
    rate = covered / n
    fits = COVERAGE[0] <= rate <= COVERAGE[1]
    return [
        parameter,
        f"{n} of {len(table)}",
        f"{width.value:.4f} ± {width.error:.4f}",
        f"{average.value:.4f} ± {average.error:.4f}",
        f"{ratio:.3f} ± {error:.3f}",
        "yes" if close else "no",
        f"{100 * rate:.1f} % ({100 * low:.1f} - {100 * high:.1f})",
        "yes" if fits else "no",
        f"{mean(table.numbers('se_seconds')).value:.1f}",
    ]


def report(tables: Tables) -> str:
    """Average standard error, spread, coverage."""
    lines = [
        [label, *case(tables[f"{problem}.{arm}"], problem, parameter)]
        for label, problem, arm, parameter in CASES
    ]
    head = [
        "problem",
        "parameter",
        "runs with standard errors",
        "spread of the estimates",
        "average standard error",
        "quotient",
        f"within {100 * CLOSE:.0f} %",
        "95 % intervals cover",
        f"within {100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %",
        "seconds",
    ]
    inside, n = likelihood_ratio_coverage(tables["table-I.truth"])
    low, high = rate_interval(inside, n)
    return "\n".join(
        [
            "Observed information by differences of the score at the default estimate, against the "
            "spread of the estimates over the realisations and the coverage of the true value.\n",
            markdown(head, lines),
            ABOUT_TABLE_I + "Intervals by the likelihood ratio (exact, by the Kalman filter) cover "
            f"{100 * inside / n:.1f} % ({100 * low:.1f} - {100 * high:.1f}) on the same estimates.\n",
            made_with(tables),
        ]
    )


def likelihood_ratio_coverage(table: Table) -> tuple[int, int]:
    """Runs of Table I whose 95 % likelihood-ratio interval holds the truth, and all runs."""
    model, seed = get_model("linear-2"), int(table.settings["seed"])
    inside = 0
    for run, value in zip(
        table.numbers("run").astype(int), table.numbers("log_likelihood"), strict=True
    ):
        series = realisation(model, seed, int(run)).series
        at_truth = kalman_smoother(model, None, series).log_likelihood
        inside += bool(2.0 * (value - at_truth) <= float(chi2.ppf(0.95, 1)))
    return inside, len(table)


def plot(tables: Tables, path: Path) -> None:
    """Normalised errors against the normal quantiles."""
    figure, panels = axes(1, len(CASES), (4.0 * len(CASES), 3.8))
    for panel, (label, problem, arm, parameter) in zip(panels, CASES, strict=True):
        table = tables[f"{problem}.{arm}"]
        model = get_model(PROBLEMS[problem].model)
        truth = model.parameters[model.parameter_names.index(parameter)].default
        z = (table.numbers(f"theta.{parameter}") - truth) / table.numbers(f"se.{parameter}")
        z = np.sort(z[np.isfinite(z)])
        q = norm.ppf((np.arange(len(z)) + 0.5) / max(len(z), 1))
        panel.plot(q, z, ".")
        panel.plot([-3, 3], [-3, 3], color="0.5", linewidth=1)
        panel.set_xlabel("normal quantile")
        panel.set_title(label)
    panels[0].set_ylabel("(estimate - truth) / standard error")
    save(figure, path)


STANDARD_ERRORS = Study(
    "standard-errors",
    "Standard errors against the Monte Carlo spread: Table I and Fig. 1",
    {arms.DEFAULT_I: 130, arms.TRUTH_I: 130, arms.DEFAULT_THETA_2: 130},
    report,
    plot,
)
