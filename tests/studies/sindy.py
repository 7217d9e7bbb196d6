"""Sparse regression by PySINDy against a diagnosis: the same hidden effects, side by side.

The series are those of the blind benchmark on ``structure``, and so are the diagnosis's answers. PySINDy
(:mod:`tests.studies.sparse`) looks for terms of the v1 equation in states that the Kalman smoother of
the estimated base model gives. Its settings were chosen on series of their own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from engine.data.series import Series
from engine.filters.kalman import kalman_smoother
from engine.statespace.model import Array
from tests.studies.blind.bases import BASES
from tests.studies.blind.cells import CLEAN, HARD, OTHER, USUAL, USUAL_ROWS, Cell
from tests.studies.blind.figures import Rate, rate
from tests.studies.blind.hidden import draw
from tests.studies.blind.report import BLIND
from tests.studies.blind.runs import CLEAN_ARM, HARD_ARM, OTHER_ARM, STREAMS, USUAL_ARM
from tests.studies.blind.sizes import fit_base, size
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.sparse import RULES, SETTINGS, WAYS, Equation, Setting, Way, equation, path
from tests.studies.study import Arm, Row, Study, Table, Tables

BASE, STATE = BASES["structure"], "v1"
EFFECTS = ("cubic:x1->v1", "coulomb:v1", "drag:v1")
STRONG = 100.0
CELLS = (
    *(Cell(BASE.name, effect) for effect in EFFECTS),
    Cell(BASE.name, "coulomb:v1", ratio=STRONG),
    Cell(BASE.name, "", ratio=0.0),
)
SOURCES = (
    (USUAL_ARM, STREAMS["usual"], USUAL),
    (OTHER_ARM, STREAMS["other"], OTHER),
    (CLEAN_ARM, STREAMS["clean"], CLEAN),
    (HARD_ARM, STREAMS["look-alikes"], HARD),
)
DEVELOPMENT_STREAM, DEVELOPMENT_RUNS = 61, 60
ALARMS = 0.1  # share of clean series in which the careful setting may find something

# the best of SETTINGS on the series for development
MOST_RIGHT = Setting(Way("step", "kept", 0.05), "bic", 4.0)
CAREFUL = Setting(Way("step", "kept", 0.05), "bic", 8.0)


@dataclass(frozen=True)
class Judged:
    """A series of the blind benchmark: run ``run`` of an arm, with its stream of random numbers."""

    cell: Cell
    arm: str
    stream: int
    run: int


def judged_series() -> list[Judged]:
    """All of them, the cells in turn."""
    found = []
    for place, cell in enumerate(CELLS):
        arm, stream, cells = next(source for source in SOURCES if cell in source[2])
        first = cells.index(cell)
        runs = range(first, BLIND.arms[arm], len(cells))
        found += [(k, place, Judged(cell, arm.name, stream, run)) for k, run in enumerate(runs)]
    return [one for _, _, one in sorted(found, key=lambda x: x[:2])]


def series_of(cell: Cell, *stream: int) -> Series:
    """Training part of the series with this stream of random numbers."""
    return draw(cell, size(cell), np.random.default_rng(stream)).train


def smoothed(cell: Cell, series: Series) -> Array:
    """States (T, 4) by the smoother of the base model, estimated from its true parameters."""
    return kalman_smoother(BASE.model, fit_base(cell, series).theta, series).x


def equation_of(series: Series, x: Array, way: Way) -> Equation:
    """The equation that is searched."""
    return equation(
        x, series.u, BASE.dt, (*BASE.model.nonlinear, *BASE.model.linear), STATE, way.target
    )


def truth(cell: Cell) -> frozenset[str]:
    """The terms to be found."""
    return frozenset([cell.effect] if cell.effect else [])


def develop(seed: int, run: int) -> Row:
    """One series for development: which settings are right."""
    cell = CELLS[run % len(CELLS)]
    series = series_of(cell, seed, DEVELOPMENT_STREAM, run)
    x = smoothed(cell, series)
    paths = {way: path(equation_of(series, x, way), way) for way in WAYS}
    right = [paths[setting.way].answer(setting) == truth(cell) for setting in SETTINGS]
    return {
        "hidden": cell.effect,
        "ratio": cell.ratio,
        "right": " ".join(str(int(is_right)) for is_right in right),
    }


def judge(seed: int, run: int) -> Row:
    """One series of the blind benchmark: what both settings answer, and what any threshold would."""
    one = judged_series()[run]
    series = series_of(one.cell, seed, one.stream, one.run)
    began = time.process_time()
    x = smoothed(one.cell, series)
    states = time.process_time() - began
    paths = {s.way: path(equation_of(series, x, s.way), s.way) for s in (MOST_RIGHT, CAREFUL)}
    seconds = time.process_time() - began
    answers = {p.terms(i) for p in paths.values() for i in range(len(p.kept))}
    return {
        "hidden": one.cell.effect,
        "ratio": one.cell.ratio,
        "arm": one.arm,
        "of": one.run,
        "most_right": _text(paths[MOST_RIGHT.way].answer(MOST_RIGHT)),
        "careful": _text(paths[CAREFUL.way].answer(CAREFUL)),
        "reachable": int(truth(one.cell) in answers),
        "seconds_states": states,
        "seconds": seconds,
    }


def _text(terms: frozenset[str]) -> str:
    return " ".join(sorted(terms))


DEVELOP = Arm(
    "sindy.development", develop, {"base": BASE.name, "N": USUAL_ROWS, "settings": len(SETTINGS)}
)
JUDGE = Arm(
    "sindy.judged",
    judge,
    {
        "base": BASE.name,
        "N": USUAL_ROWS,
        "most right": str(MOST_RIGHT),
        "careful": str(CAREFUL),
        "streams": " ".join(str(stream) for _, stream, _ in SOURCES),
    },
)

ABOUT = f"""\
Effects are hidden in simulated series of `{BASE.name}` (N = {USUAL_ROWS}) at a likelihood ratio LR of the \
true extension; the series are those of the blind benchmark. *Diagnosis*: the benchmark's rows, the naming \
part of `engine.diagnose` with its whole catalogue. *PySINDy*: STLSQ on the states that the Kalman smoother \
of the estimated base model gives, for the equation of {STATE}: its linear terms, and square, cube, x|x| \
and sign of each of the four states; it knows the equation and that nothing else can be hidden. Two of \
{len(SETTINGS)} settings ({len(WAYS)} ways to set up the regression, {len(RULES)} rules for the threshold) \
are judged, chosen on other series by their mean share of right answers over the cells: the best one, and \
the best with an answer in at most {100 * ALARMS:.0f} % of the clean series.

