"""The job kind ``design``: the input that tells causes apart, and the causes of a stored diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from typing import Any

from engine.design import Design, asked_of
from engine.errors import OptionError
from engine.words import percent
from service.computations import Progress, anew_where_another
from service.schemas import DesignRequest
from service.validation import Prepared

PROGRESS_STEPS = 100
# of each stage: per cent at which it begins, its share, what is said of it
STAGES = {
    "inputs": (0, 60, "trying inputs"),
    "pairs": (60, 10, "looking at pairs that none has told apart"),
    "length": (70, 30, "looking for a shorter record"),
}


def design(
    job: Prepared,
    request: DesignRequest,
    progress: Progress,
    kept: MutableMapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The design as JSON; its page is among it. What is ``kept`` of another one is not used."""
    options = request.options
    asked = asked_of(
        job.model,
        request.bounds,
        options.length,
        options.model_dump()["causes"],
        job.theta,
        job.free,
        alarm=options.alarm,
        measured=options.measured,
    )

    def made() -> Design:
        return asked.designed(options.inputs, options.seed, telling(progress.step), kept)

    return document(anew_where_another(made, kept))


def telling(step: Callable[[int, str], Any]) -> Callable[[str, float], None]:
    """The engine's callback(stage, share) as steps that never go back."""
    done = 0

    def tell(stage: str, share: float) -> None:
        nonlocal done
        first, width, message = STAGES[stage]
        done = max(done, int(first + width * share))
        step(done, message)

    return tell


def document(found: Design) -> dict[str, Any]:
    """The result document."""
    return {"design": found.to_dict(), "message": in_a_line(found)}


def in_a_line(found: Design) -> str:
    """What the list of jobs says of it."""
    if not found.decides:
        return "No input within the bounds tells these causes apart."
    sure = percent(found.probability)
    text = f"{len(found.u)} samples ({found.experiment.family}): the right name with {sure}"
    if found.shortest is not None:
        text += f"; {len(found.shortest)} samples reach {percent(found.level)}"
    return f"{text}."


def next_of(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """What a design is asked after a diagnosis, by its document; ``model`` is a reference.

    Raises OptionError where it weighed fewer than two causes.
    """
    if "next" not in diagnosis:
        raise OptionError("the diagnosis was made by an earlier version; run it again", "causes")
    asked: dict[str, Any] | None = diagnosis["next"]
    if asked is None:
        said = f"the diagnosis says '{diagnosis['verdict']}'"
        raise OptionError(f"{said} and weighed fewer than two causes", "causes")
    return asked


def between_samples(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Bounds that a diagnosis' document sets by default: sample time, steps in it, what inputs do meanwhile."""
    extension = diagnosis["extension"]
    known = {
        **extension["model"]["setting"],
        "hold": extension.get("hold"),
        "time_unit": diagnosis.get("time_unit"),
    }
    # that of the record first: the setting's may be of a part, and rounded otherwise
    known["dt"] = extension.get("dt") or known.get("dt")
    return {
        name: known[name] for name in ("dt", "substeps", "hold", "time_unit") if known.get(name)
    }
