"""From a request to what the engine takes; everything wrong with it is a 422 naming the field."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from engine.data.given import check_apart, check_enough, same_clock
from engine.data.joined import in_turn, longest_of, overlapping
from engine.data.series import Series
from engine.design import Bounds
from engine.design.candidates import before_any
from engine.diagnose.effects.catalogue import effect_kinds, extend
from engine.diagnose.effects.setting import Setting
from engine.diagnose.records import check_held_out, check_searched
from engine.errors import EngineError, OptionError, SeriesError
from engine.models.registry import get_model, source_of
from engine.statespace.model import Array, MixedModel, Theta
from service.problems import Problem, invalid
from service.schemas import (
    DesignRequest,
    DiagnoseRequest,
    EstimateOptions,
    EstimateRequest,
    FixedParameters,
    InputIn,
    JobRequest,
    ModelReference,
    Request,
    SeriesIn,
    SimulateOptions,
    SimulateRequest,
)
from service.settings import Settings

ADAPTER: TypeAdapter[Request] = TypeAdapter(JobRequest)
ELSEWHERE = "elsewhere"  # with a model whose functions are not here: what calls them where they are
T = TypeVar("T")


@dataclass(frozen=True)
class Prepared:
    """A checked request: what the engine's functions take."""

    request: Request
    model: MixedModel
    series: list[Series]
    theta: Theta
    free: list[str] | None = None
    test: Sequence[Series] = ()

    @property
    def time_unit(self) -> str:
        """What times count."""
        return self.series[0].time_unit


def prepare(request: Request) -> Prepared:
    """Check a request against its model. Raises Problem 422."""
    k = (
        1 if isinstance(request, DiagnoseRequest) else _substeps(request)
    )  # a diagnosis finds its own
    model = find_model(_of_steps(request.model, k), lambda model: _times(request, model, k))
    parameters = request.parameters
    free: list[str] | None = None
    if isinstance(parameters, FixedParameters):
        with _at("parameters.values"):
            theta = model.theta(parameters.values)
    else:
        free = parameters.free
        with _at("parameters.start"):
            theta = model.theta(parameters.start)
        with _at("parameters.free"):
            model.free_indices(free)
    test: list[Series] = []
    if isinstance(request, EstimateRequest | DiagnoseRequest):
        test = _all_series(request.test, model, "test", numbered=len(request.test) > 1)
    if isinstance(request, DiagnoseRequest):
        check_effects(request.options.effects)
        with _at("options"):
            check_held_out(request.options.held_out, bool(test))
    if isinstance(request, EstimateRequest):
        check_method(request.options)
        with _at("parameters.ranges"):
            for name, (low, high) in request.parameters.ranges.items():
                model.theta({name: low})
                model.theta({name: high})
    match request:
        case DesignRequest():
            _check_design(request, model, theta)
            series = []
        case SimulateRequest():
            series = _inputs(request, model)
        case _:
            series = _all_series(request.series, model, "series")
    if isinstance(request, EstimateRequest | DiagnoseRequest):
        with _at("series"):
            check_apart(series)
        with _at("test" if test else "series"):
            same_clock([*series, *test])
            check_apart(series, test)
    if isinstance(request, EstimateRequest):
        with _at("series"):
            check_enough(series, len(model.free_indices(free)))
    if isinstance(request, DiagnoseRequest):
        longest = longest_of(series)
        with _at(f"series[{longest}].y"):
            check_searched(series[longest], [one for one in series if one is not series[longest]])
    if k > 1 and not model.continuous:
        raise invalid("options.substeps", one_step(model, k))
    series = _on_one_clock(request.model, series)
    series = [one.refined(k) for one in series]
    test = [one.refined(k) for one in test]
    return Prepared(request, model, series, theta, free, test)


def _on_one_clock(reference: ModelReference, series: list[Series]) -> list[Series]:
    """Records in turn where the effects were made so, of records whose own clocks overlap."""
    later = reference.setting.later if reference.effects and reference.setting else []
    return in_turn(series) if later and overlapping(series) else series


