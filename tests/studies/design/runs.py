"""One case: the designed experiment, the record it gives, the new diagnosis. Whatever goes wrong is a row."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.design import Asked, Design
from engine.design.candidates import Question, before_any
from engine.design.runs import linearised
from engine.design.search import Tried, violations
from engine.design.weighing import Weighing
from engine.diagnose import diagnose
from engine.diagnose.judging.verdict import set_of
from engine.diagnose.search.pipeline import find_causes
from engine.errors import EngineError
from engine.simulation.simulate import simulate
from tests.studies.design.cases import (
    DECIDABLE,
    ROWS,
    UNDECIDABLE,
    Case,
    Pair,
    drawn,
    random_binary,
)
from tests.studies.study import Arm, Row

INPUTS = 128  # tried for a design
FEW_INPUTS, LENGTHS = 32, 2  # of a design that is only asked whether its probability is right
RECORDS = 2 * LENGTHS  # of it: either cause is true in turn
# another one whenever the probability was changed after cases of it were seen
CALIBRATION_STREAM = 12
ALARM = 5.0  # the statistic at which a diagnosis of two effects alone sees something
CLOCKS = (1, 8)  # samples that a random binary input holds, at least one of which suits a system
LONGER = 3  # times the designed length: how far a random binary input is followed
REACH = 11.0  # D of the pairs that are judged
WIDTHS = (
    1.0,
    0.8,
    0.6,
    0.45,
    0.3,
    0.2,
    0.1,
)  # of the range: what a random binary input takes of it
DEVELOPMENT, JUDGED = 41_000_000, 42_000_000  # first parts of the seeds
LONG, DEFAULT = 1000, 400  # samples and inputs of the designs that are timed
FULL_EACH = 8  # one in so many is diagnosed in full, with the whole catalogue

BLANK: Row = {
    "true": "",
    "rival": "",
    "D": np.nan,
    "D_least": np.nan,
    "probability": np.nan,
    "shortest": np.nan,
    "probability_shortest": np.nan,
    "family": "",
    "undecided": "",
    "sensor": "",
    "D_sensor": np.nan,
    "verdict": "",
    "named": "",
    "set": "",
    "full": "",
    **{f"binary_{clock}": np.nan for clock in CLOCKS},
    "seconds": np.nan,
    "seconds_diagnosis": np.nan,
    "note": "",
}
SHORT: Row = {
    **{f"{of}_{k}": np.nan for k in range(RECORDS) for of in ("rows", "probability", "right")},
    "seconds": np.nan,
    "note": "",
}


def work(pairs: Sequence[Pair], first: int, stream: int, seed: int, run: int) -> Row:
    """Run ``run`` belongs to pair ``run`` modulo their number, so that all grow together."""
    pair = pairs[run % len(pairs)]
    rng = np.random.default_rng([first, seed, stream, run])
    case = drawn(pair, rng)
    row: Row = {"system": pair.system, "pair": " / ".join(pair.causes), **BLANK}
    names = list(case.causes)
    row |= {"true": names[case.true], "rival": names[1 - case.true]}
    try:
        return row | _judged(case, rng, run, pairs is UNDECIDABLE)
    except (EngineError, np.linalg.LinAlgError) as error:
        return row | {"note": " ".join(str(error).split())[:200]}


def _judged(case: Case, rng: np.random.Generator, run: int, design_only: bool) -> Row:
    model = case.system.model
    asked = before_any(model, case.causes, None, case.system.dt, case.free)
    question = replace(asked, alarm=ALARM)
    made = Asked(model, question, case.task(question, ROWS)).designed(INPUTS, run)
    row = _designed(made, case)
    if design_only:
        return row
    row |= _binary(case, question, rng)
    true = question.candidates[case.true]
    record = simulate(true.model, true.theta, ROWS, rng, u=made.u, dt=case.system.dt).series
    record = record.replace(y_names=tuple(model.outputs))
    began = time.process_time()
    row |= _said(case, record, run)
    row["seconds_diagnosis"] = time.process_time() - began
    if run // len(DECIDABLE) % FULL_EACH == 0:
        found = diagnose(model, record, free=case.free, seed=run)
        row["full"] = f"{found.verdict.value} {' '.join(c.effect for c in found.causes)}".strip()
    return row


def _designed(made: Design, case: Case) -> Row:
    i, j = case.true, 1 - case.true
    row: Row = {
        "D": float(made.experiment.D[i, j]),
        "D_least": float(min(made.experiment.D[0, 1], made.experiment.D[1, 0])),
        "probability": float(made.experiment.probability[i]),
        "family": made.experiment.family,
        "seconds": made.seconds,
    }
    if made.shortest is not None:
        row["shortest"] = len(made.shortest)
        row["probability_shortest"] = float(made.shortest.probability[i])
    for one in made.undecided:
        row["undecided"] = "never" if one.hopeless else f"{one.samples} samples"
        if one.sensors:
            row |= {"sensor": one.sensors[0].channel, "D_sensor": one.sensors[0].D}
    return row


def _length(made: Design, cause: int, probability: float) -> tuple[int, float]:
    """Samples of a design after which the cause is named with a probability near this one, and that."""
    row = min(made.growth, key=lambda row: abs(float(row[1 + cause]) - probability))
    return int(row[0]), float(row[1 + cause])


def _binary(case: Case, question: Question, rng: np.random.Generator) -> Row:
    """The samples that random binary inputs need, by how long they hold; inf where LONGER times ROWS do not."""
    return {f"binary_{clock}": _needed(case, question, clock, rng) for clock in CLOCKS}


def _needed(case: Case, question: Question, clock: int, rng: np.random.Generator) -> float:
    """Of one input, as wide as the limits on states let it be."""
    T, dt = LONGER * ROWS, case.system.dt
    task = case.task(question, T)
    seed = int(rng.integers(2**31))
    for share in WIDTHS:
        limits = []
        for one in case.bounds.inputs.values():
            centre, half = 0.5 * (one.low + one.high), 0.5 * share * (one.high - one.low)
            limits.append(replace(one, low=centre - half, high=centre + half))
        u = random_binary(limits, T, dt, clock, np.random.default_rng(seed))
        runs = [
            linearised(c.model, c.theta, task.experiments(u[None]), ()) for c in task.candidates
        ]
        if violations(task, runs)[0][0] <= 0.0:
            break
    weighing = Weighing(task, question, seed)
    tried = Tried((), u, np.zeros((2, 2)), 0.0, {})
    found = weighing.reach(weighing.weighed(tried, set()), set())
    return np.inf if found is None else float(found)


def _said(case: Case, record: Series, run: int) -> Row:
    """What a diagnosis of the causes and the model without them says."""
    found = find_causes(
        case.system.model, record, None, free=case.free, effects=list(case.causes), seed=run
    )
    named = [r for r in found.search.rounds if r.equivalent]
    return {
        "verdict": found.verdict.value,
        "named": named[0].refits[0].effect.name if named else "",
        "set": " ".join(set_of(named[0])) if named else "",
    }


def calibrated(seed: int, run: int) -> Row:
    """A design of few inputs, and which of several short records of it end in the right name.

    Either cause is true in turn, and the probability is anything in each of LENGTHS parts of 0 to 1.
    """
    pair = DECIDABLE[run % len(DECIDABLE)]
    rng = np.random.default_rng([JUDGED, seed, CALIBRATION_STREAM, run])
    case = drawn(pair, rng)
    model = case.system.model
    row: Row = {"system": pair.system, "pair": " / ".join(pair.causes), **SHORT}
    asked = before_any(model, case.causes, None, case.system.dt, case.free)
    question = replace(asked, alarm=ALARM)
    try:
        made = Asked(model, question, case.task(question, ROWS)).designed(FEW_INPUTS, run)
        row["seconds"] = made.seconds
        for k in range(RECORDS):
            i, part = k % 2, k // 2
            own = question.candidates[i]
            n, p = _length(made, i, (part + rng.uniform()) / LENGTHS)
            record = simulate(own.model, own.theta, n, rng, u=made.u[:n], dt=case.system.dt).series
            said = _said(case, record.replace(y_names=tuple(model.outputs)), run)
            right = float(said["set"] == list(case.causes)[i])
            row |= {f"rows_{k}": n, f"probability_{k}": p, f"right_{k}": right}
        return row
    except (EngineError, np.linalg.LinAlgError) as error:
        return row | {"note": " ".join(str(error).split())[:200]}


def timed(seed: int, run: int) -> Row:
    """Processor seconds of a design of LONG samples with as many inputs as by default."""
    pair = DECIDABLE[run % len(DECIDABLE)]
    case = drawn(pair, np.random.default_rng([JUDGED, seed, 5, run]))
    question = before_any(case.system.model, case.causes, None, case.system.dt, case.free)
    made = Asked(case.system.model, question, case.task(question, LONG)).designed(DEFAULT, run)
    return {"system": pair.system, "pair": " / ".join(pair.causes), "seconds": made.seconds}


CALIBRATION_ARM = Arm(
    "design.calibration",
    calibrated,
    {
        "pairs": len(DECIDABLE),
        "rows": ROWS,
        "inputs": FEW_INPUTS,
        "records": RECORDS,
        "stream": CALIBRATION_STREAM,
    },
)
DECIDED_ARM = Arm(
    "design.decidable",
    partial(work, DECIDABLE, JUDGED, 3),
    {"pairs": len(DECIDABLE), "rows": ROWS, "inputs": INPUTS},
)
TIME_ARM = Arm("design.time", timed, {"rows": LONG, "inputs": DEFAULT})
NEVER_ARM = Arm(
    "design.undecidable",
    partial(work, UNDECIDABLE, JUDGED, 4),
    {"pairs": len(UNDECIDABLE), "rows": ROWS, "inputs": INPUTS},
)
