"""What free-run simulation and one-step prediction get wrong, where, by how much: numbers and words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.symptoms.compare import (
    AWAY_RANGES,
    Comparison,
    Fit,
    against_predictions,
    against_run,
    lost_at,
)
from engine.diagnose.symptoms.curves import bands_of, compared, residuals_of
from engine.diagnose.symptoms.data_checks import check_data
from engine.diagnose.symptoms.error_localization import NOTABLE, NOTABLE_RUN, most_telling
from engine.diagnose.symptoms.residuals import Whiteness, auxiliary, standardised, whiteness
from engine.diagnose.symptoms.runs import draws, noise_free, start_state
from engine.diagnose.symptoms.sentences import correlated, overall, sentence
from engine.filters.sigma_point import MomentPath, moment_path
from engine.json_values import plain
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.words import moment

__all__ = ["Comparison", "Fit", "Symptoms", "check_data", "find_symptoms"]

SIMULATIONS = 200
# simulated samples in all: longer series get fewer draws
SIMULATED_SAMPLES, FEWEST_SIMULATIONS = 4_000_000, 40
FEWEST_FINITE_RUNS = 20  # simulations that do not run away, without which nothing is judged by them
REGION_SENTENCES = 4  # sentences on regions, of the free run and of the predictions


@dataclass(frozen=True, eq=False)
class Symptoms:
    """What the model's simulation and predictions get wrong on a series.

    ``sentences`` say it in words; ``free_run`` is None where it runs away. For pictures: standardised
    innovations ``z`` (T, ny), auxiliary residuals ``of_outputs`` (T, ny) and ``of_states`` (T-1, nx).
    """

    sentences: tuple[str, ...]
    model: MixedModel
    series: Series
    free_run: Comparison | None
    one_step: Comparison
    whiteness: tuple[Whiteness, ...]
    z: Array
    of_outputs: Array
    of_states: Array

    def to_dict(self) -> dict[str, Any]:
        """As data: sentences, fits, notable regions, whiteness, and what pictures need.

        Both comparisons hold ``curves`` over time by output and ``bands``: errors in each single band of
        each signal, of time and of frequency. ``residuals`` are those of
        :func:`engine.diagnose.symptoms.curves.residuals_of`. What is not finite is None.
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
        regions = most_telling(list(comparison.regions), 4 * REGION_SENTENCES, notable)
        series, c = self.series, comparison
        names = list(self.model.outputs)
        return {
            "fits": [asdict(f) for f in c.fits],
            "regions": [asdict(r) for r in regions],
            "bands": bands_of(c.regions),
            "curves": compared(series.t, series.y, c.y, c.lower, c.upper, names),
        }


def _at_samples(path: MomentPath, series: Series) -> MomentPath:
    """What the filter saw at the samples of a refined series, ``F`` from each to the next."""
    rows, whole = series.samples, np.eye(path.F.shape[-1])
    for step in range(series.substeps):
        whole = path.F[rows[:-1] + step] @ whole
    names = (f.name for f in fields(path) if f.name not in ("F", "log_likelihood"))
    return replace(path, F=whole, **{name: getattr(path, name)[rows] for name in names})


def _rows_of(fitted: Series | None, series: Series) -> slice:
    """As many rows of a series as were fitted, from their first on; all where they are joined records."""
    if fitted is None or fitted.begins:
        return slice(None)
    first = int(np.searchsorted(series.t, fitted.t[0]))
    return slice(first, first + len(fitted.samples))


def find_symptoms(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    covariance: Array | None = None,
    seed: int = 0,
    fitted: Series | None = None,
) -> Symptoms:
    """Compare a model at theta with a series; ``covariance`` (n_theta, n_theta) is theta's uncertainty.

    Whether predictions are random is asked of the rows that theta was ``fitted`` to, a part of the series: over
    many more than those its errors show, and are no fault of the model.

    The free run starts at the first state as estimated from the first tenth of the rows and sees no
    measurement after that; its 95 % band holds the uncertainty of the first state, of theta, of the
    process and of the measurement (200 simulations, fewer of more than 20,000 samples). Errors are
    measured minus simulated or predicted. Of a refined ``series`` the samples are compared. Raises ModelError
    where the filter is lost.
    """
    vector, stepped, at = np.asarray(model.theta(theta)), series, series.samples
    path = _at_samples(moment_path(model, vector, stepped), stepped)
    series = stepped.held(stepped.hold)
    z = standardised(path, series)
    one_step = against_predictions(model, series, path, z)
    free, sentences = None, []
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    with np.errstate(over="ignore", invalid="ignore"):
        mean, P = start_state(model, vector, stepped)
        y, states = (run[at] for run in noise_free(model, vector, stepped, mean))
        row = lost_at(y, series)
        if row is None:
            n = int(np.clip(SIMULATED_SAMPLES // len(stepped), FEWEST_SIMULATIONS, SIMULATIONS))
            drawn = draws(model, vector, stepped, mean, P, covariance, n, rng)[:, at]
            fine = drawn[np.isfinite(drawn).all(axis=(1, 2))]
            if len(fine) < FEWEST_FINITE_RUNS:
                fine = fine[:0]
                sentences.append(
                    "Most of the model's own simulations run away: what it leads to expect of the free run is "
                    "not known."
                )
            free = against_run(model, series, y, states, fine)
        else:
            when = moment(float(series.t[row]), series.usual_step, series.time_unit)
            sentences.append(
                f"The free run runs away: from t = {when} on it is further off than "
                f"{AWAY_RANGES:g} times the range of the readings."
            )
    white = whiteness(z[_rows_of(fitted, series)], tuple(model.outputs))
    for comparison, what in ((free, "simulation"), (one_step, "prediction")):
        if comparison is None:
            continue
        sentences += [overall(f, what) for f in comparison.fits]
        notable = NOTABLE_RUN if what == "simulation" else NOTABLE
        telling = most_telling(list(comparison.regions), REGION_SENTENCES, notable)
        sentences += [sentence(r, what, model.outputs[r.output]) for r in telling]
    sentences += [
        correlated(w.output, w.statistic, w.lags, w.p_value) for w in white if w.p_value < 0.001
    ]
    return Symptoms(
        tuple(sentences), model, series, free, one_step, white, z, *auxiliary(path, series)
    )
