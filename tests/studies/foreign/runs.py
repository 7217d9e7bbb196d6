"""One series of a cell, diagnosed as a user would: one row. Whatever goes wrong is a row, too.

The diagnosis is given the user's model with the start values of its data sheet, the training part and the
held-out part; it knows nothing of what is hidden.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose import Diagnosis, diagnose
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging.verdict import set_of
from engine.diagnose.search.pipeline import Causes
from tests.studies.blind.hidden import Hidden
from tests.studies.blind.runs import oracle
from tests.studies.foreign.cells import Cell, clean, inside, unlisted
from tests.studies.foreign.drawing import series_of, true_values
from tests.studies.foreign.sizes import size_of
from tests.studies.foreign.units import converted, converted_series, size_factor
from tests.studies.study import Arm, Row

CRASH = "crash"
RANKED = 8  # refits of the first round whose scores are kept
TWIN_EACH = 3  # one in so many series of every cell is diagnosed in other units, too
DEVELOPMENT, JUDGED = 31_000_000, 32_000_000  # first parts of the seeds

# Streams of random numbers of the judged series: other ones whenever the diagnosis was changed after series
# of these were seen.
STREAMS = {"clean": 11, "inside": 2, "outside": 13, "euler": 4}

BLANK: Row = {
    "verdict": CRASH,
    "causes": "",
    "set": "",
    "ranked": "",
    "p_value": np.nan,
    "size": np.nan,
    "size_error": np.nan,
    "gain": np.nan,
    "size_true": np.nan,
    "ratio_truth": np.nan,
    "score_truth": np.nan,
    "score_rival": np.nan,
    "oracle": "",
    "seconds": np.nan,
    "twin": "",
    "twin_set": "",
    "twin_size": np.nan,
    "note": "",
}


def row_of(cell: Cell, seed: Sequence[int], twin: bool) -> Row:
    """The row of a series; ``twin``: diagnosed in other units, too."""
    row: Row = {"system": cell.system, "level": cell.level, "hidden": cell.hidden, **BLANK}
    plan, size = cell.plan, size_of(cell)
    row["size_true"] = size if cell.hidden else np.nan
    base, free = plan.base(cell.level), plan.free(cell.level)
    try:
        train, test, own = series_of(cell, size, seed)
    except Exception as error:  # noqa: BLE001 - never a stop
        return row | {"note": f"plant: {told(error)}"}
    began = time.perf_counter()
    try:
        found = diagnose(base, train, test=test, free=free, seed=seed[-1])
        row["seconds"] = time.perf_counter() - began
        row |= answer(found)
    except Exception as error:  # noqa: BLE001 - a crash is a result
        row["note"] = told(error)
        found = None
    if found is not None and cell.hidden and not cell.outside:
        try:
            row |= judged(cell, found, train, test, own)
        except Exception as error:  # noqa: BLE001 - the answer stands without its oracle
            row["note"] = f"oracle: {told(error)}"
    if twin:
        there = converted(base, plan.units)
        parts = [converted_series(part, base, plan.units) for part in (train, test)]
        try:
            other = diagnose(there, parts[0], test=parts[1], free=free, seed=seed[-1])
            row |= answer_there(other, cell)
        except Exception as error:  # noqa: BLE001
            row["twin"] = CRASH
            row["note"] = f"{row['note']} twin: {told(error)}".strip()
    return row


def answer(found: Diagnosis) -> Row:
    """Verdict, causes in the order found, the first round's set and what came behind, its p-value and size."""
    named = [r for r in found.search.rounds if r.equivalent]
    best = sorted(named[0].refits, key=lambda r: -r.score)[:RANKED] if named else []
    return {
        "verdict": found.verdict.value,
        "causes": " ".join(c.effect for c in found.causes),
        "set": " ".join(set_of(named[0])) if named else "",
        "ranked": " ".join(f"{r.effect.name}={r.score:.2f}" for r in best),
        "p_value": found.p_value,
        "size": found.causes[0].size if found.causes else np.nan,
        "size_error": found.causes[0].standard_error if found.causes else np.nan,
        "gain": np.nan if found.gain is None else found.gain.log_density,
    }


def answer_there(found: Diagnosis, cell: Cell) -> Row:
    """What was said of the twin, its first size in the series' own units."""
    there = answer(found)
    size: float = np.nan
    if found.causes:
        factor = size_factor(found.causes[0].effect, cell.plan.base(cell.level), cell.plan.units)
        size = np.nan if factor is None else found.causes[0].size / factor
    return {
        "twin": f"{there['verdict']} {there['causes']}".strip(),
        "twin_set": there["set"],
        "twin_size": size,
    }


def judged(cell: Cell, found: Diagnosis, train: Series, test: Series, own: dict[str, float]) -> Row:
    """The true extension refitted, and the name that the likelihood alone would have given."""
    base = found.search.base
    setting = setting_for(base.model, train, np.asarray(base.theta))
    causes = Causes(base, setting, found.search, found.verdict, ())
    effect = make_effect(cell.hidden, setting)
    values = true_values(cell, effect, size_of(cell), own)
    truth, rival = oracle(causes, Hidden(train, test, effect, values))
    best = truth if rival is None or truth.score >= rival.score else rival
    return {
        "ratio_truth": truth.gain,
        "score_truth": truth.score,
        "score_rival": -np.inf if rival is None else rival.score,
        "oracle": best.effect.name,
    }


def told(error: BaseException) -> str:
    """An error in a line: its kind, its words, and where it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    file = "/".join(last.filename.replace("\\", "/").split("/")[-2:])
    words = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {words} ({file}:{last.lineno})"


def work(cells: Sequence[Cell], first: int, stream: int, seed: int, run: int) -> Row:
    """Run ``run`` belongs to cell ``run`` modulo their number, so that all cells grow together."""
    cell = cells[run % len(cells)]
    return row_of(cell, [first, seed, stream, run], run // len(cells) % TWIN_EACH == 0)


def _arm(name: str, cells: Sequence[Cell]) -> Arm:
    stream = STREAMS[name]
    settings = {"cells": len(cells), "stream": stream}
    return Arm(f"foreign.{name}", partial(work, tuple(cells), JUDGED, stream), settings)


EULER = [*clean(True), *inside(True)]
CLEAN_ARM = _arm("clean", clean())
INSIDE_ARM = _arm("inside", inside())
OUTSIDE_ARM = _arm("outside", unlisted())
EULER_ARM = _arm("euler", EULER)

EVERY = [*clean(), *inside(), *unlisted(), *EULER]
DEVELOPMENT_ARM = Arm(
    "foreign.development",
    partial(work, tuple(EVERY), DEVELOPMENT, 0),
    {"cells": len(EVERY), "stream": 0},
)