*Right*: exactly what was hidden, nothing on clean data. *Nothing*: no term, verdict `nothing`. *Wrong*: \
another term, or a further one; named, but not the truth alone. *No name*: verdicts `set` and `unknown`. \
Intervals are Wilson's, 95 %.
"""
METHODS = ("diagnosis", "PySINDy, most right", "PySINDy, careful")
Answer = tuple[str, str]  # hidden, answered; "?" for an alarm without one name


def answers(tables: Tables, method: str, cell: Cell) -> list[Answer]:
    """What a method answered on the series of a cell."""
    rows = [
        row
        for row in tables[JUDGE.name].rows
        if row["hidden"] == cell.effect and float(row["ratio"]) == cell.ratio
    ]
    if method != METHODS[0]:
        column = "most_right" if method == METHODS[1] else "careful"
        return [(cell.effect, str(row[column])) for row in rows]
    found = []
    for row in rows:
        for other in tables[str(row["arm"])].rows:
            if int(other["run"]) == int(row["of"]) and other["hidden"] == cell.effect:
                found.append((cell.effect, _answer_of(other)))
    return found


def _answer_of(row: Row) -> str:
    if row["verdict"] == "named":
        return str(row["causes"])
    return "" if row["verdict"] == "nothing" else "?"


def is_right(answer: Answer) -> bool:
    """Exactly what was hidden."""
    return answer[0] == answer[1]


def is_nothing(answer: Answer) -> bool:
    """Nothing found where something is hidden."""
    return bool(answer[0]) and not answer[1]


def is_wrong(answer: Answer) -> bool:
    """Something else, or something more."""
    return answer[1] not in ("", "?", answer[0])


def report(tables: Tables) -> str:
    """Both methods cell by cell, the settings, the time."""
    lines = []
    for cell in CELLS:
        for method in METHODS:
            some = answers(tables, method, cell)
            counts: Iterable[Callable[[Answer], bool]] = (is_nothing, is_wrong, _no_name)
            lines.append(
                [
                    cell.effect or "clean",
                    f"{cell.ratio:g}" if cell.effect else "",
                    method,
                    str(rate_of(some)),
                    *(str(sum(map(count, some))) if some else "-" for count in counts),
                ]
            )
    head = ["hidden", "LR", "method", "right", "nothing", "wrong", "no name"]
    judged = tables[JUDGE.name]
    reachable = rate(judged.rows, lambda row: float(row["reachable"]) == 1.0)
    parts = [
        ABOUT,
        markdown(head, lines),
        f"At some threshold of the grid, picked by who knows the truth, PySINDy is right in {reachable}.\n",
        _seconds(tables),
        "## Settings of PySINDy\n",
        _development(tables[DEVELOP.name]),
        made_with(tables),
    ]
    return "\n".join(parts)


def rate_of(some: Iterable[Answer]) -> Rate:
    """Share of right answers."""
    right = [is_right(answer) for answer in some]
    return Rate(sum(right), len(right))


def _no_name(answer: Answer) -> bool:
    return answer[1] == "?"


def _seconds(tables: Tables) -> str:
    rows = tables[JUDGE.name]
    if not len(rows):
        return ""
    pairs = {(str(row["arm"]), int(row["of"])) for row in rows.rows}
    diagnosis = [
        float(row["seconds"])
        for arm, _, _ in SOURCES
        for row in tables[arm.name].rows
        if (arm.name, int(row["run"])) in pairs and np.isfinite(float(row["seconds"]))
    ]
    text = (
        f"A series takes PySINDy {rows.numbers('seconds').mean():.1f} s of processor time at all "
        f"thresholds, {rows.numbers('seconds_states').mean():.1f} s of it for the estimate and the states"
    )
    if diagnosis:
        text += f"; the diagnosis {np.mean(diagnosis):.1f} s by the clock, both with one thread"
    return text + ".\n"


def development(table: Table) -> Array:
    """Share of right answers (cells, settings) on the series for development."""
    right = table.curves("right")
    ratio, hidden = table.numbers("ratio"), np.array(table.texts("hidden"))
    masks = [(hidden == cell.effect) & (ratio == cell.ratio) for cell in CELLS]
    return np.array(
        [right[m].mean(axis=0) if m.any() else np.full(len(SETTINGS), np.nan) for m in masks]
    )


def best(shares: Array) -> tuple[Setting, Setting]:
    """The setting that is right most often, and the one among those with few false alarms."""
    mean = shares.mean(axis=0)
    careful = np.where(shares[-1] >= 1.0 - ALARMS, mean, -1.0)
    return SETTINGS[int(mean.argmax())], SETTINGS[int(careful.argmax())]


def _development(table: Table) -> str:
    if len(table) < len(CELLS):
        return "No series for development yet.\n"
    shares = development(table)
    wanted = {"most right": MOST_RIGHT, "careful": CAREFUL}
    for label, setting in zip(("best here", "best careful one here"), best(shares), strict=True):
        if setting not in wanted.values():
            wanted[label] = setting
    lines = []
    for label, setting in wanted.items():
        column = shares[:, SETTINGS.index(setting)]
        lines.append([label, str(setting), *(f"{100 * x:.0f} %" for x in [*column, column.mean()])])
    names = [f"{cell.effect} LR {cell.ratio:g}" if cell.effect else "clean" for cell in CELLS]
    text = f"Right answers on {len(table)} series for development:\n\n"
    return text + markdown(["", "setting", *names, "mean"], lines)


def plot(tables: Tables, path: Path) -> None:
    """Shares of right answers with their intervals."""
    figure, (panel,) = axes(1, 1, (9.0, 4.0))
    places = np.arange(len(CELLS))
    for k, method in enumerate(METHODS):
        rates = [rate_of(answers(tables, method, cell)) for cell in CELLS]
        values = np.array([r.value for r in rates])
        low, high = np.array([r.interval for r in rates]).T
        panel.bar(places + 0.27 * (k - 1), 100 * values, 0.25, label=method)
        errors = np.maximum(100 * np.array([values - low, high - values]), 0.0)
        panel.errorbar(
            places + 0.27 * (k - 1), 100 * values, errors, fmt="none", ecolor="0.3", capsize=2
        )
    labels = [f"{c.effect}\nLR {c.ratio:g}" if c.effect else "clean" for c in CELLS]
    panel.set_xticks(places, labels)
    panel.set_ylabel("right answers [%]")
    panel.legend()
    save(figure, path)


SINDY = Study(
    "sindy",
    "Naming a hidden effect: PySINDy and the diagnosis side by side",
    {
        DEVELOP: DEVELOPMENT_RUNS,
        JUDGE: len(judged_series()),
        **{arm: BLIND.arms[arm] for arm, _, _ in SOURCES},
    },
    report,
    plot,
)
