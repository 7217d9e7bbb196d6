"""The benchmark's page: figures against their targets, every cell, the confusion matrix."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.studies.blind import figures as f
from tests.studies.blind.cells import BOOTSTRAP, CLEAN, HARD, HIDDEN, OTHER, UNLISTED, USUAL, Cell
from tests.studies.blind.rules import ALPHA, rules
from tests.studies.blind.runs import (
    BOOTSTRAP_ARM,
    CLEAN_ARM,
    HARD_ARM,
    OTHER_ARM,
    OUTSIDE_ARM,
    SEEN,
    USUAL_ARM,
)
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.study import Row, Study, Table, Tables

ABOUT = """\
Effects are hidden in simulated series of four models, whose parameters are then estimated again, and
`engine.diagnose` is asked what the model leaves out: its naming part, with the whole catalogue and
alpha = 5 %. Series have N training rows; a quarter as many more are held out. Sizes are set once per
cell by the likelihood ratio LR of the true extension (`sizes.csv`), from other series.

*Exact*: verdict `named` and nothing but the truth. *In set*: the truth is in the set of the first round.
*Wrong*: `named`, but not the truth alone. Intervals are Wilson's, 95 %; those of shares are bootstrapped.

*Oracles* know that there is something to be named, and no sets. *By likelihood alone*: the truth has the
largest refitted likelihood, compared with the best four refits of the search; with more rivals it could
only be right less often, so its rate is an upper bound and the share a lower one. The one *that charges
for further parameters*, log T each as the diagnosis does, compares the truth also with all that looks like
it (|cos| > 0.7) and with the best of the screen; where nothing else is said, it is meant.

The last rule of decision that was changed (how much may be left to be seen after noise or two effects) was
chosen on part of these series; the last column has those that were made afterwards.
"""

LOOK_ALIKES = """\
## Look-alikes

Effects that another one imitates in these experiments (|cos| of 0.93 and more): a `set` that holds the
truth is the right answer here, and no method that knows the data only can do better. They are not
part of the figures at the top.
"""

MISSED = """\
## What is missed

