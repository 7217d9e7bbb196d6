"""One series of a cell, diagnosed: one row.

The diagnosis starts at the base model's true parameters, as given by a data sheet, and estimates them
again; it sees the training part only and knows nothing of what is hidden.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from engine.data.joined import joined
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.judging.verdict import set_of
from engine.diagnose.refits.bootstrap import bootstrap_p
from engine.diagnose.refits.calibration import Question
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import Refit, held_out_terms
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.screen import Score
from engine.diagnose.search.pipeline import Causes, find_causes
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from tests.studies.blind.bases import BASES
from tests.studies.blind.cells import BOOTSTRAP, CLEAN, HARD, OTHER, UNLISTED, USUAL, Cell
from tests.studies.blind.hidden import Hidden, draw
from tests.studies.blind.sizes import refit_truth, size
from tests.studies.study import Arm, Row

ALIKE = 0.7  # |cos| with the truth from which the oracle refits an effect
RIVALS = 4  # that it refits at most, besides those that the search did
AGAIN_RATIOS = (0.0, 100.0)
AGAIN_ROWS = 1000  # longest series that is diagnosed with another seed too ...
AGAIN_EACH = 3  # ... one in so many of each cell
SHOWN = 4  # refits of each round whose scores are kept
SAMPLES = 19  # of the parametric bootstrap


def work(cells: Sequence[Cell], stream: int, seed: int, run: int) -> Row:
    """Run ``run`` belongs to cell ``run`` modulo their number, so that all cells grow together."""
    cell = cells[run % len(cells)]
    rng = np.random.default_rng([seed, stream, run])
    row: Row = {"base": cell.base, "hidden": cell.effect, "rows": cell.rows, "ratio": cell.ratio}
    blank: Row = {
        "verdict": "error",
        "causes": "",
        "set": "",
        "p_value": np.nan,
        "oracle": "",
        "ratio_truth": np.nan,
        "score_truth": np.nan,
        "score_rival": np.nan,
        "gain": np.nan,
        "gain_truth": np.nan,
        "size": np.nan,
        "size_true": np.nan,
        "seconds": np.nan,
        "again": "",
        "evidence": "",
        "note": "",
    }
    try:
        hidden = draw(cell, size(cell), rng)
        again = cell.rows <= AGAIN_ROWS and cell.ratio in AGAIN_RATIOS
        again = again and run // len(cells) % AGAIN_EACH == 0
        return row | blank | {"size_true": size(cell)} | _diagnosed(cell, hidden, run, again)
    except (EngineError, np.linalg.LinAlgError) as error:
        return row | blank | {"note": str(error)}


def _diagnosed(cell: Cell, hidden: Hidden, run: int, again: bool) -> Row:
    base = BASES[cell.base]
    look = partial(find_causes, base.model, hidden.train, free=base.free)
    began = time.perf_counter()
    found = look(base.model.theta(), seed=run)
    row: Row = {"seconds": time.perf_counter() - began, **outcome(found)}
    if again:
        row["again"] = _said(look(found.base.theta, seed=run + 1_000_000))
    row["gain"] = held_out(found.search.base, found.search.final, hidden)
    if hidden.effect is None or hidden.effect.kind == "outside":
        return row
    truth, rival = oracle(found, hidden)
    row["gain_truth"] = held_out(found.search.base, truth.fit, hidden)
    row["ratio_truth"] = truth.gain
    row["score_truth"] = truth.score
    row["score_rival"] = -np.inf if rival is None else rival.score
    row["oracle"] = truth.effect.name
    if rival is not None and rival.score > truth.score:
        row["oracle"] = rival.effect.name
    return row


def outcome(found: Causes) -> Row:
    """Verdict, causes in the order found, the first round's set, p-value, the first size."""
    named = [r for r in found.search.rounds if r.equivalent]
    return {
        "verdict": found.verdict.value,
        "causes": " ".join(r.refits[0].effect.name for r in named),
        "set": " ".join(set_of(named[0])) if named else "",
        "p_value": found.search.rounds[0].screen.p_value,
        "evidence": " | ".join(_evidence(r) for r in found.search.rounds),
        "size": named[0].refits[0].size if named else np.nan,
    }


def _evidence(found: Round) -> str:
    """p-value of a round, and the scores of the best refits and of the unnamed force."""
    refits = [*found.refits[:SHOWN], *([found.generic] if found.generic else [])]
    scores = (f"{r.effect.name} {r.score:.1f}" for r in refits)
    return " ".join([f"p {found.screen.p_value:.3g}", *scores])


