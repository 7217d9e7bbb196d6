"""Standard errors against the spread of the estimates over the Monte Carlo runs, and what intervals cover."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.uncertainty import likelihood_intervals, standard_errors
from engine.models.registry import get_model
from tests.studies import em_arms as arms
from tests.studies.plots import axes, save
from tests.studies.problems import PROBLEMS
from tests.studies.realisation import realisation
from tests.studies.report import made_with, markdown
from tests.studies.statistics import mean, rate_interval, spread
from tests.studies.study import Arm, Row, Study, Table, Tables

CLOSE = 0.15  # of the spread, for the average standard error
COVERAGE = (0.90, 0.98)  # of 95 % intervals
QUARTILES = 1.349  # distance of the quartiles of a normal density, in standard deviations
CASES = (
    ("Table I, exact maximum, no EM", "table-I", "exact", "theta"),
    ("Table I, defaults, until settled", "table-I", "settled", "theta"),
    ("Table I, defaults, 100 iterations", "table-I", "default", "theta"),
    ("Fig. 1, defaults", "theta-2", "default", "theta_2"),
)
ABOUT_TABLE_I = (
    "**Table I.** A standard error belongs to the maximum of the likelihood. From the paper's start, "
    "0.3, EM is still on its way after the paper's 100 iterations in about half of the runs; the outcome "
    "of such a run says *iterations used up*, and the spread then holds the unfinished way too. Allowed "
    "to settle (n_iterations = 1000), it arrives at the exact maximum. Symmetric intervals, +- 1.96 "
    "standard errors, cover too little there too, and so they do with the exact likelihood and without "
    "EM: the likelihood is no parabola, and low estimates come with small standard errors. Intervals by "
    "the likelihood ratio (`engine.likelihood_intervals`; the service gives them by default) allow for "
    "that. They have been added to the runs that settle; runs stopped early get symmetric ones here.\n\n"
    "(theta, z) and (-theta, -z) differ by the prior of z_1 only. The exact maximum is searched by "
    "scoring steps, {mirrored} of whose {runs} runs stepped over zero to the mirror image, where EM, in "
    "small steps, does not go. *Not mirrored* are the runs with an estimate above {below:g}.\n"
)
MIRRORED = -0.02  # estimates of Table I below this are of the mirror image


def exact_row(seed: int, run: int) -> Row:
    """The exact maximum near the paper's start, with exact standard error and interval."""
    started = time.perf_counter()
    problem = PROBLEMS["table-I"]
    model = get_model(problem.model)
    series = realisation(model, seed, run).series
    # the moment filter is the Kalman filter on this model
    best = quasi_ml(model, series, problem.started(seed, run), problem.free)
    row: Row = {
        "theta.theta": best.theta["theta"],
        "log_likelihood": best.log_likelihood,
        "outcome": "CONVERGED" if best.converged else "ITERATIONS_USED_UP",
    }
    between = time.perf_counter()
    errors = standard_errors(model, best.theta, series, exact=True)
    row["se.theta"] = float(errors.values[0])
    row["se_seconds"] = time.perf_counter() - between
    between = time.perf_counter()
    found = likelihood_intervals(model, best.theta, series, errors=errors, exact=True)
    row["low.theta"], row["high.theta"] = found.values[0].tolist()
    row["interval_seconds"] = time.perf_counter() - between
    row["seconds"] = time.perf_counter() - started
    return row


EXACT_I = Arm("table-I.exact", exact_row, {"method": "quasi-ml", "start": "paper's"})