The series at LR 40 and N = 1000 whose answer is not the exact name: what came out, and of how many the
oracle knows the name, which is as many as any method could tell that goes by the likelihood.
"""

OTHER_RULES = """\
The same series decided by other rules. The oracles never hedge, and know that there is something to be
named; what a bolder rule wins in exact names it pays for with sets that miss the truth and with names for
what the catalogue does not hold.
"""

LEVELS = (0.05, 0.1, 0.2, 0.5)  # of p-values on clean series


def report(tables: Tables) -> str:
    """Everything."""
    usual, other = tables[USUAL_ARM.name], tables[OTHER_ARM.name]
    clean, outside = tables[CLEAN_ARM.name], tables[OUTSIDE_ARM.name]
    hard = f.chosen(tables[HARD_ARM.name])
    everything = [row for t in (usual, other, clean, outside) for row in f.chosen(t)]
    text = [
        ABOUT,
        _summary(usual, other, clean, outside),
        "## Every cell\n",
        _cells([*f.chosen(usual), *f.chosen(other)], [*USUAL, *OTHER]),
        MISSED,
        _missed(f.chosen(usual)),
        OTHER_RULES,
        rules(f.chosen(usual), f.chosen(other, ratio=15.0), f.chosen(outside)),
        LOOK_ALIKES,
        _cells(hard, HARD),
        "## Clean series\n",
        _clean(clean),
        "## Not in the catalogue\n",
        _outside(outside),
        _bootstrap(tables[BOOTSTRAP_ARM.name]),
        "## Confusion\n\nThe first cause's kind where one was named, else the verdict.\n",
        _confusion(everything),
        _errors(tables),
        made_with(tables),
    ]
    return "\n".join(text)


def _summary(*tables: Table) -> str:
    """Of all series, and of those made since a rule of decision was changed last."""
    new = [_unseen(table, n) for table, n in zip(tables, SEEN.values(), strict=True)]
    lines = [
        [*line, again] for line, (*_, again) in zip(_figures(*tables), _figures(*new), strict=True)
    ]
    return markdown(["figure", "target", "measured", "since the last change"], lines)


def _unseen(table: Table, seen: int) -> Table:
    runs = table.numbers("run")
    return table.of_runs(runs[runs >= seen])


def _figures(usual: Table, other: Table, clean: Table, outside: Table) -> list[list[str]]:
    at_40 = f.chosen(usual)
    at_100, at_15 = f.chosen(other, ratio=100.0), f.chosen(other, ratio=15.0)
    alarmed = [row for row in at_40 if f.alarm(row)]
    exact, oracle = f.rate(at_40, f.exact), f.rate(at_40, f.oracle_right)
    no_name = f.chosen(outside)
    false = f.rate(f.chosen(clean), f.alarm)
    unknown = [
        row
        for t in (usual, other, clean, outside)
        for row in f.chosen(t)
        if row["verdict"] == "unknown"
    ]
    precision = f.rate(unknown, lambda row: str(row["hidden"]).startswith("outside"))
    again = [row for row in [*f.chosen(clean), *at_100] if row["again"]]
    sizes = [f.set_size(row) for row in alarmed if f.set_size(row)]
    return [
        ["exact name, LR 40", "at least 85 %", str(exact)],
        ["... the oracle, by likelihood alone", "", str(f.rate(at_40, f.likeliest))],
        ["... as a share of it", "at least 95 %", str(f.share_of(at_40, f.likeliest))],
        ["... the oracle that charges for further parameters", "", str(oracle)],
        ["... as a share of it", "", str(f.share_of(at_40, f.oracle_right))],
        [
            "truth in the set, LR 40, of series with an alarm",
            "at least 97 %",
            str(f.rate(alarmed, f.in_set)),
        ],
        ["... of all series", "", str(f.rate(at_40, f.in_set))],
        ["mean size of the set", "below 2", f"{np.mean(sizes):.2f}" if sizes else "-"],
        [
            "right equation, of series with an alarm",
            "at least 97 %",
            str(f.rate(alarmed, f.right_equation)),
        ],
        [
            "held-out gain, share of the true extension's",
            "at least 90 %",
            str(f.gain_share(usual)),
        ],
        ["wrong names, LR 40", "", str(f.rate(at_40, f.wrong))],
        ["exact name, LR 100", "at least 95 %", str(f.rate(at_100, f.exact))],
        ["... the oracle", "", str(f.rate(at_100, f.oracle_right))],
        ["wrong names, LR 15", "below 10 %", str(f.rate(at_15, f.wrong))],
        ["false alarms, clean", "lower end at most 5 %", str(false)],
        ["wrong names, not in the catalogue", "below 10 %", str(f.rate(no_name, f.wrong))],
        [
            "`unknown`: recall (`unknown` or `set`, not in the catalogue, of alarms)",
            "",
            str(_recall(no_name)),
        ],
        ["`unknown`: precision (not in the catalogue)", "", str(precision)],
        [
            "same verdict with another seed, clean and LR 100",
            "at least 95 %",
            str(f.rate(again, f.same_again)),
        ],
    ]


def _recall(rows: Sequence[Row]) -> f.Rate:
    alarmed = [row for row in rows if f.alarm(row)]
    return f.rate(alarmed, lambda row: row["verdict"] in ("unknown", "set"))


def _cells(rows: Sequence[Row], cells: Sequence[Cell]) -> str:
    lines = []
    for cell in cells:
        some = [
            row
            for row in rows
            if (row["base"], row["hidden"]) == (cell.base, cell.effect)
            and (float(row["rows"]), float(row["ratio"])) == (cell.rows, cell.ratio)
        ]
        if not some:
            continue
        rivals = Counter(str(row["oracle"]) for row in some if not f.oracle_right(row))
        named = Counter(str(row["causes"]) for row in some if f.wrong(row))
        sizes = [f.set_size(row) for row in some if f.set_size(row)]
        lines.append(
            [
                cell.base,
                cell.effect,
                str(cell.rows),
                f"{cell.ratio:g}",
                str(len(some)),
                f"{np.mean([float(row['ratio_truth']) for row in some]):.0f}",
                str(sum(map(f.exact, some))),
                str(sum(map(f.oracle_right, some))),
                str(sum(map(f.in_set, some))),
                f"{np.mean(sizes):.1f}" if sizes else "-",
                str(sum(row["verdict"] == "nothing" for row in some)),
                _most(named),
                _most(rivals),
            ]
        )
    head = [
        "model",
        "hidden",
        "N",
        "LR",
        "series",
        "LR here",
        "exact",
        "oracle",
        "in set",
        "set size",
    ]
    return markdown([*head, "nothing", "wrong names", "the oracle's wrong names"], lines)


def _missed(rows: Sequence[Row]) -> str:
    missed: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if not f.exact(row):
            missed.setdefault((str(row["base"]), str(row["hidden"])), []).append(row)
    lines = [
        [
            base,
            hidden,
            f"{len(some)} of {sum((r['base'], r['hidden']) == (base, hidden) for r in rows)}",
            "; ".join(f"{n} {text}" for text, n in Counter(map(f.miss, some)).most_common()),
            f"{sum(map(f.oracle_right, some))} of {len(some)}",
            f"{np.mean([float(row['ratio_truth']) for row in some]):.0f}",
        ]
        for (base, hidden), some in sorted(missed.items())
    ]
    table = markdown(["model", "hidden", "missed", "what came out", "the oracle", "LR here"], lines)
    known = [row for row in rows if f.oracle_right(row) and not f.exact(row)]
    ends = Counter(str(row["verdict"]) for row in known)
    hedged = sum(row["verdict"] == "set" and f.in_set(row) for row in known)
    quiet = [float(row["ratio_truth"]) for row in known if row["verdict"] == "nothing"]
    weak = f" (LR {min(quiet):.0f} to {max(quiet):.0f} in these series)" if quiet else ""
    return (
        f"{table}\nOf the {len(known)} that the oracle knows, {ends['nothing']} raised no alarm{weak}, "
        f"{hedged} are a set with the truth in it, {ends['unknown']} end in `unknown`, {ends['named']} have a "
        "wrong name or one too many.\n"
    )


def _most(counts: Counter[str]) -> str:
    return ", ".join(f"{n} {name}" for name, n in counts.most_common(3)) or "-"


def _clean(table: Table) -> str:
    lines = []
    for cell in dict.fromkeys(CLEAN):
        some = f.chosen(table, base=cell.base, rows=cell.rows)
        if some:
            named = Counter(f"{row['verdict']} {row['causes']}" for row in some if f.alarm(row))
            seconds = float(np.mean([float(row["seconds"]) for row in some]))
            lines.append(
                [
                    cell.base,
                    str(cell.rows),
                    str(f.rate(some, f.alarm)),
                    _most(named),
                    f"{seconds:.1f}",
                ]
            )
    return markdown(["model", "N", "false alarms", "what", "seconds"], lines) + _levels(table)


def _levels(table: Table) -> str:
    """How often the first round's p-value is small where nothing is hidden."""
    p = table.numbers("p_value")
    shares = [f"{level:g}: {f.Rate(int((p <= level).sum()), len(p))}" for level in LEVELS]
    return (
        "\nThe p-values these verdicts rest on, of the first round; the shares of series at or below "
        f"{'; '.join(shares)}.\n"
    )


