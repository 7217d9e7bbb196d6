"""Arms that estimate: a problem, a method and its settings."""

from __future__ import annotations

import contextlib
import inspect
import time
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError, NotSettledWarning
from engine.estimation.em import EmResult, rbps_em, rts_em
from engine.estimation.ps_em import ps_em
from engine.estimation.uncertainty import likelihood_intervals, standard_errors
from engine.statespace.model import Array
from tests.studies.guarded_em import guarded_ps_em
from tests.studies.problems import PROBLEMS, Problem, log_likelihood, model_named
from tests.studies.realisation import METHOD, realisation, stream
from tests.studies.study import Arm, Row
from tests.studies.varied_em import varied_em

POINTS = 100  # iterates kept of a trace, evenly spaced
AVERAGED = 0.2  # share of the iterations, the last ones, over which the iterates are averaged
FAILED = "no estimate"
FAILURES = (ModelError, ArithmeticError, np.linalg.LinAlgError, ValueError)

METHODS: dict[str, Callable[..., EmResult]] = {
    "rbps": partial(rbps_em, method="em"),
    "newton": rbps_em,
    "rbps-varied": varied_em,
    "ps": ps_em,
    "ps-guarded": guarded_ps_em,
    "rts": partial(rts_em, method="em"),
}
PAPER: dict[str, Mapping[str, Any]] = {
    "rbps": {
        "n_particles": 50,
        "n_trajectories": 50,
        "proposal": "bootstrap",
        "resampling": "multinomial",
        "ess_threshold": 1.0,
        "smoother": "algorithm-3",
        "recover": False,
        "m_step": "bfgs",
        "tolerance": None,
        "warm_start": False,
    },
    "ps": {
        "n_particles": 50,
        "n_trajectories": 50,
        "proposal": "bootstrap",
        "resampling": "multinomial",
        "ess_threshold": 1.0,
        "recover": False,
        "m_step": "bfgs",
        "tolerance": None,
    },
    "rts": {"m_step": "bfgs", "tolerance": None},
}


def em_arm(
    problem: str,
    label: str,
    method: str = "rbps",
    options: Mapping[str, Any] | None = None,
    at_truth: bool = False,
    errors: bool = False,
    intervals: bool = False,
) -> Arm:
    """Estimate by a method with options (default: none, so the method's defaults).

    ``at_truth`` starts at the true parameters: what a run that is not lost is measured against.
    ``errors`` asks for standard errors at the estimate too, ``intervals`` for those and likelihood-ratio
    intervals.
    """
    options = dict(options or {})
    known = inspect.signature(METHODS[method]).parameters
    used = {
        name: parameter.default
        for name, parameter in known.items()
        if parameter.default is not inspect.Parameter.empty
        and name not in ("theta0", "free", "callback", "resume", "seed", "method")
    }
    settings = {"method": method, **used, **options, "start": "truth" if at_truth else "paper's"}
    if errors or intervals:
        settings["standard_errors"] = "defaults"
    if intervals:
        settings["intervals"] = "likelihood-ratio, 95 %"
    work = partial(estimate, problem, method, options, at_truth, errors or intervals, intervals)
    return Arm(f"{problem}.{label}", work, settings)


def estimate(
    problem_name: str,
    method: str,
    options: Mapping[str, Any],
    at_truth: bool,
    errors: bool,
    intervals: bool,
    seed: int,
    run: int,
) -> Row:
    """One run: data, start, EM, and the log-likelihood of what came out.

    Columns for every free parameter: ``start.``, ``last.`` iterate, ``average.`` of the last fifth of
    the iterates, ``theta.`` what the method reports, ``trace.`` up to POINTS iterates.
    """
    problem = PROBLEMS[problem_name]
    model = model_named(problem.model)
    series = realisation(model, seed, run).series
    start = {} if at_truth else dict(problem.started(seed, run))
    theta0 = model.theta(start)
    free = list(problem.free)
    draw = {} if method == "rts" else {"seed": _integer(stream(seed, run, METHOD))}
    started = time.perf_counter()
    row: Row = {"outcome": FAILED, "message": "", "iterations": 0, "collapsed": np.nan}
    trace, theta = np.asarray(theta0)[None], np.full(len(theta0), np.nan)
    try:
        with np.errstate(all="ignore"):
            result = METHODS[method](model, series, start, free, **draw, **options)
    except FAILURES as error:  # a run that fails is a result: it is lost
        row["message"] = f"{type(error).__name__}: {error}"
    else:
        trace, theta = result.trace, np.asarray(result.theta)
        row["outcome"] = result.outcome.name
        row["iterations"] = len(trace) - 1
        row["collapsed"] = float(result.collapsed[-20:].mean())
    row["seconds"] = time.perf_counter() - started
    row["log_likelihood"], row["log_likelihood_se"] = (
        log_likelihood(problem.model, theta, series, seed, run)
        if np.isfinite(theta).all()
        else (np.nan, np.nan)
    )
    row.update(_parameters(problem, model.parameter_names, theta, trace))
    if errors:
        row.update(_standard_errors(problem, theta, series, intervals))
    return row


