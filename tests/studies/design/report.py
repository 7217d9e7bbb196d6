"""The page: right names, samples against random binary inputs, the printed probability, what none decides."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from engine.statespace.model import Array
from tests.studies.design.cases import DECIDABLE, ROWS, UNDECIDABLE
from tests.studies.design.runs import (
    ALARM,
    CALIBRATION_ARM,
    CLOCKS,
    DECIDED_ARM,
    DEFAULT,
    FEW_INPUTS,
    INPUTS,
    LONG,
    LONGER,
    NEVER_ARM,
    REACH,
    RECORDS,
    TIME_ARM,
)
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.statistics import wilson
from tests.studies.study import Study, Table, Tables

ABOUT = f"""\
Two causes of a small system, their sizes drawn, one of them true. `engine.design_experiment` finds an
input of {ROWS} samples within the bounds (range, in part a limit on a state), a record is drawn with it,
and its naming part of `engine.diagnose` is asked anew, from the default parameters, among the two causes
and the model without them. The alarm of such a diagnosis, with two effects instead of the whole
catalogue, is a statistic of about {ALARM:g}, which the design is told. One case in eight is diagnosed
with the whole catalogue, too.

*Can reach D >= {REACH:g}*: the designed input does, whichever of the two is true. *Right name*: the set
of the diagnosis is the true cause alone. *Verdict*: the diagnosis says `named`, too; its other tests may
say `unknown` beside the right name. Intervals are Wilson's, 95 %.

*Random binary*: the ends of the range, drawn anew every 1 or {CLOCKS[-1]} samples, as wide as limits on
states let it be, {LONGER * ROWS} samples long; the samples needed are those from which the same
criterion gives 95 % whichever cause is true. Where none of {LONGER * ROWS} are enough, so many are
counted, which favours the random input. No record shorter than ten samples for each parameter is
considered.
"""

COLOR = "#1f6feb"
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0001)


def report(tables: Tables) -> str:
    """Everything."""
    decided, never = tables[DECIDED_ARM.name], tables[NEVER_ARM.name]
    parts = [
        ABOUT,
        _names(decided),
        _samples(decided),
        _calibration(tables[CALIBRATION_ARM.name], decided),
        _never(never),
    ]
    parts += [
        _times(decided, tables[TIME_ARM.name]),
        _full(decided),
        _failed(decided, never),
        made_with(tables),
    ]
    return "\n".join(part for part in parts if part)


def _reaching(table: Table) -> list[int]:
    least = table.numbers("D_least")
    return [int(k) for k in np.flatnonzero(least >= REACH)]


def _share(events: int, runs: int) -> str:
    low, high = wilson(events, runs)
    rate = "-" if not runs else f"{100 * events / runs:.1f} %"
    return f"{rate} ({100 * low:.1f} to {100 * high:.1f}; {events} of {runs})"


def _names(table: Table) -> str:
    rows, reach = [], _reaching(table)
    right = _right(table, "set")
    said = [v == "named" for v in table.texts("verdict")]
    pairs = _pairs(table)
    for name in ("", *dict.fromkeys(pairs)):
        own = [k for k in reach if not name or pairs[k] == name]
        rows.append(
            [
                name or "**all**",
                str(len(own)),
                _share(sum(right[k] for k in own), len(own)),
                _share(sum(right[k] and said[k] for k in own), len(own)),
            ]
        )
    head = ["causes", "cases that reach it", "right name", "... and verdict `named`"]
    return "## Right names\n\n" + markdown(head, rows)


def _pairs(table: Table) -> list[str]:
    both = zip(table.texts("system"), table.texts("pair"), strict=True)
    return [f"{system}: {pair}" for system, pair in both]


def _right(table: Table, column: str) -> list[bool]:
    return [a == b for a, b in zip(table.texts(column), table.texts("true"), strict=True)]


def needed(table: Table, column: str) -> Array:
    """Samples that random binary inputs need; the longest that was tried where that is not enough."""
    values = table.numbers(column)
    return np.where(np.isfinite(values), values, np.where(np.isnan(values), np.nan, LONGER * ROWS))


def _samples(table: Table) -> str:
    reach = _reaching(table)
    short = table.numbers("shortest")[reach]
    columns = [needed(table, f"binary_{clock}")[reach] for clock in CLOCKS]
    rows = []
    for name, binary in (
        *((f"drawn every {clock} samples", c) for clock, c in zip(CLOCKS, columns, strict=True)),
        ("the better of them, case by case", np.min(columns, axis=0) if len(reach) else short),
    ):
        both = np.isfinite(short) & np.isfinite(binary)
        ratio = short[both] / binary[both]
        if not len(ratio):
            continue
        quartiles = np.quantile(ratio, [0.25, 0.5, 0.75])
        rows.append(
            [
                name,
                str(len(ratio)),
                f"{quartiles[1]:.2f} ({quartiles[0]:.2f} to {quartiles[2]:.2f})",
                f"{short[both].sum() / binary[both].sum():.2f}",
                _share(int((ratio <= 1.0 / 3.0).sum()), len(ratio)),
            ]
        )
    head = [
        "random binary input",
        "cases",
        "samples designed / random: median (quartiles)",
        "of all samples",
        "a third or less",
    ]
    return "## Samples to 95 %\n\n" + markdown(head, rows)


@dataclass(frozen=True)
class Bin:
    """Records whose printed probability is alike: its mean, how many end right, and the share's interval."""

    printed: float
    right: int
    records: int
    low: float
    high: float

    @classmethod
    def of(cls, p: Array, right: Array) -> Bin:
        """From (designs, RECORDS), NaN where there is none; records of one design are not independent."""
        there = ~np.isnan(p)
        n, share = int(there.sum()), float(right[there].mean())
        apart = np.where(there, right - share, 0.0).sum(axis=1)
        half = 1.96 * float(np.sqrt((apart**2).sum())) / n
        low, high = max(share - half, 0.0), min(share + half, 1.0)
        return cls(float(p[there].mean()), int(right[there].sum()), n, low, high)