def _outside(table: Table) -> str:
    lines = []
    for cell in UNLISTED:
        some = f.chosen(table, base=cell.base, hidden=cell.effect)
        if some:
            verdicts = Counter(str(row["verdict"]) for row in some)
            named = Counter(str(row["causes"]) for row in some if row["verdict"] == "named")
            lines.append(
                [
                    cell.base,
                    cell.effect.partition(":")[2],
                    str(len(some)),
                    _most(verdicts),
                    _most(named),
                ]
            )
    return markdown(["model", "hidden", "series", "verdicts", "wrong names"], lines)


BOOTSTRAP_TEXT = """\
## Family-wise p-values: multiplier draws against the parametric bootstrap

Series of 200 rows. The bootstrap simulates 19 series at the fit, so that its p-values are multiples of
5 % and an alarm needs all of them to be quieter than the data; it fits and screens each as the data were,
and so knows what a score is where the filter's likelihood is an approximation.
"""


def _bootstrap(table: Table) -> str:
    lines = []
    for cell in BOOTSTRAP:
        some = f.chosen(table, base=cell.base, hidden=cell.effect)
        if not some:
            continue
        p, q = (np.array([float(row[k]) for row in some]) for k in ("p_value", "p_bootstrap"))
        n = len(some)
        lines.append(
            [
                cell.base,
                cell.effect or "clean",
                str(f.Rate(int((p <= ALPHA).sum()), n)),
                str(f.Rate(int((q <= ALPHA).sum()), n)),
                str(f.Rate(int(((p <= ALPHA) == (q <= ALPHA)).sum()), n)),
                f"{np.median(p):.3f}, {np.median(q):.3f}",
            ]
        )
    head = [
        "model",
        "hidden",
        "p <= 5 % by multipliers",
        "by bootstrap",
        "the same answer",
        "median p",
    ]
    return f"{BOOTSTRAP_TEXT}\n{markdown(head, lines)}"