def _said(found: Causes) -> str:
    row = outcome(found)
    return f"{row['verdict']} {row['causes']}".strip()


def held_out(base: QuasiFit, extended: QuasiFit, hidden: Hidden) -> float:
    """Log-density of the held-out rows gained, after a pass through the training rows."""
    whole = joined(hidden.train, hidden.test)
    new = len(hidden.train)
    return float((held_out_terms(extended, whole) - held_out_terms(base, whole))[new:].sum())


def oracle(found: Causes, hidden: Hidden) -> tuple[Refit, Refit | None]:
    """The true extension refitted, and the best of its rivals by likelihood alone.

    Rivals are whatever the search refitted in its first round and what looks like the truth.
    """
    series, first = hidden.train, found.search.rounds[0]
    assert hidden.effect is not None
    effect = make_effect(hidden.effect.name, found.setting)
    truth = refit_truth(found.base, series, effect, hidden.own)
    rivals = {r.effect.name: r for r in first.refits if r.effect.name != effect.name}
    own = [r for r in first.refits if r.effect.name == effect.name]
    truth = max([truth, *own], key=lambda r: r.score)
    scores = first.screen.scores
    names = [s.effect.name for s in scores]
    alike: list[Score] = []
    if effect.name in names:
        place = names.index(effect.name)
        likeness = {i: first.screen.likeness(place, i) for i in range(len(scores)) if i != place}
        order = sorted(likeness, key=lambda i: -likeness[i])
        alike = [scores[i] for i in order if likeness[i] > ALIKE][:RIVALS]
    for score in [*alike, *sorted(scores, key=lambda s: -s.statistic)[:RIVALS]]:
        name = score.effect.name
        if name in rivals or name == effect.name or score.statistic <= 0.0:
            continue
        if score.effect.kind == "latent":
            continue
        try:
            rivals[name] = refit(found.base, series, score, truth.score)
        except (EngineError, np.linalg.LinAlgError):
            continue
    return truth, max(rivals.values(), key=lambda r: r.score, default=None)


def work_bootstrap(cells: Sequence[Cell], stream: int, seed: int, run: int) -> Row:
    """Family-wise p-values by multipliers and by parametric bootstrap, on the same series."""
    cell = cells[run % len(cells)]
    base = BASES[cell.base]
    row: Row = {"base": cell.base, "hidden": cell.effect, "rows": cell.rows, "ratio": cell.ratio}
    hidden = draw(cell, size(cell), np.random.default_rng([seed, stream, run]))
    began = time.perf_counter()
    found = find_causes(base.model, hidden.train, base.model.theta(), free=base.free, seed=run)
    spent = time.perf_counter() - began
    first = found.search.rounds[0].screen
    question = Question(found.base, hidden.train, found.setting, None)
    p = bootstrap_p(question, first, n=SAMPLES, seed=run).p_value
    return row | {
        "verdict": found.verdict.value,
        "p_value": first.p_value,
        "p_bootstrap": p,
        "seconds": spent,
        "seconds_bootstrap": time.perf_counter() - began - spent,
    }


# Streams of random numbers: other ones whenever the diagnosis was changed after series of these were seen.
STREAMS = {
    "usual": 51,
    "other": 52,
    "clean": 53,
    "outside": 54,
    "bootstrap": 55,
    "look-alikes": 56,
}

# Runs that had been looked at when a rule of decision was changed last (LEFT of engine.diagnose.decide; those
# that it decides otherwise were made again): what came after is shown on its own, too.
SEEN = {"usual": 329, "other": 64, "clean": 168, "outside": 48}


def _arm(name: str, cells: Sequence[Cell]) -> Arm:
    stream = STREAMS[name]
    settings = {"cells": len(cells), "stream": stream}
    return Arm(f"blind.{name}", partial(work, tuple(cells), stream), settings)


USUAL_ARM = _arm("usual", USUAL)
OTHER_ARM = _arm("other", OTHER)
CLEAN_ARM = _arm("clean", CLEAN)
OUTSIDE_ARM = _arm("outside", UNLISTED)
HARD_ARM = _arm("look-alikes", HARD)
BOOTSTRAP_ARM = Arm(
    "blind.bootstrap",
    partial(work_bootstrap, tuple(BOOTSTRAP), STREAMS["bootstrap"]),
    {"cells": len(BOOTSTRAP), "samples": SAMPLES, "stream": STREAMS["bootstrap"]},
)
