"""The report of a diagnosis that goes on: the fitted model, what its simulation gets wrong, a first screen."""

from __future__ import annotations

from engine.presentation.report.comparison import against_data, fits, sentences
from engine.presentation.report.html import join, table, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    Report,
    grid,
    plus_minus,
    pretty,
    prose,
    section,
)
from engine.words import number, probability


def early_report(d: Document, draw: Drawer) -> Report:
    """The whole report."""
    symptoms, units = d["symptoms"], d["outputs"]
    head = tag(
        "p", "What is known so far, before the search for the cause has ended.", class_="hint"
    )
    screen = d["screen"]
    return Report(
        f"Diagnosis of the model {d['model']}, so far",
        join([head, grid(against_data(symptoms["free_run"], "free_run", units, wide=True), draw)]),
        (
            *section(
                "wrong",
                "What is wrong",
                sentences(symptoms) or tag("p", "Nothing stands out."),
                fits(symptoms),
            ),
            *section("screen", "First screen of effects", *_screen(screen)),
            *section("estimate", "The model as it is", _parameters(d)),
        ),
    )


def _screen(screen: Document | None) -> list[object]:
    if screen is None:
        return []
    rows = [
        (
            tag("code", one["effect"]),
            one["title"],
            plus_minus(one["size"], one["standard_error"], one["unit"]),
            number(one["statistic"]),
            probability(one["p_value"]),
        )
        for one in screen["scores"]
    ]
    head = ("effect", "", "size in one step", "score", "p-value of it alone")
    return [tag("p", prose(screen["sentence"])), table(head, rows, "numbers") if rows else ""]


def _parameters(d: Document) -> object:
    rows = [
        (
            tag("code", name),
            f"{number(one['value'], 4)}, held"
            if one["fixed"]
            else plus_minus(one["value"], one["standard_error"]),
            pretty(one["unit"]),
        )
        for name, one in d["estimate"].items()
    ]
    likelihood = tag("p", f"Log-likelihood {number(d['log_likelihood'], 6)}.", class_="hint")
    return join([table(("parameter", "estimate", "unit"), rows, "numbers"), likelihood])
