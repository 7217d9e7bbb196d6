"""A model's free run and its one-step predictions against the data, output by output and band by band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from engine.data.series import Series
from engine.diagnose.symptoms.error_localization import (
    Errors,
    Region,
    by_frequency,
    by_signal,
    newey_west,
)
from engine.filters.sigma_point import MomentPath
from engine.statespace.evaluation import INPUT
from engine.statespace.model import Array, MixedModel
from engine.statespace.reads import reads

BAND_LEVEL = 0.95
# Times the median: a prediction less certain than that is one of a state not yet known.
TRANSIENT = 3.0
Signal: TypeAlias = tuple[str, str, str, Array]  # kind, name, unit, values (T,)
AWAY_RANGES = 1000.0  # ranges of the readings: a run further off than that has run away


@dataclass(frozen=True)
class Fit:
    """One output: ``rmse``, ``bias`` in its unit, ``fit`` = 100 (1 - rmse / std(y)) %, ``inside`` the band.

    ``expected_rmse`` is what the model itself leads to expect, for free runs the median of its own
    simulations; ``as_wrong`` the share of these
    that are at least as far from its free run (None for one-step predictions);
    ``bias_error`` the bias's standard error (Newey-West) for predictions, None for free runs.
    """

    output: str
    unit: str
    rmse: float
    bias: float
    fit: float
    inside: float
    expected_rmse: float | None
    as_wrong: float | None = None
    bias_error: float | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured against ``y`` (T, ny), simulated or predicted, with the band ``lower``, ``upper`` (T, ny).

    ``fits`` per output, ``regions`` where errors were looked at.
    """

    y: Array
    lower: Array
    upper: Array
    fits: tuple[Fit, ...]
    regions: tuple[Region, ...]


def lost_at(y: Array, series: Series) -> int | None:
    """The first row where a run y (T, ny) is not finite or ``AWAY_RANGES`` off; None if none is."""
    low, high = np.full(y.shape[1], -np.inf), np.full(y.shape[1], np.inf)
    for i, seen in enumerate(series.observed.T):
        values = series.y[seen, i]
        reach = AWAY_RANGES * float(np.ptp(values)) if len(values) else 0.0
        if reach > 0.0:
            low[i], high[i] = values.min() - reach, values.max() + reach
    lost = ~(np.isfinite(y) & (y >= low) & (y <= high)).all(axis=1)
    return int(np.argmax(lost)) if lost.any() else None


def against_run(model: MixedModel, series: Series, y: Array, x: Array, fine: Array) -> Comparison:
    """The noise-free run against the data, judged by simulations with noise (K, T, ny) if there are any."""
    if not len(fine):
        nothing = np.full_like(y, np.nan)
        fits = _fits(model, series, y, nothing, nothing, [None] * model.ny)
        return Comparison(y, nothing, nothing, fits, ())
    tail = 0.5 * (1.0 - BAND_LEVEL)
    lower, upper = np.quantile(fine, [tail, 1.0 - tail], axis=0)
    signals = _signals(model, series, x, y)
    regions, expected, errors_drawn = [], [], []
    for i, (name, unit) in enumerate(model.outputs.items()):
        e = series.y[:, i] - y[:, i]
        seen = np.isfinite(e)
        errors = np.where(seen, fine[:, :, i] - y[:, i], np.nan)
        drawn = np.sqrt(np.mean(errors[:, seen] ** 2, axis=1)) if seen.any() else np.full(1, np.nan)
        expected.append(float(np.median(drawn)))
        errors_drawn.append(drawn)
        one = Errors(name, unit, e, upper[:, i] - lower[:, i], errors)
        regions += _regions(one, signals, series)
    found = _fits(model, series, y, lower, upper, expected)
    own = dict(zip(model.outputs, errors_drawn, strict=True))
    fits = tuple(replace(f, as_wrong=float(np.mean(own[f.output] >= f.rmse))) for f in found)
    return Comparison(y, lower, upper, fits, tuple(regions))


