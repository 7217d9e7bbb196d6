"""The report of a diagnosis that goes on: the fitted model, what its simulation gets wrong, a first screen."""

from __future__ import annotations

from collections.abc import Sequence

from engine.presentation.report.comparison import against_data, fits, sentences
from engine.presentation.report.html import bullets, join, table, table_of, tag
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


def early_report(d: Document, draw: Drawer, read: Sequence[str] = ()) -> Report:
    """The whole report; ``read`` are sentences on how the data were."""
    symptoms, said = (
        d["symptoms"],
        "What is known so far, before the search for the cause has ended.",
    )
    simulated = against_data(symptoms["free_run"], "free_run", d["outputs"], wide=True)
    wrong = sentences(symptoms) or tag("p", "Nothing stands out.")
    return Report(
        f"Diagnosis of the model {d['model']}, so far",
        join([tag("p", said, class_="hint"), grid(simulated, draw)]),
        (
            *section("wrong", "What is wrong", wrong, fits(symptoms)),
            *section("screen", "First screen of effects", *_screen(d["screen"])),
            *section("estimate", "The model as it is", _parameters(d)),
            *section("notes", "Notes", bullets(map(prose, read))),
        ),
    )


def _screen(screen: Document | None) -> list[object]:
    if screen is None:
        return []
    shown = table_of(
        screen["scores"],
        {
            "effect": lambda s: tag("code", s["effect"]),
            "": lambda s: s["title"],
            "size in one step": lambda s: plus_minus(s["size"], s["standard_error"], s["unit"]),
            "score": lambda s: number(s["statistic"]),
            "p-value of it alone": lambda s: probability(s["p_value"]),
        },
    )
    return [tag("p", prose(screen["sentence"])), shown]


def _parameters(d: Document) -> object:
    rows = []
    for name, one in d["estimate"].items():
        estimate = plus_minus(one["value"], one["standard_error"])
        if one["fixed"]:
            estimate = f"{number(one['value'], 4)}, held"
        rows.append((tag("code", name), estimate, pretty(one["unit"])))
    likelihood = tag("p", f"Log-likelihood {number(d['log_likelihood'], 6)}.", class_="hint")
    return join([table(("parameter", "estimate", "unit"), rows, "numbers"), likelihood])
