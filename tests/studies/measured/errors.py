"""Free runs on the rows that judge, and what they get wrong there."""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.gain.gain import Gain
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.simulation.free_run import free_run
from engine.statespace.model import Array, MixedModel
from tests.studies.measured.records import Data

Runs = dict[str, tuple[Series, Array | None, Array | None]]


def simulated(found: Diagnosis, data: Data) -> Runs:
    """Free runs (n,) of the first output at the samples of each test part, before and after.

    None where there is none. Without a test part those of blocks, each left out of fits.
    """
    if data.blocks:
        return {} if found.gain is None else on_blocks(found.gain)
    return runs_of(found.before, found.after, data, found.substeps)


def runs_of(before: QuasiFit, after: QuasiFit, data: Data, substeps: int) -> Runs:
    """The same for any two fits; ``after`` is ``before`` where there is no extension."""
    out: Runs = {}
    for part, series in data.tests.items():
        fine = series.refined(substeps)
        fits = (before, after if after is not before else None)
        runs = [
            None
            if fit is None
            else run_of(fit.model, np.asarray(fit.theta), fine, data.settled * substeps)
            for fit in fits
        ]
        out[part] = (series, runs[0], runs[1])
    return out


def on_blocks(gain: Gain) -> Runs:
    """The free runs that a gain was measured with."""
    one = Series(gain.y, t=gain.t)
    runs = [None if y is None else y[:, 0] for y in (gain.before, gain.after)]
    return {gain.how: (one, runs[0], runs[1])}


def run_of(model: MixedModel, theta: Array, fine: Series, rows: int) -> Array | None:
    """A free run at the samples, its first state estimated on the first rows; None where it is lost."""
    try:
        with np.errstate(all="ignore"):
            y = free_run(model, theta, fine, initial_rows=rows).y[fine.samples, 0]
    except (EngineError, ValueError, np.linalg.LinAlgError):
        return None
    return y if np.isfinite(y).all() else None


def errors(
    series: Series, before: Array | None, after: Array | None, settled: int
) -> list[float | None]:
    """RMSE before and after, the rows that settle the first state not counted."""
    y = series.y[settled:, 0]
    return [
        None if run is None else float(np.sqrt(np.nanmean((y - run[settled:]) ** 2)))
        for run in (before, after)
    ]


def all_errors(runs: Runs, settled: int, extended: bool) -> dict[str, list[float | None]]:
    """By part; without an extension the error after is that before, so that None is a run that is lost."""
    out = {}
    for part, (series, before, after) in runs.items():
        out[part] = errors(series, before, after if extended else before, settled)
    return out
