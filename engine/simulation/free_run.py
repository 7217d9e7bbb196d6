"""Free-run simulation: the model without noise over a series' inputs, and bands around it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from engine.data.given import one_series
from engine.data.series import Series
from engine.errors import OptionError, SeriesError
from engine.failing import where_it_fails
from engine.simulation.simulate import check_finite, noise, propagate
from engine.simulation.step_length import about_free_runs
from engine.statespace.checks import check_start
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.threads import single_threaded
from engine.units import alike
from engine.views import Figures, Shown, View, figures, plots, sheet, tables
from engine.words import tidy


@dataclass(frozen=True)
class Bands:
    """What the Monte Carlo bands of a free run hold.

    ``draws`` runs are made. ``covariance`` (n_theta, n_theta) is the parameters' uncertainty,
    ``start`` (nx, nx) that of the first state x_1 = (a_1, z_1); None leaves either out.
    ``process`` and ``measurement`` noise are those of the model. ``level`` is the probability
    within the bands, at each sample by itself.
    """

    draws: int = 200
    level: float = 0.95
    covariance: ArrayLike | None = None
    start: ArrayLike | None = None
    process: bool = True
    measurement: bool = True
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))


@dataclass(frozen=True, eq=False)
class FreeRun(Shown):
    """A noise-free run: y (T, ny), a (T, na), z (T, nz); bands lower, upper (T, ny) or None."""

    model: MixedModel
    theta: Theta
    series: Series
    y: Array
    a: Array
    z: Array
    lower: Array | None = None
    upper: Array | None = None

    @property
    def residuals(self) -> Array:
        """Measured minus simulated (T, ny), NaN where nothing was measured."""
        return self.series.y - self.y

    @property
    def rmse(self) -> float:
        """Root mean square of all residuals, in the outputs' unit; NaN where they have several units."""
        return self.rmse_from(0)

    @cached_property
    def note(self) -> str:
        """A sentence where the model's steps are too long for this run; "" where they are not."""
        x1 = np.concatenate((self.a[:1], self.z[:1]), axis=1)
        return about_free_runs(self.model, self.theta, [self.series], x1)

    def rmse_from(self, row: int) -> float:
        """The same, leaving out the samples before ``row``."""
        return root_mean_square(self.model, self.residuals[row:])

    @property
    def rmse_by_output(self) -> dict[str, float]:
        """Root mean square of the residuals of each output, in its unit; NaN where none was measured."""
        return root_mean_squares(self.model, self.residuals)

    def plot(self) -> Figures:
        """``outputs`` against the data with the bands there are, and ``states``; extra ``plot``."""
        t, units = self.series.t, {**self.model.nonlinear, **self.model.linear}
        clock = self.series.time_unit
        both = self.series.y, self.y
        outputs = plots().against_data(
            t, self.model.outputs, *both, "free run", self.lower, self.upper, clock
        )
        x = np.concatenate([self.a, self.z], axis=1)
        return figures(outputs=outputs, states=plots().states(t, units, x, None, clock))

    def _view(self) -> View:
        rows = [
            (name, value, tidy(self.model.outputs[name]))
            for name, value in self.rmse_by_output.items()
        ]
        return sheet(
            f"{self.model.name}: free run over {len(self.series.samples)} samples",
            tables().table(("output", "rms error", "unit"), rows),
            tables().line(self.note),
        )


def root_mean_square(model: MixedModel, residuals: Array) -> float:
    """Of all residuals (T, ny), NaN where nothing was measured, or outputs that were have several units."""
    seen = np.flatnonzero(~np.isnan(residuals).all(axis=0))
    units = [[*model.outputs.values()][i] for i in seen]
    if not units or not all(alike(units[0], unit) for unit in units[1:]):
        return np.nan
    return float(np.sqrt(np.nanmean(residuals**2)))


def root_mean_squares(model: MixedModel, residuals: Array) -> dict[str, float]:
    """Of the residuals (T, ny) of each output, in its unit; NaN where none was measured."""
    n = np.isfinite(residuals).sum(axis=0)
    means = np.nansum(residuals**2, axis=0) / np.where(n, n, np.nan)
    return dict(zip(model.outputs, np.sqrt(means).tolist(), strict=True))


