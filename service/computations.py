"""What each kind of job computes: engine in, JSON out. Runs in worker processes only."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

import engine
from engine.data.series import Series
from engine.errors import ModelError, NotSettledWarning, OptionError
from engine.estimation.uncertainty import LikelihoodIntervals, StandardErrors
from engine.presentation.examination import (
    estimate_document,
    estimation_document,
    model_document,
    smoothed,
    states_document,
    trace_document,
)
from engine.presentation.held_out import held_out
from engine.simulation.fit import OF_THE_RUN
from engine.simulation.free_run import root_mean_square, root_mean_squares
from engine.simulation.problem import REFINED
from engine.statespace.model import Array, MixedModel, Theta
from service.problems import Problem
from service.schemas import EstimateOptions, SimulateRequest, SmoothRequest
from service.strict_json import finite
from service.validation import Prepared

# Of a fit of the simulation: its starts, and the best one to its end; a second round has a share of them.
SIMULATION_STEPS = REFINED + 2
NORMAL = 1.959964  # standard errors to either side of a 95 % interval
LIKELIHOOD_RUNS = 5  # filter passes at the estimate, for the log-likelihood and its error
WIDE_NATS = 3.0  # nats of scatter: the mean of the likelihoods is then that of the luckiest run
WITHOUT_INTERVALS = "Its intervals are symmetric as yet."
WITHOUT_ERRORS = "Its standard errors are not there yet."
LOGNORMAL_DRAWS = 4000  # of that mean, to know its error to about one per cent


METHODS: dict[str, Callable[..., engine.EmResult]] = {
    "quasi-newton": partial(engine.rbps_em, method="quasi-newton"),
    "rbps-em": partial(engine.rbps_em, method="em"),
    "ps-em": engine.ps_em,
    "rts-em": engine.rts_em,
}
SEARCHING = ("quasi-newton", "rbps-em")  # of these, those that search for a start


class Progress(Protocol):
    """What a computation tells the store, and what it finds there of other attempts and tasks."""

    def rows(self) -> Array:
        """Iterations already done, (k + 1, n_theta + 4), start first; (0, ...) at a first attempt."""

    def memory(self) -> Array:
        """What each of these left to the next (k, m); see ``engine.Checkpoint``."""

    def start(self, theta: Theta) -> None:
        """Row 0 of a first attempt."""

    def iteration(self, it: Any) -> None:
        """One more iteration; an engine.Iteration."""

    def step(self, k: int, message: str = "", share: float | None = None) -> None:
        """Progress of what has no iterations; ``share`` of the message's stage, before its comma, is done."""

    def estimated(self, document: dict[str, Any]) -> None:
        """The result so far: of an estimation before its standard errors, of a diagnosis before its causes."""

    def left(self, task: int) -> Any:
        """What a task of an earlier stage left."""


Found = TypeVar("Found")


def anew_where_another(
    compute: Callable[[], Found], kept: MutableMapping[str, Any] | None
) -> Found:
    """What is computed with ``kept`` parts; without them where a model or the catalogue has changed since."""
    try:
        return compute()
    except OptionError as error:
        if kept is None or error.field != "kept":
            raise
        kept.clear()
        return compute()


# ---- estimate -------------------------------------------------------------------------------


def fit_simulation(
    job: Prepared, options: EstimateOptions, progress: Progress
) -> engine.SimulationFit:
    """Least squares on the free run, from the job's start and others around it."""
    said = "fitting the simulation by least squares"

    def tell(done: int, steps: int) -> None:
        k = SIMULATION_STEPS * done // steps if options.method == "simulation" else 0
        progress.step(k, f"{said}, {done} of {steps}", done / steps)

    progress.step(0, said)
    return engine.fit_simulation(
        job.model, job.series, job.theta, free=job.free, seed=options.seed, callback=tell
    )


