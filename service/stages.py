"""A job as stages of tasks: one computation, several starts, a bootstrap.

    one start                 estimate
    several starts            fit, fit, ... | choose
    ... and a bootstrap       ...           | resample, resample, ... | summarize

The tasks of a stage run on as many workers as there are; each stage begins when the one before is
done. Every draw comes from the job's seed and the task's number, so who computes what, and how
often it was interrupted, changes nothing.
"""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from typing import Any

import numpy as np

from engine.errors import ModelError
from engine.estimation.expectation import parameter_scale
from engine.presentation.examination import trace_document
from engine.statespace.model import Theta
from service import computations, designs, diagnoses
from service.computations import Progress
from service.problems import Problem
from service.schemas import (
    DesignRequest,
    DiagnoseRequest,
    EstimateRequest,
    Request,
    SimulateRequest,
    SmoothRequest,
)
from service.validation import Prepared

START_SPREAD = 0.5  # starts that nothing else is said about lie within +- 50 % of the first
LEVEL = 0.95  # of a bootstrap's intervals
FOR_LEVEL = 39  # runs at least, as from the least to the largest of so many they hold so much
START_KEY, BOOTSTRAP_KEY = 1 << 40, 1 << 41  # spawn keys far from those of iterations


# What the tasks of each stage do, by the number of stages.
ROLES = {
    1: ("computation",),
    2: ("start", "choice"),
    3: ("estimate", "bootstrap", "summary"),
    4: ("start", "choice", "bootstrap", "summary"),
}


def plan(request: Request) -> list[int]:
    """How many tasks each stage has."""
    if not isinstance(request, EstimateRequest) or request.options.method == "simulation":
        return [1]
    options = request.options
    stages = [1] if options.starts == 1 else [options.starts, 1]
    return [*stages, options.bootstrap, 1] if options.bootstrap else stages


def roles(stages: Sequence[int]) -> list[str]:
    """What each task of a job does, the tasks of later stages included."""
    return [name for name, n in zip(ROLES[len(stages)], stages, strict=True) for _ in range(n)]


def steps(job: Prepared) -> int:
    """How many steps of progress a job will make at most."""
    if isinstance(job.request, EstimateRequest):
        options = job.request.options
        if options.method == "simulation":
            return computations.SIMULATION_STEPS
        return options.iterations * (options.starts + options.bootstrap)
    if isinstance(job.request, DesignRequest):
        return designs.PROGRESS_STEPS
    return diagnoses.PROGRESS_STEPS if isinstance(job.request, DiagnoseRequest) else len(job.series)


def run(
    job: Prepared, task: int, progress: Progress, kept: MutableMapping[str, Any] | None = None
) -> dict[str, Any]:
    """What one task leaves; what the last leaves is the job's result.

    ``kept`` is what earlier attempts at a diagnosis or a design have finished, and where this one puts it.
    """
    match job.request:
        case SmoothRequest():
            return computations.smooth(job, job.request, progress)
        case SimulateRequest():
            return computations.simulate(job, job.request, progress)
        case DiagnoseRequest():
            return diagnoses.diagnose(job, job.request, progress, kept)
        case DesignRequest():
            return designs.design(job, job.request, progress, kept)
    stages = plan(job.request)
    first = sum(stages[:-2])  # of the bootstrap's tasks, where there are any
    match roles(stages)[task]:
        case "start":
            return _fit(job, job.request, task, progress)
        case "choice":
            return _choose(job, job.request, progress)
        case "bootstrap":
            return _resample(job, job.request, task - first, first - 1, progress)
        case "summary":
            return _summarize(job, job.request, range(first, task), first - 1, progress)
        case _:
            options = job.request.options
            if options.method == "simulation":
                return computations.simulation_fit(job, options, progress)
            first = options.first == "simulation"
            found = computations.fit(job, options, job.theta, options.seed, progress, first)
            return computations.describe(job, options, found, progress)


def _fit(job: Prepared, request: EstimateRequest, i: int, progress: Progress) -> dict[str, Any]:
    """One of several starts; a start from which nothing can be computed is no failure of the job."""
    options, theta0 = request.options, _start(job, request, i)
    start = {"start": theta0.asdict()}
    try:
        first = i == 0 and options.first == "simulation"
        # the first start is searched around as that of a single estimation; the others are spread already
        found = computations.fit(job, options, theta0, options.seed, progress, first, i > 0)
        start = {"start": dict(zip(job.model.parameter_names, found["trace"][0], strict=True))}
    except ModelError as error:
        return start | {"success": False, "outcome": "failed", "message": str(error)}
    if found["success"]:
        rng = computations.stream(options.seed, START_KEY)
        theta = job.model.theta(found["theta"])
        found["reached"] = computations.log_likelihood(
            job, theta, options.particles, rng, options.method
        )
    return start | found


