"""What each criterion alone says of a record, out of the one diagnosis that was made of it.

The likelihood has answered by itself before the free run is asked. The free run has a search of its own where
its alarm sounds; where it was asked only of what the likelihood had found, it is asked here of the base model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.free_run.answer import FreeRunSearch, causes_of, search_free_runs
from engine.diagnose.free_run.second_opinion import SETTLED
from engine.diagnose.free_run.windows import telling
from engine.diagnose.free_run_fits.columns import CANNOT
from engine.diagnose.gain.gain import measure_gain_interleaved
from engine.diagnose.judging.findings import Cause, Verdict
from engine.diagnose.judging.verdict import named_by
from engine.diagnose.records import records_of
from engine.estimation.quasi_ml import QuasiFit
from tests.studies.measured.errors import Runs, all_errors, on_blocks, runs_of
from tests.studies.measured.records import Data

LIKELIHOOD, FREE_RUN = "likelihood", "free run"  # as in Diagnosis.decided_by


@dataclass(frozen=True, eq=False)
class Answer:
    """One criterion's: verdict, causes, fits without and with them, the p-value of its first alarm.

    ``sought`` are parameters that were sought on rows, and are so again on other rows.
    """

    verdict: Verdict
    causes: Sequence[Cause]
    before: QuasiFit
    after: QuasiFit
    p_value: float | None
    sought: tuple[str, ...] = ()


def alone(found: Diagnosis, data: Data, decided: Runs) -> dict[str, Any]:
    """By criterion: verdict, names, p-value, errors; ``decided`` are the runs of the one that decided."""
    answers = {LIKELIHOOD: by_likelihood(found), FREE_RUN: by_free_run(found)}
    out: dict[str, Any] = {}
    for name, answer in answers.items():
        if answer is None:
            out[name] = None  # no free run can be had
            continue
        there = name == found.decided_by and answer.causes and decided
        runs = decided if there else _runs(answer, found, data)
        out[name] = {
            "verdict": answer.verdict.value,
            "names": [list(cause.equivalent) or [cause.effect] for cause in answer.causes],
            "p": answer.p_value,
            "errors": all_errors(runs, data.settled, bool(answer.causes)),
        }
    return out


def by_likelihood(found: Diagnosis) -> Answer:
    """As it stands where it decided; else before held-out data were asked."""
    search, asked = found.search, found.free_run
    verdict = found.verdict
    if asked is not None and asked.decides:
        verdict = asked.likelihood
    chosen = [one.refits[0].effect for one in search.rounds if one.equivalent]
    sought = tuple(name for effect in chosen for name in effect.sought)
    return Answer(verdict, named_by(search), search.base, search.final, found.p_value, sought)


def by_free_run(found: Diagnosis) -> Answer | None:
    """Its own search, or ``nothing`` where its alarm is silent; None where no free run can be had."""
    asked, base = found.free_run, found.search.base
    if asked is None:
        return None
    search = asked.search
    if search is None and (asked.alarm is None or _of_what_was_found(found)):
        try:
            search = asked_of_base(found)
        except CANNOT:
            return None
    if search is None:
        p_value = None if asked.alarm is None else asked.alarm.p_value
        return Answer(Verdict.NOTHING, (), base, base, p_value)
    p_value = search.rounds[0].alarm.p_value
    return Answer(search.verdict, causes_of(search), search.before, search.after, p_value)


def _of_what_was_found(found: Diagnosis) -> bool:
    """Whether the alarm was asked of more than the base, or at a stricter level than it has by itself."""
    asked = found.free_run
    if asked is None or asked.alarm is None or asked.likelihood is Verdict.UNKNOWN:
        return False
    return bool(asked.names) or asked.alarm.p_value <= _option(found, "alpha")


def asked_of_base(found: Diagnosis) -> FreeRunSearch:
    """The free run's search on the rows it would have had, as if the likelihood had said nothing."""
    asked, base = found.asked, found.search.base
    if asked is None:
        raise ValueError("the diagnosis does not know what was asked")
    _, records = records_of(asked.model, asked.series, asked.test, _option(found, "held_out"))
    if found.substeps > 1:
        records = records.refined(found.substeps)
    given = [records.train, *records.others]
    parts = telling(base.model, base.theta, base.free, given)
    alpha = _option(found, "alpha")
    return search_free_runs(
        base,
        parts,
        base.model.theta(asked.options["theta"]),
        levels=(alpha, SETTLED * alpha),
        kinds=asked.options["effects"],
        seed=int(_option(found, "seed")),
        progress=lambda stage, share: None,
        whole=() if parts == given else given,
    )


def _option(found: Diagnosis, name: str) -> float:
    return 0.0 if found.asked is None else float(found.asked.options[name])


def _runs(answer: Answer, found: Diagnosis, data: Data) -> Runs:
    if not data.blocks:
        return runs_of(answer.before, answer.after, data, found.substeps)
    seed = int(_option(found, "seed"))
    times = answer.sought
    gain = measure_gain_interleaved(answer.before, answer.after, [found.series], times, seed)
    return on_blocks(gain)
