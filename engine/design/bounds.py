"""What an experiment may do: the inputs' range, rate and forbidden values, limits on states and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, TypeAlias

import numpy as np

from engine.data.hold import HOLDS
from engine.errors import OptionError, check_count
from engine.json_values import plain
from engine.statespace.model import MixedModel
from engine.units import SECOND

Band: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class InputBounds:
    """Limits on one input of an experiment.

    Parameters
    ----------
    low, high : float
        The range of its values, in its unit.
    rate : float, optional
        Largest change in a unit of time (``Bounds.time_unit``), in the input's unit; no limit by default.
    forbidden : sequence of (float, float)
        Open bands of values that it must not take, in its unit; it may jump over one within a sample.
    stopbands : sequence of (float, float)
        Bands of frequency, in cycles per unit of time, that it must not excite: at most 1 % of its power about
        its mean lies in them.
    start : float, optional
        Value before the record, from which ``rate`` counts; any allowed value by default.
    """

    low: float
    high: float
    rate: float | None = None
    forbidden: tuple[Band, ...] = ()
    start: float | None = None
    stopbands: tuple[Band, ...] = ()


@dataclass(frozen=True)
class Bounds:
    """Limits that a designed experiment keeps.

    Parameters
    ----------
    inputs : mapping
        {name: InputBounds, or (low, high), or a mapping of its fields}, with every input of the model.
    states, outputs : mapping
        {name: (low, high)}, in its unit: limits that hold whichever of the causes is the true one. None in
        place of a number is no limit on that side.
    dt : float, optional
        Time between samples, in ``time_unit``, positive; that of the diagnosed record by default.
    sigmas : float
        Distance to the limits in standard deviations of the simulation, from process noise and first state.
    hold : str, optional
        What inputs do between samples, see :class:`engine.Series`; as in the diagnosed record by default, or
        "zoh".
    substeps : int, optional
        Steps of the model in a sample; as in the diagnosis by default, or 1.
    time_unit : str, optional
        Unit that times, rates and frequencies are in; that of the diagnosed record by default, or "s".

    Raises
    ------
    OptionError
        A value is of the wrong kind or impossible; ``field`` names it.
    """

    inputs: Mapping[str, InputBounds]
    states: Mapping[str, Band] = field(default_factory=dict)
    outputs: Mapping[str, Band] = field(default_factory=dict)
    dt: float | None = None
    sigmas: float = 2.0
    hold: str | None = None
    substeps: int | None = None
    time_unit: str | None = None

    def __post_init__(self) -> None:
        given = _mapping(self.inputs, "bounds.inputs")
        inputs = {name: _input(value, f"bounds.inputs.{name}") for name, value in given.items()}
        object.__setattr__(self, "inputs", inputs)
        for where in ("states", "outputs"):
            limits = _mapping(getattr(self, where), f"bounds.{where}")
            own = {name: _limit(value, f"bounds.{where}.{name}") for name, value in limits.items()}
            object.__setattr__(self, where, own)
        if self.dt is not None:
            _positive(self.dt, "bounds.dt", self.time_unit or SECOND)
        if not (_is_number(self.sigmas) and 0.0 <= self.sigmas < np.inf):
            raise refused("bounds.sigmas", f" = {self.sigmas}; a number from 0 on is needed")
        if self.hold is not None and self.hold not in HOLDS:
            raise refused("bounds.hold", f" = {self.hold!r}; one of {', '.join(HOLDS)} is needed")
        if self.substeps is not None:
            check_count("bounds.substeps", self.substeps)
        unit = self.time_unit
        if unit is not None and not (isinstance(unit, str) and unit.strip()):
            raise refused("bounds.time_unit", f" = {unit!r}; a unit such as 's' or 'h' is needed")

    @classmethod
    def of(cls, given: Bounds | Mapping[str, Any]) -> Bounds:
        """Bounds from a mapping of the fields, as a request or a file has them."""
        if isinstance(given, Bounds):
            return given
        own = _mapping(given, "bounds")
        _known(own, cls, "bounds")
        if "inputs" not in own:
            raise refused("bounds.inputs", " is missing: the range of every input is needed")
        return cls(**{name: value for name, value in own.items() if value is not None})

    def check(self, model: MixedModel) -> None:
        """Raise OptionError unless these are bounds of the model's own channels, of every input."""
        there: dict[str, Sequence[str]] = {
            "inputs": list(model.inputs),
            "states": [*model.nonlinear, *model.linear],
            "outputs": list(model.outputs),
        }
        for where, names in there.items():
            for name in getattr(self, where):
                if name not in names:
                    there_are = ", ".join(names) or "none"
                    raise refused(
                        f"bounds.{where}.{name}",
                        f": model '{model.name}' has no such channel; it has {there_are}",
                    )
        if not model.nu:
            raise OptionError(
                f"model '{model.name}' has no inputs: there is nothing to design", "bounds.inputs"
            )
        for name in model.inputs:
            if name not in self.inputs:
                said = " is missing: the range of every input is needed"
                raise refused(f"bounds.inputs.{name}", said)

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values; ``Bounds.of`` reads them."""
        document: dict[str, Any] = plain(asdict(self))
        return document


def refused(where: str, said: str) -> OptionError:
    """The error about a field, whose message begins with the field."""
    return OptionError(f"{where}{said}", where)


def finite(value: Any, where: str) -> float:
    """A field's value as a number. Raises OptionError."""
    if not (_is_number(value) and np.isfinite(value)):
        raise refused(where, f" = {value!r}; a finite number is needed")
    return float(value)


