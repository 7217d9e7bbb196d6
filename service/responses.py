"""The JSON that comes out."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from engine import Outcome
from engine.diagnose import Verdict

Kind = Literal["estimate", "smooth", "simulate", "diagnose", "design"]
Status = Literal["accepted", "running", "successful", "failed", "dismissed"]
# Of successful jobs: the verdict of a diagnosis, how an estimation ended.
OUTCOMES = (
    *(one.value for one in Verdict),
    *(one.word for one in Outcome if one.success and one is not Outcome.STOPPED_BY_CALLER),
    "evaluations-used-up",
)


class _Out(BaseModel):
    """A document; what stands below a member is its description."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class Link(_Out):
    """A link of a document."""

    href: str
    rel: str
    title: str = ""


class KeyValue(_Out):
    """One of the few numbers that sum up a result, for lists."""

    name: str
    value: float | None
    standard_error: float | None
    unit: str


class JobStatus(_Out):
    """The state of one job."""

    jobID: str  # noqa: N815 - the name OGC API - Processes gives it
    name: str
    """the name that the request gave it"""
    tags: list[str]
    data: list[str]
    """names of the files that its data are from"""
    kind: Kind
    model: str
    status: Status
    progress: int = Field(examples=[37])
    """per cent of all stages"""
    iteration: int
    iterations: int
    created: str = Field(examples=["2026-03-01T08:30:00.000Z"])
    started: str | None
    updated: str
    finished: str | None
    stage: str
    """what a running job is doing, such as iterations, standard errors"""
    estimated_end: str | None
    """when its present stage will be done at the latest, by its rate; null where that is not known"""
    message: str
    estimate: dict[str, float] | None
    """value of each parameter in the latest iteration"""
    log_likelihood: float | None
    outcome: str | None
    """of a successful job: the verdict of a diagnosis, how an estimation ended"""
    cause: str | None = None
    """of a failed job: the kind of its problem, such as `run-time-exceeded`"""
    causes: list[str]
    """the effects that a diagnosis found"""
    values: list[KeyValue]
    """the few numbers that sum up the result; before its end, those known so far"""
    links: list[Link]


class JobList(_Out):
    """Jobs, newest first or as they were sorted."""

    jobs: list[JobStatus]
    links: list[Link]


class Trace(_Out):
    """Every iteration; row 0 is the start."""

    iteration: list[int]
    theta: dict[str, list[float | None]]
    log_likelihood: list[float | None]
    ess: list[float | None]
    seconds: list[float | None]


class TaskOut(_Out):
    """One computation of a job: a start, a run of the bootstrap, ... and how far it is."""

    task: int
    role: str
    """computation, start, choice, estimate, bootstrap or summary"""
    state: str
    """waiting, queued, running, done or stopped"""
    iteration: int = 0
    restarts: int = 0
    """how often its worker was lost"""
    estimate: dict[str, float | None] | None = None
    """value of each parameter in its latest iteration"""
    log_likelihood: float | None = None


class Tasks(_Out):
    """All computations of a job, in the order in which they begin."""

    tasks: list[TaskOut]


class ReportSection(_Out):
    """A part of a report, as HTML."""

    id: str
    title: str
    html: str


class ReportOut(_Out):
    """A job's report in parts, as its page shows them.

    Where the HTML has an element with `data-chart="k"`, `charts[k]` is drawn.
    """

    title: str
    summary: str
    sections: list[ReportSection]
    charts: list[dict[str, Any]]


class ComparisonOut(_Out):
    """Two jobs side by side; where something has two values, the first is that of job `a`."""

    jobs: list[JobStatus]
    time_unit: str
    models: list[str]
    outcome: list[str | None]
    methods: list[str | None]
    """`simulation` for least squares on the simulation, else null"""
    parameters: list[dict[str, Any]]
    """name, unit, values, standard_errors, held, silent (without influence), difference, in_errors"""
    free_parameters: list[int | None]
    same_data: bool | None
    """null: not known from the results"""
    log_likelihood: list[dict[str, Any] | None]
    same_held_out: bool | None
    held_out: list[dict[str, Any] | None]
    """samples, log_density, outputs with rmse in their unit"""
    curves: list[dict[str, Any]]
    """simulation, held-out and state by name, with t, measured and values of both"""


class ChartsOut(_Out):
    """Curves of a report's charts by their numbers, as `charts` of the report has them."""

    charts: dict[int, dict[str, Any]]


class ParameterOut(_Out):
    """A parameter of a model; a bound that is null is infinite."""

    name: str
    unit: str
    default: float
    bounds: tuple[float | None, float | None]
    description: str


class ModelOut(_Out):
    """A registered model: channels and states with units, parameters, equations."""

    name: str
    description: str
    equations: list[str]
    nonlinear: dict[str, str]
    linear: dict[str, str]
    inputs: dict[str, str]
    outputs: dict[str, str]
    parameters: list[ParameterOut]
    own: bool
    """whether it comes from a file of the user's own"""
    check: list[str]
    """what the check of its functions says"""
    example: dict[str, Any]
    """a request for POST /jobs"""
    links: list[Link]


