"""Standard errors against the spread of the estimates over the Monte Carlo runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import norm

from engine.registry import get_model
from engine.studies import em_arms as arms
from engine.studies.lost import not_lost
from engine.studies.plots import axes, save
from engine.studies.problems import PROBLEMS
from engine.studies.report import made_with, markdown
from engine.studies.statistics import mean, rate_interval, spread
from engine.studies.study import Study, Table, Tables

CLOSE = 0.15  # of the spread, for the average standard error
COVERAGE = (0.90, 0.98)  # of 95 % intervals
CASES = (("Table I", "table-I", "theta", None), ("Fig. 1", "theta-2", "theta_2", "theta-2.truth"))


def _case(table: Table, problem: str, parameter: str) -> tuple[list[str], Table]:
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
    ], table


def report(tables: Tables) -> str:
    """Average standard error, spread, coverage."""
    lines = []
    for label, problem, parameter, reference in CASES:
        table = tables[f"{problem}.default"]
        lines.append([label, "all", *_case(table, problem, parameter)[0]])
        if reference is not None:
            kept = not_lost(table, tables[reference])
            if len(kept) < len(table):
                lines.append([label, "not lost", *_case(kept, problem, parameter)[0]])
    head = [
        "problem",
        "runs",
        "parameter",
        "with standard errors",
        "spread of the estimates",
        "average standard error",
        "quotient",
        f"within {100 * CLOSE:.0f} %",
        "95 % intervals cover",
        f"within {100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %",
        "seconds",
    ]
    return "\n".join(
        [
            "Observed information by differences of the score at the default estimate, against the "
            "spread of the estimates over the realisations and the coverage of the true value.\n",
            markdown(head, lines),
            made_with(tables),
        ]
    )


def plot(tables: Tables, path: Path) -> None:
    """Normalised errors against the normal quantiles."""
    figure, panels = axes(1, 2, (8.0, 3.8))
    for panel, (label, problem, parameter, _) in zip(panels, CASES, strict=True):
        table = tables[f"{problem}.default"]
        model = get_model(PROBLEMS[problem].model)
        truth = model.parameters[model.parameter_names.index(parameter)].default
        z = (table.numbers(f"theta.{parameter}") - truth) / table.numbers(f"se.{parameter}")
        z = np.sort(z[np.isfinite(z)])
        q = norm.ppf((np.arange(len(z)) + 0.5) / max(len(z), 1))
        panel.plot(q, z, ".")
        panel.plot([-3, 3], [-3, 3], color="0.5", linewidth=1)
        panel.set_xlabel("normal quantile")
        panel.set_title(f"{label}: {parameter}")
    panels[0].set_ylabel("(estimate - truth) / standard error")
    save(figure, path)


STANDARD_ERRORS = Study(
    "standard-errors",
    "Standard errors against the Monte Carlo spread: Table I and Fig. 1",
    {arms.DEFAULT_I: 130, arms.DEFAULT_THETA_2: 130, arms.TRUTH_THETA_2: 130},
    report,
    plot,
)
