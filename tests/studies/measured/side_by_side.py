"""The table of what each criterion, both and PySINDy bring: a line for each record."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from tests.studies.measured.alone import FREE_RUN, LIKELIHOOD
from tests.studies.measured.by_sindy import SETTINGS
from tests.studies.measured.records import RECORDS, Record
from tests.studies.report import markdown
from tests.studies.study import Row, Tables

HEAD = (
    *("record", "unit", "base", "likelihood alone", "error", "free run alone", "error"),
    *("both", "error"),
    *(cell for label in SETTINGS for cell in (f"PySINDy, {label}", "error")),
)
BEFORE = "made before"  # a row from before a column was there
NOT_RUN = "not run"
LOST = "lost"
ABOUT = """\
## Each criterion alone, both, and PySINDy

*Alone*: what each criterion says in the same diagnosis, and how its own last fit runs free. The likelihood
answers before the free run is asked; the free run has a search of its own, which in its first round weighs the
likelihood's answer too. Where the diagnosis asked it only of what the likelihood had found, it is asked here of
the base model.

*PySINDy*: a regression of the equation of each state that inputs or other states move. The states are those of
the smoother of the estimated base model; terms and the two settings are those of [sindy.md](sindy.md). What it
finds, and the constant that each such equation has, are effects of the catalogue, fitted to the free run on the
rows that its search looks at.

Errors are those of the table above, one for each held-out part, of the model that each ends with. Where nothing
is found that is the base, as it is fitted there. "lost" is a run that is not finite. The criterion that did not
decide was not held against held-out data before.
"""


def side_by_side(tables: Tables) -> str:
    """The table, and below it why PySINDy has nothing to say of some records."""
    lines, reasons = [], []
    for record in RECORDS.values():
        row, other = (_row(tables, name) for name in (f"measured.{record.name}", arm_of(record)))
        if row is None:
            continue
        lines.append([record.name, record.unit, *line(record, row, other)])
        if other is not None and other["reason"]:
            reasons.append(f"PySINDy cannot be applied to {record.name}: {other['reason']}.")
    return "\n".join([ABOUT, markdown(HEAD, lines), *(f"- {reason}" for reason in reasons), ""])


def arm_of(record: Record) -> str:
    """Name of the arm that asks PySINDy."""
    return f"measured.{record.name}.sindy"


def line(record: Record, row: Row, other: Row | None) -> list[str]:
    """Cells after the record and its unit; ``other`` is what PySINDy says of it."""
    scale = record.scale
    found = _read(row, "errors") or {}
    own = _read(row, "causes") or []
    causes = [[c["effect"], *c["others"]] for c in own] if isinstance(own, list) else []
    both = [
        str(row["verdict"]) + _named(causes),
        _errors((x[bool(causes)] for x in found.values()), scale),
    ]
    out = [_errors((x[0] for x in found.values()), scale)]
    alone = _read(row, "alone")
    for criterion in (LIKELIHOOD, FREE_RUN):
        out += [BEFORE, "-"] if alone is None else _alone(alone[criterion], scale)
    out += both
    for label in SETTINGS:
        out += _sparse(other, label, scale)
    return out


def _alone(said: dict[str, Any] | None, scale: float) -> list[str]:
    if said is None:
        return ["no free run can be had", "-"]
    p = "" if said["names"] or said["p"] is None else f" (p = {said['p']:.2g})"
    text = said["verdict"] + p + _named(said["names"])
    return [text, _errors((after for _, after in said["errors"].values()), scale)]


def _sparse(row: Row | None, label: str, scale: float) -> list[str]:
    if row is None:
        return [NOT_RUN, "-"]
    said = _read(row, label)
    if said is None:
        return ["-", "-"]
    names = "; ".join(said["names"]) or "nothing"
    left_out = (
        f" (no effect of the catalogue: {'; '.join(said['left_out'])})" if said["left_out"] else ""
    )
    return [names + left_out, _errors(said["errors"].values(), scale)]


def _named(causes: list[list[str]]) -> str:
    """The names after a verdict."""
    return "".join((": ", "; ".join(" or ".join(names) for names in causes))) if causes else ""


def _errors(values: Iterable[float | None], scale: float) -> str:
    """One for each held-out part."""
    return " / ".join(LOST if x is None else f"{scale * x:.3g}" for x in values) or "-"


def _row(tables: Tables, name: str) -> Row | None:
    table = tables.get(name)
    return table.rows[0] if table is not None and table.rows else None


def _read(row: Row, column: str) -> Any:
    text = str(row.get(column, ""))
    return json.loads(text) if text else None
