"""The JSON that goes in: strict, so that a mistake is told and not guessed around."""

from __future__ import annotations

from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    WithJsonSchema,
    WrapSerializer,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from engine.arrays import Array
from engine.diagnose import LEAST_ALPHA

# ---- tables of numbers ----------------------------------------------------------------------


_NUMBERS = {int, float, type(None)}


def _table(value: Any) -> Any:
    """[[1.0, null], ...] or [1.0, null, ...] -> float array (T, n), null as NaN."""
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list):
        raise PydanticCustomError("table", "a list of rows of numbers is needed")
    kinds = set(map(type, value))
    if kinds and kinds <= _NUMBERS:  # without a list for each of what may be a million
        return _floats(value).reshape(-1, 1)
    rows = value if list in kinds else [[cell] for cell in value]
    if not set(map(type, rows)) <= {list}:
        at = next(i for i, row in enumerate(rows) if not isinstance(row, list))
        raise PydanticCustomError("table", "row {row} is not a list as the others are", {"row": at})
    if len(set(map(len, rows))) > 1:
        at = next(i for i, row in enumerate(rows) if len(row) != len(rows[0]))
        raise PydanticCustomError(
            "table",
            "row {row} has {n} values where row 0 has {first}",
            {"row": at, "n": len(rows[at]), "first": len(rows[0])},
        )
    if not set(map(type, chain.from_iterable(rows))) <= _NUMBERS:
        for i, row in enumerate(rows):
            for j, cell in enumerate(row):
                if type(cell) not in _NUMBERS:
                    raise PydanticCustomError(
                        "table",
                        "row {row}, channel {channel} is {what}; a number or null is needed",
                        {"row": i, "channel": j, "what": f"{cell!r:.40}"},
                    )
    return _floats(rows).reshape(len(rows), len(rows[0]) if rows else 0)


def _floats(cells: list[Any]) -> Array:
    try:
        return np.array(cells, dtype=float)
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


# Of a long list that is wrong throughout, the first mistake is told; a million would be worked on for long.
_FIRST = Field(fail_fast=True)


class _Strict(BaseModel):
    """No guesses; what stands below a member is its description."""

    model_config = ConfigDict(
        extra="forbid", strict=True, arbitrary_types_allowed=True, use_attribute_docstrings=True
    )


# ---- requests -------------------------------------------------------------------------------


MOST_NOTES, LONGEST_NOTE = 200, 2000  # of how files were read, and letters of each

Number = Annotated[float, Field(allow_inf_nan=False)]
Values = dict[Annotated[str, Field(max_length=200)], Number]
Names = Annotated[list[Annotated[str, Field(max_length=200)]], _FIRST]


TimeUnit = Annotated[str, Field(min_length=1, max_length=20, pattern=r"^[^\W\d_]+$")]


class SettingIn(_Strict):
    """The data for which effects were made: typical sizes by channel, first and last time, time step.

    `substeps` is the number of steps from one sample to the next that the model makes.
    """

    scale: Values = Field(default_factory=dict)
    span: list[Number] = Field(min_length=2, max_length=2)
    dt: float = Field(gt=0, allow_inf_nan=False)
    substeps: int = Field(default=1, ge=1, le=64)
    time_unit: TimeUnit = "s"
    later: list[Number] = Field(default_factory=list, max_length=1000)
    """times at which further records begin, where a step may end with its record"""
    starts: list[Number] = Field(default_factory=list, max_length=1000)
    """times from which a drift counts anew"""

    @field_validator("span")
    @classmethod
    def _ordered(cls, span: list[float]) -> list[float]:
        if not span[0] < span[1]:
            raise PydanticCustomError("span", "the last time is not after the first")
        return span


class ModelReference(_Strict):
    """A registered model, by name; `with` lists effects added to it, for data as `setting` has them."""

    model_config = ConfigDict(serialize_by_alias=True)
    name: str = Field(max_length=200)
    effects: Names = Field(default_factory=list, alias="with", max_length=20)
    setting: SettingIn | None = None
    """null means the span and time step of the first series"""
    source: str | None = Field(default=None, max_length=64)
    """SHA-256 of the file of a model of one's own; the service puts it in, and refuses to compute with
    another version of the file"""


