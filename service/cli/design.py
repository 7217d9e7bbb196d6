"""``rbps design``: the input within bounds that tells the causes of a diagnosis apart."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import engine
from engine.design import INPUTS, Design, asked_of
from engine.diagnose import Diagnosis
from engine.errors import EngineError
from service import designs, strict_json, validation
from service.cli import references
from service.cli.ending import wrong
from service.cli.files import json_object
from service.cli.meter import Meter, meter
from service.cli.outputs import (
    check_outputs,
    kept_if_not_written,
    output_path,
    say_written,
    state_path,
    write_shown,
)
from service.cli.parts import Kept
from service.cli.state_file import Run, StateFile, read
from service.cli.values import about, numbers
from service.schemas import ModelReference

NO_OBJECT = "this is no JSON object"


@dataclass(kw_only=True)
class Asked(Run):
    """A design as it was asked for; of a ``diagnosis`` in a file, else of ``model`` and ``causes``."""

    command: ClassVar[str] = "design"
    result: ClassVar[str] = "design"
    same_version: ClassVar[bool] = True
    diagnosis: str | None = None
    causes: list[str] = field(default_factory=list)
    values: list[str] = field(default_factory=list)
    bounds: str | None = None
    inputs: list[str] = field(default_factory=list)
    stopbands: list[str] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    length: int = 500
    tries: int = INPUTS
    shortest: str | None = None


def design(wanted: Asked, state: Path | None, as_json: bool, quiet: bool) -> None:
    """A new design; its state goes to ``state`` or beside the output."""
    _check(wanted)
    named = wanted.diagnosis or wanted.model.partition(":")[0] or "rbps"
    path = state_path(wanted, state, f"{Path(named).stem}-design")
    files = [name for name in (wanted.diagnosis, wanted.bounds) if name]
    _work(wanted, lambda shown: Kept(wanted.begin(path, files, shown), shown), as_json, quiet)


def resume(path: Path, changes: dict[str, Any], as_json: bool, quiet: bool) -> None:
    """Go on with a design; ``changes`` are members of Asked that may differ."""
    wanted, rows, left = read(path, Asked)
    wanted.change(changes)
    _check(wanted)
    _work(wanted, lambda shown: Kept(StateFile(path, wanted), shown, rows, left), as_json, quiet)


def _work(wanted: Asked, begun: Callable[[Meter], Kept], as_json: bool, quiet: bool) -> None:
    """Make the design from where its parts have ``begun``, and tell; interrupted, what is done is saved."""
    with meter(quiet or as_json) as shown:
        asked = _asked(wanted)
        kept = begun(shown)
        shown.begin(designs.PROGRESS_STEPS, kept.percent, timed=False)
        with kept.going(kept.interrupted):
            found = asked.designed(wanted.tries, wanted.seed, designs.telling(kept.step), kept)
    _tell(found, wanted, kept, as_json)


def _check(wanted: Asked) -> None:
    """Refuse files that cannot be written before any time is spent."""
    check_outputs(wanted, ".csv")
    output_path("--shortest", Path(wanted.shortest) if wanted.shortest else None, (".csv",))


def _asked(wanted: Asked) -> engine.design.Asked:
    """All that can be wrong is found here."""
    bounds = _bounds(wanted)
    of, known = _of(wanted, bounds)
    with about("design"):
        return asked_of(of, bounds, wanted.length, **known)


def _of(wanted: Asked, bounds: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A diagnosis, or a model with its causes; what else ``engine.design.asked_of`` is given."""
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
    document = json_object(Path(wanted.diagnosis), NO_OBJECT)
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
        asked = designs.next_of(diagnosis)
    causes = asked["causes"]
    for name in names:
        if name not in causes:
            raise wrong(f"--cause {name}: the diagnosis weighed {', '.join(causes)}")
    for name, value in designs.between_samples(diagnosis).items():
        bounds.setdefault(name, value)
    name = asked["model"]["name"]
    if not wanted.model and name not in engine.model_names():
        raise wrong(
            f"{wanted.diagnosis}: it is of model '{name}', which is not registered; say where it is with "
            "--model path/to/file.py"
        )
    model = references.model_of(wanted.model or name)
    with about(str(wanted.diagnosis)):
        model = validation.extended(model, ModelReference.model_validate(asked["model"]))
    return model, {
        "causes": {name: causes[name] for name in names or causes},
        **{name: asked[name] for name in ("theta", "free", "alarm", "measured")},
    }


def _bounds(wanted: Asked) -> dict[str, Any]:
    """From the file and the options, which come on top of it."""
    bounds = {} if wanted.bounds is None else json_object(Path(wanted.bounds), NO_OBJECT)
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
    name, equals, value = text.partition("=")
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


def _tell(found: Design, wanted: Asked, kept: Kept, as_json: bool) -> None:
    """Write the files and print the table; then the state is removed, unless --state named it."""
    document = json.loads(strict_json.dumps(designs.document(found)))
    with kept_if_not_written(kept):
        written = []
        if wanted.out:
            written.append(str(found.to_csv(wanted.out)))
        if wanted.shortest and found.shortest is not None:
            written.append(str(found.to_csv(wanted.shortest, shortest=True)))
        written += write_shown(wanted, document, {})
    kept.settle()
    if as_json:
        print(strict_json.dumps(document))
        return
    print(found)
    say_written(written)
    if wanted.shortest and found.shortest is None:
        print("No shortest record was written: none reaches the probability that is wanted.")
