"""The page of the study, its pictures, and the study itself."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from engine.words import estimate
from tests.studies.measured import by_sindy
from tests.studies.measured.known import KNOWN
from tests.studies.measured.looked_at import LOOKED_AT
from tests.studies.measured.records import RECORDS, Record
from tests.studies.measured.runs import work
from tests.studies.measured.side_by_side import arm_of, side_by_side
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.study import Arm, Row, Study, Tables

HEAD = ("record", "part used", "verdict", "decided by", "names", "sizes")
HEAD_ERRORS = ("record", "held out", "unit", "base", "extended", "reference", "gain, 95 %", "s")
COLOURS = {"before": "#c44e52", "after": "#2a7f5f"}
INTRODUCTION = """\
Each record with the simple model that an engineer would start from, diagnosed without a word about what is
missing. Errors are those of the free run on held-out data, its first state estimated on the first 50 rows,
which are not scored; "base" is the model as given and "extended" the one with what was found, with the
parameters of the criterion that decided. "Reference" are the same two errors in the README.md of the data,
for the documented effects fitted by hand. Seconds were taken while other work used the same cores.
"One round one step ahead" is max_effects=1: on records nearly free of noise the likelihood's search goes on
with patches, and the free run is asked all the same.
"""


def report(tables: Tables) -> str:
    """All tables, then each record: what is known, what came out, why, the page."""
    answers, errors, pages = [], [], []
    for record in RECORDS.values():
        table = tables.get(f"measured.{record.name}")
        if table is None or not table.rows:
            pages.append(f"## {record.name}\n\nSkipped: {reason(record)}.\n")
            continue
        row = table.rows[0]
        answers.append([record.name, record.cut, *answer(row)])
        errors.extend(error_rows(record, row))
        pages.append(page(record, row))
    return "\n".join(
        [
            INTRODUCTION,
            markdown(HEAD, answers),
            markdown(HEAD_ERRORS, errors),
            side_by_side(tables),
            *pages,
            made_with({name: table for name, table in tables.items() if table.rows}),
        ]
    )


def reason(record: Record) -> str:
    """Why a record is not in the table."""
    return "it was not run" if record.there else record.reason


def answer(row: Row) -> list[str]:
    """Cells: verdict, criterion, names, sizes."""
    causes = _read(row, "causes") or []
    if isinstance(causes, str):
        return ["error", "-", causes, "-"]
    names = [" or ".join([c["effect"], *c["others"]]) for c in causes]
    sizes = [f"{c['effect']} {estimate(c['size'], c['error'], c['unit'])}" for c in causes]
    return [
        str(row["verdict"]),
        str(row["decided"]),
        "; ".join(names) or "-",
        "; ".join(sizes) or "-",
    ]


def error_rows(record: Record, row: Row) -> list[list[str]]:
    """A line for each held-out part."""
    found, gained = _read(row, "errors") or {}, _read(row, "gain")
    out = []
    for k, (part, (base, extended)) in enumerate(found.items()):
        known = KNOWN[record.name].reference.get(part)
        told = "-" if known is None else f"{known[0]:.4g} -> {known[1]:.4g}"
        cells = [
            record.name,
            part,
            record.unit,
            *(_number(x, record.scale) for x in (base, extended)),
        ]
        if k == 0:
            out.append([*cells, told, _gain(gained, record.scale), f"{float(row['seconds']):.0f}"])
        else:
            out.append([*cells, told, "", ""])
    return out


def _number(value: float | None, scale: float) -> str:
    return "-" if value is None else f"{scale * value:.3g}"


def _gain(gained: dict[str, Any] | None, scale: float) -> str:
    """The change of the error, over all rows of the part."""
    if gained is None:
        return "-"
    values = [scale * x for x in (gained["difference"], *gained["interval"])]
    return f"{values[0]:.3g} ({values[1]:.3g} to {values[2]:.3g})"


def page(record: Record, row: Row) -> str:
    """One record."""
    known = KNOWN[record.name]
    text = str(_read(row, "page") or "").rstrip()
    looked = LOOKED_AT.get(record.name, "")
    parts = [
        f"## {record.name}",
        f"Model: {known.start}",
        f"Known to be missing: {known.missing}",
        f"Published: {known.published}",
        looked,
        f"![held-out data](measured-{record.name}.png)" if _read(row, "curves") else "",
        judged(row),
        f"```\n{text}\n```" if text else "",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def judged(row: Row) -> str:
    """Why which criterion decided, and what was compared on rows left out."""
    seen = _read(row, "rounds")
    if not seen:
        return ""
    out = [seen["reason"]]
    head = (
        "refitted",
        "error on rows left out",
        "p of a gain",
        "p of being the best",
        "parameters",
    )
    for k, one in enumerate(seen["rounds"]):
        alarm = one["alarm"]
        out.append(
            f"Round {k + 1} of the free run: p = {alarm['p']:.2g}; error on rows left out, weighed, "
            f"{one['held_out']:.3g} without an effect."
        )
        rows = [
            [names, f"{held_out:.3g}", f"{p_gain:.2g}", f"{p_best:.2g}", str(n)]
            for names, held_out, _, p_gain, p_best, n in one["candidates"]
        ]
        if rows:
            out.append(markdown(head, rows).rstrip())
        groups = ["; ".join(group) for group in one["survivors"]]
        out.append(
            "Survivors, those that run alike together: " + (" | ".join(groups) or "none") + "."
        )
    return "\n\n".join(out)


def _read(row: Row, column: str) -> Any:
    text = str(row.get(column, ""))
    return json.loads(text) if text else None


def plot(tables: Tables, path: Path) -> None:
    """A picture for each record, and one of all of them at ``path``."""
    drawn = {}
    for name in RECORDS:
        table = tables.get(f"measured.{name}")
        curves = _read(table.rows[0], "curves") if table is not None and table.rows else None
        if curves:
            drawn[name] = curves
    for name, curves in drawn.items():
        figure, panels = axes(2, 1, (9.0, 5.0))
        _draw(panels, name, curves)
        save(figure, path.with_name(f"{path.stem}-{name}.png"))
    if drawn:
        figure, panels = axes(len(drawn), 1, (10.0, 2.4 * len(drawn)))
        for panel, (name, curves) in zip(panels, drawn.items(), strict=True):
            _runs(panel, name, curves)
        save(figure, path)


def _draw(panels: list[Any], name: str, curves: dict[str, Any]) -> None:
    """Above the runs, below what they get wrong."""
    _runs(panels[0], name, curves)
    scale, unit = RECORDS[name].scale, RECORDS[name].unit
    t, y = (np.array(curves[key], dtype=float) for key in ("t", "measured"))
    for key, colour in COLOURS.items():
        if key in curves:
            wrong = scale * (y - np.array(curves[key], dtype=float))
            panels[1].plot(t, wrong, color=colour, linewidth=0.9, label=key)
    panels[1].axhline(0.0, color="#222222", linewidth=0.5)
    panels[1].set_ylabel(f"measured - simulated, {unit}", fontsize=8)


def _runs(panel: Any, name: str, curves: dict[str, Any]) -> None:
    scale, unit = RECORDS[name].scale, RECORDS[name].unit
    t = np.array(curves["t"], dtype=float)
    values = {key: scale * np.array(x, dtype=float) for key, x in curves.items() if key != "t"}
    panel.plot(t, values["measured"], ".", color="#222222", markersize=2.5, label="measured")
    for key, colour in COLOURS.items():
        if key in values:
            panel.plot(t, values[key], color=colour, linewidth=0.9, label=key)
    panel.set_title(f"{name}: held-out data, free run before and after", fontsize=9)
    panel.set_ylabel(unit, fontsize=8)
    panel.legend(fontsize=7)


def _settings(record: Record) -> dict[str, str]:
    return {"data": record.folder or record.name, "cut": record.cut}


def _arms(record: Record) -> tuple[Arm, Arm]:
    """The diagnosis of a record, and PySINDy's answer."""
    settings = _settings(record)
    sparse = settings | {label: str(one) for label, one in by_sindy.SETTINGS.items()}
    return (
        Arm(f"measured.{record.name}", partial(work, record.name), settings),
        Arm(arm_of(record), partial(by_sindy.work, record.name), sparse),
    )


MEASURED = Study(
    "measured",
    "Diagnosis of models on measured records",
    {arm: 1 for record in RECORDS.values() if record.there for arm in _arms(record)},
    report,
    plot,
)