@single_threaded
def free_run(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    a1: ArrayLike | None = None,
    z1: ArrayLike | None = None,
    initial_rows: int = 0,
    bands: Bands | None = None,
) -> FreeRun:
    """Simulate without noise over a series' inputs and times.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    series : Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times.
    a1 : array (na,), optional
        First nonlinear state; the mean of the initial density by default.
    z1 : array (nz,), optional
        First linear state; the mean of the initial density by default.
    initial_rows : int
        Number of samples on which the uncertain components of the first state are estimated by least squares.
        0 keeps the given or expected first state, and then y may be missing throughout.
    bands : Bands, optional
        Which uncertainty the Monte Carlo bands of the run include: parameters, first state, noise. No bands by
        default.

    Returns
    -------
    FreeRun
        ``y`` (T, ny), ``a`` (T, na), ``z`` (T, nz), and bands (T, ny) where asked for.

    Raises
    ------
    ModelError
        The run stops being finite; names the time.
    OptionError
        A first state has the wrong size.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel.
    """
    series = one_series(series, model, measured=initial_rows > 0).alone()
    vector = model.theta(theta)
    check_start(model, vector, series)
    record = model.record(vector)
    given = [
        _given(values, n, name) for values, n, name in ((a1, model.na, "a1"), (z1, model.nz, "z1"))
    ]
    x1, spread = first_state(model, vector, given[0])
    own = np.ones(model.nx, dtype=bool)  # what the model says; neither given nor found
    for values, where in zip(given, (slice(0, model.na), slice(model.na, model.nx)), strict=True):
        if values is not None:
            x1[where], spread[where], own[where] = values, 0.0, False
    if initial_rows:
        x1 = _fit_first_state(model, vector, series, x1, spread, own, initial_rows)
        own &= spread == 0.0
    y, a, z = propagate(model, record, series, x1[None, : model.na], x1[None, model.na :])
    check_finite(model, record, series, y, a, z)
    lower, upper = (None, None) if bands is None else _bands(model, vector, series, x1, own, bands)
    return FreeRun(model, vector, series, y[:, 0], a[:, 0], z[:, 0], lower, upper)


def _given(value: ArrayLike | None, n: int, name: str) -> Array | None:
    """A part of the first state as the caller gives it; raises OptionError."""
    if value is None:
        return None
    values = np.asarray(value, dtype=float).ravel()
    if values.size != n or not np.isfinite(values).all():
        raise OptionError(f"{name} = {values}; {n} finite values are needed", name)
    return values


def first_state(model: MixedModel, theta: Theta, a1: Array | None = None) -> tuple[Array, Array]:
    """Mean and standard deviation (nx,) of x_1 = (a_1, z_1) under the initial density; of z_1 given a1 (na,).

    A density without ``mean`` and ``cov`` is averaged over 1000 draws.
    """
    start = model.start(model.record(theta))
    density = start.density
    if hasattr(density, "mean") and hasattr(density, "cov"):
        mean, variance = np.asarray(density.mean), np.diagonal(density.cov)
    else:
        draws = density.sample(np.random.default_rng(0), 1000)
        mean, variance = draws.mean(axis=0), draws.var(axis=0)
    z, P = start.linear(np.array(mean if a1 is None else a1, dtype=float)[None])
    variance_z = np.diagonal(P if P.ndim == 2 else P[0])
    return np.concatenate((mean, z[0])), np.sqrt(np.concatenate((variance, variance_z)))


def following(model: MixedModel, theta: Theta, x: Array, known: NDArray[np.bool_]) -> Array:
    """First states x (K, nx) whose linear ones that are ``known`` (nx,) are where the model says, given a_1."""
    at = np.flatnonzero(known[model.na :])
    if not at.size or not model.na:
        return x
    z, _ = model.start(model.record(theta)).linear(x[:, : model.na])
    x = x.copy()
    x[:, model.na + at] = z[:, at]
    return x


def run_rows(model: MixedModel, thetas: Array, series: Series, x1: Array) -> tuple[Array, Array]:
    """Noise-free runs of K parameter vectors (K, n_theta) from K first states (K, nx).

    Returns y (T, K, ny) and x (T, K, nx), NaN for those at which the model cannot be had. K runs cost about as
    much as one where the model's functions take arrays of parameters.
    """
    na, K = model.na, len(thetas)
    nowhere = (
        np.full((len(series), 1, model.ny), np.nan),
        np.full((len(series), 1, model.nx), np.nan),
    )

    @where_it_fails(nowhere)
    def runs(rows: slice) -> tuple[Array, Array]:
        record, x = model.records(thetas[rows]), x1[rows]
        y, a, z = propagate(model, record, series, x[:, :na], x[:, na:])
        return y, np.concatenate((a, z), axis=2)

    found = runs(slice(None))
    if found is not nowhere or K == 1:
        return found
    each = [runs(slice(k, k + 1)) for k in range(K)]
    return np.concatenate([y for y, _ in each], axis=1), np.concatenate(
        [x for _, x in each], axis=1
    )