def _standard_errors(problem: Problem, theta: Array, series: Series, intervals: bool) -> Row:
    """Columns ``se.`` and, if ``intervals``, ``low.`` and ``high.`` of every free parameter."""
    model = model_named(problem.model)
    started = time.perf_counter()
    values = np.full(len(theta), np.nan)
    ends, interval_seconds = np.full((len(theta), 2), np.nan), 0.0
    if np.isfinite(theta).all():
        with contextlib.suppress(*FAILURES), warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", NotSettledWarning
            )  # some methods stop early, on purpose
            found = standard_errors(model, theta, series, problem.free, replicates=8)
            values = found.values
            if intervals:
                between = time.perf_counter()
                ends = likelihood_intervals(model, theta, series, errors=found).values
                interval_seconds = time.perf_counter() - between
    row: Row = {"se_seconds": time.perf_counter() - started - interval_seconds}
    if intervals:
        row["interval_seconds"] = interval_seconds
    for name in problem.free:
        k = model.parameter_names.index(name)
        row[f"se.{name}"] = float(values[k])
        if intervals:
            row[f"low.{name}"], row[f"high.{name}"] = ends[k].tolist()
    return row


def _parameters(problem: Problem, names: tuple[str, ...], theta: Array, trace: Array) -> Row:
    row: Row = {}
    last = max(round(AVERAGED * (len(trace) - 1)), 1)
    kept = np.unique(np.linspace(0, len(trace) - 1, POINTS + 1).round().astype(int))
    for name in problem.free:
        values = trace[:, names.index(name)]
        row[f"start.{name}"] = float(values[0])
        row[f"last.{name}"] = float(values[-1])
        row[f"average.{name}"] = float(values[-last:].mean())
        row[f"theta.{name}"] = float(theta[names.index(name)])
        row[f"trace.{name}"] = " ".join(f"{v:.4g}" for v in values[kept])
    return row


def _integer(sequence: np.random.SeedSequence) -> int:
    return int(sequence.generate_state(1)[0])


def _paper(method: str, n_iterations: int, m_step: str = "bfgs") -> dict[str, Any]:
    return {"n_iterations": n_iterations, **PAPER[method], "m_step": m_step}


RTS_I = em_arm("table-I", "rts-em", "rts", _paper("rts", 100))
PS_I = em_arm("table-I", "ps-em", "ps", _paper("ps", 100))
RBPS_I = em_arm("table-I", "rbps-em", "rbps", _paper("rbps", 100))
DEFAULT_I = em_arm("table-I", "default", errors=True)
# as by default, but not stopped before it has settled
SETTLED_I = em_arm("table-I", "settled", "rbps", {"n_iterations": 1000}, intervals=True)
RBPS_THETA_2 = em_arm("theta-2", "rbps-em", "rbps", _paper("rbps", 500))
PS_THETA_2 = em_arm("theta-2", "ps-em", "ps", _paper("ps", 500))
GUARDED_THETA_2 = em_arm("theta-2", "ps-em-guarded", "ps-guarded", {"n_iterations": 500})
DEFAULT_THETA_2 = em_arm("theta-2", "default", errors=True)
TRUTH_THETA_2 = em_arm("theta-2", "truth", at_truth=True)
# scoring finds the same maximiser as BFGS, at 18 ms per iteration in place of 46
RBPS_ALL_FIVE = em_arm("all-five", "rbps-em", "rbps", _paper("rbps", 1000, "scoring"))
PS_ALL_FIVE = em_arm("all-five", "ps-em", "ps", _paper("ps", 1000, "scoring"))
GUARDED_ALL_FIVE = em_arm(
    "all-five", "ps-em-guarded", "ps-guarded", {"n_iterations": 1000, "m_step": "scoring"}
)
GRADIENT_ALL_FIVE = em_arm(
    "all-five", "gradient-step", "rbps-varied", {"n_iterations": 1000, "m_step_iterations": 1}
)
PS_GRADIENT_ALL_FIVE = em_arm(
    "all-five", "ps-em-gradient-step", "ps-guarded", {"n_iterations": 1000, "m_step_iterations": 1}
)
DEFAULT_ALL_FIVE = em_arm("all-five", "default")
TRUTH_ALL_FIVE = em_arm("all-five", "truth", at_truth=True)
