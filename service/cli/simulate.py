"""``rbps simulate``: data with a known truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.data.files import csv_text, write_series
from engine.data.series import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.presentation import plots
from engine.statespace.model import Array, MixedModel
from engine.units import SECOND
from service import computations, strict_json
from service.cli import references
from service.cli.ending import wrong
from service.cli.files import Columns, inputs_of
from service.cli.meter import Meter
from service.cli.outputs import figure_folder, output_path
from service.cli.values import about
from service.schemas import ModelReference, SimulateOptions, SimulateRequest
from service.validation import Prepared

SHAPES = ("steps", "square", "sine")


@dataclass(frozen=True)
class Wanted:
    """The command's arguments."""

    model: str
    effects: dict[str, float]
    values: dict[str, float]
    samples: int | None
    inputs: Path | None
    columns: Columns
    excite: dict[str, str]
    noise: bool
    seed: int
    out: Path | None
    plot: Path | None


class Steps:
    """The part of ``computations.Progress`` that a simulation uses; it takes hardly any time."""

    def step(self, k: int, message: str = "", share: float | None = None) -> None:
        """Nothing to show."""


def run(wanted: Wanted, as_json: bool) -> None:
    """Simulate and write."""
    output_path("--out", wanted.out, (".csv", ".mat", ".npz"))
    figure_folder("--plot", wanted.plot)
    base = references.model_of(wanted.model)
    frame, notes = _frame(base, wanted)
    for note in notes:
        Meter().warn(note)
    model = references.with_effects(base, list(wanted.effects), [frame])
    sizes = _sizes(base, wanted.effects, frame)
    with about("--set"):
        theta = model.theta(sizes | wanted.values)
    request = SimulateRequest.model_construct(
        kind="simulate",
        model=ModelReference(name=base.name),
        options=SimulateOptions(
            mode="stochastic" if wanted.noise else "free-run", seed=wanted.seed
        ),
    )
    job = Prepared(request, model, [frame], theta)
    document = computations.simulate(job, request, Steps())  # type: ignore[arg-type]  # told steps only
    one = document["simulation"]["series"][0]
    y = np.array([one["y"][name] for name in model.outputs]).T
    drawn = frame.replace(y=y, y_names=tuple(model.outputs), u_names=tuple(model.inputs))
    if wanted.out:
        write_series(drawn, wanted.out)
    if wanted.plot:
        plots.of_document(document).save(wanted.plot)
    if as_json:
        print(strict_json.dumps(document | ({"notes": notes} if notes else {})))
    elif wanted.out:
        print(f"Written: {wanted.out}, {len(drawn)} samples of {', '.join(drawn.y_names)}")
    else:
        print(csv_text(drawn), end="")


def _frame(model: MixedModel, wanted: Wanted) -> tuple[Series, list[str]]:
    """Times and inputs, y is missing throughout; and what to know of how they were read."""
    names = list(model.inputs)
    for name in wanted.excite:
        if name not in names:
            there = ", ".join(names) or "none"
            raise wrong(f"--excite {name}: model '{model.name}' has no such input; it has {there}")
    if wanted.inputs is not None:
        if wanted.excite:
            raise wrong("--excite and --inputs are both given; choose one")
        given, notes = inputs_of(wanted.inputs, model, wanted.columns)
        if wanted.samples not in (None, len(given)):
            raise wrong(f"--samples {wanted.samples}: {wanted.inputs.name} has {len(given)} rows")
        return given, notes
    if wanted.samples is None:
        raise wrong("--samples is missing: how many samples, or a file of --inputs")
    dt = 1.0 if wanted.columns.dt is None else wanted.columns.dt
    if not (np.isfinite(dt) and dt > 0.0):
        raise wrong(f"--dt {dt:g}: a positive time step is needed")
    t = dt * np.arange(wanted.samples, dtype=np.float64)
    missing = [name for name in names if name not in wanted.excite]
    if missing:
        raise wrong(
            f"model '{model.name}' has the input '{missing[0]}': give a file with --inputs, or make "
            f"one with --excite {missing[0]}=steps:SIZE:SECONDS"
        )
    u = [
        shape(name, wanted.excite[name], t, np.random.default_rng([wanted.seed, i]))
        for i, name in enumerate(names)
    ]
    blank = np.full((len(t), model.ny), np.nan)
    with about("--hold, --time-unit"):
        made = Series(
            blank,
            np.array(u).T if u else None,
            t=t,
            hold=wanted.columns.hold or "zoh",
            time_unit=wanted.columns.time_unit or SECOND,
        )
    return made, []


def shape(name: str, text: str, t: Array, rng: np.random.Generator) -> Array:
    """An input (T,) from ``kind:size:seconds``."""
    kind, *rest = text.split(":")
    try:
        size, seconds = map(float, rest)
    except ValueError:
        size = seconds = np.nan
    if kind not in SHAPES or not (np.isfinite(size) and np.isfinite(seconds) and seconds > 0.0):
        raise wrong(
            f"--excite {name}={text}: KIND:SIZE:SECONDS is needed, with KIND one of "
            f"{', '.join(SHAPES)}, as in {name}=steps:2:0.5"
        )
    phase = (t - t[0]) / seconds
    if kind == "sine":
        return np.asarray(size * np.sin(2.0 * np.pi * phase))
    if kind == "square":
        return np.where(phase % 1.0 < 0.5, size, -size)
    held = np.floor(phase + 1e-9).astype(int)
    return np.asarray(rng.uniform(-size, size, held[-1] + 1)[held])


def _sizes(model: MixedModel, effects: Mapping[str, float], frame: Series) -> dict[str, float]:
    """{parameter: value} of the effects' sizes."""
    out = {}
    for name, size in effects.items():
        effect = make_effect(name, references.setting_of(model, [frame]))
        out[effect.size.name] = size
        model = effect.apply(model)
    return out
