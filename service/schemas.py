"""The JSON that goes in and comes out, with examples that the API really accepts."""

from __future__ import annotations

from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

Kind = Literal["estimate", "smooth", "simulate", "diagnose"]
Status = Literal["accepted", "running", "successful", "failed", "dismissed"]


# ---- tables of numbers ----------------------------------------------------------------------


def _table(value: Any) -> Any:
    """[[1.0, null], ...] or [1.0, null, ...] -> float array (T, n), null as NaN."""
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list):
        raise PydanticCustomError("table", "a list of rows of numbers is needed")
    rows = value if any(isinstance(row, list) for row in value) else [[cell] for cell in value]
    if not all(isinstance(row, list) for row in rows):
        at = next(i for i, row in enumerate(rows) if not isinstance(row, list))
        raise PydanticCustomError("table", "row {row} is not a list as the others are", {"row": at})
    for i, row in enumerate(rows):
        if len(row) != len(rows[0]):
            raise PydanticCustomError(
                "table",
                "row {row} has {n} values where row 0 has {first}",
                {"row": i, "n": len(row), "first": len(rows[0])},
            )
    if not set(map(type, chain.from_iterable(rows))) <= {int, float, type(None)}:
        for i, row in enumerate(rows):
            for j, cell in enumerate(row):
                if type(cell) not in (int, float, type(None)):
                    raise PydanticCustomError(
                        "table",
                        "row {row}, channel {channel} is {what}; a number or null is needed",
                        {"row": i, "channel": j, "what": f"{cell!r:.40}"},
                    )
    try:
        return np.array(rows, dtype=float).reshape(len(rows), len(rows[0]) if rows else 0)
    except OverflowError:
        raise PydanticCustomError("table", "a number is too large for a float") from None


_CELL = {"anyOf": [{"type": "number"}, {"type": "null"}]}
Table = Annotated[
    Any,
    BeforeValidator(_table),
    PlainSerializer(lambda a: a.tolist()),
    WithJsonSchema(
        {"type": "array", "items": {"anyOf": [{"type": "array", "items": _CELL}, *_CELL["anyOf"]]}}
    ),
]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True)


# ---- requests -------------------------------------------------------------------------------


Number = Annotated[float, Field(allow_inf_nan=False)]
Values = dict[Annotated[str, Field(max_length=200)], Number]


class SettingIn(_Strict):
    """What data told when effects were made: typical sizes by channel, first and last time, time step."""

    scale: Values = Field(default_factory=dict)
    span: list[Number] = Field(min_length=2, max_length=2)
    dt: float = Field(gt=0, allow_inf_nan=False)

    @field_validator("span")
    @classmethod
    def _ordered(cls, span: list[float]) -> list[float]:
        if not span[0] < span[1]:
            raise PydanticCustomError("span", "the last time is not after the first")
        return span


class ModelReference(_Strict):
    """A registered model, by name; `with` lists effects added to it, `setting` as a diagnosis gave it."""

    model_config = ConfigDict(extra="forbid", strict=True, serialize_by_alias=True)
    name: str = Field(max_length=200)
    effects: list[Annotated[str, Field(max_length=200)]] = Field(
        default_factory=list, alias="with", max_length=20
    )
    setting: SettingIn | None = Field(
        default=None, description="null means the span and time step of the first series"
    )


