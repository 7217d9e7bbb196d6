"""The gain: held-out data before and after, and where the error went."""

from __future__ import annotations

from engine.presentation.report.chart import Chart, Trace
from engine.presentation.report.comparison import TIME
from engine.presentation.report.html import Html, bullets, join, table, tag
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
)
from engine.words import fit_quality, number, percent


def gain_section(d: Document, units: Document, draw: Drawer) -> list[object]:
    """Numbers, then figures."""
    gain = d["gain"]
    if gain is None:
        return [tag("p", "Nothing was added, so nothing is gained or lost.")]
    parts: list[object] = [
        tag(
            "p",
            f"On {gain['samples']} samples ({gain['how']}) that {_unseen(gain)}.",
        ),
        facts(
            [
                ("log-density gained", signed(gain["log_density"])),
                ("per sample", plus_minus(gain["per_sample"], gain["standard_error"])),
                ("test of no gain (Diebold-Mariano)", p_value(gain["p_value"])),
            ]
        ),
    ]
    rows = []
    for o in gain["outputs"]:
        low, high = (number(v) for v in o["interval_difference"])
        rows.append(
            (
                f"free run of {o['output']}",
                measured(o["rmse_before"], o["unit"]),
                measured(o["rmse_after"], o["unit"]),
                f"{number(o['difference'])} ({low} to {high})",
                f"{_fit(o['fit_before'])} → {_fit(o['fit_after'])}",
            )
        )
    if rows:
        head = ("", "rms before", "rms after", "difference (95 %)", "fit")
        parts.append(table(head, rows, "numbers"))
    parts += [_budget(gain), adopted(gain, "in_full"), bullets(map(prose, gain["notes"]))]
    figures = (
        _gained if has_before_and_after(gain) else held_out_figures
    )  # the others are at the top
    parts.append(grid(figures(gain, units, draw)))
    return parts


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
    rows = []
    for b in budget:
        parts, at = [], 0.0
        for key, role in (("gone", "after"), ("left", "before"), ("noise", "data")):
            width = max(100.0 * b[key], 0.0)
            parts.append(
                tag(
                    "rect",
                    x=f"{at:.2f}",
                    y=0,
                    width=f"{width:.2f}",
                    height=8,
                    class_=f"bar r-{role}",
                )
            )
            at += width
        bar = tag(
            "svg", *parts, viewBox="0 0 100 8", preserveAspectRatio="none", class_="budget",
            role="img",
            aria_label=f"{percent(b['gone'])} gone, {percent(b['left'])} left, {percent(b['noise'])} noise",
        )  # fmt: skip
        rows.append((b["output"], bar, *(percent(b[key]) for key in ("gone", "left", "noise"))))
    head = (
        "",
        "squared error of the free run before = 100 %",
        tag("span", tag("i", class_="swatch bars r-after"), "gone"),
        tag("span", tag("i", class_="swatch bars r-before"), "left"),
        tag("span", tag("i", class_="swatch bars r-data"), "noise"),
    )
    return join([tag("h3", "Error budget"), table(head, rows, "budget-table")])


def before_and_after(gain: Document | None, units: Document, draw: Drawer) -> list[Html]:
    """Measured and simulated before and after on held-out data, a figure per output; none without a gain."""
    if gain is None or not has_before_and_after(gain):
        return []
    return [draw(chart) for chart in _simulated(gain["curves"], units)]


def has_before_and_after(gain: Document | None) -> bool:
    """Whether there are both curves."""
    curves: Document = (gain or {}).get("curves") or {}
    return all(curves.get(when) is not None for when in ("before", "after"))


def held_out_figures(gain: Document, units: Document, draw: Drawer) -> list[Html]:
    """Measured, simulated before and after; then the log-density gained so far."""
    curves = gain.get("curves")
    if not curves:
        return []
    return [draw(chart) for chart in _simulated(curves, units)] + _gained(gain, units, draw)


def _gained(gain: Document, units: Document, draw: Drawer) -> list[Html]:
    """The log-density gained so far."""
    curves = gain["curves"]
    gained = (Trace("log-density gained", curves["log_density"], "line", "after"),)
    title, level = "Log-density gained so far", (0.0,)
    return [draw(Chart(title, TIME, "log-density", curves["t"], gained, level=level, wide=True))]


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
        charts.append(Chart(title, TIME, y_label, curves["t"], tuple(traces), wide=True))
    return charts
