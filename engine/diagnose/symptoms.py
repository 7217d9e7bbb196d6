"""What free-run simulation and one-step prediction get wrong, where, by how much: numbers and words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from engine.diagnose.curves import bands_of, compared, residuals_of
from engine.diagnose.data_checks import check_data
from engine.diagnose.plain import plain
from engine.diagnose.regions import (
    NOTABLE,
    NOTABLE_RUN,
    Errors,
    Region,
    by_frequency,
    by_signal,
    most_telling,
    newey_west,
)
from engine.diagnose.residuals import Whiteness, auxiliary, pit, standardised, whiteness
from engine.diagnose.runs import draws, noise_free, start_state
from engine.diagnose.sentences import overall, sentence
from engine.model import Array, MixedModel, ThetaLike
from engine.moment_filter import MomentPath, moment_path
from engine.series import Series

__all__ = ["Comparison", "Fit", "Symptoms", "check_data", "find_symptoms"]

DRAWS = 200
ROOM, FEWEST_DRAWS = 4_000_000, 40  # simulated samples in all: longer series get fewer draws
LEVEL = 0.95
TRANSIENT = (
    3.0  # times the median: a prediction less certain than that is one of a state not yet known
)
SHOWN = 4  # sentences on regions, of the free run and of the predictions


@dataclass(frozen=True)
class Fit:
    """One output: ``rmse``, ``bias`` in its unit, ``fit`` = 100 (1 - rmse / std(y)) %, ``inside`` the band.

    ``expected_rmse`` is what the model itself leads to expect; ``as_wrong`` the share of its own
    simulations that are at least as far from its free run (None for one-step predictions);
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


@dataclass(frozen=True, eq=False)
class Symptoms:
    """What the model's simulation and predictions get wrong on a series.

    ``sentences`` say it in words; ``free_run`` is None where it runs away. For pictures: standardised
    innovations ``z``, their ``pit``, auxiliary residuals ``of_outputs`` (T, ny) and ``of_states`` (T-1, nx),
    simulated states ``x`` (T, nx) and predicted states (T, nx).
    """

    sentences: tuple[str, ...]
    model: MixedModel
    series: Series
    free_run: Comparison | None
    one_step: Comparison
    whiteness: tuple[Whiteness, ...]
    z: Array
    pit: Array
    of_outputs: Array
    of_states: Array
    x: Array | None
    predicted: Array

    def to_dict(self) -> dict[str, Any]:
        """As data: sentences, fits, notable regions, whiteness, and what pictures need.

        Both comparisons hold ``curves`` over time by output and ``bands``: errors in each single band of
        each signal, of time and of frequency. ``residuals`` are those of
        :func:`engine.diagnose.curves.residuals_of`. What is not finite is None.
        """
        states = [*self.model.nonlinear, *self.model.linear]
        document = {
            "sentences": list(self.sentences),
            "free_run": self._comparison(self.free_run, NOTABLE_RUN),
            "one_step": self._comparison(self.one_step, NOTABLE),
            "residuals": residuals_of(
                self.series.t, self.z, self.of_outputs, self.of_states, self.model.outputs, states
            ),
            "whiteness": [asdict(w) for w in self.whiteness],
        }
        cleaned: dict[str, Any] = plain(document)
        return cleaned

    def _comparison(self, comparison: Comparison | None, notable: float) -> dict[str, Any] | None:
        if comparison is None:
            return None
        regions = most_telling(list(comparison.regions), 4 * SHOWN, notable)
        series, c = self.series, comparison
        names = list(self.model.outputs)
        return {
            "fits": [asdict(f) for f in c.fits],
            "regions": [asdict(r) for r in regions],
            "bands": bands_of(c.regions),
            "curves": compared(series.t, series.y, c.y, c.lower, c.upper, names),
        }