def against_predictions(
    model: MixedModel, series: Series, path: MomentPath, z: Array
) -> Comparison:
    """One-step predictions against the data, without the first ones from an unknown first state."""
    H_mean = series.y - path.innovations
    y = np.where(np.isfinite(H_mean), H_mean, np.nan)
    spread = np.sqrt(np.maximum(np.diagonal(path.S_predicted, axis1=1, axis2=2), 0.0))
    half = 1.959964 * spread
    lower, upper = y - half, y + half
    signals = _signals(model, series, path.predicted, y)
    regions = []
    settled = np.where(spread > TRANSIENT * np.median(spread, axis=0), np.nan, path.innovations)
    for i, (name, unit) in enumerate(model.outputs.items()):
        one = Errors(name, unit, settled[:, i], 2.0 * half[:, i])
        regions += _regions(one, signals, series, spectrum=False)
        if series.dt is not None:
            flat = Errors(name, "standard deviations", z[:, i], 2.0 * half[:, i] / spread[:, i])
            regions += by_frequency(flat, series.dt, series.time_unit)
    known = np.isfinite(settled)
    expected = [_root_mean(spread[known[:, i], i] ** 2) for i in range(model.ny)]
    fits = []
    for f in _fits(model, series, np.where(known, y, np.nan), lower, upper, expected):
        e = settled[:, list(model.outputs).index(f.output)]
        seen = np.isfinite(e)
        error = newey_west(e[seen] - f.bias, int(seen.sum()))
        fits.append(replace(f, bias_error=error))
    return Comparison(y, lower, upper, tuple(fits), tuple(regions))


def settled_from(path: MomentPath) -> int:
    """The first row at which predictions are about as certain as they usually are; 0 where there is none."""
    spread = np.sqrt(np.maximum(np.diagonal(path.S_predicted, axis1=1, axis2=2), 0.0))
    wide = np.asarray((spread > TRANSIENT * np.median(spread, axis=0)).any(axis=1))
    first = int(np.argmin(wide))
    return first if first < len(spread) // 2 else 0


def _signals(model: MixedModel, series: Series, x: Array, y: Array) -> list[Signal]:
    """All that is known before an error is; then time.

    Of the inputs that is the one before, for that of a reading's own row may have been set by who saw it; but
    for a model whose readings depend on it.
    """
    named = [("state", n, u) for n, u in {**model.nonlinear, **model.linear}.items()]
    named += [("input", n, u) for n, u in model.inputs.items()]
    named += [("output", n, u) for n, u in model.outputs.items()]
    u = series.u
    if not reads(model.measurement, INPUT):
        u = np.concatenate([u[:1], u[:-1]])
    values = [*x.T, *u.T, *y.T]
    out = [(*name, value) for name, value in zip(named, values, strict=True)]
    out.append(("time", "time", series.time_unit, np.asarray(series.t)))
    return out


def _regions(
    errors: Errors, signals: list[Signal], series: Series, spectrum: bool = True
) -> list[Region]:
    if not np.isfinite(errors.e).any():
        return []
    out: list[Region] = []
    done: list[Array] = []
    for kind, name, unit, values in signals:
        if any(_same(values, other) for other in done):
            continue  # an output that is a state
        done.append(values)
        out += by_signal(errors, kind, name, unit, values)
    if spectrum and series.dt is not None:
        out += by_frequency(errors, series.dt, series.time_unit)
    return out


def _fits(
    model: MixedModel,
    series: Series,
    y: Array,
    lower: Array,
    upper: Array,
    expected: Sequence[float | None],
) -> tuple[Fit, ...]:
    out = []
    for i, (name, unit) in enumerate(model.outputs.items()):
        seen = series.observed[:, i] & np.isfinite(y[:, i])
        if not seen.any():
            continue
        measured = series.y[seen, i]
        e = measured - y[seen, i]
        spread = float(measured.std())
        rmse = _root_mean(e**2)
        inside = (measured >= lower[seen, i]) & (measured <= upper[seen, i])
        out.append(
            Fit(
                name,
                unit,
                rmse,
                float(e.mean()),
                100.0 * (1.0 - rmse / spread) if spread > 0.0 else float("nan"),
                float(inside.mean()) if np.isfinite(upper[seen, i]).any() else float("nan"),
                expected[i],
            )
        )
    return tuple(out)


def _same(one: Array, other: Array) -> bool:
    """Whether two signals are one, up to rounding."""
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any() or not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return False
    close = 1e-9 * float(np.ptp(one[both]))
    return bool(np.abs(one[both] - other[both]).max() <= close)


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")