def simulation_fit(job: Prepared, options: EstimateOptions, progress: Progress) -> dict[str, Any]:
    """The result document of a fit of the free run."""
    found, model = fit_simulation(job, options, progress), job.model
    estimate = estimate_document(model, found.theta, found.estimated, None)
    for name, error in found.standard_errors.items():
        if name in found.tied:
            continue
        value = estimate[name]["value"]
        low, high = model.parameters[model.index(name)].bounds
        interval = [max(value - NORMAL * error, low), min(value + NORMAL * error, high)]
        estimate[name] |= {"standard_error": error, "interval": interval}
    for name in found.silent:
        estimate[name]["silent"] = True
    return {
        "model": model_document(model),
        "time_unit": job.time_unit,
        "method": "simulation",
        "estimate": estimate,
        "outcome": "converged" if found.success else "evaluations-used-up",
        "message": found.message,
        "warning": OF_THE_RUN,
        "rmse": finite(found.rmse),
        "rmse_by_output": {name: finite(value) for name, value in found.rmse_by_output.items()},
        **_held_out(job, found.theta),
        "simulation": {
            "units": _units(model),
            "series": [_run_document(model, run.series, run) for run in found.runs],
        },
    }


def fit(
    job: Prepared,
    options: EstimateOptions,
    theta0: Theta,
    seed: int,
    progress: Progress,
    simulation_first: bool = False,
    uphill: bool = False,
) -> dict[str, Any]:
    """Estimate from theta0, going on where an earlier attempt was; rows as in ``db_schema.iterations``.

    With ``simulation_first`` it leaves from the fit of the simulation; ``uphill`` it does not search around
    theta0 for a better start.
    """
    method = METHODS[options.method]
    arguments: dict[str, Any] = {"n_iterations": options.iterations}
    if options.method != "rts-em":
        arguments |= {"n_particles": options.particles, "seed": seed}
        arguments |= {"n_trajectories": options.trajectories}
    if uphill and options.method in SEARCHING:
        arguments["warm_start"] = "uphill"
    rows = progress.rows()
    if len(rows):
        trace, columns = np.split(rows, [len(job.model.parameters)], axis=1)
        checkpoint = engine.Checkpoint(trace, *columns[1:].T)
        arguments["resume"] = replace(checkpoint, memory=progress.memory())
    else:
        if simulation_first:
            theta0 = fit_simulation(job, options, progress).theta
        progress.start(theta0)
    found = method(
        job.model, job.series, theta0, free=job.free, callback=progress.iteration, **arguments
    )
    note = " EM started from the fit of the simulation." if simulation_first else ""
    return {
        "theta": found.theta.tolist(),
        "trace": found.trace.tolist(),
        "log_likelihood": found.log_likelihood.tolist(),
        "ess": found.ess.tolist(),
        "seconds": found.seconds.tolist(),
        "free": list(found.free),
        "outcome": found.outcome.word,
        "success": found.outcome.success,
        "message": found.message + note,
    }