def calibration(table: Table) -> list[Bin]:
    """The records of each bin of the printed probability."""
    p, right = (
        np.column_stack([table.numbers(f"{of}_{k}") for k in range(RECORDS)])
        for of in ("probability", "right")
    )
    bins = [np.where((p >= low) & (p < high), p, np.nan) for low, high in pairwise(BINS)]
    return [Bin.of(own, right) for own in (*bins, p) if not np.isnan(own).all()]


def _calibration(short: Table, whole: Table) -> str:
    rows = []
    for one in calibration(short):
        share, low, high = (100 * x for x in (one.right / one.records, one.low, one.high))
        said = f"{share:.1f} % ({low:.1f} to {high:.1f}; {one.right} of {one.records})"
        rows.append([f"{100 * one.printed:.1f} %", said])
    if rows:
        rows[-1][0] = f"**all**: {rows[-1][0]}"
    p, right = whole.numbers("probability"), _right(whole, "set")
    rows.append([f"whole designs, above: {100 * p.mean():.1f} %", _share(sum(right), len(right))])
    text = (
        "## Is the printed probability right?\n\n"
        f"{len(short)} designs of {FEW_INPUTS} inputs, of each {RECORDS} records: either cause true in turn, "
        "each cut off where the printed probability is anything between 0 and 0.5, and between 0.5 and 1. "
        "Intervals count a design's records as one (a normal distribution of their sums). What a design takes "
        "into account was settled on other cases.\n\n"
    )
    return text + markdown(["probability printed, mean of the bin", "right names"], rows)


