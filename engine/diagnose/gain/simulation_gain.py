"""Free-run error before and after an extension, with intervals from a block bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.symptoms.runs import covariance_of, draws, noise_free, start_state
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.statespace.model import Array

BOOTSTRAPS = 999
INTERVAL_LEVEL = 0.95
DRAWN = 200  # records of the extended model


@dataclass(frozen=True)
class OutputGain:
    """Free-run error of one output before and after; intervals hold 95 % (block bootstrap).

    ``rmse`` in ``unit``, ``fit`` = 100 (1 - rmse / std(y)) %, ``difference`` = after - before;
    ``floor`` the standard deviation of the measurement noise; ``share_gone`` of the squared error above that
    floor, None where there is none above it. ``as_worse``, where it seems to be worse: of records that the
    extended model simulates itself, the share where its run is as much worse than the one before, as a ratio of
    their errors: by the difference an excursion that dwarfs both runs, as of outliers, would excuse any run.
    """

    output: str
    unit: str
    rmse_before: float
    rmse_after: float
    interval_before: tuple[float, float]
    interval_after: tuple[float, float]
    difference: float
    interval_difference: tuple[float, float]
    fit_before: float
    fit_after: float
    floor: float
    share_gone: float | None
    as_worse: float | None = None


def free_run_from(fit: QuasiFit, series: Series, first: int) -> tuple[Array, Array] | None:
    """y and x from row ``first`` on; None where the run does not stay finite."""
    theta = np.asarray(fit.theta)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            x1, _ = start_state(fit.model, theta, series, first)
            y, x = noise_free(fit.model, theta, series.part(first, len(series)), x1)
    except (EngineError, np.linalg.LinAlgError):
        return None
    return (y, x) if np.isfinite(y).all() else None


def drawn_from(fit: QuasiFit, series: Series, first: int, seed: int) -> Array:
    """Records (DRAWN, n, ny) from row ``first`` on as a fitted model simulates them, uncertain as it is.

    Noise that wanders takes one free run nearer to a record than the other by chance, for as long as it
    wanders: resampled blocks of one record, which may hold one such excursion, do not tell.
    """
    theta, rng = np.asarray(fit.theta), np.random.default_rng([seed, 7])
    x1, P1 = start_state(fit.model, theta, series, first)
    part = series.part(first, len(series))
    with np.errstate(over="ignore", invalid="ignore"):
        return draws(fit.model, theta, part, x1, P1, covariance_of(fit), DRAWN, rng)


def noise_level(fit: QuasiFit, series: Series, x: Array) -> Array:
    """Standard deviation (ny,) of the measurement noise along a run x (T, nx)."""
    model = fit.model
    record = model.record(fit.theta)
    variances = []
    for a, u, t in zip(x[:, None, : model.na], series.u, series.t.tolist(), strict=True):
        _, _, R = model.observation(a, u, t, record)
        variances.append(np.diagonal(R.reshape(model.ny, model.ny)))
    return np.asarray(np.sqrt(np.maximum(np.mean(variances, axis=0), 0.0)))


def output_gains(
    base: QuasiFit,
    part: Series,
    rows: NDArray[np.bool_],
    before: Array,
    after: Array,
    floor: Array,
    seed: int,
    drawn: Callable[[], Array] | None = None,
) -> list[OutputGain]:
    """Errors of two free runs (T, ny) on the marked rows, for each output with readings there.

    ``drawn`` makes records (N, T, ny) of the extended model, where one run is worse than the other.
    """
    out: list[OutputGain] = []
    for i, (name, unit) in enumerate(base.model.outputs.items()):
        kept = rows & part.observed[:, i]
        if kept.sum() < 2:
            continue
        y = part.y[kept, i]
        squares = np.stack([(y - run[kept, i]) ** 2 for run in (before, after)])
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        rmse = np.sqrt(squares.mean(axis=1))
        again = np.sqrt(bootstrap_means(squares, rng))
        spread = float(y.std())
        fits = 100.0 * (1.0 - rmse / spread) if spread > 0.0 else np.full(2, np.nan)
        above = float(rmse[0] ** 2 - floor[i] ** 2)
        out.append(
            OutputGain(
                name,
                unit,
                float(rmse[0]),
                float(rmse[1]),
                _interval(again[0]),
                _interval(again[1]),
                float(rmse[1] - rmse[0]),
                _interval(again[1] - again[0]),
                float(fits[0]),
                float(fits[1]),
                float(floor[i]),
                float((rmse[0] ** 2 - rmse[1] ** 2) / above) if above > 0.0 else None,
            )
        )
    seems = [o.output for o in out if o.interval_difference[0] > 0.0]
    if drawn is None or not seems:
        return out
    records = drawn()
    for k, one in enumerate(out):
        if one.output in seems:
            i = list(base.model.outputs).index(one.output)
            kept = rows & part.observed[:, i]
            each = [_root_means(records[:, kept, i] - run[kept, i]) for run in (before, after)]
            worse = each[1] * one.rmse_before >= each[0] * one.rmse_after
            out[k] = replace(one, as_worse=float(np.mean(worse)))
    return out


@np.errstate(over="ignore", invalid="ignore")  # of a record that runs away
def _root_means(errors: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))


def bootstrap_means(values: Array, rng: np.random.Generator, n: int = BOOTSTRAPS) -> Array:
    """Means (k, n) of circular block resamples of values (k, T), all rows alike (Politis, Romano 1992).

    A block is twice as long as the difference of the first and last row stays correlated (above 0.2),
    between T^(1/3) and T / 5.
    """
    T = values.shape[1]
    d = values[-1] - values[0] if len(values) > 1 else values[0]
    if not np.ptp(d) > 0.0:
        d = values[0]
    d = d / (np.abs(d).max() or 1.0)  # squares of a run that all but runs away have no squares
    d -= d.mean()
    spectrum = np.abs(np.fft.rfft(d, 2 * T)) ** 2
    r = np.fft.irfft(spectrum)[: max(T // 2, 1)]
    below = np.flatnonzero(r < 0.2 * r[0])
    length = 2 * int(below[0]) if below.size else T
    length = max(int(np.clip(length, np.ceil(T ** (1.0 / 3.0)), max(T // 5, 1))), 1)
    blocks = int(np.ceil(T / length))
    sums = np.concatenate(
        [np.zeros((len(values), 1)), np.cumsum(np.tile(values, 2), axis=1)], axis=1
    )
    starts = rng.integers(0, T, size=(n, blocks))
    totals = (sums[:, starts + length] - sums[:, starts]).sum(axis=2)
    return np.asarray(np.maximum(totals, 0.0) / (blocks * length))


def _interval(drawn: Array) -> tuple[float, float]:
    tail = 0.5 * (1.0 - INTERVAL_LEVEL)
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return float(low), float(high)
