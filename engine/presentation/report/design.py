"""The report of a designed experiment: what it says, the input, the predictions, the probability by length."""

from __future__ import annotations

from engine.presentation.report.chart import Chart, Trace
from engine.presentation.report.comparison import TIME
from engine.presentation.report.html import Html, join, table, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    Report,
    facts,
    grid,
    label,
    measured,
    prose,
    section,
)
from engine.units import SECOND
from engine.words import percent

COLOURS = 6  # roles c1 ... c6


def design_report(d: Document, draw: Drawer) -> Report:
    """The parts of a report."""
    summary = join(tag("p", prose(sentence)) for sentence in d["sentences"])
    rows = [(c["effect"], c["title"], percent(c["probability"])) for c in d["causes"]]
    told = table(("cause", "", "right name, if it is the true one"), rows, "numbers")
    short = d["shortest"]
    about = facts(
        [
            ("samples", d["experiment"]["samples"]),
            ("every", measured(d["dt"], d.get("time_unit", SECOND))),
            ("kind of input", d["experiment"]["family"]),
            ("shortest that reaches " + percent(d["level"]), short["samples"] if short else "none"),
            ("inputs tried", d["tried"]),
        ]
    )
    return Report(
        f"Experiment for {d['model']}",
        summary,
        (
            *section("causes", "What it tells apart", told, about),
            *section("input", "The input", grid(input_figures(d, draw))),
            *section("predictions", "What each cause predicts", grid(prediction_figures(d, draw))),
            *section("length", "By length", grid(length_figures(d, draw))),
        ),
    )


def input_figures(d: Document, draw: Drawer) -> list[Html]:
    """Each input of the length asked, and of the shortest experiment."""
    out = []
    units = d["channels"]["inputs"]
    for kind, said in (("experiment", ""), ("shortest", ", shortest")):
        one = d[kind]
        if one is None or (kind == "shortest" and one["samples"] == d["experiment"]["samples"]):
            continue
        for name, unit in units.items():
            trace = (Trace(name, one["u"][name], "steps", "model"),)
            title = f"Input {name}{said}"
            out.append(draw(Chart(title, TIME, label(name, unit), one["t"], trace, wide=True)))
    return out


def prediction_figures(d: Document, draw: Drawer) -> list[Html]:
    """Outputs as each cause predicts them, at the parameters as estimated."""
    out, t = [], d["predictions"]["t"]
    for name, unit in d["channels"]["outputs"].items():
        traces = tuple(
            Trace(cause, values, "line", f"c{1 + k % COLOURS}")
            for k, (cause, values) in enumerate(d["predictions"][name].items())
        )
        out.append(draw(Chart(f"Predicted {name}", TIME, label(name, unit), t, traces, wide=True)))
    return out


def length_figures(d: Document, draw: Drawer) -> list[Html]:
    """The probability of the right name over the length of the record."""
    samples = d["growth"]["samples"]
    traces = tuple(
        Trace(f"{c['effect']} is true", d["growth"][c["effect"]], "line", f"c{1 + k % COLOURS}")
        for k, c in enumerate(d["causes"])
    )
    chart = Chart(
        "Probability of the right name",
        "samples of this input",
        "probability",
        samples,
        traces,
        level=(d["level"],),
        sync="samples",
    )
    return [draw(chart)]
