"""``rbps diagnose``: find out what a model leaves out; what is finished is kept for a resumed run."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import engine
from engine.data.series import Series
from engine.diagnose import Verdict, all_effects, effect_kinds
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.spare_inputs import with_inputs
from engine.presentation.diagnosis_text import page
from engine.statespace.model import MixedModel
from service import diagnoses, strict_json
from service.cli import references
from service.cli.ending import Code, Ending, wrong
from service.cli.experiment import Experiment
from service.cli.files import series_of
from service.cli.meter import Meter, meter
from service.cli.outputs import check_outputs, output_path, say_written, write_outputs
from service.cli.parts import Kept
from service.cli.state_file import StateFile, beside, can_be, read
from service.cli.values import free_of, theta_of


@dataclass(kw_only=True)
class Asked(Experiment):
    """A diagnosis as it was asked for."""

    command: ClassVar[str] = "diagnose"
    result: ClassVar[str] = "diagnosis"
    same_version: ClassVar[bool] = True
    extra: list[str] = field(default_factory=list)
    alpha: float = 0.05
    consider: list[str] = field(default_factory=list)
    max_effects: int = 3
    bootstrap: int = 0
    every: bool = False
    exit_code: bool = False


class Early(Kept):
    """The finished parts, and what is known before all of them are."""

    early: dict[str, Any] | None = None

    def tell(self, early: dict[str, Any]) -> None:
        """Show what is known so far, each sentence once."""
        before = [] if self.early is None else diagnoses.said_so_far(self.early)
        self.early = early
        for sentence in diagnoses.said_so_far(early):
            if sentence not in before:
                self.shown.note(sentence)


def diagnose(asked: Asked, state: Path | None, as_json: bool, quiet: bool) -> None:
    """A new diagnosis; its state goes to ``state`` or beside the output."""
    path = state or beside(asked.out, f"{Path(asked.data[0]).stem}-diagnosis")
    asked.keep = state is not None
    _check(asked)
    output_path("--state", can_be(state, path))
    with meter(quiet or as_json) as shown:
        job = _prepare(asked, shown)
        kept = Early(asked.begin(path, [*asked.data, *asked.test], shown), shown)
        found, document = _run(job, asked, kept)
    _tell(asked, found, document, kept, as_json)


def resume(path: Path, changes: dict[str, Any], as_json: bool, quiet: bool) -> None:
    """Go on with a diagnosis; ``changes`` are members of Asked that may differ."""
    asked, rows, left = read(path, Asked)
    asked.change(changes)
    _check(asked)
    with meter(quiet or as_json) as shown:
        job = _prepare(asked, shown)
        kept = Early(StateFile(path, asked), shown, dict(left), int(rows[0, 0]))
        shown.note(f"going on at {kept.percent} %")
        found, document = _run(job, asked, kept)
    _tell(asked, found, document, kept, as_json)


def _check(asked: Asked) -> None:
    """Refuse what cannot be written, or asked, before any time is spent."""
    check_outputs(asked)
    if not 0.0 < asked.alpha < 1.0:
        raise wrong(f"--alpha {asked.alpha:g}: a probability between 0 and 1 is needed")


@dataclass(frozen=True)
class Job:
    """What ``engine.diagnose`` is given; ``name`` is that of the registered model."""

    name: str
    model: MixedModel
    series: list[Series]
    test: list[Series]
    theta: engine.Theta | None
    free: list[str] | None


def _prepare(asked: Asked, shown: Meter) -> Job:
    """All that can be wrong is found here."""
    base = references.model_of(asked.model)
    columns = asked.of_columns(asked.extra)
    read_in = [series_of(Path(name), base, columns) for name in (*asked.data, *asked.test)]
    for _, said in read_in:
        shown.note(said)
    every = [series for series, _ in read_in]
    series, test = every[: len(asked.data)], every[len(asked.data) :]
    model = references.with_effects(base, asked.effects, series[0])
    theta = theta_of(model, asked.start, asked.fixed)
    free = free_of(model, asked.free, list(asked.fixed))
    model = _holding(model, asked.fixed)
    _check_effects(model, asked)
    # without a start, one is searched for
    return Job(base.name, model, series, test, theta if asked.start else None, free)


def _run(job: Job, asked: Asked, kept: Early) -> tuple[engine.Diagnosis, dict[str, Any]]:
    """The diagnosis and its document; when it is interrupted, what is done is saved."""
    kept.shown.begin(diagnoses.PROGRESS_STEPS, kept.percent, timed=False)
    with kept.going(partial(_interrupted, asked, kept)):
        found = engine.diagnose(
            job.model,
            job.series,
            job.theta,
            job.test,
            seed=asked.seed,
            alpha=asked.alpha,
            effects=asked.consider or None,
            max_effects=asked.max_effects,
            free=job.free,
            bootstrap=asked.bootstrap,
            callback=diagnoses.Percent(kept.step),
            kept=kept,
            early=kept.tell,
        )
    return found, diagnoses.document(found, job.name, asked.effects)


def _interrupted(asked: Asked, kept: Early) -> Ending:
    """What is said at Ctrl-C; what is known so far goes where the result would have gone."""
    text, known = "", {} if kept.early is None else diagnoses.so_far(kept.early)
    if known:
        written = write_outputs(replace(asked, plot=None), known, asked.data, kept)
        text = "".join(f"\nWhat is known so far: {os.path.relpath(name)}" for name in written)
    return kept.interrupted(text, **({"early": kept.early} if known else {}))


def _check_effects(model: MixedModel, asked: Asked) -> None:
    """Refuse effects to look for that are neither a kind nor one of this model's."""
    extra = tuple(asked.extra)
    there = {one.name for one in all_effects(Setting(with_inputs(model, extra), extra=extra))}
    for name in asked.consider:
        if name not in there and name not in effect_kinds():
            raise wrong(
                f"--effects {name}: there is no such effect; 'rbps models NAME --effects' lists them"
            )


def _holding(model: MixedModel, fixed: dict[str, float]) -> MixedModel:
    """The model whose defaults are the values held, so that a start is still searched for."""
    parameters = [
        replace(p, default=fixed[p.name]) if p.name in fixed else p for p in model.parameters
    ]
    return replace(model, parameters=parameters)


def _tell(
    asked: Asked,
    found: engine.Diagnosis,
    document: dict[str, Any],
    kept: Early,
    as_json: bool,
) -> None:
    """Write the files and print the page; then the state is removed, unless --state named it."""
    written = write_outputs(asked, document, asked.data, kept)
    kept.settle()
    if as_json:
        print(strict_json.dumps(document))
    else:
        print(page(found, asked.every))
        say_written(written)
    if asked.exit_code and found.verdict is not Verdict.NOTHING:
        raise SystemExit(Code.FOUND)