def _substeps(request: Request) -> int:
    """Steps a sample: as many as an extended model makes, or as are asked for, if these are more."""
    reference = request.model
    own = reference.setting.substeps if reference.effects and reference.setting else 1
    asked = request.options
    return max(own, asked.substeps) if isinstance(asked, EstimateOptions | SimulateOptions) else own


def _of_steps(reference: ModelReference, k: int) -> ModelReference:
    """The reference, its effects made for ``k`` steps a sample."""
    if reference.setting is None or not reference.effects:
        return reference
    setting = reference.setting.model_copy(update={"substeps": k})
    return reference.model_copy(update={"setting": setting})


def one_step(model: MixedModel, k: int) -> str:
    """Why it does not make ``k`` steps a sample."""
    return f"{k}; model '{model.name}' does not declare a real time step and makes one a sample"


def load(document: Any) -> Prepared:
    """The same from a stored request."""
    return prepare(ADAPTER.validate_python(document))


def check_limits(request: Request, settings: Settings) -> None:
    """Raise Problem 422 where a request is larger than the settings allow."""
    samples = 0
    series: Sequence[SeriesIn | InputIn] = request.series
    if isinstance(request, EstimateRequest | DiagnoseRequest):
        series = [*request.series, *request.test]
    for i, one in enumerate(series):
        rows = max((len(x) for x in (one.y, one.u) if x is not None), default=0)
        samples += rows * _substeps(request)
        _limit(f"series[{i}]", "samples in all series", samples, settings.max_samples)
    _limit("series", "series", len(request.series), settings.max_series)
    options = request.options.model_dump()
    for name, most in (
        ("particles", settings.max_particles),
        ("trajectories", settings.max_particles),
        ("iterations", settings.max_iterations),
        ("samples", settings.max_samples),
        ("starts", settings.max_tasks),
        ("bootstrap", settings.max_tasks),
    ):
        _limit(f"options.{name}", name, options.get(name) or 0, most)
    if isinstance(request, EstimateRequest):
        _check_cost(request.options, samples, settings.max_cost)


def _check_cost(options: EstimateOptions, samples: int, most: float) -> None:
    """Refuse a study that would cost more than the settings allow; one run alone is limited by its time."""
    runs = options.starts + options.bootstrap
    exact = options.method == "rts-em"
    particles = 2 if exact else options.particles + (options.trajectories or options.particles)
    cost = samples * options.iterations * particles
    if runs > 1 and runs * cost > most:
        field = "bootstrap" if options.bootstrap > options.starts else "starts"
        raise invalid(
            f"options.{field}",
            f"{runs} estimations of {samples} samples x {options.iterations} iterations x {particles} "
            f"particles and trajectories; this service allows {int(most // max(cost, 1))} of that size",
        )


def _limit(field: str, what: str, value: int, most: int) -> None:
    if value > most:
        raise invalid(field, f"{value} {what}; this service allows {most}")


def find_model(
    reference: ModelReference, known: Callable[[MixedModel], Setting | None]
) -> MixedModel:
    """The registered model with the effects asked for; ``known`` is what data tell where it does not."""
    try:
        model = get_model(reference.name)
    except OptionError as error:
        raise invalid("model", str(error)) from None
    if reference.source is not None and reference.source != source_of(reference.name):
        raise invalid(
            "model.source",
            f"the file of model '{reference.name}' is not the one this job was made with; send the job "
            "again, without source, to use the file as it is now",
        )
    try:
        return extended(model, reference, known)
    except EngineError as error:
        raise invalid("model.with", str(error)) from None


def extended(
    model: MixedModel,
    reference: ModelReference,
    known: Callable[[MixedModel], Setting | None] = lambda model: None,
) -> MixedModel:
    """A model with the effects of a reference to it. Raises EngineError."""
    if not reference.effects:
        return model
    return _called(_extended, model, reference.effects, _given(reference, model) or known(model))