def _model_reference(value: Any) -> Any:
    return {"name": value} if isinstance(value, str) else value


ModelChoice = Annotated[
    ModelReference,
    BeforeValidator(
        _model_reference,
        json_schema_input_type=Annotated[str, Field(max_length=200)] | ModelReference,
    ),
]


# The signs are those of effects and models: extra-input:NAME->STATE, MODEL+EFFECT.
ExtraName = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^+:>]*$")]


class _Timed(_Strict):
    dt: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """time step, in time_unit"""
    t: Annotated[list[float], _FIRST] | None = None
    """time stamps, increasing; instead of dt"""
    time_unit: TimeUnit = "s"
    """unit of time, such as min or year: a label, which changes printed units and no number"""

    @model_validator(mode="after")
    def _one_clock(self) -> _Timed:
        if self.dt is not None and self.t is not None:
            raise PydanticCustomError("clock", "dt and t are both given; choose one")
        return self


Hold = Literal["zoh", "foh", "past"]


class _Recorded(_Timed):
    hold: Hold = "zoh"
    """what inputs do between samples: held until the next one (zoh), on a straight line to it (foh), or
    held at a row's value since the row before (past)"""
    extra: dict[ExtraName, Annotated[list[Number], _FIRST]] | None = Field(
        default=None, max_length=50
    )
    """channels by name that were recorded beside y and u, without gaps; a diagnosis asks whether the
    model should use them. A model that has inputs of these names takes them from here"""


class SeriesIn(_Recorded):
    """Measured data: y (T, ny) with null where a value is missing, u (T, nu) without gaps."""

    y: Table
    u: Table | None = None


class InputIn(_Recorded):
    """What drives a simulation: u (T, nu); y, where measured, is what a free run starts from."""

    u: Table | None = None
    y: Table | None = None


class DiagnoseParameters(_Strict):
    """Where the model's own estimation starts and what it may change."""

    start: Values = Field(default_factory=dict)
    """start values by name; parameters that are not named start at their defaults"""
    free: Names | None = Field(default=None, min_length=1)
    """parameters to estimate; null means all"""

    @field_validator("free")
    @classmethod
    def _once(cls, free: list[str] | None) -> list[str] | None:
        twice = next((name for name in free or () if (free or []).count(name) > 1), None)
        if twice is not None:
            raise PydanticCustomError("twice", "'{name}' is named twice", {"name": twice})
        return free


class EstimateParameters(DiagnoseParameters):
    """Where the estimation starts and what it may change."""

    ranges: dict[Annotated[str, Field(max_length=200)], Annotated[list[Number], _FIRST]] = Field(
        default_factory=dict
    )
    """where further starts are drawn, name: [low, high]"""

    @field_validator("ranges")
    @classmethod
    def _ordered(cls, ranges: dict[str, list[float]]) -> dict[str, list[float]]:
        for name, values in ranges.items():
            if len(values) != 2 or values[0] > values[1]:
                raise PydanticCustomError("range", "{name} needs [low, high]", {"name": name})
        return ranges


class FixedParameters(_Strict):
    """Values of the model's parameters, in their units."""

    values: Values = Field(default_factory=dict)
    """values by name; parameters that are not named have their defaults"""


Seed = Annotated[
    int,
    Field(
        ge=0,
        lt=2**63,
        description="seed of random numbers; the same seed gives the same result to the last bit",
    ),
]
RunSeconds = Annotated[
    float | None,
    Field(gt=0, allow_inf_nan=False, description="the job fails if it takes longer, s"),
]
Particles = Annotated[int, Field(ge=2)]
Substeps = Annotated[
    int,
    Field(
        ge=1,
        le=64,
        description="steps that differential equations make from one sample to the next",
    ),
]


def _spread(runs: int) -> int:
    if runs == 1:
        raise ValueError("1 run shows no spread; 2 or more are needed, or 0 for none")
    return runs


Bootstrap = Annotated[
    int, Field(ge=0, json_schema_extra={"not": {"const": 1}}), AfterValidator(_spread)
]
Trajectories = Annotated[Particles | None, Field(description="null means as many as particles")]