def _model_reference(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


ModelChoice = Annotated[
    ModelReference,
    BeforeValidator(
        _model_reference,
        json_schema_input_type=Annotated[str, Field(max_length=200)] | ModelReference,
    ),
]


class _Timed(_Strict):
    dt: float | None = Field(default=None, gt=0, allow_inf_nan=False, description="time step, s")
    t: list[float] | None = Field(
        default=None, description="time stamps, s, increasing; instead of dt"
    )

    @model_validator(mode="after")
    def _one_clock(self) -> _Timed:
        if self.dt is not None and self.t is not None:
            raise PydanticCustomError("clock", "dt and t are both given; choose one")
        return self


class SeriesIn(_Timed):
    """Measured data: y (T, ny) with null where a value is missing, u (T, nu) without gaps."""

    y: Table
    u: Table | None = None


class InputIn(_Timed):
    """What drives a simulation: u (T, nu); y, where measured, is what a free run starts from."""

    u: Table | None = None
    y: Table | None = None


class EstimateParameters(_Strict):
    """Where the estimation starts and what it may change."""

    start: Values = Field(default_factory=dict, description="start values; else the defaults")
    free: list[Annotated[str, Field(max_length=200)]] | None = Field(
        default=None, min_length=1, description="parameters to estimate; null means all"
    )
    ranges: dict[Annotated[str, Field(max_length=200)], list[Number]] = Field(
        default_factory=dict, description="where further starts are drawn, name: [low, high]"
    )

    @field_validator("ranges")
    @classmethod
    def _ordered(cls, ranges: dict[str, list[float]]) -> dict[str, list[float]]:
        for name, values in ranges.items():
            if len(values) != 2 or values[0] > values[1]:
                raise PydanticCustomError("range", "{name} needs [low, high]", {"name": name})
        return ranges


class DiagnoseParameters(_Strict):
    """Where the model's own estimation starts and what it may change."""

    start: Values = Field(default_factory=dict, description="start values; else the defaults")
    free: list[Annotated[str, Field(max_length=200)]] | None = Field(
        default=None, min_length=1, description="parameters to estimate; null means all"
    )


class FixedParameters(_Strict):
    """Parameter values."""

    values: Values = Field(default_factory=dict, description="values; else the defaults")


Seed = Annotated[int, Field(ge=0, lt=2**63, description="the same seed gives the same bits")]
RunSeconds = Annotated[
    float | None, Field(gt=0, allow_inf_nan=False, description="fail if it takes longer, s")
]
Particles = Annotated[int, Field(ge=2)]


class EstimateOptions(_Strict):
    """How to estimate."""

    method: Literal["rbps-em", "ps-em", "rts-em"] = "rbps-em"
    particles: Particles = 50
    trajectories: Particles | None = Field(
        default=None, description="null means as many as particles"
    )
    iterations: int = Field(default=100, ge=1)
    seed: Seed = 0
    standard_errors: bool = Field(default=True, description="takes about as long as the rest")
    starts: int = Field(default=1, ge=1, description="the best of so many starts is taken")
    bootstrap: int = Field(
        default=0, ge=0, description="standard errors from so many estimations on simulated data"
    )


class SmoothOptions(_Strict):
    """How to smooth."""

    particles: Particles = 200
    trajectories: Particles | None = Field(
        default=None, description="null means as many as particles"
    )
    seed: Seed = 0


class SimulateOptions(_Strict):
    """`free-run` has no noise; `stochastic` draws the model's noise."""

    mode: Literal["free-run", "stochastic"] = "stochastic"
    samples: int | None = Field(default=None, ge=2, description="length, where no u gives it")
    seed: Seed = 0


class DiagnoseOptions(_Strict):
    """What to look for, and how sure to be."""

    alpha: float = Field(default=0.05, gt=0, lt=1, description="chance of an alarm without cause")
    effects: list[Annotated[str, Field(max_length=200)]] | None = Field(
        default=None, min_length=1, max_length=500, description="kinds or names; null means all"
    )
    max_effects: int = Field(default=3, ge=1, le=10, description="found in turn at most")
    seed: Seed = 0


class EstimateRequest(_Strict):
    """Maximum-likelihood estimation of the free parameters."""

    kind: Literal["estimate"]
    model: ModelChoice
    series: list[SeriesIn] = Field(min_length=1)
    parameters: EstimateParameters = EstimateParameters()
    options: EstimateOptions = EstimateOptions()
    run_seconds: RunSeconds = None


class SmoothRequest(_Strict):
    """Means and standard deviations of all states at given parameters."""

    kind: Literal["smooth"]
    model: ModelChoice
    series: list[SeriesIn] = Field(min_length=1)
    parameters: FixedParameters = FixedParameters()
    options: SmoothOptions = SmoothOptions()
    run_seconds: RunSeconds = None


class SimulateRequest(_Strict):
    """The model's response to inputs at given parameters."""

    kind: Literal["simulate"]
    model: ModelChoice
    series: list[InputIn] = Field(default_factory=list)
    parameters: FixedParameters = FixedParameters()
    options: SimulateOptions = SimulateOptions()
    run_seconds: RunSeconds = None


class DiagnoseRequest(_Strict):
    """What the model gets wrong on a series, why, and what an extension gains."""

    kind: Literal["diagnose"]
    model: ModelChoice
    series: list[SeriesIn] = Field(min_length=1, max_length=1)
    test: SeriesIn | None = Field(
        default=None, description="held-out data; null means the last fifth of the series"
    )
    parameters: DiagnoseParameters = DiagnoseParameters()
    options: DiagnoseOptions = DiagnoseOptions()
    run_seconds: RunSeconds = None


JobRequest = Annotated[
    EstimateRequest | SmoothRequest | SimulateRequest | DiagnoseRequest,
    Field(discriminator="kind"),
]

_NILE = [1120, 1160, 963, 1210, 1160, 1160, 813, 1230, 1370, 1140, 995, 935, 1110, 994, None]
_NILE += [960, 1180, 799, 958, 1140, 1100, 1210, 1150, 1250, 1260, 1220, 1030, 1100, 774, 840]
_NILE += [874, 694, 940, 833, 701, 916, 692]

EXAMPLES: dict[str, Any] = {
    "nile": {
        "summary": "Variances of the local-level model from Nile flows; 1885 is missing",
        "value": {
            "kind": "estimate",
            "model": "local-level",
            "series": [
                {
                    "y": [[flow] for flow in _NILE],
                    "dt": 1.0,
                }
            ],
            "parameters": {"start": {"q": 1000.0, "r": 10000.0}, "free": ["q", "r"]},
            "options": {"method": "rbps-em", "particles": 50, "iterations": 30, "seed": 1},
        },
    },
    "smooth": {
        "summary": "Smoothed states of the mixed fourth-order model, irregular time stamps",
        "value": {
            "kind": "smooth",
            "model": {"name": "mixed-4"},
            "series": [
                {
                    "y": [[0.1, 0.4], [0.2, None], [0.1, 0.1], [None, None], [0.3, -0.2]],
                    "t": [0.0, 1.0, 2.0, 3.5, 4.0],
                }
            ],
            "parameters": {"values": {"theta_2": 0.9}},
            "options": {"particles": 100, "seed": 3},
        },
    },
    "diagnose": {
        "summary": "What the local-level model leaves out of the Nile flows",
        "value": {
            "kind": "diagnose",
            "model": "local-level",
            "series": [{"y": [[flow] for flow in _NILE], "dt": 1.0}],
            "options": {"effects": ["step", "pulse", "ramp", "latent"], "seed": 1},
        },
    },
    "simulate": {
        "summary": "One draw of 50 samples from the linear second-order model",
        "value": {
            "kind": "simulate",
            "model": "linear-2",
            "parameters": {"values": {"theta": 0.2}},
            "options": {"mode": "stochastic", "samples": 50, "seed": 7},
        },
    },
}


# ---- answers --------------------------------------------------------------------------------


class Link(BaseModel):
    """A link of a document."""

    href: str
    rel: str
    title: str = ""


class JobStatus(BaseModel):
    """The state of one job."""

    jobID: str  # noqa: N815 - the name OGC API - Processes gives it
    kind: Kind
    model: str
    status: Status
    progress: int = Field(description="per cent", examples=[37])
    iteration: int
    iterations: int
    created: str = Field(examples=["2026-03-01T08:30:00.000Z"])
    started: str | None
    updated: str
    finished: str | None
    estimated_end: str | None = Field(description="where a running job will be done, by its rate")
    message: str
    estimate: dict[str, float] | None = Field(description="latest estimate")
    log_likelihood: float | None
    links: list[Link]


class JobList(BaseModel):
    """Jobs, newest first."""

    jobs: list[JobStatus]
    links: list[Link]


class Trace(BaseModel):
    """Every iteration; row 0 is the start."""

    iteration: list[int]
    theta: dict[str, list[float | None]]
    log_likelihood: list[float | None]
    ess: list[float | None]
    seconds: list[float | None]


class ParameterOut(BaseModel):
    """A parameter of a model; a bound that is null is infinite."""

    name: str
    unit: str
    default: float
    bounds: tuple[float | None, float | None]
    description: str


class ModelOut(BaseModel):
    """A registered model: channels and states with units, parameters, equations."""

    name: str
    description: str
    equations: list[str]
    nonlinear: dict[str, str]
    linear: dict[str, str]
    inputs: dict[str, str]
    outputs: dict[str, str]
    parameters: list[ParameterOut]
    example: dict[str, Any] = Field(description="a request for POST /jobs")
    links: list[Link]


class ModelList(BaseModel):
    """Registered models, and plug-ins that could not be loaded."""

    models: list[ModelOut]
    broken_plugins: dict[str, str]
    links: list[Link]


class ProblemOut(BaseModel):
    """RFC 9457."""

    type: str
    title: str
    status: int
    detail: str
    errors: list[dict[str, Any]] | None = None


class Estimated(BaseModel):
    """An estimate; the standard error is null where it was not computed."""

    value: float
    standard_error: float | None
    unit: str
    fixed: bool = Field(default=False, description="true for a parameter that was not free")


class Uncertain(BaseModel):
    """A value with its Monte Carlo standard error."""

    value: float | None
    standard_error: float | None


class States(BaseModel):
    """Smoothed states of one series."""

    t: list[float]
    mean: dict[str, list[float | None]]
    standard_deviation: dict[str, list[float | None]]


class StatesOut(BaseModel):
    """Smoothed states of every series, with the states' units."""

    units: dict[str, str]
    series: list[States]


class Simulated(BaseModel):
    """Simulated outputs and states of one series."""

    t: list[float]
    y: dict[str, list[float]]
    states: dict[str, list[float]]
    rmse: float | None = Field(
        default=None, description="against the measured y, where there is one"
    )


class SimulationOut(BaseModel):
    """Simulated outputs and states of every series, with units."""

    units: dict[str, str]
    series: list[Simulated]


class Results(BaseModel):
    """What a job found; which members there are depends on its kind."""

    estimate: dict[str, Estimated] | None = None
    parameters: dict[str, float] | None = None
    outcome: str | None = None
    message: str | None = None
    log_likelihood: Uncertain | None = None
    trace: Trace | None = None
    states: StatesOut | None = None
    simulation: SimulationOut | None = None
    diagnosis: dict[str, Any] | None = Field(
        default=None, description="verdict, causes, symptoms, extension, gain, detectable, page"
    )
    starts: list[dict[str, Any]] | None = Field(default=None, description="each start's outcome")
    bootstrap: dict[str, Any] | None = Field(default=None, description="estimates, quantiles")