def _extended(model: MixedModel, effects: Sequence[str], setting: Setting | None) -> MixedModel:
    return extend(model, effects, setting and replace(setting, model=model))


def _called(call: Callable[..., T], model: MixedModel, *args: Any) -> T:
    """``call(model, *args)``, where the model's functions are, see :mod:`service.own_models`."""
    there = model.derived.get(ELSEWHERE)
    found: T = call(model, *args) if there is None else there(call, *args)
    return found


def _given(reference: ModelReference, model: MixedModel) -> Setting | None:
    """What effects need to know of data, as a diagnosis gave it."""
    if (given := reference.setting) is None:
        return None
    if given.substeps > 1 and not model.continuous:
        raise invalid("model.setting.substeps", one_step(model, given.substeps))
    span = given.span[0], given.span[1]
    return Setting(
        model,
        given.scale,
        span,
        given.dt,
        substeps=given.substeps,
        time_unit=given.time_unit,
        later=tuple(given.later),
        starts=tuple(given.starts),
    )


def _times(request: Request, model: MixedModel, k: int) -> Setting | None:
    """The same from the first series' times, for ``k`` steps a sample."""
    one: SeriesIn | InputIn = request.series[0] if request.series else InputIn()
    n = max((len(x) for x in (one.y, one.u, one.t) if x is not None), default=0)
    if n < 2:
        return None
    if one.t is None:
        dt = one.dt or 1.0
        return Setting(model, {}, (0.0, dt * (n - 1)), dt, substeps=k, time_unit=one.time_unit)
    steps = np.diff(one.t)
    if not (np.isfinite(one.t).all() and (steps > 0.0).all()):
        return None  # the series is refused next, with the row
    span, dt = (one.t[0], one.t[-1]), float(np.median(steps))
    return Setting(model, {}, span, dt, substeps=k, time_unit=one.time_unit)


def check_method(options: EstimateOptions) -> None:
    """Raise Problem 422 for options that the method has no use for."""
    if options.method != "simulation":
        return
    if options.first == "simulation":
        raise invalid(
            "options.first", "the method is the fit of the simulation itself; leave it out"
        )
    for name, value, none in (("starts", options.starts, 1), ("bootstrap", options.bootstrap, 0)):
        if value != none:
            raise invalid(
                f"options.{name}",
                f"the method simulation tries starts of its own and has no bootstrap; leave {name} out",
            )


def _check_design(request: DesignRequest, model: MixedModel, theta: Theta) -> None:
    """Raise Problem 422 for bounds or causes that cannot be used, naming the field."""
    options = request.options
    try:
        bounds = Bounds.of(request.bounds)
        bounds.check(model)
        if bounds.dt is None:
            raise OptionError("bounds.dt is missing: the time between samples", "bounds.dt")
        causes = options.model_dump()["causes"]
        free = request.parameters.free
        _called(
            _check_causes, model, causes, theta, bounds.dt, free, options.alarm, options.measured
        )
    except OptionError as error:
        raise invalid(f"options.{error.field or 'causes'}", str(error)) from None
    except EngineError as error:
        raise invalid("options.causes", str(error)) from None


def _check_causes(*args: Any) -> None:
    before_any(*args)


def check_effects(effects: Sequence[str] | None) -> None:
    """Raise Problem 422 for an effect of a kind there is not."""
    known = effect_kinds()
    for i, name in enumerate(effects or ()):
        if name.partition(":")[0] not in known:
            raise invalid(
                f"options.effects[{i}]", f"'{name}' is not known; kinds are {', '.join(known)}"
            )