class EstimateOptions(_Strict):
    """Options of an estimation: method, particles, iterations, starts, standard errors."""

    method: Literal["quasi-newton", "simulation", "rbps-em", "ps-em", "rts-em"] = "quasi-newton"
    """maximum likelihood by steps on the log-likelihood, or by EM: with Rao-Blackwellized particles,
    with particles alone, or exact, for linear models; simulation: least squares on the simulation
    without noise"""
    first: Literal["none", "simulation"] = "none"
    """simulation: iterations leave from the least-squares fit of the simulation"""
    particles: Particles = 50
    trajectories: Trajectories = None
    iterations: int = Field(default=100, ge=1)
    seed: Seed = 0
    standard_errors: bool = True
    """whether to compute them, which takes about as long as the rest"""
    intervals: Literal["likelihood-ratio", "symmetric"] = "symmetric"
    """how the 95 % intervals are computed. Symmetric ones cost nothing more, but cover too little where
    the log-likelihood is far from quadratic. By the likelihood ratio they take several times as long as
    all the rest"""
    starts: int = Field(default=1, ge=1)
    """the best of this many starts is taken. Around the first a better one is searched for; the others climb
    from where they are"""
    bootstrap: Bootstrap = 0
    """standard errors from this many estimations on simulated data; 0 for none"""
    substeps: Substeps = 1


class SmoothOptions(_Strict):
    """Options of smoothing: numbers of particles and trajectories."""

    particles: Particles = 200
    trajectories: Trajectories = None
    seed: Seed = 0


class SimulateOptions(_Strict):
    """`free-run` has no noise; `stochastic` draws the model's noise."""

    mode: Literal["free-run", "stochastic"] = "stochastic"
    samples: int | None = Field(default=None, ge=2)
    """number of samples, where no u gives it"""
    seed: Seed = 0
    substeps: Substeps = 1


class DiagnoseOptions(_Strict):
    """What to look for, and how sure to be."""

    alpha: float = Field(default=0.05, ge=LEAST_ALPHA, lt=1)
    """probability of an alarm where nothing is wrong"""
    effects: Names | None = Field(default=None, min_length=1, max_length=500)
    """kinds or names of effects to look for; null means all"""
    max_effects: int = Field(default=3, ge=1, le=10)
    """upper limit on effects found in turn; more than two mean an unknown cause"""
    held_out: float = Field(default=0.2, ge=0, le=0.5)
    """share that judges what is found and is not searched: the last part of the longest series, or whole ones
    of many (one of five); 0 searches all. Not with `test`, which decides then."""
    seed: Seed = 0


# A tag stands in lists that commas part; a name of a file in a line.
Tag = Annotated[str, Field(min_length=1, max_length=50, pattern=r"^[^,\x00-\x1f]*[^,\s]$")]
Tags = Annotated[list[Tag], Field(max_length=20)]
JobName = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f]*$")]


class _Labelled(_Strict):
    """Labels by which jobs are told apart in a list; no computation uses them."""

    name: JobName = ""
    """a name for the job, shown in lists and reports"""
    tags: Tags = Field(default_factory=list)
    """words by which the job is found in the list"""
    data: list[JobName] = Field(default_factory=list, max_length=100)
    """names of the files that the data are from; an upload puts them in"""
    notes: list[Annotated[str, Field(max_length=LONGEST_NOTE)]] = Field(
        default_factory=list, max_length=MOST_NOTES
    )
    """what is to be known of how these were read; an upload puts it in, and results have it"""


class LabelsIn(_Strict):
    """Another name of a job, other tags; null leaves what there is."""

    name: JobName | None = None
    tags: Tags | None = None


class ResumeIn(_Strict):
    """How long a job may take from now on, and how many iterations it may make; null leaves either."""

    run_seconds: RunSeconds = None
    iterations: Annotated[int, Field(ge=1)] | None = None
    """of an estimation from one start without a bootstrap, in all: more than it has made. With them one
    that is successful and used its iterations up goes on, too"""


def _tests(value: Any) -> Any:
    if value is None:
        return []
    return value if isinstance(value, list) else [value]


