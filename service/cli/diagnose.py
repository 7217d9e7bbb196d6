"""``rbps diagnose``: find out what a model leaves out; what is finished is kept for a resumed run."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import engine
from engine.diagnose import LEAST_ALPHA, Verdict, all_effects, effect_kinds
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.spare_inputs import with_inputs
from engine.diagnose.records import HELD_OUT
from engine.presentation.diagnosis_text import page
from engine.statespace.model import MixedModel
from service import diagnoses, strict_json
from service.cli.ending import Code, Ending, wrong
from service.cli.experiment import Experiment, Job
from service.cli.meter import Meter, meter
from service.cli.outputs import check_outputs, say_written, state_path, write_outputs
from service.cli.parts import Kept
from service.cli.state_file import StateFile, read


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
    held_out: float = HELD_OUT
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
    _check(asked)
    path = state_path(asked, state, f"{Path(asked.data[0]).stem}-diagnosis")

    def begun(shown: Meter) -> Early:
        return Early(asked.begin(path, [*asked.data, *asked.test], shown), shown)

    _work(asked, begun, as_json, quiet)


def resume(path: Path, changes: dict[str, Any], as_json: bool, quiet: bool) -> None:
    """Go on with a diagnosis; ``changes`` are members of Asked that may differ."""
    asked, rows, left = read(path, Asked)
    asked.change(changes)
    _check(asked)
    _work(asked, lambda shown: Early(StateFile(path, asked), shown, rows, left), as_json, quiet)


def _work(asked: Asked, begun: Callable[[Meter], Early], as_json: bool, quiet: bool) -> None:
    """Make the diagnosis from where its parts have ``begun``, and tell."""
    with meter(quiet or as_json) as shown:
        job = _prepare(asked, shown)
        kept = begun(shown)
        found = _run(job, asked, kept)
    _tell(asked, found, diagnoses.document(found, job.name, asked.effects), kept, as_json)


def _check(asked: Asked) -> None:
    """Refuse what cannot be written, or asked, before any time is spent."""
    check_outputs(asked)
    if not LEAST_ALPHA <= asked.alpha < 1.0:
        needed = f"a probability from {LEAST_ALPHA:g} to below 1 is needed"
        raise wrong(f"--alpha {asked.alpha:g}: {needed}")
    if asked.test and asked.held_out != HELD_OUT:
        raise wrong(
            f"--held-out {asked.held_out:g}: --test is what is held out then; give one of the two"
        )


def _prepare(asked: Asked, shown: Meter) -> Job:
    """All that can be wrong is found here."""
    job = asked.job(shown, asked.extra)
    model = _holding(job.model, asked.fixed)
    _check_effects(model, asked)
    return replace(job, model=model)


def _run(job: Job, asked: Asked, kept: Early) -> engine.Diagnosis:
    """The diagnosis; when it is interrupted, what is done is saved."""
    kept.shown.begin(diagnoses.PROGRESS_STEPS, kept.percent, timed=False)
    with kept.going(partial(_interrupted, asked, kept)):
        return engine.diagnose(
            job.model,
            job.series,
            job.theta if asked.start else None,  # without a start, one is searched for
            job.test,
            seed=asked.seed,
            alpha=asked.alpha,
            effects=asked.consider or None,
            max_effects=asked.max_effects,
            held_out=asked.held_out,
            free=job.free,
            bootstrap=asked.bootstrap,
            callback=diagnoses.Percent(kept.step),
            kept=kept,
            early=kept.tell,
        )


def _interrupted(asked: Asked, kept: Early) -> Ending:
    """What is said at Ctrl-C; what is known so far goes where the result would have gone."""
    text, known = "", {} if kept.early is None else diagnoses.so_far(kept.early)
    if known:
        written = write_outputs(replace(asked, plot=None), known, kept)
        text = "".join(f"\nWhat is known so far: {os.path.relpath(name)}" for name in written)
    return kept.interrupted(text, **({"early": kept.early} if known else {}))


def _check_effects(model: MixedModel, asked: Asked) -> None:
    """Refuse effects to look for that are neither a kind nor one of this model's."""
    extra = tuple(asked.extra)
    setting = Setting(with_inputs(model, extra), extra=extra)
    for name in asked.consider:
        if name not in effect_kinds() and not all_effects(setting, [name]):
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
    asked: Asked, found: engine.Diagnosis, document: dict[str, Any], kept: Early, as_json: bool
) -> None:
    """Write the files and print the page; then the state is removed, unless --state named it."""
    document = asked.with_notes(document)
    written = write_outputs(asked, document, kept)
    kept.settle()
    if as_json:
        print(strict_json.dumps(document))
    else:
        print(page(found, asked.every))
        say_written(written)
    if asked.exit_code and found.verdict is not Verdict.NOTHING:
        raise SystemExit(Code.FOUND)
