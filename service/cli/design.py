"""``rbps design``: the input within bounds that tells the causes of a diagnosis apart."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import engine
from engine.design import Design, design_experiment
from engine.diagnose import Diagnosis
from engine.errors import EngineError
from engine.presentation import plots
from engine.presentation.report import write_report
from service import designs, strict_json
from service.cli import references
from service.cli.ending import about_file, wrong
from service.cli.meter import meter
from service.cli.outputs import figure_folder, output_path, say_written
from service.cli.values import about, numbers


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """As it was asked for; ``diagnosis`` is a file, else ``model`` and ``causes`` are given."""

    diagnosis: Path | None
    model: str
    causes: Sequence[str]
    values: Sequence[str]
    free: list[str]
    bounds: Path | None
    inputs: Sequence[str]
    stopbands: Sequence[str]
    states: Sequence[str]
    outputs: Sequence[str]
    dt: float | None
    length: int
    tries: int
    seed: int
    out: Path | None
    shortest: Path | None
    report: Path | None
    plot: Path | None


def run(wanted: Wanted, as_json: bool, quiet: bool) -> None:
    """Design, write the files, print the table."""
    output_path("--out", wanted.out, (".csv",))
    output_path("--shortest", wanted.shortest, (".csv",))
    output_path("--report", wanted.report, (".html", ".htm"))
    figure_folder("--plot", wanted.plot)
    bounds = _bounds(wanted)
    asked, options = _asked(wanted, bounds)
    with meter(quiet or as_json) as shown:
        shown.begin(100, timed=False)

        def tell(stage: str, share: float) -> None:
            first, width = designs.STAGES[stage]
            shown.at(int(first + width * share), designs.STAGE_MESSAGES[stage])

        with about("design"):
            found = design_experiment(
                asked,
                bounds,
                wanted.length,
                inputs=wanted.tries,
                seed=wanted.seed,
                callback=tell,
                **options,
            )
    _tell(found, wanted, as_json)


def _asked(wanted: Wanted, bounds: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A diagnosis, or a model with its causes; what else ``design_experiment`` is given."""
    names = [name for text in wanted.causes for name in text.split(",") if name]
    if wanted.diagnosis is None:
        if not wanted.model:
            raise wrong(
                "DIAGNOSIS is missing: a saved diagnosis, or --model with --cause EFFECT=SIZE"
            )
        with about("--set"):
            model = references.model_of(wanted.model)
            theta = model.theta(numbers("--set", wanted.values))
        return model, {
            "causes": numbers("--cause", wanted.causes),
            "theta": theta,
            "free": wanted.free or None,
        }
    document = _read(wanted.diagnosis)
    if "rbps" in document:
        try:
            own = references.model_of(wanted.model) if wanted.model else None
            found = engine.load(wanted.diagnosis, model=own)
        except EngineError as error:
            raise wrong(str(error)) from None
        if not isinstance(found, Diagnosis):
            raise wrong(f"{wanted.diagnosis}: this is no diagnosis, but a {type(found).__name__}")
        return found, {"causes": names or None}
    diagnosis = document.get("diagnosis")
    if not isinstance(diagnosis, Mapping):
        raise wrong(
            f"{wanted.diagnosis}: neither the JSON of 'rbps diagnose --out' nor a file of Diagnosis.save"
        )
    with about(str(wanted.diagnosis)):
        causes, free = designs.causes_of(diagnosis)
    for name in names:
        if name not in causes:
            raise wrong(f"--cause {name}: the diagnosis weighed {', '.join(causes)}")
    for name, value in designs.between_samples(diagnosis).items():
        bounds.setdefault(name, value)
    model = references.model_of(wanted.model or diagnosis["extension"]["model"]["name"])
    return model, {
        "causes": {name: causes[name] for name in names or causes},
        "theta": diagnosis["base_theta"],
        "free": free,
    }


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise wrong(about_file(error)) from None
    except ValueError as error:
        raise wrong(f"{path}: this is no JSON ({error})") from None
    if not isinstance(document, dict):
        raise wrong(f"{path}: an object is needed")
    return document


def _bounds(wanted: Wanted) -> dict[str, Any]:
    """From the file and the options, which come on top of it."""
    bounds = {} if wanted.bounds is None else _read(wanted.bounds)
    for option, key, texts in (
        ("--input", "inputs", wanted.inputs),
        ("--limit", "states", wanted.states),
        ("--limit-output", "outputs", wanted.outputs),
    ):
        own: dict[str, Any] = dict(bounds.get(key) or {})
        for text in texts:
            name, value = _named(option, text)
            own[name] = _range(option, text, value, key == "inputs")
        if own:
            bounds[key] = own
    for text in wanted.stopbands:
        name, value = _named("--stopband", text)
        one = (bounds.get("inputs") or {}).get(name)
        if isinstance(one, list) and len(one) == 2:
            one = bounds["inputs"][name] = dict(zip(("low", "high"), one, strict=True))
        if not isinstance(one, dict):
            raise wrong(f"--stopband {text}: give its range too, with --input {name}=LOW:HIGH")
        one["stopbands"] = [*(one.get("stopbands") or []), _range("--stopband", text, value, False)]
    if wanted.dt is not None:
        bounds["dt"] = wanted.dt
    return bounds


def _named(option: str, text: str) -> tuple[str, str]:
    name, equals, value = text.rpartition("=")
    if not (equals and name):
        raise wrong(f"{option} {text}: NAME=LOW:HIGH is needed")
    return name, value


def _range(option: str, text: str, value: str, is_input: bool) -> Any:
    parts = value.split(":")
    if len(parts) not in ((2, 3) if is_input else (2,)):
        raise wrong(f"{option} {text}: NAME=LOW:HIGH{'[:RATE]' if is_input else ''} is needed")
    try:
        ends = [None if not part and not is_input else float(part) for part in parts]
    except ValueError:
        raise wrong(f"{option} {text}: '{value}' holds what is no number") from None
    return dict(zip(("low", "high", "rate"), ends, strict=False)) if is_input else ends


def _tell(found: Design, wanted: Wanted, as_json: bool) -> None:
    """Write the files and print the table."""
    document = json.loads(strict_json.dumps(designs.document(found)))
    written = []
    try:
        if wanted.out:
            written.append(str(found.to_csv(wanted.out)))
        if wanted.shortest and found.shortest is not None:
            written.append(str(found.to_csv(wanted.shortest, shortest=True)))
        if wanted.report:
            written.append(str(write_report(document, wanted.report, {"seed": wanted.seed})))
        if wanted.plot:
            plots.of_document(document).save(wanted.plot)
            written.append(str(wanted.plot))
    except OSError as error:
        raise wrong(about_file(error)) from None
    if as_json:
        print(strict_json.dumps(document))
        return
    print(found)
    say_written(written)
    if wanted.shortest and found.shortest is None:
        print("No shortest record was written: none reaches the probability that is wanted.")