def describe(
    job: Prepared, options: EstimateOptions, found: dict[str, Any], progress: Progress
) -> dict[str, Any]:
    """The result document of a fit, with one smoothing pass at the estimate."""
    if not found["success"]:
        raise Problem(422, found["outcome"], found["message"])
    model, done = job.model, len(found["log_likelihood"])
    theta = model.theta(found["theta"])
    n = options.particles
    rng = stream(options.seed, 0)
    progress.step(done, "smoothing the states at the estimate")
    states = _states(job, theta, n, options.trajectories or n, rng, options.method)
    message = found["message"]
    likelihood = log_likelihood(job, theta, n, rng, options.method)
    message = f"{message} {_scattered(likelihood)}".rstrip()
    rest = {
        "outcome": found["outcome"],
        "log_likelihood": likelihood,
        **_held_out(job, theta),
        "trace": trace_document(model.parameter_names, found),
    }
    documented = partial(
        estimation_document, model, theta, found["free"], job.series, states, seed=options.seed
    )
    errors: StandardErrors | None = None
    intervals: LikelihoodIntervals | None = None
    at, exact = (model, theta, job.series), options.method == "rts-em"
    if options.standard_errors and not options.bootstrap:
        said = f"{message} {WITHOUT_ERRORS}"
        progress.estimated({**documented((None, None)), **rest, "message": said})
        progress.step(done, "standard errors")
        ask = partial(engine.standard_errors, *at, job.free, seed=options.seed, exact=exact)
        errors, why = _tried(ask)
        message += f" No standard errors: {why}" if why else ""
    if errors is not None and options.intervals == "likelihood-ratio":
        names = list(errors.names)
        said = f"{message} {WITHOUT_INTERVALS}"
        progress.estimated({**documented((errors, None)), **rest, "message": said})

        def sought(name: str) -> None:
            k, n = names.index(name), len(names)
            progress.step(done, f"intervals, {k + 1} of {n}: {name}", k / n)

        sides = partial(engine.likelihood_intervals, *at, errors=errors, callback=sought)
        intervals, why = _tried(partial(sides, seed=options.seed, exact=exact))
        message += f" Intervals are symmetric: {why}" if why else ""
    progress.step(done, "comparing simulation and prediction with the data")
    return {**documented((errors, intervals)), **rest, "message": message}


def _held_out(job: Prepared, theta: Theta) -> dict[str, Any]:
    """The error on data that were held out, where there are any."""
    return {"held_out": held_out(job.model, theta, job.test, job.series)} if job.test else {}


def _tried(compute: Callable[[], Any]) -> tuple[Any, str]:
    """What is computed, or None and why it could not be; what is not settled, the page says."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotSettledWarning)
            return compute(), ""
    except ModelError as error:
        return None, str(error)


def log_likelihood(
    job: Prepared, theta: Theta, n: int, rng: np.random.Generator, method: str
) -> dict[str, Any]:
    """Log of the mean of several likelihood estimates (which are unbiased), and its standard error.

    Each estimate comes from a filter with random numbers of its own; ``spread`` is the standard deviation
    of their logs. Logs of particle filters' likelihoods are nearly normal (Pitt et al. 2012), so the
    error is that of the log of the mean of as many lognormal numbers, see :func:`mean_error`: spread /
    sqrt(runs) where the spread is small, and about that of the largest where it is not.
    """
    if method == "rts-em":
        exact = sum(engine.kalman_smoother(job.model, theta, s).log_likelihood for s in job.series)
        return {"value": float(exact), "standard_error": 0.0, "spread": 0.0}
    runs = np.array(
        [
            sum(engine.rbpf(job.model, theta, s, n, rng).log_likelihood for s in job.series)
            for _ in range(LIKELIHOOD_RUNS)
        ]
    )
    value = float(np.logaddexp.reduce(runs) - np.log(len(runs)))
    if not np.isfinite(runs).all():  # some filter was lost: nothing is known about the error
        return {"value": value, "standard_error": None, "spread": None}
    spread = float(runs.std(ddof=1))
    return {"value": value, "standard_error": mean_error(spread, len(runs)), "spread": spread}


def _scattered(likelihood: Mapping[str, Any]) -> str:
    """A sentence where passes of the filter scatter widely: then the states' bands are too narrow, too."""
    if (likelihood["spread"] or 0.0) < WIDE_NATS:
        return ""
    return (
        f"The log-likelihood is known poorly, and is probably too low: {LIKELIHOOD_RUNS} passes of the "
        f"filter scatter by {likelihood['spread']:.2g}. Use more particles."
    )


def mean_error(spread: float, runs: int) -> float:
    """Standard deviation of log mean exp of ``runs`` normal numbers whose own is ``spread``."""
    logs = spread * np.random.default_rng(0).standard_normal((LOGNORMAL_DRAWS, runs))
    return float((np.logaddexp.reduce(logs, axis=1) - np.log(runs)).std())


# ---- smooth ---------------------------------------------------------------------------------


