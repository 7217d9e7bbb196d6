"""``rbps fit``: estimate, print the estimate, and keep the state that a resumed run needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import engine
from engine import words
from engine.data.series import Series
from engine.filters.linearity import why_not_linear
from engine.statespace.model import MixedModel
from service import stages, strict_json
from service.cli.ending import Code, Ending, wrong
from service.cli.meter import Meter, meter
from service.cli.outputs import check_outputs, say_written, state_path, write_outputs
from service.cli.state import Asked, Recorder
from service.cli.state_file import StateFile, read
from service.problems import Problem
from service.schemas import EstimateOptions, EstimateParameters, EstimateRequest, ModelReference
from service.validation import Prepared, one_step


def fit(asked: Asked, state: Path | None, as_json: bool, quiet: bool) -> None:
    """A new estimation; its state goes to ``state`` or beside the output."""
    check_outputs(asked)
    path = state_path(asked, state, Path(asked.data[0]).stem)

    def begun(job: Prepared, shown: Meter) -> Recorder:
        file = asked.begin(path, [*asked.data, *asked.test], shown)
        return Recorder(job, file, asked, shown)

    _work(asked, begun, as_json, quiet)


def resume(path: Path, changes: dict[str, Any], as_json: bool, quiet: bool) -> None:
    """Go on with an estimation; ``changes`` are members of Asked that may differ."""
    asked, rows, finished = read(path, Asked)
    if "iterations" in changes and (asked.starts > 1 or asked.bootstrap):
        raise wrong("--iterations cannot be changed where there are several starts or a bootstrap")
    asked.change(changes)
    check_outputs(asked)

    def begun(job: Prepared, shown: Meter) -> Recorder:
        n, free = len(job.model.parameters) + 4, len(job.model.free_indices(job.free))
        if len(rows) and rows.shape[1] not in (n, n + engine.Checkpoint.width(free)):
            raise wrong(f"--resume {path}: its parameters are not those of model '{asked.model}'")
        recorder = Recorder(job, StateFile(path, asked), asked, shown, rows, finished)
        if asked.iterations < recorder.k:
            raise wrong(f"--iterations {asked.iterations}: {recorder.k} are done already")
        within = f" of {recorder.name}" if recorder.name else ""
        shown.note(f"going on after iteration {recorder.k}{within}")
        return recorder

    _work(asked, begun, as_json, quiet)


def _work(
    asked: Asked, begun: Callable[[Prepared, Meter], Recorder], as_json: bool, quiet: bool
) -> None:
    """Estimate from where the iterations have ``begun``, and tell."""
    with meter(quiet or as_json) as shown:
        job = _prepare(asked, shown)
        recorder = begun(job, shown)
        with _resumable(recorder):
            document = _run(job, recorder)
    with _resumable(recorder):
        _tell(job, asked, document, recorder, as_json)


def _prepare(asked: Asked, shown: Meter) -> Prepared:
    """All that can be wrong is found here."""
    job = asked.job(shown, substeps=asked.substeps)
    if asked.method == "rts-em":
        for one in job.series:
            if why := why_not_linear(job.model, job.theta, one):
                raise wrong(f"--method rts-em: {why}; use quasi-newton")
    request = EstimateRequest.model_construct(
        kind="estimate",
        model=ModelReference(name=job.name),
        parameters=EstimateParameters(),
        options=EstimateOptions.model_validate(asked, from_attributes=True),
    )
    if asked.substeps > 1 and not job.model.continuous:
        raise wrong(f"--substeps {one_step(job.model, asked.substeps)}")
    return Prepared(request, job.model, job.series, job.theta, job.free, job.test)


@contextmanager
def _resumable(recorder: Recorder) -> Iterator[None]:
    """Save what is done when it is interrupted, and say how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        recorder.save()
        where = f"in {recorder.name}, " if recorder.name else ""
        raise Ending(
            Code.INTERRUPTED,
            f"interrupted {where}{_how_far(recorder)}. Go on with\n"
            f"  {recorder.file.again}{_so_far(recorder)}",
            state=str(recorder.file.path),
            iteration=recorder.k,
        ) from None


def _how_far(recorder: Recorder) -> str:
    if recorder.asked.method == "simulation":
        return "in its fit"
    if not recorder.done:
        return "before the first iteration"
    return f"after {recorder.k} of {recorder.asked.iterations} iterations"


