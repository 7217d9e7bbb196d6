"""The job kind ``diagnose``: the engine's diagnosis with progress in per cent."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from functools import partial
from typing import Any

import engine
from engine import words
from engine.diagnose import Cause, Diagnosis, Verdict
from engine.errors import OptionError
from service.computations import Progress
from service.schemas import DiagnoseRequest
from service.validation import Prepared

PROGRESS_STEPS = 100  # of progress
# per cent for the base model's fit, for all rounds of search, and for the free run
FIT_PERCENT, SEARCH_PERCENT, FREE_RUN_PERCENT = 10.0, 60.0, 20.0
# where each stage of a round begins, and its share of it
ROUND_SHARES = {"screen": (0.0, 0.3), "calibration": (0.3, 0.3), "refit": (0.6, 0.4)}
STAGE_PERCENT = {"gain": 92.0, "symptoms": 95.0}
STAGE_MESSAGES = {
    "fit": "estimating the model without effects",
    "search": "looking for effects",
    "screen": "screening effects",
    "calibration": "calibrating p-values on simulated series",
    "refit": "estimating the most likely effects",
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
    try:
        found = ask()
    except OptionError as error:
        if kept is None or error.field != "kept":
            raise
        kept.clear()
        found = ask()
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
    reference = diagnosis["extension"]["model"]
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

    How many rounds of screening and refitting there will be is not known: each takes half of what
    is left, six tenths of it for the screen and its calibration. What moves less than a per cent tells its
    own share.
    """

    def __init__(self, step: Callable[[int, str], None]) -> None:
        self.step, self.done, self.said, self.message = step, -1, "", ""
        self.round = -1

    def __call__(self, stage: str, fraction: float) -> None:
        """Tell the store where something has changed."""
        if stage == "screen" and self.said != "screen":
            self.round += 1
        done = max(self.done, int(self._percent(stage, min(max(fraction, 0.0), 1.0))))
        message = STAGE_MESSAGES.get(stage, stage)
        if stage == "calibration":
            message += f", {100.0 * fraction:.0f} % of them"
        if done > self.done or stage != self.said or message != self.message:
            self.done, self.said, self.message = done, stage, message
            self.step(done, message)

    def _percent(self, stage: str, fraction: float) -> float:
        if stage in ROUND_SHARES:
            left = 0.5 ** max(self.round, 0)
            begin, width = ROUND_SHARES[stage]
            part = begin + width * fraction
            return FIT_PERCENT + SEARCH_PERCENT * (1.0 - left + 0.5 * left * part)
        if stage == "fit":
            return FIT_PERCENT * fraction
        if stage == "free run":
            return FIT_PERCENT + SEARCH_PERCENT + FREE_RUN_PERCENT * fraction
        if stage == "bootstrap":
            searched = FIT_PERCENT + SEARCH_PERCENT + FREE_RUN_PERCENT
            return searched + (STAGE_PERCENT["gain"] - searched) * fraction
        return STAGE_PERCENT.get(stage, FIT_PERCENT if stage == "search" else 0.0)
