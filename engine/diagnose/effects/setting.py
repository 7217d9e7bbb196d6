"""The model for which effects are made, where they may enter it, and the sizes its data have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from engine.data.joined import anew
from engine.data.rounded_times import rounding_of
from engine.diagnose.effects.identifiers import Identifiers
from engine.diagnose.effects.rates import (
    Points,
    Rate,
    beside,
    feeding,
    guessed_points,
    moved_by,
    rates,
)
from engine.diagnose.effects.rest import at_rest
from engine.diagnose.effects.zeros import without_zero
from engine.errors import EngineError
from engine.statespace.model import Array, MixedModel, Parameter
from engine.units import SECOND, frequency_in, is_per_time, product, zero_of

SLOWEST_PROBE = 30.0  # samples: the longest time constant that a probe of an effect has
PROBED = 32  # rows of a record at which a model's structure is looked at
NARROWEST, WIDEST = 1e-3, 10.0  # of a channel's typical distance from its zero: bounds of a width
ALIKE = 1e-3  # of a channel's size: zeros so near are one
ZEROS_OUTSIDE = (0.5, 2.0, 10.0)  # of a channel's range, beyond it: where its zero is looked for
NEARLY_ALL = 0.9  # of the steps
WAY_BACK = 0.01  # of the way out: with less, nothing has come back
POSITIVE = float(np.finfo(float).tiny)  # in any unit
ANY_TIME, SOME_TIME = (-np.inf, np.inf), (POSITIVE, np.inf)  # bounds of a time, of a length of time
FREQUENCIES = (0.02, 0.06, 0.12, 0.25)  # cycles a sample at which the screen looks
ON_TIME = 1e-3  # of a sample: how far off its time a sample may be


@dataclass(frozen=True, eq=False)
class Record:
    """The samples of one series: ``values`` of states (filtered means), inputs and outputs by channel (n,);

    times ``t`` (n,) and steps ``dt`` (n,); ``theta`` of the filter. Outputs may hold NaN.
    """

    values: Mapping[str, Array]
    t: Array
    dt: Array
    theta: Array


@dataclass(frozen=True)
class Setting:
    """The model for which effects are made, with what its data tell about sizes.

    ``scale`` maps a channel to its typical variation (standard deviation) in its unit, 1 where unknown;
    ``span`` is the first and last time; ``dt`` the median time between samples. ``extra`` are
    those inputs that were recorded but that the model does not use; ``resolution`` maps an output to the
    step its readings come in, where they show one. ``record`` is what the series showed, None without
    data. ``zeros`` are the known zeros of channels (default: as the model declares and tells), ``afloat``
    channels whose zero means nothing to the model (default: as it tells), ``rest`` where its states are at
    rest (likewise); ``substeps`` the steps that the model makes from one sample to the next; ``hold`` what the
    series says of its inputs between samples;
    ``held`` the parameters of the model that are not estimated; ``time_unit`` what its times count; ``regular``
    whether samples are at one common step; ``later`` the times at which further records begin, where the times
    of several tell them apart; ``starts`` those from which what begins with a record counts; ``found`` the
    parameters of the effects that a search has added to the model so far.
    """

    model: MixedModel
    scale: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 100.0)
    dt: float = 1.0
    extra: tuple[str, ...] = ()
    resolution: Mapping[str, float] = field(default_factory=dict)
    record: Record | None = None
    zeros: Mapping[str, float] | None = None
    afloat: frozenset[str] | None = None
    rest: Mapping[str, float] | None = None
    substeps: int = 1
    hold: str = "zoh"
    held: tuple[str, ...] = ()
    time_unit: str = SECOND
    regular: bool = True
    later: tuple[float, ...] = ()
    starts: tuple[float, ...] = ()
    found: tuple[str, ...] = ()

    @cached_property
    def made(self) -> dict[Any, Any]:
        """The effects made in this setting so far, by maker and channel; what `once` was asked."""
        return {}

    def once(self, function: Callable[..., Any], *of: str) -> Any:
        """``function(setting, *of)``, worked out the first time: the steps of a search ask again."""
        key = function, *of
        if key not in self.made:
            self.made[key] = function(self, *of)
        return self.made[key]

    # ---- sizes --------------------------------------------------------------------------------

    def limits(self, low: float, high: float, least: float = POSITIVE) -> tuple[float, float]:
        """Bounds (low, high) taken from the data, (least, inf) where there are none."""
        return (low, high) if self.record is not None else (least, float("inf"))

    def size(self, channel: str) -> float:
        """The channel's typical variation, 1 where unknown."""
        value = float(self.scale.get(channel, 1.0))
        return value if value > 0.0 else 1.0

    def quantile(self, channel: str, level: float) -> float:
        """The value below which the channel is for a share ``level`` of the record."""
        values = self._values(channel)
        if values.size:
            return float(np.quantile(values, level))
        return self.known_zeros.get(channel, 0.0) + self.size(channel) * float(ndtri(level))

    def distance(self, channel: str, level: float, zero: float | None = None) -> float:
        """The distance from its zero, or another, within which it is for a share ``level`` of the record."""
        away = np.abs(self._values(channel) - (self.zero(channel) if zero is None else zero))
        value = float(np.quantile(away, level)) if away.size else 0.0
        return value if value > 0.0 else self.size(channel) * float(ndtri(0.5 + 0.5 * level))

    def width(self, channel: str, zeros: Sequence[float] = ()) -> tuple[float, float]:
        """Bounds of a width in the channel's unit, counted from its zero or from one of several others."""
        most = [self.distance(channel, 0.7, zero) for zero in (None, *zeros)]
        return self.limits(NARROWEST * min(most), WIDEST * max(most))

    def inside(self, channel: str) -> tuple[float, float]:
        """Bounds of a value on the channel's axis: its range and as much again at each side."""
        values = self._values(channel)
        if not values.size:
            return -np.inf, np.inf
        low, high = float(values.min()), float(values.max())
        more = max(high - low, self.size(channel))
        return low - more, high + more

    def first(self, channel: str) -> float:
        """The channel's first value in the record; its zero where there is none."""
        values = self._values(channel)
        return float(values[0]) if values.size else self.zero(channel)

    def turns(self, channel: str) -> bool:
        """Whether the channel, as a speed, goes both ways from its zero in the record, where there is one."""
        away = self._values(channel) - self.zero(channel)
        ways = np.array([away[away > 0.0].sum(), -away[away < 0.0].sum()])
        return not away.size or bool(ways.min() > WAY_BACK * ways.max())

    def _values(self, channel: str) -> Array:
        if self.record is None:
            return np.zeros(0)
        values = self.record.values.get(channel, np.zeros(0))
        return np.asarray(values[np.isfinite(values)])

    # ---- zeros --------------------------------------------------------------------------------

    @cached_property
    def _rates(self) -> dict[str, Rate]:
        return rates(self.model)

    @cached_property
    def known_zeros(self) -> Mapping[str, float]:
        """Zeros that are declared, or that the model tells: of a rate, where what it moves stands still."""
        if self.zeros is not None:
            return self.zeros
        derived = {name: rate.zero for name, rate in self._rates.items() if rate.zero is not None}
        return {**derived, **self.model.reference}

    @cached_property
    def _afloat(self) -> frozenset[str]:
        return without_zero(self.model, self.dt) if self.afloat is None else self.afloat

    def zero(self, channel: str) -> float:
        """The channel's zero in its unit: declared, derived from the model, else 0 of the unit.

        Of a temperature that is absolute zero, whatever its unit. Where it means nothing to the model it is the
        middle of the record.
        """
        if channel in self.known_zeros:
            return float(self.known_zeros[channel])
        if channel not in self._afloat:
            return zero_of(self.unit(channel))
        values = self._values(channel)
        return float(np.median(values)) if values.size else 0.0

    def may_be_off(self, channel: str) -> bool:
        """Whether the channel has a zero, as a voltage has and a temperature in degC has not."""
        return channel in self.known_zeros or channel not in self._afloat

    def zeros_outside(self, channel: str) -> tuple[float, ...]:
        """Where else the zero of a channel may be, if neither the model nor its declarations tell it.

        Out of the record's range at both sides; from the last places all looks the same but for a constant.
        """
        values = self._values(channel)
        if channel in self.known_zeros or channel not in self._afloat or not values.size:
            return ()
        low, high = float(values.min()), float(values.max())
        ways = np.multiply(ZEROS_OUTSIDE, max(high - low, self.size(channel)))
        return tuple(place for way in ways.tolist() for place in (low - way, high + way))

    def zeros_inside(self, channel: str) -> tuple[float, ...]:
        """Where else the zero of a channel may be.

        A position may be counted from a wall: the zero is where the model is at rest. Or it is in the middle of
        a record that keeps away from that of the unit. Of a speed that no equation counts from anywhere, only
        from another speed, it is that of its unit all the same: there it stands.
        """
        values, zero = self._values(channel), self.zero(channel)
        if channel in self.known_zeros or not values.size:
            return ()
        low, high = self.inside(channel)
        if channel in self._afloat:
            places = [0.0] if low < 0.0 < high and is_per_time(self.unit(channel)) else []
        else:
            near = float(values.min()) <= zero <= float(values.max())
            places = [] if near else [float(np.median(values))]
            if low < self._rest.get(channel, -np.inf) < high:
                places.append(self._rest[channel])
        close = ALIKE * self.size(channel)
        return tuple(place for place in places if abs(place - zero) > close)

    @cached_property
    def _rest(self) -> Mapping[str, float]:
        if self.rest is not None:
            return self.rest
        points, theta = self.points(self.model)
        u = np.array([self.zero(name) for name in self.model.inputs])
        try:
            found = at_rest(self.model, theta, points, u)
        except (EngineError, np.linalg.LinAlgError):
            found = None
        return {} if found is None else dict(zip(self.states, found.tolist(), strict=True))

    def beside(self, model: MixedModel) -> Setting:
        """The same beside what ``model`` has more than the one for which effects are made."""
        found = tuple(
            name for name in model.parameter_names if name not in self.model.parameter_names
        )
        return self if found == self.found else replace(self, found=found)

    def keeping_zeros(self) -> Setting:
        """The same for models that effects extend: what an effect adds moves no zero."""
        return replace(self, zeros=self.known_zeros, afloat=self._afloat, rest=self._rest)

    def is_rate(self, state: str) -> bool:
        """Whether the state is the rate of another one: friction and drag suit it, stiffness does not."""
        return state in self._rates

    def is_rate_of(self, state: str, position: str) -> bool:
        """Whether the state is the rate of that one, as far as the equations tell."""
        return state in self._rates and position in self._rates[state].of

    # ---- time ---------------------------------------------------------------------------------

    def anew(self, t: Any) -> Any:
        """Times (a number or (M,)) as if every record began with the first: what begins with one counts so.

        A function of a model takes this method itself, not the setting: what it calls by name is recorded.
        """
        return anew(t, self.starts, self.early * self.dt)

    @cached_property
    def early(self) -> float:
        """The share of a sample by which one may be off its time: more where times are rounded, far from 0."""
        return ON_TIME + rounding_of(self.span) / self.dt

    @property
    def run(self) -> tuple[float, float]:
        """The first and the last time of the longest record, on that clock: ``span`` of one alone."""
        if len(self.starts) < 2 or self.record is None:
            return self.span
        return self.starts[0], float(self.anew(self.record.t).max())

    @property
    def counted(self) -> str:
        """What an equation says of t where it counts so."""
        return ", t anew in each record" if len(self.starts) > 1 else ""

    @property
    def tells_samples(self) -> bool:
        """Whether times tell the samples from the steps between them, as what counts samples needs.

        Of a model whose dt is a real one, so many samples must also be about one time.
        """
        return self.regular or (self.substeps == 1 and self._alike)

    @cached_property
    def _alike(self) -> bool:
        """Whether nearly every step from sample to sample is the usual one, when rounded to such."""
        if self.record is None or not self.model.continuous:
            return True
        return bool(np.mean(np.abs(self.record.dt / self.dt - 1.0) < 0.5) >= NEARLY_ALL)

    def at_sample(self, t: Any) -> Any:
        """Whether a time t (a number or (M,)) is that of a sample: True, or (M,) where times are refined.

        What asks this is no effect of irregular samples with several steps each, so the phase tells.
        """
        if self.substeps == 1:
            return True
        phase = (t - self.span[0]) / self.dt
        return np.abs(phase - np.rint(phase)) < self.early + 1e-9 * np.abs(phase)

    def part_of_sample(self, t: Any, dt: Any) -> tuple[Any, Any]:
        """From where to where of a sample, 0 to 1, a step from t goes; all of it unless times are refined."""
        if self.substeps == 1:
            return 0.0, 1.0
        phase = (t - self.span[0]) / self.dt
        begin = np.maximum(phase - np.floor(phase + self.early + 1e-9 * np.abs(phase)), 0.0)
        return begin, begin + dt / self.dt

    # ---- channels -----------------------------------------------------------------------------

    def identifier(self, *parts: str) -> str:
        """A parameter name from an effect's kind and channel: another one for each channel."""
        return self._identifiers.of(*parts)

    @cached_property
    def _identifiers(self) -> Identifiers:
        return Identifiers([*self.states, *self.model.inputs, *self.model.outputs])

    @property
    def states(self) -> dict[str, str]:
        """All states with their units."""
        return {**self.model.nonlinear, **self.model.linear}

    @property
    def targets(self) -> list[str]:
        """States whose equations may be wrong: all but those that hold by definition."""
        return [name for name in self.states if name not in self.model.kinematic]

    def has_rate(self, state: str) -> bool:
        """Whether another state is this one's rate: stiffness suits it, friction does not."""
        return state in self.model.kinematic or any(state in r.of for r in self._rates.values())

    def rate(self, target: str, divided_by: str = "") -> str:
        """Unit of what enters a state's equation per unit of time, divided by another unit."""
        return product(self.unit(target), (self.time_unit, -1.0), (divided_by, -1.0))

    @property
    def length(self) -> float:
        """The time from the first sample to the last; of records that lie apart, that during them."""
        width = self.span[1] - self.span[0]
        during = width if self.record is None else float(self.record.dt[:-1].sum())
        return during if during < (1.0 - ON_TIME) * width else width

    def time(
        self, name: str, default: float, bounds: tuple[float, float] = ANY_TIME, what: str = ""
    ) -> Parameter:
        """A parameter that is a time."""
        return Parameter(name, default, self.time_unit, bounds, what)

    def time_constant(self, name: str, what: str = "") -> Parameter:
        """Of a lag that can be told from none and from a constant."""
        fast, slow = 2.0 * self.dt, max(0.5 * self.length, SLOWEST_PROBE * self.dt)
        return self.time(name, 10.0 * self.dt, self.limits(fast, slow), what)

    def frequency(self, name: str) -> Parameter:
        """Of an oscillation that takes part of the record, and several samples."""
        slowest = min(0.5 / max(self.length, 10.0 * self.dt), min(FREQUENCIES) / self.dt)
        fastest = 0.48 / self.dt
        unit = frequency_in(self.time_unit)
        return Parameter(name, 0.1 / self.dt, unit, self.limits(slowest, fastest))

    @property
    def per_time(self) -> str:
        """Unit of a rate of decay."""
        return product((self.time_unit, -1.0))

    def unit(self, channel: str) -> str:
        """Unit of a state, input or output."""
        model = self.model
        return {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}[channel]

    # ---- structure ----------------------------------------------------------------------------

    def points(self, model: MixedModel, most: int = PROBED) -> tuple[Points, Array]:
        """Where to evaluate a model (this one, or one with more states), and the base's theta.

        At most so many rows of a record, evenly over it.
        """
        own = self.record
        theta = np.asarray(model.theta())
        guess = guessed_points(model, self.dt)
        if own is None:
            return guess, theta
        rows = np.unique(np.linspace(0, len(own.t) - 1, most).astype(int))
        n = min(len(own.theta), len(theta))
        theta[:n] = own.theta[:n]

        def columns(names: Mapping[str, str], otherwise: Array) -> tuple[Array, Array]:
            there = [own.values.get(name) for name in names]
            x = [
                v[rows] if v is not None else np.full(len(rows), otherwise[i])
                for i, v in enumerate(there)
            ]
            sizes = [
                self.size(name) if v is not None else 1.0
                for name, v in zip(names, there, strict=True)
            ]
            return np.reshape(x, (len(names), len(rows))).T, np.array(sizes)

        x, scale = columns({**model.nonlinear, **model.linear}, guess.x.mean(axis=0))
        u, u_scale = columns(model.inputs, np.zeros(model.nu))
        return Points(x, u, own.t[rows], own.dt[rows], scale, u_scale), theta

    @cached_property
    def feeds(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which state (column) feeds which (row), (nx, nx); which input (column) moves it at once (nx, nu)."""
        points, theta = self.points(self.model)
        return feeding(self.model, theta, points)

    def feeding(self, state: str) -> list[str]:
        """The states that feed a state within a step, itself among them where it does.

        Also those that do so at other parameters alone, as by a spring whose stiffness is 0 at first.
        """
        states = list(self.states)
        return [states[j] for j in np.flatnonzero(self._may_feed[states.index(state)])]

    @cached_property
    def _may_feed(self) -> NDArray[np.bool_]:
        """Which state (column) may feed which (row), (nx, nx)."""
        points, theta = self.points(self.model)
        feeds, _ = feeding(self.model, beside(self.model, theta), points)
        return self.feeds[0] | feeds

    @cached_property
    def steering(self) -> tuple[str, ...]:
        """Parameters on which more than noise depends, or beside whose values the model cannot be used."""
        points, theta = self.points(self.model)

        def moves(parameter: str) -> bool:
            try:
                return any(moved_by(self.model, theta, points, parameter))
            except (EngineError, np.linalg.LinAlgError):
                return True

        return tuple(filter(moves, self.model.parameter_names))

    @cached_property
    def moved(self) -> tuple[str, ...]:
        """States that an input or another state moves: not disturbances of their own."""
        feeds, by_inputs = self.feeds
        return tuple(
            name
            for i, name in enumerate(self.states)
            if by_inputs[i].any() or np.delete(feeds[i], i).any()
        )
