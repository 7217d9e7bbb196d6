"""One plasmode: a size, a place, the diagnosis of the changed record: one row."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from engine.diagnose import diagnose, make_effect
from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging.verdict import set_of
from engine.errors import OptionError
from tests.studies.plasmodes.planted import PUTS, Place, Put, put_in
from tests.studies.plasmodes.sizes import IMITATED, RATIOS, SHARES, size_for
from tests.studies.plasmodes.windows import Base, Window, base_of, usable
from tests.studies.study import Arm, Row

SAME = 0.98  # |cos| of footprints from which two effects are one in other words, on these data
SEED = 41_000_000  # first part of the seeds
NOTHING = "nothing"  # put in: the base is diagnosed again with other random numbers
REACHED = 0.7  # of what was wanted: with less it is not in the cell

BLANK: Row = {
    "window": "",
    "hidden": "",
    "wanted": np.nan,
    "size": np.nan,
    "strength": np.nan,
    "own": np.nan,
    "counts": "",
    "verdict": "",
    "causes": "",
    "set": "",
    "words": "",
    "decided": "",
    "p_value": np.nan,
    "seconds": np.nan,
    "note": "",
}


def cells(record: str) -> list[tuple[Window, str, int]]:
    """Window, what is put in, and at which of the two strengths, in random order; nothing, once in eight.

    Windows of a record may have been extended by different effects, and so take different ones.
    """
    out: list[tuple[Window, str, int]] = []
    for window in usable(record):
        there = [(window, name, k) for name in PUTS if _fits(PUTS[name], window) for k in (0, 1)]
        out += there + [(window, NOTHING, 0)] * max(len(there) // 7, 1)
    order = np.random.default_rng(SEED).permutation(len(out))
    return [out[k] for k in order]


def _fits(put: Put, window: Window) -> bool:
    """Whether the window's model has what the truth is named after, and not the effect itself."""
    base = base_of(window)
    if (put.on_input and not base.model.nu) or (not window.gain and "{gain}" in put.truth[0]):
        return False
    if window.noisy and not put.among_noise:
        return False
    setting = setting_for(base.model, base.series, np.asarray(base.theta))
    try:
        effect = make_effect(truth_of(put, base)[0], setting)
    except OptionError:
        return False
    return effect.size.name not in base.model.parameter_names


def truth_of(put: Put, base: Base) -> tuple[str, ...]:
    """Its name in the window's model, and others for the same thing."""
    y, u = next(iter(base.model.outputs)), next(iter(base.model.inputs), "")
    return tuple(text.format(y=y, u=u, gain=base.window.gain) for text in put.truth)


def work(record: str, seed: int, run: int) -> Row:
    """Run ``run`` belongs to a cell, so that all grow together."""
    all_cells = cells(record)
    window, name, level = all_cells[run % len(all_cells)]
    base = base_of(window)
    rng = np.random.default_rng([SEED, seed, run, *record.encode()])
    row: Row = {**BLANK, "window": base.window.name, "hidden": name, "counts": "clean"}
    series = base.series
    truth: tuple[str, ...] = ()
    if name != NOTHING:
        put, place = PUTS[name], Place.drawn(rng)
        truth = truth_of(put, base)
        wanted = (SHARES if base.window.by_free_run and not put.scatter else RATIOS)[level]
        size, there = size_for(base, put, place, wanted)
        series = put_in(put, base.series, size, place)
        counts = "hidden" if there.own >= IMITATED else "clean"
        if there.value < REACHED * wanted and counts == "hidden":
            counts = "weak"
        row |= {"hidden": truth[0], "wanted": wanted, "size": size, "counts": counts}
        row |= {"strength": there.value, "own": there.own}
    if row["counts"] == "weak":
        return row
    began = time.perf_counter()
    try:
        found = diagnose(base.model, series, base.theta, free=base.free, seed=run)
    except Exception as error:  # noqa: BLE001 - a crash is a result
        return row | {"verdict": "crash", "note": f"{type(error).__name__}: {error}"[:300]}
    return row | answer(found, truth) | {"seconds": time.perf_counter() - began}


def answer(found: Diagnosis, truth: tuple[str, ...]) -> Row:
    """What was said, and what says the same as the truth on these data."""
    return {
        "verdict": found.verdict.value,
        "causes": " ".join(cause.effect for cause in found.causes),
        "set": " ".join(first_set(found)),
        "words": " ".join(sorted(words(found, truth))),
        "decided": found.decided_by,
        "p_value": found.p_value,
    }


def first_set(found: Diagnosis) -> tuple[str, ...]:
    """The names that cannot be told apart from the first cause, by the criterion that decided."""
    if not found.causes:
        named = [r for r in found.search.rounds if r.equivalent]
        return set_of(named[0]) if named else ()
    first = found.causes[0]
    return (first.effect, *(name for name in first.equivalent if name != first.effect))


def words(found: Diagnosis, truth: tuple[str, ...]) -> set[str]:
    """The truth and what has the same footprint on these data, by the first screen."""
    screen = found.search.rounds[0].screen
    names = [score.effect.name for score in screen.scores]
    out = set(truth)
    for name in truth[:1]:
        if name in names:
            at = names.index(name)
            out |= {other for i, other in enumerate(names) if screen.likeness(at, i) > SAME}
    return out


def arm_of(record: str) -> Arm:
    """The runs of a record."""
    shown = {"ratios": list(RATIOS), "shares": list(SHARES), "windows": len(usable(record))}
    return Arm(f"plasmodes.{record}", partial(work, record), shown)