def smooth(job: Prepared, request: SmoothRequest, progress: Progress) -> dict[str, Any]:
    """Means and standard deviations of all states at given parameters."""
    n = request.options.particles
    N = request.options.trajectories or n
    rng = np.random.default_rng(request.options.seed)
    states = _states(job, job.theta, n, N, rng, progress=progress)
    likelihood = log_likelihood(job, job.theta, n, rng, "")
    return {
        "parameters": job.theta.asdict(),
        "model": model_document(job.model),
        "time_unit": job.time_unit,
        "log_likelihood": likelihood,
        "message": _scattered(likelihood),
        "states": states_document(job.model, job.series, states),
    }


def _states(
    job: Prepared,
    theta: Theta,
    M: int,
    N: int,
    rng: np.random.Generator,
    method: str = "",
    progress: Progress | None = None,
) -> list[tuple[Array, Array]]:
    """Smoothed means and standard deviations of each series."""
    model, out = job.model, []
    for i, series in enumerate(job.series):
        if method == "rts-em":
            exact = engine.kalman_smoother(model, theta, series)
            mean, std = exact.x, np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
        else:
            mean, std = smoothed(model, theta, series, M, N, rng)
        if not np.isfinite(mean).all():
            row = int(np.argmin(np.isfinite(mean).all(axis=1)))
            when = f"row {row} (t = {series.t[row]:g} {series.time_unit})"
            raise Problem(422, "not-finite", f"the model's states are not finite at {when}")
        out.append((mean, std))
        if progress is not None:
            progress.step(i + 1)
    return out


# ---- simulate -------------------------------------------------------------------------------


def simulate(job: Prepared, request: SimulateRequest, progress: Progress) -> dict[str, Any]:
    """Outputs and states, without noise or drawn with the model's noise."""
    model, out, notes = job.model, [], []
    rng = np.random.default_rng(request.options.seed)
    for i, series in enumerate(job.series):
        if request.options.mode == "free-run":
            run: Any = engine.free_run(model, job.theta, series)
            notes.append(run.note)
        else:
            run = drawn(model, job.theta, series, rng)
        out.append(_run_document(model, series, run))
        progress.step(i + 1)
    return {
        "model": model_document(model),
        "time_unit": job.time_unit,
        "parameters": job.theta.asdict(),
        **({"message": said} if (said := max(notes, key=len, default="")) else {}),
        "simulation": {"units": _units(model), "series": out},
    }


def _run_document(model: MixedModel, series: Series, run: Any) -> dict[str, Any]:
    """Outputs and states of a run at the samples, beside what was measured where something was."""
    at, x = series.samples, np.concatenate([run.a, run.z], axis=1)
    document: dict[str, Any] = {
        "t": series.t[at].tolist(),
        "y": _columns(run.y[at], tuple(model.outputs)),
        "states": _columns(x[at], (*model.nonlinear, *model.linear)),
    }
    if series.observed.any():
        document["measured"] = _columns(series.y[at], tuple(model.outputs))
        left = series.y - run.y
        document["rmse"] = finite(root_mean_square(model, left))
        each = root_mean_squares(model, left)
        document["rmse_by_output"] = {name: finite(value) for name, value in each.items()}
    return document


def _units(model: MixedModel) -> dict[str, str]:
    return {**model.outputs, **model.nonlinear, **model.linear}


def drawn(
    model: MixedModel, theta: Theta, series: Series, rng: np.random.Generator
) -> engine.Simulation:
    """A run with the model's noise over a series' times and inputs."""
    u = series.u if model.nu else None
    return engine.simulate(model, theta, len(series), rng, u=u, t=series.t, hold=series.hold)


def stream(seed: int, key: int) -> np.random.Generator:
    """Random numbers of a job that are independent of those with other keys."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,)))


def _columns(values: Array, names: tuple[str, ...]) -> dict[str, list[float]]:
    return {name: values[:, i].tolist() for i, name in enumerate(names)}