def find_symptoms(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    covariance: Array | None = None,
    n_bands: int = 8,
    seed: int = 0,
) -> Symptoms:
    """Compare a model at theta with a series; ``covariance`` (n_theta, n_theta) is theta's uncertainty.

    The free run starts at the first state as estimated from the first tenth of the rows and sees no
    measurement after that; its 95 % band holds the uncertainty of the first state, of theta, of the
    process and of the measurement (200 simulations, fewer of more than 20,000 samples). Errors are
    measured minus simulated or predicted. Raises ModelError where the filter is lost.
    """
    vector = np.asarray(model.theta(theta))
    path = moment_path(model, vector, series)
    z = standardised(path, series)
    one_step = _predictions(model, series, path, z, n_bands)
    free, x, sentences = None, None, []
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    with np.errstate(over="ignore", invalid="ignore"):
        mean, P = start_state(model, vector, series)
        y, states = noise_free(model, vector, series, mean)
        if np.isfinite(y).all():
            x = states
            n = int(np.clip(ROOM // len(series), FEWEST_DRAWS, DRAWS))
            drawn = draws(model, vector, series, mean, P, covariance, n, rng)
            free = _free_run(model, series, y, states, drawn, n_bands)
        else:
            row = int(np.argmin(np.isfinite(y).all(axis=1)))
            sentences.append(
                f"The free run runs away: from t = {series.t[row]:g} s on it is not finite."
            )
    white = whiteness(z, tuple(model.outputs))
    for comparison, what in ((free, "simulation"), (one_step, "prediction")):
        if comparison is None:
            continue
        sentences += [overall(f, what) for f in comparison.fits]
        notable = NOTABLE_RUN if what == "simulation" else NOTABLE
        telling = most_telling(list(comparison.regions), SHOWN, notable)
        sentences += [sentence(r, what, model.outputs[r.output]) for r in telling]
    sentences += [
        f"What the predictions of {w.output} miss is not random: their errors are correlated in time "
        f"(Ljung-Box {w.statistic:.0f} over {w.lags} lags, p = {w.p_value:.2g})."
        for w in white
        if w.p_value < 0.001
    ]
    of_y, of_x = auxiliary(path, series)
    return Symptoms(
        tuple(sentences),
        model,
        series,
        free,
        one_step,
        white,
        z,
        pit(z),
        of_y,
        of_x,
        x,
        path.predicted,
    )


def _free_run(
    model: MixedModel, series: Series, y: Array, x: Array, drawn: Array, n_bands: int
) -> Comparison:
    """The noise-free run against the data, judged by simulations with noise (K, T, ny)."""
    fine = drawn[np.isfinite(drawn).all(axis=(1, 2))]
    if len(fine) < 20:  # most simulations run away: nothing can be judged by them
        fine = np.repeat(y[None], 2, axis=0)
    tail = 0.5 * (1.0 - LEVEL)
    lower, upper = np.quantile(fine, [tail, 1.0 - tail], axis=0)
    signals = _signals(model, series, x, y)
    regions, expected, errors_drawn = [], [], []
    for i, (name, unit) in enumerate(model.outputs.items()):
        e = series.y[:, i] - y[:, i]
        seen = np.isfinite(e)
        errors = np.where(seen, fine[:, :, i] - y[:, i], np.nan)
        expected.append(float(np.sqrt(np.mean(errors[:, seen] ** 2))) if seen.any() else np.nan)
        errors_drawn.append(np.sqrt(np.nanmean(errors**2, axis=1)) if seen.any() else np.zeros(1))
        one = Errors(name, unit, e, upper[:, i] - lower[:, i], errors)
        regions += _regions(one, signals, series, n_bands)
    found = _fits(model, series, y, lower, upper, expected)
    own = dict(zip(model.outputs, errors_drawn, strict=True))
    fits = tuple(replace(f, as_wrong=float(np.mean(own[f.output] >= f.rmse))) for f in found)
    return Comparison(y, lower, upper, fits, tuple(regions))


def _predictions(
    model: MixedModel, series: Series, path: MomentPath, z: Array, n_bands: int
) -> Comparison:
    """One-step predictions against the data, without the first ones from an unknown first state."""
    H_mean = series.y - path.innovations
    y = np.where(np.isfinite(H_mean), H_mean, np.nan)
    spread = np.sqrt(np.maximum(np.diagonal(path.S, axis1=1, axis2=2), 0.0))
    half = 1.959964 * spread
    lower, upper = y - half, y + half
    signals = _signals(model, series, path.predicted, y)
    regions = []
    settled = np.where(spread > TRANSIENT * np.median(spread, axis=0), np.nan, path.innovations)
    for i, (name, unit) in enumerate(model.outputs.items()):
        one = Errors(name, unit, settled[:, i], 2.0 * half[:, i])
        regions += _regions(one, signals, series, n_bands, spectrum=False)
        if series.dt is not None:
            flat = Errors(name, "standard deviations", z[:, i], 2.0 * half[:, i] / spread[:, i])
            regions += by_frequency(flat, series.dt, n_bands)
    known = np.isfinite(settled)
    expected = [_root_mean(spread[known[:, i], i] ** 2) for i in range(model.ny)]
    fits = []
    for f in _fits(model, series, np.where(known, y, np.nan), lower, upper, expected):
        e = settled[:, list(model.outputs).index(f.output)]
        seen = np.isfinite(e)
        error = newey_west(np.where(seen, e - f.bias, 0.0), int(seen.sum()))
        fits.append(replace(f, bias_error=error))
    return Comparison(y, lower, upper, tuple(fits), tuple(regions))


def _signals(
    model: MixedModel, series: Series, x: Array, y: Array
) -> list[tuple[str, str, str, Array]]:
    """(kind, name, unit, values (T,)) of all that is known before an error is; then time."""
    named = [("state", n, u) for n, u in {**model.nonlinear, **model.linear}.items()]
    named += [("input", n, u) for n, u in model.inputs.items()]
    named += [("output", n, u) for n, u in model.outputs.items()]
    values = [*x.T, *series.u.T, *y.T]
    out = [(*name, value) for name, value in zip(named, values, strict=True)]
    out.append(("time", "time", "s", np.asarray(series.t)))
    return out


def _regions(
    errors: Errors,
    signals: list[tuple[str, str, str, Array]],
    series: Series,
    n_bands: int,
    spectrum: bool = True,
) -> list[Region]:
    if not np.isfinite(errors.e).any():
        return []
    out: list[Region] = []
    done: list[Array] = []
    for kind, name, unit, values in signals:
        if any(np.array_equal(values, other) for other in done):
            continue  # an output that is a state
        done.append(values)
        out += by_signal(errors, kind, name, unit, values, n_bands)
    if spectrum and series.dt is not None:
        out += by_frequency(errors, series.dt, n_bands)
    return out


def _fits(
    model: MixedModel, series: Series, y: Array, lower: Array, upper: Array, expected: list[float]
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
                float(inside.mean()),
                expected[i],
            )
        )
    return tuple(out)


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")