class ModelList(_Out):
    """Registered models, and plug-ins that could not be loaded."""

    models: list[ModelOut]
    broken_plugins: dict[str, str]
    links: list[Link]


class TimeOut(_Out):
    """The column of time stamps of a file; ``step`` is the median."""

    column: str
    problem: str | None
    """why it cannot be used"""
    first: float | None
    last: float | None
    step: float | None
    regular: bool


class ColumnOut(_Out):
    """A column of a file: ``value`` at some of its rows, extremes kept; rows count from 0."""

    name: str
    rows: int
    missing: int
    minimum: float | None
    maximum: float | None
    problem: str | None
    """why it cannot be a channel"""
    dates: bool
    """holds dates, so that it may have the times, which are then its values"""
    counts: bool
    """goes up by the same step, as years and sample numbers do"""
    row: list[int]
    value: list[float | None]
    gaps: list[tuple[int, int]]
    """first and last row of missing values"""


class PreviewOut(_Out):
    """What a data file holds."""

    file: str
    rows: int
    dt: float | None
    """time step stored in the file"""
    time_unit: str
    """what times count, as stated by the file, else s"""
    time: TimeOut | None
    columns: list[ColumnOut]
    ignored: list[str]


class ProblemOut(_Out):
    """A problem document (RFC 9457); `errors` name the fields of the request that are wrong."""

    type: str
    title: str
    status: int
    detail: str
    advice: str | None = None
    """what can be done about a failed job"""
    errors: list[dict[str, Any]] | None = None


class Estimated(_Out):
    """An estimate; the standard error is null where it was not computed."""

    value: float
    standard_error: float | None
    interval: tuple[float, float] | None = None
    """95 %: by the likelihood ratio, or symmetric, or from the bootstrap where there was one; null
    where it has no end or was not computed"""
    unit: str
    fixed: bool = False
    """true for a parameter that was not free"""
    silent: bool = False
    """true for one that was free and has no influence on a simulation"""


class Uncertain(_Out):
    """A value with its Monte Carlo standard error, and the ``spread`` of the single runs behind it."""

    value: float | None
    standard_error: float | None
    spread: float | None = None


class States(_Out):
    """Smoothed states of one series."""

    t: list[float]
    mean: dict[str, list[float | None]]
    standard_deviation: dict[str, list[float | None]]


class StatesOut(_Out):
    """Smoothed states of every series, with the states' units."""

    units: dict[str, str]
    series: list[States]


class Simulated(_Out):
    """Simulated outputs and states of one series."""

    t: list[float]
    y: dict[str, list[float]]
    states: dict[str, list[float]]
    measured: dict[str, list[float | None]] | None = None
    """what y is compared with, where something was measured"""
    rmse: float | None = None
    """against the measured y, where there is one; null where outputs have several units"""
    rmse_by_output: dict[str, float | None] | None = None
    """the same of each output, in its unit"""


class SimulationOut(_Out):
    """Simulated outputs and states of every series, with units."""

    units: dict[str, str]
    series: list[Simulated]


class ExaminationOut(_Out):
    """An estimate looked at, series by series.

    Each holds ``sentences``, ``free_run`` (null where it diverges) and ``one_step`` with ``fits``,
    ``regions``, ``bands`` and ``curves``, ``residuals`` and ``whiteness``, or a ``problem``.
    """

    series: list[dict[str, Any]]


class Results(_Out):
    """What a job found; which members there are depends on its kind."""

    name: str = ""
    """of the job, as its `tags`; `data` are the names of the files that it is about"""
    tags: list[str] = []
    data: list[str] = []
    created: str = ""
    model: dict[str, Any] | None = None
    """name, equations, states, inputs and outputs with units"""
    time_unit: str | None = None
    """what times of the data count, such as s or year"""
    estimate: dict[str, Estimated] | None = None
    parameters: dict[str, float] | None = None
    method: str | None = None
    """`simulation` where least squares on the simulation was used, else null"""
    rmse: float | None = None
    """root mean square error of a fit of the simulation; null where outputs have several units"""
    rmse_by_output: dict[str, float | None] | None = None
    """the same of each output, in its unit"""
    outcome: str | None = None
    message: str | None = None
    warning: str | None = None
    """why standard errors and intervals cannot be trusted, where the estimate is no maximum"""
    notes: list[str] | None = None
    """what is to be known of how files were read, such as a step that was assumed"""
    log_likelihood: Uncertain | None = None
    held_out: dict[str, Any] | None = None
    """of an estimation with `test`: samples, log_density, outputs with rmse, curves by series"""
    trace: Trace | None = None
    states: StatesOut | None = None
    simulation: SimulationOut | None = None
    early: dict[str, Any] | None = None
    """of a diagnosis that goes on or was stopped: estimate, symptoms, screen"""
    diagnosis: dict[str, Any] | None = None
    """verdict, causes, symptoms, extension, gain, detectable, page"""
    examination: ExaminationOut | None = None
    """free run and predictions against the data, residuals"""
    starts: list[dict[str, Any]] | None = None
    """each start's outcome"""
    bootstrap: dict[str, Any] | None = None
    """estimates, quantiles"""
