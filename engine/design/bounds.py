"""What an experiment may do: the inputs' range, rate and forbidden values, limits on states and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import fields as dataclass_fields
from typing import Any, TypeAlias

import numpy as np

from engine.data.series import HOLDS
from engine.errors import OptionError, check_count
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
            raise OptionError(
                f"bounds.sigmas = {self.sigmas}; a number from 0 on is needed", "bounds.sigmas"
            )
        if self.hold is not None and self.hold not in HOLDS:
            raise OptionError(
                f"bounds.hold = {self.hold!r}; one of {', '.join(HOLDS)} is needed", "bounds.hold"
            )
        if self.substeps is not None:
            check_count("bounds.substeps", self.substeps)
        unit = self.time_unit
        if unit is not None and not (isinstance(unit, str) and unit.strip()):
            raise OptionError(
                f"bounds.time_unit = {unit!r}; a unit such as 's' or 'h' is needed",
                "bounds.time_unit",
            )

    @classmethod
    def of(cls, given: Bounds | Mapping[str, Any]) -> Bounds:
        """Bounds from a mapping of the fields, as a request or a file has them."""
        if isinstance(given, Bounds):
            return given
        fields = _mapping(given, "bounds")
        _known(fields, [one.name for one in dataclass_fields(cls)], "bounds")
        if "inputs" not in fields:
            raise OptionError(
                "bounds.inputs is missing: the range of every input is needed", "bounds.inputs"
            )
        return cls(**{name: value for name, value in fields.items() if value is not None})

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
                    raise OptionError(
                        f"bounds.{where}.{name}: model '{model.name}' has no such channel; it has "
                        f"{', '.join(names) or 'none'}",
                        f"bounds.{where}.{name}",
                    )
        if not model.nu:
            raise OptionError(
                f"model '{model.name}' has no inputs: there is nothing to design", "bounds.inputs"
            )
        for name in model.inputs:
            if name not in self.inputs:
                raise OptionError(
                    f"bounds.inputs.{name} is missing: the range of every input is needed",
                    f"bounds.inputs.{name}",
                )

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values; ``Bounds.of`` reads them."""
        return {
            "inputs": {
                name: {
                    "low": one.low,
                    "high": one.high,
                    "rate": one.rate,
                    "forbidden": [list(band) for band in one.forbidden],
                    "start": one.start,
                    "stopbands": [list(band) for band in one.stopbands],
                }
                for name, one in self.inputs.items()
            },
            **{
                where: {
                    name: [end if np.isfinite(end) else None for end in band]
                    for name, band in getattr(self, where).items()
                }
                for where in ("states", "outputs")
            },
            "dt": self.dt,
            "sigmas": self.sigmas,
            "hold": self.hold,
            "substeps": self.substeps,
            "time_unit": self.time_unit,
        }


def _input(given: Any, where: str) -> InputBounds:
    if isinstance(given, InputBounds):
        fields = dict(vars(given))
    elif isinstance(given, Mapping):
        fields = dict(given)
    else:
        fields = dict(zip(("low", "high"), _pair(given, where), strict=True))
    _known(fields, [one.name for one in dataclass_fields(InputBounds)], where)
    for name in ("low", "high"):
        if name not in fields:
            raise OptionError(f"{where}.{name} is missing", f"{where}.{name}")
        _number(fields[name], f"{where}.{name}")
    low, high = float(fields["low"]), float(fields["high"])
    if not low < high:
        raise OptionError(f"{where}.low = {low:g} is not below high = {high:g}", f"{where}.low")
    rate, start = fields.get("rate"), fields.get("start")
    if rate is not None:
        _positive(rate, f"{where}.rate", "units per unit of time")
    bands = tuple(
        _forbidden(band, f"{where}.forbidden[{i}]")
        for i, band in enumerate(fields.get("forbidden") or ())
    )
    if start is not None:
        _number(start, f"{where}.start")
        if not low <= start <= high:
            raise OptionError(
                f"{where}.start = {start:g} is not within [{low:g}, {high:g}]", f"{where}.start"
            )
    stop = tuple(
        _stopband(band, f"{where}.stopbands[{i}]")
        for i, band in enumerate(fields.get("stopbands") or ())
    )
    out = InputBounds(low, high, None if rate is None else float(rate), bands, start, stop)
    if start is not None and not allowed(out, start):
        raise OptionError(f"{where}.start = {start:g} is within a forbidden band", f"{where}.start")
    if not any(allowed(out, value) for value in _edges(out)):
        raise OptionError(
            f"{where}.forbidden leaves no value between {low:g} and {high:g}", f"{where}.forbidden"
        )
    return out


def allowed(bounds: InputBounds, value: float) -> bool:
    """Whether an input may take a value."""
    inside = any(low < value < high for low, high in bounds.forbidden)
    return bounds.low <= value <= bounds.high and not inside


def _edges(bounds: InputBounds) -> list[float]:
    """The ends of the range and of the bands: if any value is allowed, one of these is."""
    return [bounds.low, bounds.high, *(end for band in bounds.forbidden for end in band)]


def _forbidden(given: Any, where: str) -> Band:
    low, high = _pair(given, where)
    for end in (low, high):
        _number(end, where)
    if not low < high:
        raise OptionError(f"{where} = [{low:g}, {high:g}]: its ends are not in order", where)
    return float(low), float(high)


def _stopband(given: Any, where: str) -> Band:
    low, high = _forbidden(given, where)
    if low < 0.0:
        raise OptionError(f"{where} = [{low:g}, {high:g}]: a frequency is negative", where)
    return low, high


def _limit(given: Any, where: str) -> Band:
    low, high = _pair(given, where)
    for end in (low, high):
        if end is not None and not (_is_number(end) and not np.isnan(end)):
            raise OptionError(f"{where}: {end!r} is no number", where)
    ends = (-np.inf if low is None else float(low), np.inf if high is None else float(high))
    if not ends[0] < ends[1]:
        raise OptionError(f"{where} = [{low}, {high}]: its ends are not in order", where)
    return ends


def _mapping(given: Any, where: str) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise OptionError(f"{where} = {given!r}; names with their bounds are needed", where)
    return dict(given)


def _pair(given: Any, where: str) -> tuple[Any, Any]:
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise OptionError(f"{where} = {given!r}; [low, high] is needed", where)
    return given[0], given[1]


def _known(fields: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    for name in fields:
        if name not in names:
            raise OptionError(
                f"{where}.{name} is not known; {', '.join(names)} are", f"{where}.{name}"
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _number(value: Any, where: str) -> None:
    if not (_is_number(value) and np.isfinite(value)):
        raise OptionError(f"{where} = {value!r}; a finite number is needed", where)


def _positive(value: Any, where: str, unit: str) -> None:
    if not (_is_number(value) and 0.0 < value < np.inf):
        raise OptionError(f"{where} = {value!r} {unit}; a positive number is needed", where)
