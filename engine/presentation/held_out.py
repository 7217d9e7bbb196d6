"""An estimate on data that it has not seen: the error of its simulation, the density of its predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.data.joined import joined, past_of
from engine.data.series import Series
from engine.diagnose.symptoms.curves import named
from engine.diagnose.symptoms.runs import noise_free, start_state
from engine.errors import EngineError
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array, MixedModel, ThetaLike


def held_out(
    model: MixedModel, theta: ThetaLike, tests: Sequence[Series], records: Sequence[Series] = ()
) -> dict[str, Any]:
    """Errors of the simulation on ``tests``, each begun at the state that its own first rows tell.

    A test that goes on where one of the ``records`` ended begins at the state that this one leaves.

    ``outputs`` holds the rms over all rows that were measured, in the output's unit, and the fit, 100 (1 - rms
    / standard deviation) %; ``log_density`` the sum of one-step predictive log-densities by the moment
    filter, None where it is lost; ``series`` the curves. A run that does not stay finite has the error None.
    """
    values = np.asarray(model.theta(theta))
    wholes = [_with_past(one, records) for one in tests]
    runs = [_run(model, values, *whole) for whole in wholes]
    errors = np.concatenate([one.y - run for one, run in zip(tests, runs, strict=True)])
    y = np.concatenate([one.y for one in tests])
    outputs = []
    for i, (name, unit) in enumerate(model.outputs.items()):
        seen = np.isfinite(y[:, i])
        if not seen.any():
            continue
        rmse, spread = float(np.sqrt(np.mean(errors[seen, i] ** 2))), float(y[seen, i].std())
        fit = 100.0 * (1.0 - rmse / spread) if spread > 0.0 else np.nan
        outputs.append({"output": name, "unit": unit, "rmse": _known(rmse), "fit": _known(fit)})
    return {
        "samples": int(sum(one.n_measured for one in tests)),
        "log_density": _log_density(model, values, wholes),
        "outputs": outputs,
        "series": [
            {
                "t": one.t[one.samples].tolist(),
                "y": named(run[one.samples], tuple(model.outputs)),
                "measured": named(one.y[one.samples], tuple(model.outputs)),
            }
            for one, run in zip(tests, runs, strict=True)
        ],
    }


def _known(value: float) -> float | None:
    """As documents have it, also before they are JSON."""
    return value if np.isfinite(value) else None


def _with_past(test: Series, records: Sequence[Series]) -> tuple[Series, int]:
    """The test behind the record that it goes on with, if there is one, and the row where it begins."""
    past = past_of(test, records)
    whole = test if past is None else joined(past, test)
    return whole, len(whole) - len(test)


def _run(model: MixedModel, theta: Array, whole: Series, first: int) -> Array:
    """The simulation y (T, ny) from row ``first`` on, NaN from where it is lost."""
    part = whole.part(first, len(whole))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            x1, _ = start_state(model, theta, whole, first)
            y, _ = noise_free(model, theta, part, x1)
    except (EngineError, np.linalg.LinAlgError):
        return np.full_like(part.y, np.nan)
    return y


def _log_density(
    model: MixedModel, theta: Array, wholes: Sequence[tuple[Series, int]]
) -> float | None:
    try:
        found = [
            moment_filter(model, theta[None], whole).log_terms[first:, 0].sum()
            for whole, first in wholes
        ]
    except (EngineError, np.linalg.LinAlgError):
        return None
    total = float(np.sum(found))
    return total if np.isfinite(total) else None
