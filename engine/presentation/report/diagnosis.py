"""The report of a diagnosis: the verdict at a glance, then the four questions, then what was testable."""

from __future__ import annotations

from engine.presentation.cause_sentences import SMALLEST, in_time, took, value_of
from engine.presentation.report.chart import Chart
from engine.presentation.report.comparison import (
    against_data,
    auxiliary_charts,
    errors_over_time,
    fits,
    residual_charts,
    sentences,
    where_it_is,
)
from engine.presentation.report.diagnosis_cause import cause_section
from engine.presentation.report.diagnosis_gain import (
    before_and_after,
    gain_section,
    has_before_and_after,
)
from engine.presentation.report.diagnosis_summary import answers, verdict
from engine.presentation.report.html import Html, bullets, join, table, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    Report,
    equations,
    folded,
    grid,
    measured,
    plus_minus,
    pretty,
    prose,
    section,
)
from engine.presentation.report.priority import asked_first
from engine.words import number, percent


def diagnosis_report(d: Document, draw: Drawer) -> Report:
    """The whole report."""
    units, seconds = d["channels"]["outputs"], tag("p", took(d["seconds"]), class_="hint")
    return Report(
        f"Diagnosis of the model {d['model']}",
        join([verdict(d), answers(d), grid(_hero(d, units), draw)]),
        (
            *section("wrong", "1. What is wrong", *_wrong(d, units, draw)),
            *section("cause", "2. The cause", *cause_section(d, draw)),
            *section("extension", "3. The extension", *_extension(d)),
            *section("gain", "4. The gain", *gain_section(d, units, draw)),
            *section("testable", "What these data could have shown", *_testable(d)),
            *section("notes", "Notes", bullets(map(prose, d["notes"])), seconds),
        ),
    )


def _wrong(d: Document, units: Document, draw: Drawer) -> list[object]:
    symptoms = d["symptoms"]
    no_verdict = "No verdict rests on these, because fitted process noise hides much of an error."
    return [
        sentences(symptoms) or tag("p", "Nothing stands out."),
        fits(symptoms),
        grid(_simulation(d, units), draw),
        grid(errors_over_time(symptoms, units), draw),
        tag("h3", "Where the error is"),
        where_it_is(symptoms, units, draw),
        tag("h3", "One-step predictions and their residuals"),
        tag("p", no_verdict, class_="hint"),
        grid(against_data(symptoms["one_step"], "one_step", units), draw),
        grid(residual_charts(symptoms), draw),
        folded("Auxiliary residuals", grid(auxiliary_charts(symptoms), draw)),
    ]


def _simulation(d: Document, units: Document) -> list[Chart]:
    """The simulation and all the data, where the top shows something else."""
    if not has_before_and_after(d["gain"]):
        return []
    return against_data(d["symptoms"]["free_run"], "free_run", units, wide=True)


def _hero(d: Document, units: Document) -> list[Chart]:
    """Measured, before and after on held-out data; where nothing was found, the simulation and the data."""
    symptoms = d["symptoms"]
    return (
        before_and_after(d["gain"], units)
        or against_data(symptoms["free_run"], "free_run", units, wide=True)
        or against_data(symptoms["one_step"], "one_step", units, wide=True)
    )


def _extension(d: Document) -> list[object]:
    extension = d["extension"]
    before = extension["equations_before"]
    if not d["causes"]:
        return [tag("p", "None: the model stays as it is."), equations(before), _parameters(d)]
    parts: list[object] = []
    if d["gain"] is not None and not d["gain"]["adopt"]:
        said = "Not adopted: the model stays as it is. With what was found it would be:"
        parts.append(tag("p", said))
    elif d["gain"] is None:
        parts.append(tag("p", "Not judged on other data. With what was found the model would be:"))
    parts += [tag("h3", "Before"), equations(before)] if before else []
    return [
        *parts,
        tag("h3", "After: the same, and" if before else "Added"),
        equations([], extension["equations"][len(before) :]),
        _parameters(d),
        tag("p", extension.get("in_the_library", ""), class_="hint"),
    ]


def _parameters(d: Document) -> Html:
    """Every parameter with its standard error: before, and after where something was added."""
    extension, before = d["extension"], d["base_theta"]
    bounds = extension.get("at_bounds", {"before": (), "after": ()})
    rows: list[list[object]] = []
    for name, value in extension["theta"].items():
        known = name in before
        row: list[object] = [tag("code", name, class_=None if known else "added")]
        error = d["base_standard_errors"].get(name)
        row.append(_estimate(before[name], error, name in bounds["before"]) if known else "")
        if d["causes"]:
            error = extension["standard_errors"].get(name)
            unit = extension["units"][name], d["time_unit"], d.get("step")
            row.append(_estimate(value, error, name in bounds["after"], *unit))
        rows.append([*row, pretty(extension["units"][name])])
    titles = ["before", "after"] if d["causes"] else ["estimate"]
    return table(["parameter", *titles, "unit"], rows, "numbers")


def _estimate(
    value: float,
    error: float | None,
    at_bound: bool,
    unit: str = "",
    clock: str = "",
    step: float | None = None,
) -> str:
    if at_bound:
        return f"{number(value, 4)}, at its bound"
    if error is None:
        return prose(value_of(value, unit, error, clock, step))
    return plus_minus(value, error)


def _testable(d: Document) -> list[object]:
    rows = {}
    for x in d["detectable"]:
        if x["testable"]:
            size = measured(x["smallest"], x["unit"])
            size += prose(in_time(x["smallest"], x["unit"], d.get("step"), d["time_unit"]))
            rows[x["effect"]] = tag("code", x["effect"]), x["title"], size, percent(x["rho"])
    if not rows:
        return []
    head = ("effect", "", "smallest size found with 80 %", "share left by the parameters")
    first = asked_first(list(rows))
    rest = [row for name, row in rows.items() if name not in first]
    return [
        tag("p", f"{SMALLEST}.", class_="hint"),
        table(head, [rows[name] for name in first]),
        folded(f"{len(rest)} more effects", table(head, rest) if rest else Html("")),
    ]