def case(table: Table, problem: str, parameter: str) -> list[str]:
    """One line of the report."""
    truth = _truth(problem, parameter)
    theta, se = table.numbers(f"theta.{parameter}"), table.numbers(f"se.{parameter}")
    there = np.isfinite(se)
    average, width = mean(se), spread(theta)
    ratio = average.value / width.value
    error = ratio * float(np.hypot(average.error / average.value, width.error / width.value))
    quartiles = np.quantile(theta[np.isfinite(theta)], [0.25, 0.75])
    half = float(norm.ppf(0.975)) * se
    low, high = table.numbers(f"low.{parameter}"), table.numbers(f"high.{parameter}")
    settled = sum(outcome == "CONVERGED" for outcome in table.texts("outcome"))
    return [
        parameter,
        f"{int(there.sum())} of {len(table)}",
        str(settled),
        f"{width.value:.4f} ± {width.error:.4f}",
        f"{np.ptp(quartiles) / QUARTILES:.4f}",
        f"{average.value:.4f} ± {average.error:.4f}",
        f"{ratio:.3f} ± {error:.3f}",
        "yes" if abs(ratio - 1.0) <= CLOSE else "no",
        *_coverage(theta - half, theta + half, truth),
        *_coverage(low, high, truth),
    ]


def _truth(problem: str, parameter: str) -> float:
    model = get_model(PROBLEMS[problem].model)
    return model.parameters[model.parameter_names.index(parameter)].default


def _coverage(low: NDArray[np.float64], high: NDArray[np.float64], truth: float) -> list[str]:
    """Cells: how often the truth is inside, and whether that is as often as it should be."""
    there = ~(np.isnan(low) | np.isnan(high))
    n = int(there.sum())
    if not n:
        return ["-", "-"]
    inside = int(((low <= truth) & (truth <= high))[there].sum())
    lower, upper = rate_interval(inside, n)
    fits = COVERAGE[0] <= inside / n <= COVERAGE[1]
    cell = f"{100 * inside / n:.1f} % ({100 * lower:.1f} - {100 * upper:.1f}) of {n}"
    return [cell, "yes" if fits else "no"]


def report(tables: Tables) -> str:
    """Average standard error, spread, coverage."""
    lines = [
        [label, *case(tables[f"{problem}.{arm}"], problem, parameter)]
        for label, problem, arm, parameter in CASES
    ]
    exact = tables["table-I.exact"]
    upright = exact.of_runs(exact.numbers("run")[exact.numbers("theta.theta") > MIRRORED])
    lines.insert(1, ["... not mirrored", *case(upright, "table-I", "theta")])
    about = ABOUT_TABLE_I.format(
        mirrored=len(exact) - len(upright), runs=len(exact), below=MIRRORED
    )
    within = f"within {100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %"
    head = [
        "problem",
        "parameter",
        "runs with standard errors",
        "settled",
        "spread of the estimates",
        "by quartiles",
        "average standard error",
        "quotient",
        f"within {100 * CLOSE:.0f} %",
        "symmetric 95 % intervals cover",
        within,
        "likelihood-ratio 95 % intervals cover",
        within,
    ]
    return "\n".join(
        [
            "Observed information by differences of the score at the estimate, against the spread of "
            "the estimates over the realisations (standard deviation ± its Monte Carlo standard error; "
            "beside it the distance of the quartiles as a standard deviation) and the coverage of the "
            "true value with its 95 % interval.\n",
            markdown(head, lines),
            about,
            made_with(tables),
        ]
    )


def plot(tables: Tables, path: Path) -> None:
    """Normalised errors against the normal quantiles."""
    figure, panels = axes(1, len(CASES), (4.0 * len(CASES), 3.8))
    for panel, (label, problem, arm, parameter) in zip(panels, CASES, strict=True):
        table = tables[f"{problem}.{arm}"]
        truth = _truth(problem, parameter)
        z = (table.numbers(f"theta.{parameter}") - truth) / table.numbers(f"se.{parameter}")
        z = np.sort(z[np.isfinite(z)])
        q = norm.ppf((np.arange(len(z)) + 0.5) / max(len(z), 1))
        panel.plot(q, z, ".")
        panel.plot([-3, 3], [-3, 3], color="0.5", linewidth=1)
        panel.set_xlabel("normal quantile")
        panel.set_title(label, fontsize=9)
    panels[0].set_ylabel("(estimate - truth) / standard error")
    save(figure, path)


STANDARD_ERRORS = Study(
    "standard-errors",
    "Standard errors against the Monte Carlo spread: Table I and Fig. 1",
    {EXACT_I: 400, arms.SETTLED_I: 200, arms.DEFAULT_I: 130, arms.DEFAULT_THETA_2: 200},
    report,
    plot,
)