def _series(one: SeriesIn, model: MixedModel, where: str) -> Series:
    """Measured data with the model's channel names, so that messages use them."""
    u, extra = _with_inputs(one, model, where)
    if model.nu and u is None:
        inputs = ", ".join(model.inputs)
        raise invalid(f"{where}.u", f"is missing; model '{model.name}' has inputs ({inputs})")
    for name, table, channels in (("y", one.y, model.outputs), ("u", u, model.inputs)):
        if table is not None and len(table) and table.shape[1] != len(channels):
            there = f"{len(channels)} ({', '.join(channels) or 'none'})"
            width = f"rows have {table.shape[1]} values; model '{model.name}' needs {there}"
            raise invalid(f"{where}.{name}", width, row=0)
    with _at(where):
        return Series(
            one.y,
            u if model.nu else None,
            t=one.t,
            y_names=tuple(model.outputs),
            u_names=tuple(model.inputs),
            dt=one.dt,
            extra=np.column_stack(list(extra.values())) if extra else None,
            extra_names=tuple(extra) or None,
            hold=one.hold,
            time_unit=one.time_unit,
        ).check(model)


def _all_series(
    every: Sequence[SeriesIn], model: MixedModel, where: str, numbered: bool = True
) -> list[Series]:
    return [
        _series(one, model, f"{where}[{i}]" if numbered else where) for i, one in enumerate(every)
    ]


def _with_inputs(
    one: SeriesIn, model: MixedModel, where: str
) -> tuple[Array | None, dict[str, list[float]]]:
    """u with those extra channels behind it that the model has as inputs; the other extra channels."""
    extra = dict(one.extra or {})
    for name, column in extra.items():
        if len(column) != len(one.y):
            raise invalid(
                f"{where}.extra", f"'{name}' has {len(column)} rows and y has {len(one.y)}"
            )
        if name in {**model.outputs, **model.nonlinear, **model.linear}:
            raise invalid(
                f"{where}.extra", f"'{name}' is the name of a channel of model '{model.name}'"
            )
    added = [extra.pop(name) for name in model.inputs if name in extra]
    if not added:
        return one.u, extra
    own = np.zeros((len(one.y), 0)) if one.u is None else one.u
    if len(own) != len(one.y):
        raise invalid(f"{where}.u", f"u has {len(own)} rows and y has {len(one.y)}")
    return np.column_stack([own, *added]), extra


def _inputs(request: SimulateRequest, model: MixedModel) -> list[Series]:
    """Series to simulate over; y is NaN where the request has none."""
    if not request.series and request.options.samples is None:
        raise invalid("options.samples", "is needed where no series gives the length")
    out = []
    for i, one in enumerate(request.series or [InputIn()]):
        where = f"series[{i}]"
        lengths = [len(x) for x in (one.u, one.y, one.t) if x is not None]
        n = lengths[0] if lengths else request.options.samples
        if n is None:
            raise invalid(where, "nothing gives the length; pass u, t or options.samples")
        if request.options.samples not in (None, n):
            raise invalid("options.samples", f"{request.options.samples}; {where} has {n} rows")
        y = one.y if one.y is not None else np.zeros((n, model.ny))
        measured = SeriesIn.model_construct(y=y, **{k: v for k, v in one if k != "y"})
        out.append(_series(measured, model, where))
        if one.y is None:
            out[-1] = out[-1].masked(np.arange(n))
    return out


@contextmanager
def _at(where: str) -> Iterator[None]:
    """Engine errors become problems about the field ``where``, with row and channel if named."""
    try:
        yield
    except SeriesError as error:
        text = str(error)
        part = re.match(r"(y|u|t|dt|extra)\b", text)
        more: dict[str, Any] = {}
        if row := re.search(r"\brow (\d+)", text):
            more["row"] = int(row[1])
        if channel := re.search(r"channel '([^']+)'", text):
            more["channel"] = channel[1]
        raise invalid(f"{where}.{part[1]}" if part else where, text, **more) from None
    except OptionError as error:
        raise invalid(f"{where}.{error.field}" if error.field else where, str(error)) from None
    except EngineError as error:
        raise Problem(422, "validation", str(error)) from None
