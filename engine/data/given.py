"""What a user gives as data, one series or several, checked against the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError, SeriesError

if TYPE_CHECKING:
    from engine.statespace.base import BaseModel


def one_series(series: Any, model: BaseModel, measured: bool = True) -> Series:
    """A single series, which may hold records together, checked against the model.

    Raises ModelError and SeriesError.
    """
    if isinstance(series, list | tuple) and len(series) != 1:
        raise SeriesError(f"{len(series)} series were given; one is needed: call it for each")
    if isinstance(series, Series):
        must_be_model(model)
        return series.check(model, measured)
    return as_series_list(series, model, together=True)[0]


def must_be_model(model: BaseModel) -> None:
    """Raise ModelError unless it is a model."""
    if not hasattr(model, "parameters"):
        raise ModelError(
            f"the model is {model!r:.60}, of type {type(model).__name__}; a model is needed, such as "
            "engine.get_model('servo')"
        )


def as_series_list(
    series: Any, model: BaseModel, what: str = "record", together: bool = False
) -> list[Series]:
    """One series or several, each checked against the model; ``what`` they are, in errors.

    None may hold several records unless they may be ``together``.
    """
    must_be_model(model)
    several = not (series is None or isinstance(series, Series | np.ndarray))
    all_series: list[Any] = list(series) if several else [series]
    if not all_series:
        raise SeriesError("no series was given; at least one is needed")
    for k, one in enumerate(all_series):
        if not isinstance(one, Series):
            raise SeriesError(
                f"the data are of type {type(one).__name__}; a series is needed: engine.Series(y, u, dt=...)"
            )
        try:
            (one if together else one.alone()).check(model)
        except SeriesError as error:
            if len(all_series) == 1:
                raise
            raise SeriesError(f"{what} {k}: {error}") from None
    same_clock(all_series)
    return all_series


def check_enough(all_series: Sequence[Series], parameters: int, first_states: int = 0) -> None:
    """Raise SeriesError where there are no more readings than is to be found: they can all be met exactly."""
    readings = sum(int(one.observed.sum()) for one in all_series)
    if readings <= parameters + first_states:
        found = f"{parameters} parameters" + (
            f" and {first_states} first states" if first_states else ""
        )
        raise SeriesError(
            f"{readings} readings do not tell {found}: give more data, or hold parameters fixed (free=)"
        )


def same_clock(all_series: Sequence[Series]) -> None:
    """Raise SeriesError where the times of two series are in different units."""
    for one in all_series:
        if one.time_unit != all_series[0].time_unit:
            raise SeriesError(
                f"times of one series are in {all_series[0].time_unit}, of another in {one.time_unit}; all "
                "need the same unit"
            )


def check_apart(records: Sequence[Series], tests: Sequence[Series] = ()) -> None:
    """Raise SeriesError where one is another once more: it would count twice, or a test would be none."""
    every, n = [*records, *tests], len(records)
    seen: dict[tuple[object, ...], int] = {}
    for j, one in enumerate(every):
        k = seen.setdefault(_numbers(one), j)
        if k == j:
            continue
        if j < n or k >= n:
            what, first = ("records", 0) if j < n else ("tests", n)
            raise SeriesError(f"{what} {k - first} and {j - first} are the same: give each once")
        raise SeriesError(
            f"test is record {k}, which the model is fitted to: give data that it has not seen, or none"
        )


def _numbers(one: Series) -> tuple[object, ...]:
    """What is equal where readings and inputs are the same numbers."""
    plain = [np.where(np.isnan(x), np.nan, x) + 0.0 for x in (one.y, one.u)]  # -0 is 0
    return tuple((x.shape, x.tobytes()) for x in plain)
