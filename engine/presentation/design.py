"""A designed experiment as a short table, as data, and as a CSV file."""

from __future__ import annotations

import csv
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.errors import OptionError
from engine.json_values import plain
from engine.presentation.display import View, line, show, table
from engine.units import SECOND, clock_of, time_column
from engine.words import number, percent, with_unit

if TYPE_CHECKING:
    from engine.design.design import Design, Experiment, Undecided

SENSOR_TELLS = 14.5  # D from which a further sensor is worth naming: 95 % against one rival
DIGITS = 10  # of an input in a file


def page(d: Design) -> View:
    """What it tells apart, how surely, in how many samples, and what it cannot."""
    rows = [
        (name, title, percent(float(p)))
        for name, title, p in zip(d.causes, d.titles, d.experiment.probability, strict=True)
    ]
    return show(
        f"{d.model.name}: an experiment of {len(d.u)} samples every "
        f"{with_unit(d.dt, d.time_unit)} ({d.experiment.family})",
        *map(line, sentences(d)),
        table(("cause", "", "right name, if it is the true one"), rows),
        line(".to_csv(path) writes the input, .plot() draws it."),
    )


def sentences(d: Design) -> list[str]:
    """The answer in words."""
    out = []
    (true, rival), D = d.smallest
    if d.decides:
        out.append(
            f"Hardest to tell apart: {true} (true) from {rival}, D = {number(D)}. A diagnosis of the record "
            f"names the true cause with a probability of {percent(d.probability)} at least."
        )
        if d.shortest is not None:
            long = len(d.shortest) * d.dt
            out.append(
                f"The shortest record found that reaches {percent(d.level)}: {len(d.shortest)} samples, "
                f"{with_unit(long, d.time_unit)} ({d.shortest.family})."
            )
        else:
            out.append(f"No input of this length was found that reaches {percent(d.level)}.")
    out += [undecided_sentence(one, d) for one in d.undecided]
    if not d.anew:
        out.append("What the earlier record told of the parameters counts too (anew=False).")
    return [*out, *d.notes]


def undecided_sentence(one: Undecided, d: Design) -> str:
    """What is said of causes that the experiment does not tell apart."""
    names = " and ".join(one.causes)
    if not one.hopeless:
        return (
            f"{names}: D = {number(one.D)} in {len(d.u)} samples; about {one.samples} samples would reach "
            f"{percent(d.level)}."
        )
    text = f"{names}: no input within these bounds tells them apart (D = {number(one.D)} at most)."
    best = one.sensors[0] if one.sensors else None
    if best is None or best.D < SENSOR_TELLS:
        return (
            f"{text} Nor would a sensor of any state or output that the model has: measure what they act on, "
            "such as what the input really is where it enters."
        )
    noise = "" if not np.isfinite(best.noise) else f" to {with_unit(best.noise, best.unit, 2)}"
    return f"{text} Another sensor would: measure {best.channel}{noise}, and D = {number(best.D)}."


def as_dict(d: Design) -> dict[str, Any]:
    """The content as JSON values, with the curves that pictures show."""
    t = d.dt * np.arange(len(d.u))
    (true, rival), D = d.smallest
    data = {
        "model": d.model.name,
        "channels": {"inputs": dict(d.model.inputs), "outputs": dict(d.model.outputs)},
        "causes": [
            {"effect": name, "title": title, "probability": float(p)}
            for name, title, p in zip(d.causes, d.titles, d.experiment.probability, strict=True)
        ],
        "bounds": d.bounds.to_dict(),
        "dt": d.dt,
        "time_unit": d.time_unit,
        "anew": d.anew,
        "level": d.level,
        "smallest": {"true": true, "rival": rival, "D": D},
        "probability": d.probability,
        "experiment": _experiment(d.experiment, d),
        "shortest": None if d.shortest is None else _experiment(d.shortest, d),
        "undecided": [
            {**asdict(one), "sentence": undecided_sentence(one, d)} for one in d.undecided
        ],
        "predictions": {
            "t": t,
            **{
                output: {cause: d.predictions[i, :, k] for i, cause in enumerate(d.causes)}
                for k, output in enumerate(d.model.outputs)
            },
        },
        "growth": {
            "samples": d.growth[:, 0],
            **{cause: d.growth[:, 1 + i] for i, cause in enumerate(d.causes)},
        },
        "sentences": sentences(d),
        "tried": d.tried,
        "seconds": d.seconds,
        "page": str(d),
    }
    cleaned: dict[str, Any] = plain(data)
    return cleaned


def _experiment(one: Experiment, d: Design) -> dict[str, Any]:
    return {
        "samples": len(one),
        "family": one.family,
        "D": one.D,
        "probability": one.least,
        "t": d.dt * np.arange(len(one)),
        "u": {name: one.u[:, i] for i, name in enumerate(d.model.inputs)},
    }


def write_csv(d: Design, path: str | Path, shortest: bool) -> Path:
    """Times and inputs, a row each sample; see ``Design.to_csv``."""
    one = d.shortest if shortest else d.experiment
    if one is None:
        raise OptionError(
            f"no shortest experiment reaches {percent(d.level)}; write that of the length asked",
            "shortest",
        )
    file = Path(path)
    with file.open("w", newline="", encoding="utf-8") as out:
        head = time_column(d.time_unit)
        if (clock_of(head) or SECOND) != d.time_unit:
            out.write(f"# time unit: {d.time_unit}\n")
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow([head, *d.model.inputs])
        for k, values in enumerate(one.u.tolist()):
            rows.writerow([f"{k * d.dt:.{DIGITS}g}", *(f"{value:.{DIGITS}g}" for value in values)])
    return file