def _as_asked(tests: Any, handler: SerializerFunctionWrapHandler) -> Any:
    """None and one series as they are sent, several as a list."""
    every = handler(tests)
    return every if len(every) > 1 else every[0] if every else None


Tests = Annotated[
    list[SeriesIn],
    BeforeValidator(_tests, json_schema_input_type=SeriesIn | list[SeriesIn] | None),
    WrapSerializer(_as_asked),
]


class _Job(_Labelled):
    """What every job is asked with."""

    model: ModelChoice
    run_seconds: RunSeconds = None


class _OnData(_Job):
    """What a job with measured data is asked with."""

    series: Annotated[list[SeriesIn], _FIRST] = Field(min_length=1)


class EstimateRequest(_OnData):
    """Maximum-likelihood estimation of the free parameters."""

    kind: Literal["estimate"]
    test: Tests = []
    """held-out data, one series or several, on which the error of the estimate is measured"""
    parameters: EstimateParameters = EstimateParameters()
    options: EstimateOptions = EstimateOptions()


class SmoothRequest(_OnData):
    """Means and standard deviations of all states at given parameters."""

    kind: Literal["smooth"]
    parameters: FixedParameters = FixedParameters()
    options: SmoothOptions = SmoothOptions()


class SimulateRequest(_Job):
    """The model's response to inputs at given parameters."""

    kind: Literal["simulate"]
    series: Annotated[list[InputIn], _FIRST] = Field(default_factory=list)
    parameters: FixedParameters = FixedParameters()
    options: SimulateOptions = SimulateOptions()


class DiagnoseRequest(_OnData):
    """What the model gets wrong on one or several series, why, and what an extension gains."""

    kind: Literal["diagnose"]
    test: Tests = []
    """held-out data, one series or several; none means a part of them, as `held_out` says"""
    parameters: DiagnoseParameters = DiagnoseParameters()
    options: DiagnoseOptions = DiagnoseOptions()


class InformationIn(_Strict):
    """Information of a record on some parameters: the inverse (n, n) of their covariance."""

    free: list[Annotated[str, Field(max_length=200)]] = Field(min_length=1, max_length=200)
    matrix: list[Annotated[list[Number], Field(max_length=200)]] = Field(max_length=200)


CauseIn = dict[Annotated[str, Field(max_length=200)], Number | InformationIn]


class DesignOptions(_Strict):
    """Causes to tell apart, and the bounds of the experiment."""

    causes: dict[Annotated[str, Field(max_length=200)], Number | CauseIn] = Field(
        min_length=1, max_length=20
    )
    """effects with their sizes, or with values of their own and the model's parameters by name, and the
    information that a record gave of them"""
    bounds: dict[str, Any]
    """inputs: {name: {low, high, rate, forbidden, start}}, states and outputs: {name: [low, high]}, dt,
    time_unit, sigmas, hold, substeps. Times, rates and frequencies are in time_unit. Where dt, time_unit or
    substeps are left out, they are those of the model's setting"""
    length: int = Field(ge=30, le=20_000)
    """number of samples of the experiment"""
    alarm: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """statistic from which a diagnosis sees something, as the threshold of an earlier one's first
    round; null where there is none"""
    measured: Names | None = Field(default=None, min_length=1)
    """outputs that are measured; null means all"""
    inputs: int = Field(default=400, ge=1, le=5000)
    """how many inputs are tried"""
    seed: Seed = 0


class DesignRequest(_Job):
    """The input within bounds that tells causes apart."""

    kind: Literal["design"]
    series: Annotated[list[InputIn], _FIRST] = Field(default_factory=list, max_length=0)
    """none is needed"""
    parameters: DiagnoseParameters = DiagnoseParameters()
    options: DesignOptions

    @property
    def bounds(self) -> dict[str, Any]:
        """The bounds; what they leave out is as in the data for which the effects were made."""
        known = {} if self.model.setting is None else self.model.setting.model_dump()
        given = {name: value for name, value in self.options.bounds.items() if value is not None}
        return {
            name: known[name] for name in ("dt", "substeps", "time_unit") if name in known
        } | given


Request = EstimateRequest | SmoothRequest | SimulateRequest | DiagnoseRequest | DesignRequest
JobRequest = Annotated[Request, Field(discriminator="kind")]
