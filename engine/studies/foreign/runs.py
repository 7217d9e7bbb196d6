"""One series of a cell, diagnosed as a user would: one row. Whatever goes wrong is a row, too."""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence

import numpy as np

from engine.diagnose import Diagnosis, diagnose
from engine.diagnose.catalogue import make_effect
from engine.diagnose.causes import Causes
from engine.diagnose.decide import set_of
from engine.diagnose.setting import setting_for
from engine.series import Series
from engine.studies.blind.hidden import Hidden
from engine.studies.blind.runs import oracle
from engine.studies.foreign.cells import Cell
from engine.studies.foreign.drawing import series_of, true_values
from engine.studies.foreign.sizes import size_of
from engine.studies.study import Row

BLANK: Row = {
    "verdict": "crash",
    "causes": "",
    "set": "",
    "p_value": np.nan,
    "size": np.nan,
    "size_true": np.nan,
    "gain": np.nan,
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
    row: Row = {"system": cell.system, "level": cell.level, "hidden": cell.hidden}
    row |= BLANK
    try:
        size = size_of(cell)
        train, test, own = series_of(cell, size, seed)
        row["size_true"] = size
        system = cell.plan
        began = time.perf_counter()
        found = diagnose(
            system.base(cell.level), train, test=test, free=system.free(cell.level), seed=seed[-1]
        )
        row["seconds"] = time.perf_counter() - began
        row |= answer(found)
        if cell.hidden and not cell.outside:
            row |= judged(cell, found, train, test, size, own)
    except Exception as error:  # noqa: BLE001 - a crash is a result
        row["note"] = told(error)
    return row


def answer(found: Diagnosis) -> Row:
    """Verdict, causes in the order found, the first round's set, its p-value, the first size."""
    named = [r for r in found.search.rounds if r.equivalent]
    return {
        "verdict": found.verdict.value,
        "causes": " ".join(c.effect for c in found.causes),
        "set": " ".join(set_of(named[0])) if named else "",
        "p_value": found.p_value,
        "size": found.causes[0].size if found.causes else np.nan,
        "gain": np.nan if found.gain is None else found.gain.log_density,
    }


def judged(
    cell: Cell, found: Diagnosis, train: Series, test: Series, size: float, own: dict[str, float]
) -> Row:
    """The true extension refitted, and the name that the likelihood alone would have given."""
    base = found.search.base
    setting = setting_for(found.model, train, np.asarray(base.theta))
    causes = Causes(base, setting, found.search, found.verdict, ())
    effect = make_effect(cell.hidden, setting)
    truth, rival = oracle(causes, Hidden(train, test, effect, true_values(cell, effect, size, own)))
    out: Row = {
        "ratio_truth": truth.gain,
        "score_truth": truth.score,
        "score_rival": -np.inf if rival is None else rival.score,
        "oracle": truth.effect.name,
    }
    if rival is not None and rival.score > truth.score:
        out["oracle"] = rival.effect.name
    return out


def told(error: BaseException) -> str:
    """An error in a line: its kind, its words, and where in the engine it was raised."""
    places = traceback.extract_tb(error.__traceback__)
    last = places[-1]
    file = "/".join(last.filename.replace("\\", "/").split("/")[-2:])
    words = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {words} ({file}:{last.lineno})"