def _fit_first_state(
    model: MixedModel,
    theta: Theta,
    series: Series,
    x1: Array,
    spread: Array,
    own: NDArray[np.bool_],
    rows: int,
) -> Array:
    """x_1 by least squares on the first rows; components without spread stay, or follow where ``own``."""
    part = series.part(0, min(max(rows, 2), len(series)))
    free = np.flatnonzero(spread > 0.0)
    seen = part.observed
    if not free.size:
        return x1
    if not seen.any():
        raise SeriesError(f"no measurement in the first {rows} rows to estimate the start from")
    scale, h = spread_of([part]), 1e-5
    record, na, known = model.record(theta), model.na, own & (spread == 0.0)

    def begun(p: Array) -> Array:
        """First states (K, nx), each component p (K, n) in standard deviations away from where it began."""
        x = np.tile(x1, (len(p), 1))
        x[:, free] += spread[free] * p
        return following(model, theta, x, known)

    def evaluate(p: Array) -> tuple[Array, Array]:
        around = np.tile(p, (2 * free.size + 1, 1))
        for i in range(free.size):
            around[1 + 2 * i, i] += h
            around[2 + 2 * i, i] -= h
        x = begun(around)
        y, _, _ = propagate(model, record, part, x[:, :na], x[:, na:])
        e = ((part.y[:, None] - y) / scale).transpose(0, 2, 1)[seen]
        return e[:, 0], (e[:, 1::2] - e[:, 2::2]) / (2.0 * h)

    def residuals(p: Array) -> Array:
        return evaluate(p)[0]

    def jacobian(p: Array) -> Array:
        return evaluate(p)[1]

    best = least_squares(residuals, np.zeros(free.size), jacobian)
    return np.asarray(begun(best.x[None])[0])


def output_scale(series: list[Series]) -> Array:
    """One number per output to weigh residuals by: its standard deviation; 1 for one output."""
    return np.ones(1) if series[0].y.shape[1] == 1 else spread_of(series)


def spread_of(series: list[Series]) -> Array:
    """Standard deviation (ny,) of each output over all series; 1 where it does not move."""
    y = np.concatenate([one.y for one in series])
    seen = ~np.isnan(y)
    n = np.maximum(seen.sum(axis=0), 1)
    mean = np.nansum(y, axis=0) / n
    scale = np.sqrt(np.nansum((y - mean) ** 2, axis=0) / n)
    return np.where(scale > 0.0, scale, 1.0)


def _bands(
    model: MixedModel,
    theta: Theta,
    series: Series,
    x1: Array,
    own: NDArray[np.bool_],
    bands: Bands,
) -> tuple[Array, Array]:
    """Quantiles (T, ny) of runs with drawn parameters, first states and noise.

    Drawn parameters move those components of the first state that are the model's ``own`` (nx,).
    """
    if bands.draws < 2 or not 0.0 < bands.level < 1.0:
        raise OptionError(
            f"bands: draws = {bands.draws}, level = {bands.level}; at least 2 draws and a level "
            "between 0 and 1 are needed",
            "bands",
        )
    K, na, rng = bands.draws, model.na, bands.rng
    x = np.tile(x1, (K, 1))
    if bands.start is not None:
        x += noise(np.asarray(bands.start, dtype=float), x.shape, rng)
    thetas = np.tile(np.asarray(theta), (K, 1))
    if bands.covariance is not None:
        thetas += noise(np.asarray(bands.covariance, dtype=float), thetas.shape, rng)
        thetas = np.clip(thetas, model.lower, model.upper)
        a1 = None if own[:na].all() else x1[:na]
        moved = np.array([first_state(model, model.theta(one), a1)[0] for one in thetas])
        x += np.where(own, moved - first_state(model, theta, a1)[0], 0.0)
    noises = {"process": bands.process, "measurement": bands.measurement}
    y, _, _ = propagate(model, model.records(thetas), series, x[:, :na], x[:, na:], rng, **noises)
    y = np.sort(np.where(np.isnan(y), np.inf, y), axis=1)
    tail = 0.5 * (1.0 - bands.level)
    low, high = int(np.floor(tail * (K - 1))), int(np.ceil((1.0 - tail) * (K - 1)))
    return y[:, low], y[:, high]
