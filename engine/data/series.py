"""Measured data: outputs y, inputs u and their times, with missing values as NaN in y."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.arrays import Array
from engine.data.channels import check_channels
from engine.data.clock import (
    about_index,
    about_name,
    check_same_rows,
    common_step,
    index_of,
    times_of,
)
from engine.data.columns import columns_of, names_of, own_names
from engine.data.doubts import doubts_of
from engine.data.hold import HOLDS, between, means, over_steps
from engine.errors import OptionError, ReadingWarning, SeriesError
from engine.units import SECOND
from engine.views import Shown, View, frame, sheet, tables

if TYPE_CHECKING:
    from engine.statespace.base import BaseModel

TIME_UNIT = re.compile(r"[^\W\d_]{1,20}")  # a word, as requests have it


@dataclass(frozen=True, eq=False)
class Series(Shown):
    """One experiment: measured outputs and inputs, times, channel names, units.

    Parameters
    ----------
    y : array (T, ny) or (T,)
        Outputs; NaN is a missing value, of a whole row or a single channel. Columns of a pandas table bring
        their names along, and an index of dates, durations or decimal numbers the times. Tables are joined
        row by row, so their indices must be the same; one that counts rows from 0 goes with dates, too.
    u : array (T, nu) or (T,), optional
        Inputs, without gaps, in the order in which the model lists them; none by default.
    dt : float, optional
        Time step of a regularly sampled series, in ``time_unit``, or a duration such as timedelta; 1 where
        nothing says when rows were measured.
    t : array (T,), optional
        Increasing time stamps, one per row, instead of ``dt``, in ``time_unit``. Dates are counted from the
        first of them, in this unit, too.
    y_names, u_names : sequence of str, optional
        Names of the columns of y and u; y1, y2, ... and u1, u2, ... by default.
    extra : array (T, n), optional
        Channels that were recorded but that the model does not use; a diagnosis asks whether they matter.
    extra_names : sequence of str, optional
        One name for each column of ``extra``.
    substeps : int
        Number of rows from one sample to the next, where the series was refined (see :meth:`refined`); its
        first row is a sample.
    hold : str
        What inputs did between their samples. ``"zoh"``: held until the next one, as a converter holds what a
        computer sends. ``"foh"``: on a straight line to it, as a signal that was measured like the outputs.
        ``"past"``: at a row's value since the row before, as loggers write mean currents.
    time_unit : str
        What times and steps count, such as ``"min"`` or ``"year"``. A label: it changes the units that are
        printed (``1/year``, ``m/min``) and no number. A model's equations, and the units that it declares,
        are to be in the same unit of time.
    units : mapping of str to str, optional
        Units of channels by name; :meth:`check` compares them with those that a model declares.
    begins : sequence of int
        Rows, beside the first, at which another record begins, where times may fall back. Of
        :func:`engine.data.joined.together`, for filters and the likelihood, which go on from the model's first
        state there; all else takes a list of records.

    Raises
    ------
    SeriesError
        Lengths differ, times do not increase, or an input is missing; names the row and the channel.
    OptionError
        ``hold`` is none of the three words, or ``time_unit`` no unit.
    """

    y: Array
    u: Array
    t: Array
    y_names: tuple[str, ...]
    u_names: tuple[str, ...]
    extra: Array
    extra_names: tuple[str, ...]
    substeps: int
    hold: str
    time_unit: str
    units: Mapping[str, str]
    begins: tuple[int, ...]

    def __init__(  # noqa: PLR0913
        self,
        y: ArrayLike,
        u: ArrayLike | None = None,
        dt: Any = None,
        t: Any = None,
        y_names: Sequence[str] | None = None,
        u_names: Sequence[str] | None = None,
        extra: ArrayLike | None = None,
        extra_names: Sequence[str] | None = None,
        substeps: int = 1,
        hold: str = "zoh",
        time_unit: str = SECOND,
        units: Mapping[str, str] | None = None,
        begins: Sequence[int] = (),
    ) -> None:
        check_same_rows({"y": y, "u": u, "extra": extra, "t": t})
        if t is None and dt is None:
            t = index_of((y, u))
        counted = t is None
        y_names, u_names, extra_names = (
            own_names(values) if names is None else names
            for values, names in ((y, y_names), (u, u_names), (extra, extra_names))
        )
        y_ = columns_of(y, "y")
        T = y_.shape[0]
        u_ = np.zeros((T, 0)) if u is None else columns_of(u, "u")
        extra_ = np.zeros((T, 0)) if extra is None else columns_of(extra, "extra")
        if hold not in HOLDS:
            raise OptionError(f"hold = {hold!r}; one of {', '.join(HOLDS)} is needed", "hold")
        if not isinstance(time_unit, str) or not TIME_UNIT.fullmatch(time_unit.strip()):
            raise OptionError(
                f"time_unit = {time_unit!r}; a unit such as 's' or 'year' is needed, in letters",
                "time_unit",
            )
        if T < 2:
            raise SeriesError(f"y has {T} samples; at least 2 are needed")
        for name, values in (("u", u_), ("extra", extra_)):
            if values.shape[0] != T:
                raise SeriesError(
                    f"{name} has {values.shape[0]} rows and y has {T}; they must be equal"
                )
        set_ = object.__setattr__
        set_(self, "y_names", names_of(y_names, y_.shape[1], "y"))
        set_(self, "u_names", names_of(u_names, u_.shape[1], "u"))
        set_(self, "extra_names", names_of(extra_names, extra_.shape[1], "extra"))
        for row, column in np.argwhere(np.isinf(y_))[:1]:
            raise SeriesError(
                f"y is infinite at row {row}, channel '{self.y_names[column]}'; "
                "use NaN for a missing value"
            )
        for name, values, names in (("u", u_, self.u_names), ("extra", extra_, self.extra_names)):
            for row, column in np.argwhere(~np.isfinite(values))[:1]:
                raise SeriesError(
                    f"{name} is not finite at row {row}, channel '{names[column]}'; "
                    "an input must be known at every sample"
                )
        set_(self, "y", y_)
        set_(self, "u", u_)
        set_(self, "extra", extra_)
        if not all(0 < row < T for row in begins):
            raise SeriesError(f"begins = {tuple(begins)}: rows from 1 to {T - 1} are needed")
        set_(self, "begins", tuple(map(int, begins)))
        set_(self, "t", times_of(t, dt, T, time_unit.strip(), self.begins))
        set_(self, "substeps", int(substeps))
        set_(self, "hold", hold)
        set_(self, "time_unit", time_unit.strip())
        set_(self, "units", self._known_units(units or {}))
        self._freeze()
        notes = [about_name(t, self.time_unit)]
        if counted:
            notes += [about_index((y, u), dt, self.time_unit)]
        elif hasattr(t, "name"):
            notes += doubts_of(t, self.t, self.time_unit)
        for note in filter(None, notes):
            warnings.warn(note, ReadingWarning, stacklevel=2)

    def _freeze(self) -> None:
        for array in (self.y, self.u, self.extra, self.t):
            array.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """As it was before it was pickled or copied, from which its arrays come back writable.

        Kernels would be compiled anew for such, for half a minute.
        """
        vars(self).update(state)
        vars(self).pop("u_step", None)
        self._freeze()

    def _known_units(self, units: Mapping[str, str]) -> dict[str, str]:
        """The units given, each of a channel there is. Raises SeriesError."""
        there = (*self.y_names, *self.u_names, *self.extra_names)
        for name in units:
            if name not in there:
                raise SeriesError(
                    f"units: there is no channel '{name}'; there are {', '.join(there)}"
                )
        return dict(units)

    def __len__(self) -> int:
        return int(self.y.shape[0])

    @cached_property
    def steps(self) -> Array:
        """The time steps dt_t = t_{t+1} - t_t in ``time_unit``, (T-1,); all the same where ``dt`` is one."""
        if self.dt is not None:
            return np.full(len(self) - 1, self.dt)
        steps = np.diff(self.t).astype(float)
        into = np.array(self.begins, dtype=np.intp) - 1
        steps[into] = np.median(np.delete(steps, into))  # none is made: any that is usual
        return steps

    @cached_property
    def dt(self) -> float | None:
        """The common time step in ``time_unit``, or None where sampling is irregular.

        The number of twelve digits that the times allow, if there is one: 0.1, also of a part that begins
        at 37.3, for a model may remember what belongs to a step. Times far from 0, as since 1970, are at one
        step where they are but for their rounding.
        """
        return common_step(self.t, self.begins)

    @cached_property
    def usual_step(self) -> float:
        """The common time step, or the median of those of irregular sampling, in ``time_unit``."""
        return float(np.median(self.steps)) if self.dt is None else self.dt

    @cached_property
    def observed(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Which values are there, (T, ny)."""
        return ~np.isnan(self.y)

    @cached_property
    def patterns(self) -> tuple[tuple[NDArray[np.intp], NDArray[np.intp]], ...]:
        """Channels that are there together, and the rows at which just these are; none without any."""
        each, which = np.unique(self.observed, axis=0, return_inverse=True)
        pairs = (
            (np.flatnonzero(one), np.flatnonzero(which.ravel() == k)) for k, one in enumerate(each)
        )
        return tuple((channels, rows) for channels, rows in pairs if channels.size)

    @cached_property
    def n_measured(self) -> int:
        """Number of rows with a measurement: what a sample size is, refined or with gaps."""
        return int(self.observed.any(axis=1).sum())

    @cached_property
    def u_step(self) -> Array:
        """The inputs (T, nu) over the step that begins at each row, as ``hold`` says: what moves the states.

        The mean of a straight line, which a step of second order asks for. The last row begins no step.
        """
        over = over_steps(self.u, self.hold)
        over.setflags(write=False)
        return over

    @cached_property
    def samples(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """The rows (n,) that are samples: every row, or every ``substeps``-th one."""
        return np.arange(0, len(self), self.substeps)

    def refined(self, k: int) -> Series:
        """The same experiment with ``k`` steps from each sample to the next, (T-1) k + 1 rows.

        Inputs and extra channels do between samples what ``hold`` says, nothing is measured in between, times
        are subdivided evenly. ``values[series.samples]`` maps what was computed on it back to the samples.
        Raises SeriesError for k < 1 and for a series that is refined already.
        """
        if k != int(k) or k < 1:
            raise SeriesError(f"k = {k} steps a sample; a whole number, at least 1, is needed")
        if self.substeps != 1:
            raise SeriesError(f"the series is refined already, {self.substeps} steps a sample")
        if k == 1:
            return self
        rows = np.repeat(np.arange(len(self)), k)[: (len(self) - 1) * k + 1]
        y = np.full((len(rows), self.y.shape[1]), np.nan)
        y[::k] = self.y
        share = np.tile(np.arange(k) / k, len(self))[: len(rows)]
        steps = np.append(self.steps, 0.0)
        return self.replace(
            y=y,
            u=between(self.u, self.hold, rows, share),
            t=self.t[rows] + share * steps[rows],
            extra=between(self.extra, self.hold, rows, share),
            substeps=k,
            begins=[k * row for row in self.begins],
        )

    def thinned(self, k: int) -> Series:
        """Every k-th sample of a record that was sampled far more often than its plant moves.

        Inputs and extra channels are their means over the time until the next sample that is kept, and held; a
        reading that depends on the input of its own row sees that mean.
        Raises SeriesError for k < 1, where fewer than two samples are left, for a refined series and for
        several records together.
        """
        left = (len(self.alone()) - 1) // max(k, 1)
        if k < 1 or left < 1:
            raise SeriesError(f"k = {k} of {len(self)} samples; two at least must be left")
        if self.substeps != 1:
            raise SeriesError(f"the series is refined already, {self.substeps} steps a sample")
        if k == 1:
            return self
        rows = np.arange(left + 1) * k
        u, extra = (means(values, self.hold, self.steps, rows) for values in (self.u, self.extra))
        return self.replace(y=self.y[rows], u=u, t=self.t[rows], extra=extra, hold="zoh")

    def held(self, hold: str) -> Series:
        """The samples of this series, not refined, with inputs that do what ``hold`` says between them."""
        return self._rows(self.samples, substeps=1, hold=hold)

    def replace(self, **changes: Any) -> Series:
        """The same series with some of its fields changed, given by their names as for :class:`Series`."""
        kept = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "units"}
        made = {**kept, **changes}
        names = {name for key in ("y_names", "u_names", "extra_names") for name in made[key] or ()}
        made.setdefault("units", {k: v for k, v in self.units.items() if k in names})
        return Series(**made)

    def alone(self) -> Series:
        """Return self unless it holds several records. Raises SeriesError."""
        if self.begins:
            raise SeriesError(
                f"the series holds {1 + len(self.begins)} records (begins); give each as a series of its own"
            )
        return self

    def follows(self, before: Series) -> bool:
        """Whether its times go on where those of ``before`` end, a usual step later, in the same channels."""
        for one, other in ((self.y, before.y), (self.u, before.u), (self.extra, before.extra)):
            if one.shape[1] != other.shape[1]:
                return False
        clocks = [(one.hold, one.substeps, one.time_unit) for one in (self, before)]
        if clocks[0] != clocks[1]:
            return False
        gap, steps = float(self.t[0] - before.t[-1]), np.diff(before.t[before.samples])
        return bool(0.5 * steps.min() <= gap <= 1.5 * steps.max())

    def part(self, start: int, stop: int) -> Series:
        """Rows start .. stop-1 as a series of its own, with its own times.

        Of a refined series ``start`` must be a sample.
        """
        if start % self.substeps:
            raise SeriesError(f"row {start} of a refined series is no sample")
        return self._rows(slice(start, stop))

    def _rows(self, rows: slice | NDArray[np.intp], **changes: Any) -> Series:
        """Some of the rows, with other fields changed too."""
        own = {name: getattr(self, name)[rows] for name in ("y", "u", "t", "extra")}
        if self.begins:
            places = np.arange(len(self))[rows]
            own["begins"] = [k for k, row in enumerate(places) if k and row in self.begins]
        return self.replace(**own, **changes)

    def masked(self, rows: ArrayLike) -> Series:
        """The same series with the measurements of ``rows`` (mask or indices) missing."""
        y = self.y.copy()
        y[rows] = np.nan  # type: ignore[index]
        return self.replace(y=y)

    def with_extra_inputs(self) -> Series:
        """The same series with its extra channels as further inputs too, behind its own."""
        if not self.extra_names:
            return self
        return self.replace(
            u=np.hstack([self.u, self.extra]), u_names=(*self.u_names, *self.extra_names)
        )

    def to_frame(self) -> Any:
        """A pandas table of y, u and extra channels over the times; needs pandas.

        Its ``attrs`` hold ``units`` and ``time_unit``, as :meth:`from_frame` takes them.
        """
        columns = zip(
            (*self.y_names, *self.u_names, *self.extra_names),
            np.hstack([self.y, self.u, self.extra]).T,
            strict=True,
        )
        made = frame(dict(columns), {"t": self.t})
        made.attrs = {"units": dict(self.units), "time_unit": self.time_unit}
        return made

    def check(self, model: BaseModel, measured: bool = True) -> Series:
        """Return self if its widths, names and units fit the model and, unless not ``measured``, y has a value.

        Channels are taken in their order, whatever their names. But names of the model's own channels, and
        those that have one in them as a word, belong where the model has them. Raises SeriesError.
        """
        check_channels(self, model)
        counted = getattr(model, "steps_counted", 0)
        if counted not in (0, self.substeps):
            raise SeriesError(
                f"model '{model.name}' remembers samples of {counted} steps each, and the series makes "
                f"{self.substeps} steps a sample: put its delay or lag in for this series, "
                "extend(model, effects, setting_for(model, series, theta))"
            )
        if measured and not self.observed.any():
            raise SeriesError("every value of y is missing; at least one measurement is needed")
        return self

    def _view(self) -> View:
        clock = self.time_unit
        every = f"every {self.dt:g} {clock}" if self.dt is not None else "irregularly"
        rows: list[tuple[object, ...]] = []
        for kind, names, values in (
            ("y", self.y_names, self.y),
            ("u", self.u_names, self.u),
            ("extra", self.extra_names, self.extra),
        ):
            for name, column in zip(names, values.T, strict=True):
                there = column[~np.isnan(column)]
                least, mean, most = (
                    float(f(there)) if there.size else "" for f in (np.min, np.mean, np.max)
                )
                unit = self.units.get(name, "")
                rows.append((kind, name, len(column) - there.size, least, mean, most, unit))
        head = ["", "channel", "missing", "least", "mean", "most", "unit"]
        if not self.units:
            head, rows = head[:-1], [row[:-1] for row in rows]
        return sheet(
            f"{len(self)} samples, {every}, t = {self.t[0]:g} ... {self.t[-1]:g} {clock}",
            tables().table(head, rows),
        )

    @staticmethod
    def from_frame(table: Any, y: Sequence[str], u: Sequence[str] = (), **options: Any) -> Series:
        """Columns of a pandas table, with units where asked; see :func:`engine.data.frames.from_frame`."""
        from engine.data.frames import from_frame

        return from_frame(table, y, u, **options)

    @staticmethod
    def read(
        path: str | Path,
        y: Sequence[str] | Mapping[str, str] | None = None,
        u: Sequence[str] | Mapping[str, str] | None = None,
        t: str | None = None,
        dt: float | None = None,
        hold: str | None = None,
        time_unit: str | None = None,
        extra: Sequence[str] | Mapping[str, str] | None = None,
    ) -> Series:
        """Read a .csv, .mat or .npz file; see :func:`engine.data.files.read_series`."""
        from engine.data.files import read_series

        return read_series(path, y=y, u=u, t=t, dt=dt, hold=hold, time_unit=time_unit, extra=extra)

    @staticmethod
    def read_records(path: str | Path, by: str | Sequence[str], **options: Any) -> list[Series]:
        """The records that stand in one file, told apart by a column, as of subjects, or by several.

        ``options`` are the other arguments of :meth:`read`; see :func:`engine.data.files.read_records`.
        """
        from engine.data.files import read_records

        return read_records(path, by, **options)