def _never(table: Table) -> str:
    said, pairs, rows = table.texts("undecided"), _pairs(table), []
    for name in ("", *dict.fromkeys(pairs)):
        own = [k for k in range(len(said)) if not name or pairs[k] == name]
        rows.append(
            [
                name or "**all**",
                _share(sum(said[k] == "never" for k in own), len(own)),
                _share(sum(said[k] != "" for k in own), len(own)),
            ]
        )
    head = ["causes", "said: no input tells them apart", "... or needs a longer record"]
    text = (
        "A force and an offset of the input are the same thing in other words there. The others are kept from "
        "happening by the bounds: an overflow above the level that must be kept; inputs that are too small to "
        "leave a dead zone or to overcome friction, or for a cubic term to be seen beside the noise.\n\n"
    )
    return f"## What no input decides\n\n{text}" + markdown(head, rows)


def _times(table: Table, long: Table) -> str:
    rows = []
    for samples, inputs, one in ((ROWS, INPUTS, table), (LONG, DEFAULT, long)):
        seconds = one.numbers("seconds")
        seconds = seconds[np.isfinite(seconds)]
        if len(seconds):
            numbers = f"{np.median(seconds):.1f}", f"{seconds.max():.1f}"
            rows.append([str(samples), str(inputs), str(len(seconds)), *numbers])
    head = ["samples", "inputs tried", "designs", "s of the processor, median", "at most"]
    return "## Time\n\nThe search for the shortest record is included.\n\n" + markdown(head, rows)


def _full(table: Table) -> str:
    said, true = table.texts("full"), table.texts("true")
    rows = [k for k, text in enumerate(said) if text]
    if not rows:
        return ""
    named = sum(said[k] == f"named {true[k]}" for k in rows)
    first = sum(true[k] in said[k].split() for k in rows)
    return (
        "## With the whole catalogue\n\n"
        f"Of {len(rows)} such diagnoses {named} say `named` and the true cause alone; {first} list it as the "
        "cause, a `set` with others of the catalogue or a further effect included: the input was designed "
        "for two.\n"
    )


def _failed(*tables: Table) -> str:
    notes = [note for table in tables for note in table.texts("note") if note]
    kinds = "; ".join(sorted({note.partition(" = ")[0] for note in notes}))
    return f"{len(notes)} cases could not be made: {kinds}\n" if notes else ""


def plot(tables: Tables, path: Path) -> None:
    """The calibration, and the samples against those of random binary inputs."""
    table = tables[DECIDED_ARM.name]
    figure, (left, right) = axes(1, 2, (9.0, 4.0))
    left.plot([0, 1], [0, 1], color="#888888", linewidth=0.8)
    for one in calibration(tables[CALIBRATION_ARM.name])[:-1]:
        left.plot([one.printed] * 2, [one.low, one.high], color=COLOR, linewidth=1.2)
        left.plot([one.printed], [one.right / one.records], "o", color=COLOR, markersize=4)
    left.set(xlabel="probability printed", ylabel="share of right names", xlim=(0, 1), ylim=(0, 1))
    reach = _reaching(table)
    short = table.numbers("shortest")[reach]
    for clock in CLOCKS:
        binary = needed(table, f"binary_{clock}")[reach]
        right.plot(binary, short, ".", markersize=4, label=f"drawn every {clock}")
    ends = np.array([30.0, LONGER * ROWS])
    for share, style in ((1.0, "-"), (1.0 / 3.0, "--")):
        right.plot(ends, share * ends, style, color="#888888", linewidth=0.8)
    right.set(
        xlabel="samples to 95 %, random binary input",
        ylabel="samples to 95 %, designed",
        xscale="log",
        yscale="log",
    )
    right.legend(fontsize=7)
    save(figure, path)


STUDY = Study(
    "design",
    "Designed experiments: do they end in the right name?",
    {
        DECIDED_ARM: 45 * len(DECIDABLE),
        CALIBRATION_ARM: 40 * len(DECIDABLE),
        NEVER_ARM: 20 * len(UNDECIDABLE),
        TIME_ARM: 4,
    },
    report,
    plot,
)
