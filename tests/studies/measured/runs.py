"""One diagnosis of each record, as a row: verdict, sizes, gain, errors of free runs, curves to draw."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose import diagnose
from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.free_run.search import FreeRound
from engine.errors import EngineError
from engine.statespace.model import Array
from tests.studies.measured.alone import alone
from tests.studies.measured.errors import Runs, errors, simulated
from tests.studies.measured.records import RECORDS, Data
from tests.studies.study import Row

POINTS = 400  # of each curve that is kept for the picture
LISTED = 12  # candidates of a round of the free run that are kept
COLUMNS = ("verdict", "decided", "causes", "errors", "gain", "rounds", "page", "curves", "alone")


def work(name: str, seed: int, run: int) -> Row:
    """One diagnosis; what stops it is a row too."""
    record = RECORDS[name]
    data = record.load(record.path)
    row: Row = {"model": data.model.name, "rows": len(data.train), **dict.fromkeys(COLUMNS, "")}
    test = next(iter(data.tests.values()), None)
    began = time.perf_counter()
    try:
        found = diagnose(data.model, data.train, test=test, seed=seed, **data.options)
    except EngineError as error:
        seconds = time.perf_counter() - began
        return row | {"verdict": "error", "causes": json.dumps(str(error)), "seconds": seconds}
    seconds = time.perf_counter() - began
    runs = simulated(found, data)
    return (
        row
        | {"verdict": found.verdict.value, "decided": found.decided_by, "seconds": seconds}
        | {
            key: json.dumps(value)
            for key, value in {
                "causes": causes(found),
                "errors": {part: errors(*both, data.settled) for part, both in runs.items()},
                "gain": gain(found),
                "rounds": rounds(found),
                "page": str(found),
                "curves": curves(runs, data),
                "alone": alone(found, data, runs),
            }.items()
        }
    )


def causes(found: Diagnosis) -> list[dict[str, Any]]:
    """Name, size, error and unit of each, and what cannot be told from it."""
    return [
        {
            "effect": cause.effect,
            "size": cause.size,
            "error": cause.standard_error,
            "unit": cause.unit,
            "others": [name for name in cause.equivalent if name != cause.effect],
            "values": cause.parameters,
        }
        for cause in found.causes
    ]


def gain(found: Diagnosis) -> dict[str, Any] | None:
    """Of the first output's free run on the part that judges, with 95 % intervals."""
    if found.gain is None or not found.gain.outputs:
        return None
    output = found.gain.outputs[0]
    return {
        "difference": output.difference,
        "interval": output.interval_difference,
        "before": output.rmse_before,
        "log_density": found.gain.log_density,
        "p_value": found.gain.p_value,
        "how": found.gain.how,
    }


def rounds(found: Diagnosis) -> dict[str, Any]:
    """Why which criterion decided, and what the free run saw in each of its rounds."""
    asked = found.free_run
    if asked is None:
        return {}
    searched = asked.search.rounds if asked.search is not None else ()
    alarm = None if asked.alarm is None else vars(asked.alarm) | {"p": asked.alarm.p_value}
    return {
        "reason": asked.reason,
        "substeps": found.substeps,
        "alarm": alarm,
        "likelihood": [
            [r.effect.name for r in one.refits[:1]] for one in found.rounds if one.equivalent
        ],
        "rounds": [_round(one) for one in searched],
        "seconds": found.seconds,
    }


def _round(one: FreeRound) -> dict[str, Any]:
    return {
        "alarm": vars(one.alarm) | {"p": one.alarm.p_value},
        "held_out": one.held_out,
        "screened": [[*s.names, s.share] for s in one.screened[:LISTED]],
        "candidates": [
            [" + ".join(c.names), c.held_out, c.fit.rms, c.p_gain, c.p_best, c.fit.n_parameters]
            for c in one.candidates[:LISTED]
        ],
        "survivors": [[" + ".join(c.names) for c in group] for group in one.survivors],
    }


def curves(runs: Runs, data: Data) -> dict[str, list[float | None]]:
    """Of the first test part: the stretch where the model as given is worst."""
    if not runs:
        return {}
    series, before, after = next(iter(runs.values()))
    rows = stretch(series, before, data.settled)
    drawn = {"t": series.t[rows], "measured": series.y[rows, 0]}
    for name, run in (("before", before), ("after", after)):
        if run is not None:
            drawn[name] = run[rows]
    return {key: [_number(x) for x in values.tolist()] for key, values in drawn.items()}


def stretch(series: Series, run: Array | None, settled: int) -> Array:
    """Rows (n,) of about POINTS readings: all of a short record, else around the largest error."""
    seen = np.flatnonzero(series.observed[:, 0])
    if len(seen) <= 4 * POINTS or run is None:
        return np.asarray(seen[:: max(len(seen) // POINTS, 1)])
    seen = seen[seen >= settled]
    worst = int(np.argmax(np.abs(series.y[seen, 0] - run[seen])))
    first = int(np.clip(worst - POINTS // 2, 0, len(seen) - POINTS))
    return np.asarray(seen[first : first + POINTS])


def _number(x: float) -> float | None:
    return float(f"{x:.6g}") if np.isfinite(x) else None
