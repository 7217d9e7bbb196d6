"""The job kind ``diagnose``: the engine's diagnosis with progress in per cent."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from functools import partial
from typing import Any

import engine
from engine import words
from engine.diagnose import Cause, Diagnosis, Verdict
from service.computations import Progress, anew_where_another
from service.schemas import DiagnoseRequest
from service.validation import Prepared

PROGRESS_STEPS = 100  # of progress
# of what is left when a stage begins: whether others follow, and how often, nobody knows by then
SHARES = {
    "fit": 0.07,
    "search": 0.0,
    "screen": 0.08,
    "calibration": 0.35,
    "refit swallowed": 0.1,
    "calibration of refits": 0.35,
    "refit": 0.3,
    "looking back": 0.5,
    "contradictions": 0.05,
    "free run": 0.5,
    "bootstrap": 0.9,
    "gain": 0.5,
    "symptoms": 1.0,
}
LATEST = {"gain": 90.0, "symptoms": 95.0}  # per cent: nothing that takes long follows these
COUNTED = {  # of steps whose number is known
    "screen",
    "calibration",
    "refit swallowed",
    "calibration of refits",
    "refit",
    "looking back",
    "bootstrap",
}
STAGE_MESSAGES = {
    "fit": "estimating the model without effects",
    "search": "looking for effects",
    "screen": "screening effects",
    "calibration": "calibrating p-values on simulated series",
    "refit swallowed": "estimating effects that noise may hide",
    "calibration of refits": "calibrating these on simulated series",
    "refit": "estimating the most likely effects",
    "looking back": "weighing what was found once more together",
    "contradictions": "looking for what contradicts it",
    "free run": "searching with the free run",
    "bootstrap": "parametric bootstrap of the first p-value",
    "gain": "measuring the gain on held-out data",
    "symptoms": "comparing simulation and prediction with the data",
}


def diagnose(
    job: Prepared,
    request: DiagnoseRequest,
    progress: Progress,
    kept: MutableMapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The diagnosis as JSON; its page is among it.

    What was ``kept`` before the model or the catalogue changed, with a plug-in, is not used.
    """
    options = request.options
    ask = partial(
        engine.diagnose,
        job.model,
        job.series,
        job.theta if request.parameters.start else None,
        job.test,
        seed=options.seed,
        alpha=options.alpha,
        effects=options.effects,
        max_effects=options.max_effects,
        free=job.free,
        callback=Percent(progress.step),
        kept=kept,
        early=lambda document: progress.estimated(so_far(document)),
    )
    found = anew_where_another(ask, kept)
    return document(found, request.model.name, request.model.effects)


def so_far(early: dict[str, Any]) -> dict[str, Any]:
    """The result document of a diagnosis whose search goes on."""
    return {"early": early, "message": " ".join(said_so_far(early))}


def said_so_far(early: dict[str, Any]) -> list[str]:
    """What it knows in sentences: how wrong the simulation is, and what the first screen suspects."""
    first = early["sentences"][: len(early["outputs"])]
    return [*first, *([] if early["screen"] is None else [early["screen"]["sentence"]])]


def document(found: Diagnosis, name: str, effects: Sequence[str]) -> dict[str, Any]:
    """The result document; ``name`` with ``effects`` is the model that was diagnosed."""
    diagnosis = found.to_dict()
    references = [diagnosis["extension"]["model"]]
    if diagnosis["next"] is not None:
        references.append(diagnosis["next"]["model"])
    for reference in references:
        reference["name"] = name
        reference["with"] = [*effects, *reference["with"]]
    return {"diagnosis": diagnosis, "message": in_a_line(found)}


def in_a_line(found: Diagnosis) -> str:
    """What the list of jobs says of it: the cause with its size, or how far it is known."""
    if not found.causes:
        return found.verdict.sentence
    said = "; ".join(_cause(one) for one in found.causes)
    if found.verdict is Verdict.UNKNOWN:
        return f"{found.verdict.sentence} Nearest: {said}"
    adopted = found.gain is not None and found.gain.adopt
    return f"{said}. {'Adopted' if adopted else 'Not adopted'} on held-out data."


def _cause(one: Cause) -> str:
    text = f"{one.title[:1].upper()}{one.title[1:]} {words.estimate(one.size, one.standard_error, one.unit)}"
    if len(one.equivalent) < 2:
        return text
    return f"{text}, or {words.enumerated(list(one.equivalent[1:]), 'or')}"


class Percent:
    """The engine's callback(stage, fraction) as steps that never go back.

    Each stage takes its share of what is left. Those of steps that are counted tell how many of them are done,
    by which the time is known that is left of the stage: a per cent of the whole may be long.
    """

    def __init__(self, step: Callable[[int, str, float | None], object]) -> None:
        self.step, self.stage, self.told = step, "", (-1, "")
        self.begun = self.at = self.fraction = 0.0

    def __call__(self, stage: str, fraction: float) -> None:
        """Tell the store where something has changed."""
        if stage != self.stage:
            self.stage, self.fraction = stage, 0.0
            self.begun = max(self.at, LATEST.get(stage, 0.0))
        self.fraction = max(self.fraction, min(fraction, 1.0))
        self.at = self.begun + (PROGRESS_STEPS - self.begun) * SHARES[stage] * self.fraction
        message, share = STAGE_MESSAGES[stage], None
        if stage in COUNTED:
            message, share = f"{message}, {100.0 * self.fraction:.0f} % of them", self.fraction
        if (int(self.at), message) != self.told:
            self.told = int(self.at), message
            self.step(int(self.at), message, share)
