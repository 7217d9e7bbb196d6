"""What a series is given, arrays and tables of others, as numbers (T, n) with a name for each channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from engine.arrays import Array
from engine.data.channels import default_names
from engine.errors import SeriesError


def columns_of(values: ArrayLike, name: str) -> Array:
    """Values (T, n), a copy of those of y, u or extra, which ``name`` says; NaN behind a mask.

    Raises SeriesError where they are no table of real numbers.
    """
    if _holds_dates(values):
        raise SeriesError(f"{name} holds dates or durations, no numbers: only times may be such")
    try:
        if np.iscomplexobj(values):
            raise ValueError("they are complex")
        # by rows, whoever made them, as a frame has them by columns: kernels are compiled for each layout
        array = np.array(values, dtype=float, order="C")
        if isinstance(values, np.ma.MaskedArray):  # NumPy keeps what is behind the mask
            array[np.ma.getmaskarray(values)] = np.nan
    except (TypeError, ValueError) as error:
        raise SeriesError(f"{name} is not a table of numbers (T, n{name}): {error}") from error
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise SeriesError(f"{name} has shape {array.shape}; (T, n{name}) is needed")
    return array


def _holds_dates(values: Any) -> bool:
    """Whether a column of a table, or an array, is of dates or durations, which NumPy turns into numbers."""
    columns = getattr(values, "dtypes", None)  # of a table each has its own
    kinds = [values] if columns is None or not hasattr(columns, "__iter__") else columns
    found = [getattr(getattr(one, "dtype", one), "kind", "") for one in kinds]
    return any(kind in ("m", "M") for kind in found)


def names_of(names: Sequence[str] | None, n: int, prefix: str) -> tuple[str, ...]:
    """A name for each of n channels, as given or by default. Raises SeriesError where there are not as many."""
    if names is None:
        return default_names(n, prefix)
    if len(names) != n:
        raise SeriesError(f"{len(names)} names were given for {n} channels of {prefix}")
    return tuple(names)


def own_names(values: Any) -> tuple[str, ...] | None:
    """Names of a pandas table's columns, or of the one column it is, where it has any."""
    columns = getattr(values, "columns", None)
    if columns is not None:
        return tuple(map(str, columns))
    name = getattr(values, "name", None) if hasattr(values, "index") else None
    return None if name is None else (str(name),)
