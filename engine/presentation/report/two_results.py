"""Two results side by side, as a report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from engine.presentation.report.chart import Chart, Trace
from engine.presentation.report.comparison import clocked, over_time
from engine.presentation.report.html import Html, bullets, join, table, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    Report,
    grid,
    label,
    measured,
    plus_minus,
    pretty,
    section,
)
from engine.presentation.two_results import likelihood_difference
from engine.words import number

SAID = {
    "simulation": "Simulation of {}",
    "held-out": "Simulation of {} on held-out data",
    "state": "Smoothed state {}",
}


def comparison_report(c: Document, names: Sequence[str], draw: Drawer) -> Report:
    """The report of what :func:`engine.presentation.two_results.compare_results` gives.

    ``names`` are what the two results are called.
    """
    draw = clocked(draw, c["time_unit"])
    charts = [
        _overlaid(one, names, c["same_held_out" if one["what"] == "held-out" else "same_data"])
        for one in c["curves"]
    ]
    return Report(
        f"{names[0]} and {names[1]}",
        join([_numbers(c, names), bullets(comparison_notes(c, names), "hint")]),
        (
            *section("parameters", "Parameters", _parameters(c, names)),
            *section("curves", "Curves", grid(charts, draw)),
        ),
    )


def _numbers(c: Document, names: Sequence[str]) -> Html:
    """Model, outcome, log-likelihood and held-out errors, a column for each result."""
    rows: list[Sequence[object]] = [
        ("model", *(tag("code", name) for name in c["models"]), ""),
        ("outcome", *((name or "").replace("-", " ") for name in c["outcome"]), ""),
        ("free parameters", *("" if n is None else n for n in c["free_parameters"]), ""),
        ("log-likelihood", *map(_likelihood, c["log_likelihood"]), _likelihood_difference(c)),
    ]
    held = [{o["output"]: o for o in (one or {}).get("outputs", ())} for one in c["held_out"]]
    for output in dict.fromkeys([*held[0], *held[1]]):
        pair = [each.get(output) for each in held]
        difference = _difference([o and o["rmse"] for o in pair], c["same_held_out"])
        sizes = ["" if o is None else _error(o) for o in pair]
        unit = next(o["unit"] for o in pair if o)
        said = "" if difference is None else measured(difference, unit)
        rows.append((f"held-out error of {output}, rms", *sizes, said))
    densities = [(one or {}).get("log_density") for one in c["held_out"]]
    difference = _difference(densities, c["same_held_out"])
    gained = "" if difference is None else number(difference, 4)
    logs = ["" if one is None else number(one, 6) for one in densities]
    rows.append(("held-out log-density", *logs, gained))
    shown = [row for row in rows if any(cell != "" for cell in row[1:])]
    return table(("", *names, "difference"), shown, "numbers")


def _error(o: Document) -> str:
    return "diverges" if o["rmse"] is None else measured(o["rmse"], o["unit"])


def _likelihood(one: Document | None) -> str:
    return "" if one is None else plus_minus(one["value"], one.get("standard_error"))


def _likelihood_difference(c: Document) -> str:
    found = likelihood_difference(c)
    return "" if found is None else plus_minus(*found)


def _difference(pair: Sequence[Any], same: bool | None) -> float | None:
    """Second less first, where both are known and of the same data."""
    return None if not same or None in pair else float(pair[1] - pair[0])


def comparison_notes(c: Document, names: Sequence[str]) -> list[str]:
    """What may be compared, and what not."""
    out = []
    if all(c["log_likelihood"]) and not c["same_data"]:
        why = (
            "are of different data"
            if c["same_data"] is False
            else "may be of different data, which these results do not show"
        )
        out.append(f"The log-likelihoods {why}: their difference has no meaning.")
    if all(c["held_out"]) and c["same_held_out"] is False:
        out.append("The held-out errors are of different rows: their difference has no meaning.")
    missing = [name for name, held in zip(names, c["held_out"], strict=True) if not held]
    if missing:
        out.append(
            f"No held-out error of {' and '.join(missing)}: give held-out data with an estimation (test in "
            "a request, --test in the shell)."
        )
    if any(row["in_errors"] is not None for row in c["parameters"]) and c["same_data"]:
        out.append(
            "Both estimates come from the same data, so their errors are not independent: a difference of less "
            "than one standard error may still be systematic."
        )
    fitted = [name for name, how in zip(names, c["methods"], strict=True) if how == "simulation"]
    if fitted and any(row["in_errors"] is not None for row in c["parameters"]):
        out.append(
            f"The standard errors of {' and '.join(fitted)} are of a fit of the simulation, which knows less "
            "of the parameters than maximum likelihood does where process noise moves the states."
        )
    return out


def _value(value: float, error: float | None, held: bool, silent: bool) -> str:
    if silent:
        return f"{number(value, 4)}, no influence"
    return "held at " * held + plus_minus(value, error)


def _parameters(c: Document, names: Sequence[str]) -> Html:
    rows = []
    for row in c["parameters"]:
        cells = [
            "" if value is None else _value(value, error, held, silent)
            for value, error, held, silent in zip(
                row["values"], row["standard_errors"], row["held"], row["silent"], strict=True
            )
        ]
        difference = "" if row["difference"] is None else number(row["difference"], 3)
        errors = "" if row["in_errors"] is None else number(row["in_errors"], 2)
        rows.append((tag("code", row["name"]), *cells, difference, errors, pretty(row["unit"])))
    head = ("parameter", *names, "difference", "in standard errors (the larger)", "unit")
    return table(head, rows, "numbers") if rows else Html("")


def _overlaid(one: Document, names: Sequence[str], same: bool | None) -> Chart:
    traces = [
        Trace(name, values, "line", role)
        for name, values, role in zip(names, one["values"], ("before", "after"), strict=True)
        if values
    ]
    seen = [(f"measured, {n}", m) for n, m in zip(names, one["measured"], strict=True) if m]
    if same and seen:
        seen = [("measured", seen[0][1])]
    roles = ("data", "c4")
    traces += [Trace(said, m, "points", role) for (said, m), role in zip(seen, roles, strict=False)]
    title = SAID[one["what"]].format(one["name"])
    if one["series"]:
        title += f", series {one['series'] + 1}"
    return over_time(title, label(one["name"], one["unit"]), one["t"], *traces, wide=True)
