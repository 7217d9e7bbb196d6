"""The gain: held-out data before and after, and where the error went."""

from __future__ import annotations

from engine.presentation.report.chart import Chart, Trace
from engine.presentation.report.comparison import over_time
from engine.presentation.report.html import Html, bullets, join, table, table_of, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    adopted,
    facts,
    grid,
    label,
    measured,
    p_value,
    plus_minus,
    prose,
    signed,
    without_gain,
)
from engine.presentation.report.svg import drawn
from engine.words import ends, fit_quality, number, percent

BUDGET = {"gone": "after", "left": "before", "noise": "data"}  # and their colours


def gain_section(d: Document, units: Document, draw: Drawer) -> list[object]:
    """Numbers, then figures."""
    gain = d["gain"]
    if gain is None:
        return [without_gain(d)]
    # what was simulated before and after is at the top
    charts = _gained(gain) if has_before_and_after(gain) else held_out_charts(gain, units)
    return [
        tag("p", f"On {gain['samples']} samples ({gain['how']}) that {_unseen(gain)}."),
        facts(
            [
                ("log-density gained", signed(gain["log_density"])),
                ("per sample", plus_minus(gain["per_sample"], gain["standard_error"])),
                ("test of no gain (Diebold-Mariano)", p_value(gain)),
            ]
        ),
        table_of(
            gain["outputs"],
            {
                "": lambda o: f"free run of {o['output']}",
                "rms before": lambda o: measured(o["rmse_before"], o["unit"]),
                "rms after": lambda o: measured(o["rmse_after"], o["unit"]),
                "difference (95 %)": _difference,
                "fit": lambda o: f"{_fit(o['fit_before'])} → {_fit(o['fit_after'])}",
            },
        ),
        _budget(gain),
        adopted(gain, "in_full"),
        bullets(map(prose, gain["notes"])),
        grid(charts, draw),
    ]


def _difference(o: Document) -> str:
    low, high = o["interval_difference"]
    low, high = ends(low, high, least=3)
    return f"{number(o['difference'])} ({low} to {high})"


def _fit(fit: float | None) -> str:
    """The share in a column of its own."""
    return fit_quality(fit).removeprefix("fit ")


def _unseen(gain: Document) -> str:
    if gain["how"].endswith(("out of the fit", "in turn")):
        return "the estimation of the extension has not seen; its choice has seen most of them"
    return "neither the choice of the extension nor its estimation has seen"


def _budget(gain: Document) -> Html:
    """Where the squared error of the free run went, as one bar per output."""
    budget = [b for b in gain.get("budget") or () if b["gone"] >= 0.0]
    if not budget:
        return Html("")
    swatches = [tag("i", class_=f"swatch bars r-{role}") for role in BUDGET.values()]
    titles = [tag("span", *both) for both in zip(swatches, BUDGET, strict=True)]
    head = ("", "squared error of the free run before = 100 %", *titles)
    rows = [(b["output"], _stacked(b), *(percent(b[key]) for key in BUDGET)) for b in budget]
    return join([tag("h3", "Error budget"), table(head, rows, "budget-table")])


def _stacked(shares: Document) -> Html:
    """One bar of the shares beside each other."""
    parts, at = [], 0.0
    for key, role in BUDGET.items():
        width = max(100.0 * shares[key], 0.0)
        parts.append(
            tag("rect", x=f"{at:.2f}", y=0, width=f"{width:.2f}", height=8, class_=f"bar r-{role}")
        )
        at += width
    said = ", ".join(f"{percent(shares[key])} {key}" for key in BUDGET)
    return drawn(parts, 100, 8, said, "budget", preserveAspectRatio="none")


def before_and_after(gain: Document | None, units: Document) -> list[Chart]:
    """Measured and simulated before and after on held-out data, a chart per output; none without a gain."""
    if gain is None or not has_before_and_after(gain):
        return []
    return _simulated(gain["curves"], units)


def has_before_and_after(gain: Document | None) -> bool:
    """Whether there are both curves."""
    curves: Document = (gain or {}).get("curves") or {}
    return all(curves.get(when) is not None for when in ("before", "after"))


def held_out_charts(gain: Document, units: Document) -> list[Chart]:
    """Measured, simulated before and after; then the log-density gained so far."""
    curves = gain.get("curves")
    return [*_simulated(curves, units), *_gained(gain)] if curves else []


def _gained(gain: Document) -> list[Chart]:
    """The log-density gained so far."""
    curves = gain["curves"]
    gained = Trace("log-density gained", curves["log_density"], "line", "after")
    title, level = "Log-density gained so far", (0.0,)
    return [over_time(title, "log-density", curves["t"], gained, level=level, wide=True)]


def _simulated(curves: Document, units: Document) -> list[Chart]:
    charts = []
    for name, unit in units.items():
        traces = [
            Trace(f"simulated {when} the extension", curves[when][name], "line", when)
            for when in ("before", "after")
            if curves[when] is not None
        ]
        traces.append(Trace("measured, held out", curves["measured"][name], "points", "data"))
        title, y_label = f"Held-out data and simulation of {name}", label(name, unit)
        charts.append(over_time(title, y_label, curves["t"], *traces, wide=True))
    return charts
