"""The job kind ``diagnose``: the engine's diagnosis with progress in per cent."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import engine
from engine import words
from engine.data.series import Series
from engine.diagnose import Cause, Diagnosis, Verdict
from engine.presentation.cause_sentences import late, sample_step, sized
from service.computations import Progress, anew_where_another
from service.schemas import DiagnoseRequest
from service.validation import Prepared

PROGRESS_STEPS = 100  # of progress


class Stage(NamedTuple):
    """A part of a diagnosis, and how much of the per cent is its.

    Its ``share`` is of what is left when it begins: whether others follow, and how often, nobody knows by then.
    """

    share: float
    message: str
    counted: bool = False  # the number of its steps is known
    latest: float = 0.0  # per cent at which it begins at least: nothing that takes long follows


STAGES = {
    "fit": Stage(0.07, "estimating the model without effects"),
    "search": Stage(0.0, "looking for effects"),
    "screen": Stage(0.08, "screening effects", counted=True),
    "calibration": Stage(0.35, "calibrating p-values on simulated series", counted=True),
    "refit swallowed": Stage(0.1, "estimating effects that noise may hide", counted=True),
    "calibration of refits": Stage(0.35, "calibrating these on simulated series", counted=True),
    "refit": Stage(0.3, "estimating the most likely effects", counted=True),
    "looking back": Stage(0.5, "weighing what was found once more together", counted=True),
    "another beginning": Stage(0.5, "searching once more, with another effect as the first"),
    "contradictions": Stage(0.05, "looking for what contradicts it"),
    "free run": Stage(0.5, "searching with the free run"),
    "bootstrap": Stage(0.9, "parametric bootstrap of the first p-value", counted=True),
    "gain": Stage(0.5, "measuring the gain on held-out data", latest=90.0),
    "symptoms": Stage(1.0, "comparing simulation and prediction with the data", latest=95.0),
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
        held_out=options.held_out,
        free=job.free,
        processes=1,  # the other cores have other jobs
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
        chance = found.why if found.verdict is Verdict.NOTHING else ()
        further = () if found.unsearched is None else (found.unsearched.sentence,)
        return " ".join([found.verdict.sentence, *chance, *further])
    said = "; ".join(_cause(one, found.series) for one in found.causes)
    if found.verdict is Verdict.UNKNOWN:
        return f"{found.verdict.sentence} Nearest: {said}"
    if found.gain is None:
        return f"{said}. No data were held out to judge it."
    return f"{said}. {'Adopted' if found.adopted else 'Not adopted'} on held-out data."


def _cause(one: Cause, series: Series) -> str:
    comma = "" if one.amplitude is None else ","
    text = f"{one.title[:1].upper()}{one.title[1:]}{comma} {sized(one)}"
    text += late(one, sample_step(series), series.time_unit)
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
        now = STAGES[stage]
        if stage != self.stage:
            self.stage, self.fraction = stage, 0.0
            self.begun = max(self.at, now.latest)
        self.fraction = max(self.fraction, min(fraction, 1.0))
        self.at = self.begun + (PROGRESS_STEPS - self.begun) * now.share * self.fraction
        message, share = now.message, None
        if now.counted:
            message, share = f"{message}, {100.0 * self.fraction:.0f} % of them", self.fraction
        if (int(self.at), message) != self.told:
            self.told = int(self.at), message
            self.step(int(self.at), message, share)
