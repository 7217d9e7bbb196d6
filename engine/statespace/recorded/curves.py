"""Curves of :mod:`scipy.interpolate` as the polynomials that they are, in operations that kernels know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from scipy.interpolate import BSpline, PPoly, UnivariateSpline, interp1d

from engine.statespace.recorded.numbers import check_finite, record
from engine.statespace.recorded.of_python import searched
from engine.statespace.recorded.tables import one_of
from engine.statespace.rows import Array

SAME = 1e-10  # of the curve's size
NOWHERE = np.nan, np.nan
MOST = 400  # pieces


@dataclass(frozen=True)
class Pieces:
    """Polynomials between ``points`` (n + 1,), of which ``powers`` (k, n) has the highest power first.

    ``beyond`` are the heights before the first and after the last point, None where these are those of the
    first and the last piece. There is no height there where it ``raises``.
    """

    points: Array
    powers: Array
    beyond: tuple[float, float] | None = None
    raises: bool = False

    def __call__(self, x: Any) -> Any:
        """The height at a number that is traced, or not."""
        points, outside = self.points, []
        if self.beyond is not None:
            outside = [record(np.less, (x, points[0])), record(np.greater, (x, points[-1]))]
        if self.raises:
            beyond = record(np.logical_or, outside)
            x = record(check_finite, (record(np.where, (beyond, np.nan, x)),))
        piece = searched(points[1:-1], x, "right")
        along = x - one_of(points[:-1].tolist(), piece)
        first, *rest = (one_of(each.tolist(), piece) for each in self.powers)
        out = first
        for each in rest:
            out = out * along + each
        if self.beyond is not None and not self.raises:
            for there, height in zip(outside, self.beyond, strict=True):
                out = record(np.where, (there, height, out))
        return out

    def agrees(self, curve: Callable[[Array], Any]) -> bool:
        """Whether the curve says the same, at the points, between them and beyond."""
        points = self.points
        width = points[-1] - points[0]
        x = np.concatenate([points[:-1] + share * np.diff(points) for share in (0.0, 0.3, 0.7)])
        if not self.raises:
            x = np.concatenate(
                [x, points[0] - width * np.array([0.01, 1.0]), points[-1] + [0.01 * width, width]]
            )
        try:
            own = np.asarray(curve(x), dtype=float)
        except (ArithmeticError, ValueError, TypeError):
            return False
        return own.shape == x.shape and bool(
            np.allclose(
                self.at(x), own, rtol=SAME, atol=SAME * np.nanmax(np.abs(own)), equal_nan=True
            )
        )

    def at(self, x: Array) -> Array:
        """The heights at numbers x (m,)."""
        piece = np.searchsorted(self.points[1:-1], x, side="right")
        out = np.zeros(x.shape)
        for each in self.powers:
            out = out * (x - self.points[piece]) + each[piece]
        for there, height in zip(
            (x < self.points[0], x > self.points[-1]), self.beyond or (), strict=False
        ):
            out = np.where(there, height, out)
        return out


def pieces_of(curve: Any) -> Pieces | None:
    """A curve's polynomials; None where it has none that are known, or many."""
    if curve not in _KNOWN:
        found = _pieces_of(curve)
        right = found is not None and found.powers.shape[1] <= MOST and found.agrees(curve)
        _KNOWN[curve] = found if right else None
    return _KNOWN[curve]


_KNOWN: WeakKeyDictionary[Any, Pieces | None] = WeakKeyDictionary()


def _pieces_of(curve: Any) -> Pieces | None:
    if isinstance(curve, BSpline):
        if np.ndim(curve.c) != 1:
            return None
        knots = curve.t, curve.c, curve.k
        return _of_polynomials(PPoly.from_spline(knots, extrapolate=curve.extrapolate))
    if isinstance(curve, PPoly):
        return _of_polynomials(curve)
    if isinstance(curve, UnivariateSpline):
        return _of_fit(curve)
    if isinstance(curve, interp1d) and np.ndim(curve.y) == 1:
        return _between(curve)
    return None


def _of_fit(curve: Any) -> Pieces | None:
    own = _of_polynomials(PPoly.from_spline(curve._eval_args))
    if own is None or curve.ext == 0:
        return own
    low, high = own.at(own.points[[0, -1]])
    beyond = {1: (0.0, 0.0), 2: NOWHERE, 3: (float(low), float(high))}[int(curve.ext)]
    return Pieces(own.points, own.powers, beyond, raises=curve.ext == 2)


def _between(curve: Any) -> Pieces | None:
    spline, filled = getattr(curve, "_spline", None), curve.fill_value
    if spline is None:
        x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
        own: Pieces | None = Pieces(x, np.stack([np.diff(y) / np.diff(x), y[:-1]]))
    else:
        own = _of_polynomials(PPoly.from_spline((spline.t, np.ravel(spline.c), spline.k)))
    if own is None or isinstance(filled, str):  # it goes on as at its ends
        return own
    below, above = filled if isinstance(filled, tuple) else (filled, filled)
    beyond = float(np.ravel(below)[0]), float(np.ravel(above)[0])
    return Pieces(own.points, own.powers, beyond, raises=bool(curve.bounds_error))


def _of_polynomials(own: PPoly) -> Pieces | None:
    if np.ndim(own.c) != 2 or own.extrapolate == "periodic" or np.iscomplexobj(own.c):
        return None
    real = np.append(np.diff(own.x) > 0.0, True)  # splines have knots several times at their ends
    points, powers = own.x[real], own.c[:, real[:-1]]
    if len(points) < 2 or len(points) != powers.shape[1] + 1:
        return None
    return Pieces(points, powers, None if own.extrapolate else NOWHERE)