def _so_far(recorder: Recorder) -> str:
    """The values that the iterations have reached."""
    if not recorder.k:
        return ""
    values = dict(zip(recorder.parameters, recorder.done[-1].tolist(), strict=False))
    said = ", ".join(f"{name} = {words.number(value, 4)}" for name, value in values.items())
    return f"\nSo far: {said}"


def _run(job: Prepared, recorder: Recorder) -> dict[str, Any]:
    """All tasks that are left, one after the other; what the last one leaves is the result."""
    last = sum(recorder.plan) - 1
    recorder.meter.begin(stages.steps(job), recorder.steps)
    try:
        while True:
            with recorder.interrupt.held():
                document = stages.run(job, recorder.task, recorder)
            if recorder.task == last:
                return document
            recorder.finish(document)
    except Problem:  # diverged or lost: from here nothing leads on
        recorder.file.remove()
        raise


# ---- telling ----------------------------------------------------------------------------------


def _tell(
    job: Prepared, asked: Asked, document: dict[str, Any], recorder: Recorder, as_json: bool
) -> None:
    """Write the files and print the estimate; then remove a state that nothing can be resumed from."""
    document = asked.with_notes(document)
    one_run = asked.starts == 1 and not asked.bootstrap
    open_ended = document["outcome"] in ("iterations-used-up", "wandered")
    more = one_run and open_ended and "trace" in document
    written = write_outputs(asked, document, recorder)
    if not more:
        recorder.file.remove()
    if as_json:
        print(strict_json.dumps(document))
        return
    print("\n".join(table(job.model, job.series, document)))
    if more:
        print(f"More iterations: {recorder.file.again} --iterations {2 * asked.iterations}")
    say_written(written)


def table(model: MixedModel, series: Sequence[Series], document: dict[str, Any]) -> list[str]:
    """The estimate for people."""
    samples = sum(len(one.samples) for one in series)
    how = (
        f"{document['trace']['iteration'][-1]} iterations" if "trace" in document else "simulation"
    )
    lines = [f"{model.name}: {samples} samples, {how}. {document['message']}"]
    intervals = any(one.get("interval") for one in document["estimate"].values())
    between = f"{'95 % interval':>26}" if intervals else ""
    lines.append(f"{'':<16}{'estimate':>12}{'std. error':>12}{between}  unit")
    for name, one in document["estimate"].items():
        error = one["standard_error"]
        held = "no effect" if one.get("silent") else "fixed" if one.get("fixed") else ""
        shown = held or ("-" if error is None else words.number(error, 3))
        value = words.number(one["value"], words.digits(one["value"], error, 5))
        if intervals:
            ends = words.ends(*one["interval"]) if one.get("interval") else ()
            shown = f"{shown:>12}  {' to '.join(ends):>24}"
        lines.append(f"{name:<15} {value:>12}{shown:>12}  {words.tidy(one['unit'])}".rstrip())
    if document.get("warning"):
        lines.append(document["warning"])
    if likelihood := document.get("log_likelihood"):
        error = likelihood["standard_error"]
        lines.append(
            f"log-likelihood {likelihood['value']:.2f}" + (f" +- {error:.2f}" if error else "")
        )
    if errors := document.get("rmse_by_output"):
        lines.append(f"simulation wrong by {words.errors_in_words(errors, model.outputs)} rms")
    for o in (document.get("held_out") or {}).get("outputs", ()):
        error = "diverges"
        if o["rmse"] is not None:
            error = f"is wrong by {words.with_unit(o['rmse'], o['unit'])} rms"
        lines.append(f"on held-out data the simulation of {o['output']} {error}")
    if bootstrap := document.get("bootstrap"):
        lines.append(
            f"standard errors and intervals from {bootstrap['runs'] - bootstrap['failed']} estimations on "
            "data simulated at the estimate"
        )
    return lines + _starts(document)


def _starts(document: dict[str, Any]) -> list[str]:
    """Where each of several starts ended, the best first."""
    found = document.get("starts") or []
    reached = [(i, one) for i, one in enumerate(found, 1) if "log_likelihood" in one]
    reached.sort(key=lambda pair: -pair[1]["log_likelihood"]["value"])
    free = [name for name, one in document["estimate"].items() if not one.get("fixed")]
    lines = [
        f"start {i}: log-likelihood {one['log_likelihood']['value']:.2f}; "
        + ", ".join(f"{name} {words.number(one['estimate'][name], 4)}" for name in free)
        for i, one in reached
    ]
    lost = [
        f"start {i}: {one['message']}"
        for i, one in enumerate(found, 1)
        if "log_likelihood" not in one
    ]
    return lines + lost