def _start(job: Prepared, request: EstimateRequest, i: int) -> Theta:
    """The i-th start: the given one, then draws from the given ranges or around the given start."""
    if i == 0:
        return job.theta
    rng = computations.stream(request.options.seed, START_KEY + i)
    theta = np.array(job.theta)
    for k in job.model.free_indices(job.free):
        size = abs(theta[k]) or parameter_scale(job.model, theta, int(k))
        around = (theta[k] - START_SPREAD * size, theta[k] + START_SPREAD * size)
        low, high = request.parameters.ranges.get(job.model.parameter_names[k], around)
        theta[k] = rng.uniform(max(low, job.model.lower[k]), min(high, job.model.upper[k]))
    return job.model.theta(theta)


def _choose(job: Prepared, request: EstimateRequest, progress: Progress) -> dict[str, Any]:
    """The best of the starts by log-likelihood, described; all of them in ``starts``."""
    found = [progress.left(i) for i in range(request.options.starts)]
    reached = [one for one in found if one["success"]]
    if not reached:
        reasons = "; ".join(sorted({one["message"] for one in found}))
        detail = f"none of {len(found)} starts succeeded: {reasons}"
        raise Problem(422, "no-start-succeeded", detail)
    best = max(reached, key=lambda one: one["reached"]["value"])
    result = computations.describe(job, request.options, best, progress)
    result["starts"] = [_of_start(job.model.parameter_names, one) for one in found]
    return result


def _of_start(names: Sequence[str], found: dict[str, Any]) -> dict[str, Any]:
    """What the result says of one start."""
    said = {key: found[key] for key in ("start", "outcome", "message")}
    if not found["success"]:
        return said
    trace = trace_document(names, found)
    return said | {
        "estimate": dict(zip(names, found["theta"], strict=True)),
        "log_likelihood": found["reached"],
        "trace": {key: trace[key] for key in ("iteration", "theta")},
    }


def _resample(
    job: Prepared, request: EstimateRequest, i: int, estimated: int, progress: Progress
) -> dict[str, Any]:
    """One run of the parametric bootstrap: simulate at the estimate, estimate again."""
    options, model = request.options, job.model
    estimate = progress.left(estimated)["estimate"]
    theta = model.theta({name: one["value"] for name, one in estimate.items()})
    rng = computations.stream(options.seed, BOOTSTRAP_KEY + i)
    drawn = []
    for series in job.series:
        y = computations.drawn(model, theta, series, rng).y
        y[~series.observed] = np.nan
        drawn.append(series.replace(y=y))
    again = Prepared(request, model, drawn, theta, job.free)
    try:
        seed = options.seed + 1 + i
        found = computations.fit(again, options, theta, seed, progress, uphill=True)
    except ModelError as error:
        return {"success": False, "message": str(error)}
    return {key: found[key] for key in ("theta", "success", "message")}


def _summarize(
    job: Prepared, request: EstimateRequest, tasks: range, estimated: int, progress: Progress
) -> dict[str, Any]:
    """The estimate's document with standard errors and quantiles from the bootstrap."""
    result: dict[str, Any] = progress.left(estimated)
    left = [progress.left(i) for i in tasks]
    thetas = np.array([one["theta"] for one in left if one["success"]])
    names = job.model.parameter_names
    failed = len(left) - len(thetas)
    result["bootstrap"] = {"runs": len(left), "failed": failed, "estimates": {}, "quantiles": {}}
    if len(thetas) < 2:
        result["message"] += f" No standard errors: {failed} of {len(left)} bootstrap runs failed."
        return result
    if failed:
        result["message"] += (
            f" {failed} of {len(left)} bootstrap runs failed and are left out. Where it was the data they drew "
            "that made them fail, the errors and intervals of the others are too small."
        )
    most = (len(thetas) - 1) / (len(thetas) + 1)  # from the least to the largest of so many
    if most < LEVEL:
        result["message"] += (
            f" An interval of {len(thetas)} bootstrap runs holds {100.0 * most:.0f} % at most, not 95 %: "
            f"{FOR_LEVEL} runs or more are needed for that."
        )
    for k in job.model.free_indices(job.free):
        name, values = names[k], thetas[:, k]
        result["estimate"][name]["standard_error"] = float(values.std(ddof=1))
        result["bootstrap"]["estimates"][name] = values.tolist()
        quantiles = np.quantile(values, [0.025, 0.5, 0.975], method="weibull").tolist()
        result["estimate"][name]["interval"] = [quantiles[0], quantiles[2]]
        by_share = zip(("0.025", "0.5", "0.975"), quantiles, strict=True)
        result["bootstrap"]["quantiles"][name] = dict(by_share)
    return result