def _input(given: Any, where: str) -> InputBounds:
    if isinstance(given, InputBounds):
        own = vars(given)
    elif isinstance(given, Mapping):
        own = dict(given)
    else:
        own = dict(zip(("low", "high"), _pair(given, where), strict=True))
    _known(own, InputBounds, where)
    for name in ("low", "high"):
        if name not in own:
            raise refused(f"{where}.{name}", " is missing")
    low, high = (finite(own[name], f"{where}.{name}") for name in ("low", "high"))
    if not low < high:
        raise refused(f"{where}.low", f" = {low:g} is not below high = {high:g}")
    rate, start = own.get("rate"), own.get("start")
    if rate is not None:
        rate = _positive(rate, f"{where}.rate", "units per unit of time")
    bands = _bands(own.get("forbidden"), f"{where}.forbidden")
    if start is not None and not low <= finite(start, f"{where}.start") <= high:
        raise refused(f"{where}.start", f" = {start:g} is not within [{low:g}, {high:g}]")
    stop = _bands(own.get("stopbands"), f"{where}.stopbands")
    for i, (slowest, fastest) in enumerate(stop):
        if slowest < 0.0:
            said = f" = [{slowest:g}, {fastest:g}]: a frequency is negative"
            raise refused(f"{where}.stopbands[{i}]", said)
    out = InputBounds(low, high, rate, bands, start, stop)
    if start is not None and not allowed(out, start):
        raise refused(f"{where}.start", f" = {start:g} is within a forbidden band")
    if not any(allowed(out, value) for value in _edges(out)):
        raise refused(f"{where}.forbidden", f" leaves no value between {low:g} and {high:g}")
    return out


def allowed(bounds: InputBounds, value: float) -> bool:
    """Whether an input may take a value."""
    inside = any(low < value < high for low, high in bounds.forbidden)
    return bounds.low <= value <= bounds.high and not inside


def _edges(bounds: InputBounds) -> list[float]:
    """The ends of the range and of the bands: if any value is allowed, one of these is."""
    return [bounds.low, bounds.high, *(end for band in bounds.forbidden for end in band)]


def _bands(given: Any, where: str) -> tuple[Band, ...]:
    bands = []
    for i, ends in enumerate(given or ()):
        own = f"{where}[{i}]"
        low, high = (finite(end, own) for end in _pair(ends, own))
        if not low < high:
            raise refused(own, f" = [{low:g}, {high:g}]: its ends are not in order")
        bands.append((low, high))
    return tuple(bands)


def _limit(given: Any, where: str) -> Band:
    low, high = _pair(given, where)
    for end in (low, high):
        if end is not None and not (_is_number(end) and not np.isnan(end)):
            raise refused(where, f": {end!r} is no number")
    ends = (-np.inf if low is None else float(low), np.inf if high is None else float(high))
    if not ends[0] < ends[1]:
        raise refused(where, f" = [{low}, {high}]: its ends are not in order")
    return ends


def _mapping(given: Any, where: str) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise refused(where, f" = {given!r}; names with their bounds are needed")
    return dict(given)


def _pair(given: Any, where: str) -> tuple[Any, Any]:
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise refused(where, f" = {given!r}; [low, high] is needed")
    return given[0], given[1]


def _known(given: Mapping[str, Any], kind: type[Bounds | InputBounds], where: str) -> None:
    names = [one.name for one in fields(kind)]
    for name in given:
        if name not in names:
            raise refused(f"{where}.{name}", f" is not known; {', '.join(names)} are")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _positive(value: Any, where: str, unit: str) -> float:
    if not (_is_number(value) and 0.0 < value < np.inf):
        raise refused(where, f" = {value!r} {unit}; a positive number is needed")
    return float(value)