def _confusion(rows: Sequence[Row]) -> str:
    hidden, answers, counts = f.confusion(rows)
    lines = []
    for name, row in zip(hidden, counts, strict=True):
        cells = [
            f"{n} {a}" for a, n in sorted(zip(answers, row, strict=True), key=lambda x: -x[1]) if n
        ]
        lines.append([name, str(int(row.sum())), ", ".join(cells)])
    return markdown(["hidden", "series", "answers"], lines)


def _errors(tables: Tables) -> str:
    notes = [
        f"- {row['base']} {row['hidden'] or 'clean'}, N = {row['rows']}: {row['note']}"
        for name, table in tables.items()
        if name != BOOTSTRAP_ARM.name
        for row in table.rows
        if row["verdict"] == "error"
    ]
    if not notes:
        return "No series ended in an error.\n"
    return "Series that ended in an error, counted nowhere above:\n\n" + "\n".join(notes) + "\n"


def plot(tables: Tables, path: Path) -> None:
    """Exact names and the oracle's per effect; the confusion matrix; false alarms."""
    figure, panels = axes(1, 3, (17.0, 6.5))
    _names(panels[0], f.chosen(tables[USUAL_ARM.name]))
    _matrix(panels[1], f.chosen(tables[USUAL_ARM.name]))
    _alarms(panels[2], tables[CLEAN_ARM.name])
    save(figure, path)


def _names(panel: Any, rows: Sequence[Row]) -> None:
    labels, ours, theirs = [], [], []
    for base, effects in HIDDEN.items():
        for effect in effects:
            some = [r for r in rows if (r["base"], r["hidden"]) == (base, effect)]
            if some:
                labels.append(f"{base} {effect}")
                ours.append(f.rate(some, f.exact).value)
                theirs.append(f.rate(some, f.oracle_right).value)
    at = np.arange(len(labels))
    panel.barh(at - 0.2, ours, 0.4, color="#2a7f5f", label="exact name")
    panel.barh(at + 0.2, theirs, 0.4, color="#c8c8c8", label="oracle")
    panel.set_yticks(at, labels, fontsize=7)
    panel.invert_yaxis()
    panel.set_xlim(0.0, 1.0)
    panel.set_title("LR 40, N = 1000", fontsize=9)
    panel.legend(fontsize=7, frameon=False, ncol=2, loc="upper center", bbox_to_anchor=(0.5, -0.05))


def _matrix(panel: Any, rows: Sequence[Row]) -> None:
    hidden, answers, counts = f.confusion(rows)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    panel.imshow(shares, cmap="Greens", vmin=0.0, vmax=1.0, aspect="auto")
    panel.set_xticks(np.arange(len(answers)), answers, rotation=70, ha="right", fontsize=7)
    panel.set_yticks(np.arange(len(hidden)), hidden, fontsize=7)
    panel.set_title("LR 40: hidden (rows), answered (columns)", fontsize=9)


def _alarms(panel: Any, table: Table) -> None:
    cells = list(dict.fromkeys(CLEAN))
    rates = [f.rate(f.chosen(table, base=c.base, rows=c.rows), f.alarm) for c in cells]
    labels = [f"{c.base}, N = {c.rows}" for c in cells]
    for k, found in enumerate(rates):
        low, high = found.interval
        panel.plot([100 * low, 100 * high], [k, k], color="#9a9a9a")
        panel.plot([100 * found.value], [k], "o", color="#c44e52", markersize=5)
    panel.axvline(5.0, color="0.5", linestyle="--", linewidth=1)
    panel.set_yticks(np.arange(len(labels)), labels, fontsize=7)
    panel.invert_yaxis()
    panel.set_title("false alarms on clean series, %", fontsize=9)


BLIND = Study(
    "blind",
    "Blind benchmark of the diagnosis",
    {
        USUAL_ARM: 480,
        CLEAN_ARM: 312,
        OTHER_ARM: 320,
        OUTSIDE_ARM: 120,
        HARD_ARM: 50,
        BOOTSTRAP_ARM: 100,
    },
    report,
    plot,
)
