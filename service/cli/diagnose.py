"""``rbps diagnose``: what a model leaves out."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import engine
from engine.diagnose import Verdict, all_effects, effect_kinds
from engine.diagnose.report import page
from engine.diagnose.setting import Setting
from engine.diagnose.spare_inputs import with_inputs
from engine.model import MixedModel
from engine.report import write_report
from service import diagnoses, strict_json
from service.cli import references
from service.cli.ending import Code, Ending, Interrupt, wrong
from service.cli.files import Columns, series_of
from service.cli.meter import Meter, meter
from service.cli.values import figure_folder, free_of, output_path, theta_of


@dataclass(frozen=True)
class Wanted:
    """The command's arguments."""

    data: Path
    model: str
    effects: list[str]
    start: dict[str, float]
    fixed: dict[str, float]
    free: list[str]
    columns: Columns
    test: Path | None
    alpha: float
    consider: list[str]
    max_effects: int
    bootstrap: int
    seed: int
    out: Path | None
    report: Path | None
    plot: Path | None
    every: bool
    exit_code: bool


class Steps:
    """Where ``diagnoses.Percent`` tells how far it is, and where Ctrl-C ends the diagnosis."""

    def __init__(self, shown: Meter, interrupt: Interrupt) -> None:
        self.shown, self.interrupt = shown, interrupt

    def step(self, k: int, message: str = "") -> None:
        """Per cent done."""
        self.shown.at(k, message)
        self.interrupt.check()


def run(wanted: Wanted, as_json: bool, quiet: bool) -> None:
    """Diagnose, write the files, print the page."""
    output_path("--out", wanted.out, (".json",))
    output_path("--report", wanted.report, (".html", ".htm"))
    figure_folder("--plot", wanted.plot)
    if not 0.0 < wanted.alpha < 1.0:
        raise wrong(f"--alpha {wanted.alpha:g}: a probability between 0 and 1 is needed")
    with meter(quiet or as_json) as shown:
        found, document = _diagnosis(wanted, shown)
    written = _write(wanted, found, document)
    if as_json:
        print(strict_json.dumps(document))
    else:
        print(page(found, wanted.every))
        for path in written:
            print(f"Written: {path}")
    if wanted.exit_code and found.verdict is not Verdict.NOTHING:
        raise SystemExit(Code.FOUND)


def _diagnosis(wanted: Wanted, shown: Meter) -> tuple[engine.Diagnosis, dict[str, Any]]:
    base = references.model_of(wanted.model)
    series, said = series_of(wanted.data, base, wanted.columns)
    shown.note(said)
    test = None
    if wanted.test is not None:
        test, said = series_of(wanted.test, base, wanted.columns)
        shown.note(said)
    model = references.with_effects(base, wanted.effects, series)
    theta = theta_of(model, wanted.start, wanted.fixed)
    free = free_of(model, wanted.free, list(wanted.fixed))
    model = _holding(model, wanted.fixed)
    _check_effects(model, wanted)
    shown.begin(diagnoses.STEPS)
    interrupt = Interrupt()
    try:
        with interrupt.held():
            found = engine.diagnose(
                model,
                series,
                theta if wanted.start else None,  # without a start, one is searched for
                test,
                seed=wanted.seed,
                alpha=wanted.alpha,
                effects=wanted.consider or None,
                max_effects=wanted.max_effects,
                free=free,
                bootstrap=wanted.bootstrap,
                callback=diagnoses.Percent(Steps(shown, interrupt)),
            )
    except KeyboardInterrupt:
        raise Ending(
            Code.INTERRUPTED,
            "interrupted; a diagnosis keeps nothing to go on from. The same command begins anew and gives "
            "the same answer; one that looks for less, such as --effects coulomb,bias, ends sooner.",
        ) from None
    return found, diagnoses.document(found, base.name, wanted.effects)


def _check_effects(model: MixedModel, wanted: Wanted) -> None:
    """Refuse effects to look for that are neither a kind nor one of this model's."""
    extra = tuple(wanted.columns.extra)
    there = {one.name for one in all_effects(Setting(with_inputs(model, extra), extra=extra))}
    for name in wanted.consider:
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


def _write(wanted: Wanted, found: engine.Diagnosis, document: dict[str, Any]) -> list[Path]:
    written = []
    if wanted.out:
        wanted.out.write_text(strict_json.dumps(document) + "\n", encoding="utf-8")
        written.append(wanted.out)
    if wanted.report:
        rows = {"data": wanted.data.name, "seed": wanted.seed}
        plain = json.loads(strict_json.dumps(document))
        written.append(write_report(plain, wanted.report, rows))
    if wanted.plot:
        found.plot().save(wanted.plot)
        written.append(wanted.plot)
    return written
