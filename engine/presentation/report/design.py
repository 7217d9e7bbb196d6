"""The report of a designed experiment: what it says, the input, the predictions, the probability by length."""

from __future__ import annotations

from collections.abc import Mapping

from engine.presentation.report.chart import Chart, Numbers, Trace
from engine.presentation.report.comparison import over_time
from engine.presentation.report.html import join, table, tag
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
            *section("input", "The input", grid(input_charts(d), draw)),
            *section("predictions", "What each cause predicts", grid(prediction_charts(d), draw)),
            *section("length", "By length", grid([growth_chart(d)], draw)),
        ),
    )


def input_charts(d: Document) -> list[Chart]:
    """Each input of the length asked, and of the shortest experiment."""
    asked, shortest = d["experiment"], d["shortest"]
    kinds = [("", asked)]
    if shortest is not None and shortest["samples"] != asked["samples"]:
        kinds.append((", shortest", shortest))
    charts = []
    for said, one in kinds:
        for name, unit in d["channels"]["inputs"].items():
            trace, title = Trace(name, one["u"][name], "steps"), f"Input {name}{said}"
            charts.append(over_time(title, label(name, unit), one["t"], trace, wide=True))
    return charts


def prediction_charts(d: Document) -> list[Chart]:
    """Outputs as each cause predicts them, at the parameters as estimated."""
    charts, predicted = [], d["predictions"]
    for name, unit in d["channels"]["outputs"].items():
        title, traces = f"Predicted {name}", _by_cause(predicted[name])
        charts.append(over_time(title, label(name, unit), predicted["t"], *traces, wide=True))
    return charts


def growth_chart(d: Document) -> Chart:
    """The probability of the right name over the length of the record."""
    growth = {f"{c['effect']} is true": d["growth"][c["effect"]] for c in d["causes"]}
    title, axes = "Probability of the right name", ("samples of this input", "probability")
    traces, level = _by_cause(growth), (d["level"],)
    return Chart(title, *axes, d["growth"]["samples"], traces, level=level, sync="samples")


def _by_cause(curves: Mapping[str, Numbers]) -> tuple[Trace, ...]:
    """A curve for each cause, each in a colour of its own."""
    return tuple(
        Trace(said, values, "line", f"c{1 + k % COLOURS}")
        for k, (said, values) in enumerate(curves.items())
    )
