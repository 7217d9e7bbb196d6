"""Parts of the measured records, each with a model in which nothing is found any more.

``python -m tests.studies.plasmodes.windows`` makes ``bases.csv``: of every window the model as given is
diagnosed, extended by what is found, and diagnosed again, until nothing is found. A window where something
always is has no base and is not used, nor one that takes more than two effects, which are patches on another
cause.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from engine.data.series import Series
from engine.diagnose import diagnose, extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging.verdict import PATCHES
from engine.errors import EngineError
from engine.statespace.model import MixedModel, Theta
from tests.studies.measured.records import RECORDS, Data

FILE = Path(__file__).with_name("bases.csv")
HEAD = ("window", "effects", "verdict", "p_value", "theta")
ROUNDS = 4  # of extending
ALPHA = 0.05


@dataclass(frozen=True)
class Window:
    """Rows of a record.

    ``part`` is the training part, or the name of a test part. ``by_free_run``: the noise is so small that the
    free run decides, and sizes are shares of its error. ``noisy``: what the readings show from one to the next
    is noise, of which neither a delay nor a bent sensor makes sense. ``gain`` is the parameter that the input
    is multiplied by, ``held`` parameters that are known.
    """

    record: str
    first: int
    last: int
    part: str = ""
    by_free_run: bool = False
    noisy: bool = False
    gain: str = ""
    held: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """As in ``bases.csv``."""
        of = f"{self.record}/{self.part}" if self.part else self.record
        return f"{of} {self.first}-{self.last}"


@dataclass(frozen=True, eq=False)
class Base:
    """A window's series with a model that leaves nothing out, at its estimate."""

    window: Window
    model: MixedModel
    series: Series
    theta: Theta
    free: tuple[str, ...]


WINDOWS = (
    Window("nile", 0, 100, noisy=True),
    Window("nile", 28, 100, noisy=True),
    # before the law, which falls into what is held out
    Window("seatbelts", 0, 168, noisy=True, gain="b"),
    Window("tanks", 0, 512, gain="k4"),
    Window("tanks", 512, 1024, gain="k4"),
    Window("tanks", 0, 512, part="test", gain="k4"),
    Window("tanks", 512, 1024, part="test", gain="k4"),
    *(
        Window("silverbox", k, k + 500, by_free_run=True, gain="gain")
        for k in range(5000, 65000, 10000)
    ),
    *(Window("boucwen", k, k + 500, by_free_run=True) for k in range(2000, 32000, 5000)),
    Window("emps", 0, 620, by_free_run=True, held=("gtau",)),
    Window("emps", 0, 620, part="pulses", by_free_run=True, held=("gtau",)),
)


@lru_cache(maxsize=2)
def _data(record: str) -> Data:
    one = RECORDS[record]
    return one.load(one.path)


def series_of(window: Window) -> Series:
    """Its rows."""
    data = _data(window.record)
    whole = data.tests[window.part] if window.part else data.train
    return whole.part(window.first, min(window.last, len(whole)))


def model_of(window: Window, effects: Sequence[str]) -> tuple[MixedModel, Theta]:
    """The model as given with effects, and where to start from."""
    data, series = _data(window.record), series_of(window)
    start = data.model.theta(None if window.record == "emps" else data.options.get("theta"))
    model = extend(data.model, effects, setting_for(data.model, series, np.asarray(start)))
    own = [p.default for p in model.parameters[len(start) :]]
    return model, model.theta([*start, *own])


def free_of(window: Window, model: MixedModel) -> tuple[str, ...]:
    """What is estimated."""
    return tuple(name for name in model.parameter_names if name not in window.held)


def prepared(window: Window) -> dict[str, str]:
    """A row of ``bases.csv``."""
    effects: list[str] = []
    model, theta = model_of(window, effects)
    series, verdict, p = series_of(window), "", np.nan
    for _ in range(ROUNDS):
        found = diagnose(model, series, theta, free=free_of(window, model), alpha=ALPHA)
        verdict, p = found.verdict.value, found.p_value
        theta = found.theta if found.causes else found.before.theta
        if verdict == "nothing" or not found.causes:
            break
        effects += [cause.effect for cause in found.causes]
        model = found.extended
    return {
        "window": window.name,
        "effects": " ".join(effects),
        "verdict": verdict,
        "p_value": f"{p:.3g}",
        "theta": json.dumps([float(f"{x:.6g}") for x in theta]),
    }


@lru_cache
def rows() -> dict[str, dict[str, str]]:
    """What has been prepared, by window."""
    if not FILE.exists():
        return {}
    with FILE.open(newline="") as file:
        return {row["window"]: row for row in csv.DictReader(file)}


def usable(record: str) -> list[Window]:
    """The windows of a record that have a base."""
    ready = [
        name
        for name, row in rows().items()
        if row["verdict"] == "nothing" and len(row["effects"].split()) <= PATCHES
    ]
    return [w for w in WINDOWS if w.record == record and w.name in ready]


@lru_cache(maxsize=2)
def base_of(window: Window) -> Base:
    """The base that was prepared."""
    row = rows()[window.name]
    model, _ = model_of(window, row["effects"].split())
    found: list[float] = json.loads(row["theta"])
    model = model.with_parameters(  # an effect's bounds depend on where its base stood when it was found
        [
            replace(p, bounds=(min(p.bounds[0], x), max(p.bounds[1], x)))
            for p, x in zip(model.parameters, found, strict=True)
        ]
    )
    return Base(window, model, series_of(window), model.theta(found), free_of(window, model))


def main(arguments: list[str] | None = None) -> None:
    """Prepare the windows that are missing, or those of some records again."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.plasmodes.windows")
    parser.add_argument("--records", default="", help="only these, separated by commas, made again")
    asked = [name for name in parser.parse_args(arguments).records.split(",") if name]
    for window in WINDOWS:
        if not RECORDS[window.record].there:
            print(f"{window.name}: {RECORDS[window.record].reason}")
        elif window.record in asked if asked else window.name not in rows():
            try:
                row = prepared(window)
            except EngineError as error:
                row = dict.fromkeys(HEAD, "") | {
                    "window": window.name,
                    "verdict": f"error: {error}",
                }
            print(row["window"], row["verdict"], row["effects"], flush=True)
            _write(rows() | {window.name: row})
            rows.cache_clear()


def _write(found: dict[str, dict[str, str]]) -> None:
    with FILE.open("w", newline="") as file:
        out = csv.DictWriter(file, HEAD, lineterminator="\n")
        out.writeheader()
        out.writerows(found[w.name] for w in WINDOWS if w.name in found)


if __name__ == "__main__":
    main()
