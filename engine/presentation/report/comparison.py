"""Figures of what a model gets wrong: simulation and prediction against data, residuals, where errors are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Any, TypeVar

from engine.diagnose.symptoms.compare import TRANSIENT
from engine.presentation.report.chart import Chart, Numbers, Ranking, Trace
from engine.presentation.report.html import Html, bullets, join, table, tag
from engine.presentation.report.parts import Document, Drawer, grid, label, measured, pretty, prose
from engine.units import SECOND, frequency_in
from engine.words import fit_quality, percent, probability

TIME, FREQUENCY = "time [s]", "frequency [Hz]"  # axes, where times are in seconds
WHAT = {"free_run": "Free-run simulation", "one_step": "One-step prediction"}


AnyChart = TypeVar("AnyChart", Chart, Ranking, Chart | Ranking)


def relabelled(chart: AnyChart, time_unit: str | None) -> AnyChart:
    """The same chart with another unit on its axis of time or of frequency; None are seconds."""
    if time_unit in (None, SECOND) or isinstance(chart, Ranking):
        return chart
    frequency = label("frequency", frequency_in(time_unit))
    labels = {TIME: label("time", time_unit), FREQUENCY: frequency}
    return replace(chart, x_label=labels.get(chart.x_label, chart.x_label))


def clocked(draw: Drawer, time_unit: str | None) -> Drawer:
    """The same drawer for times in another unit."""

    def drawn(chart: Chart | Ranking) -> Html:
        return draw(relabelled(chart, time_unit))

    return drawn


def compared(
    title: str,
    y_label: str,
    t: Numbers,
    computed: tuple[str, Numbers],
    measured: Numbers | None = None,
    band: tuple[Numbers, Numbers] | None = None,
    wide: bool = False,
) -> Chart:
    """What was ``computed`` (its name, values) over time with its band, and what was measured."""
    traces = [Trace(*computed, band=band)]
    if measured is not None:
        traces.append(Trace("measured", measured, "points", "data"))
    return Chart(title, TIME, y_label, t, tuple(traces), wide=wide)


def against_data(
    comparison: Document | None, what: str, units: Document, draw: Drawer, wide: bool = False
) -> list[Html]:
    """Measured and simulated or predicted with its band, a figure per output."""
    if comparison is None or "curves" not in comparison:
        return []
    c = comparison["curves"]
    said = f"{'simulated' if what == 'free_run' else 'predicted'}, 95 % band"
    return [
        draw(
            compared(
                f"{WHAT[what]} of {name} and the data",
                label(name, unit),
                c["t"],
                (said, c["y"][name]),
                c["measured"][name],
                (c["lower"][name], c["upper"][name]),
                wide,
            )
        )
        for name, unit in units.items()
    ]


def errors_over_time(symptoms: Document, units: Document, draw: Drawer) -> list[Html]:
    """Measured less simulated, and less predicted, over time: a figure per output."""
    figures = []
    for name, unit in units.items():
        traces = []
        for what, role in (("free_run", "model"), ("one_step", "data")):
            comparison = symptoms[what]
            if comparison is None or "curves" not in comparison:
                continue
            e = _errors(comparison["curves"], name, settled=what == "one_step")
            traces.append(Trace(WHAT[what].lower(), e, "line", role))
        if traces:
            t = symptoms["one_step"]["curves"]["t"]
            title = f"Error of {name} over time (measured less simulated)"
            y_label, wide = label(name, unit), len(units) == 1
            errors = Chart(title, TIME, y_label, t, tuple(traces), level=(0.0,), wide=wide)
            figures.append(draw(errors))
    return figures


def _errors(curves: Document, name: str, settled: bool) -> list[float | None]:
    """Measured less computed; where ``settled``, without predictions from next to nothing, as the first one."""
    y, readings = curves["y"][name], curves["measured"][name]
    lower, upper = curves["lower"][name], curves["upper"][name]
    widths = [b - a for a, b in zip(lower, upper, strict=True) if a is not None and b is not None]
    most = TRANSIENT * median(widths) if settled and widths else math.inf
    return [
        None
        if m is None or p is None or (a is not None and b is not None and b - a > most)
        else m - p
        for m, p, a, b in zip(readings, y, lower, upper, strict=True)
    ]


def fits(symptoms: Document) -> Html:
    """How wrong simulation and prediction are, output by output."""
    rows = []
    for what, name in WHAT.items():
        comparison = symptoms[what]
        for f in comparison["fits"] if comparison else ():
            rows.append(
                (
                    f"{name} of {f['output']}",
                    measured(f["rmse"], f["unit"]),
                    measured(f["expected_rmse"], f["unit"]) if f["expected_rmse"] else "",
                    fit_quality(f["fit"]).removeprefix("fit "),
                    percent(f["inside"]) if f["inside"] is not None else "",
                )
            )
    head = ("", "rms error", "expected by the model", "fit", "inside the 95 % band")
    return table(head, rows, "numbers") if rows else Html("")


def where_it_is(symptoms: Document, units: Document, draw: Drawer) -> Html:
    """Mean errors by bands of every signal and of time, and the errors' spectrum."""
    parts = []
    for what, title in WHAT.items():
        comparison = symptoms[what]
        if comparison is None:
            continue
        said, role = ("simulated", "model") if what == "free_run" else ("predicted", "data")
        figures = [
            draw(
                _spectrum(f"{said} {output}", units[output] if role == "model" else "", bands, role)
                if kind == "frequency"
                else _by_bands(f"{said} {output}", units[output], signal, bands, role)
            )
            for (output, kind, signal), bands in _by_signal(comparison["bands"])
        ]
        if figures:
            note = "mean error ± 2 standard errors in bands of every signal"
            parts += [tag("h4", f"{title}: {note}"), grid(figures, small=True)]
    return join(parts)


def _by_signal(
    bands: list[dict[str, Any]],
) -> Iterator[tuple[tuple[str, str, str], list[dict[str, Any]]]]:
    keys = dict.fromkeys((b["output"], b["kind"], b["signal"]) for b in bands)
    order = {"time": 0, "frequency": 1}
    for key in sorted(keys, key=lambda k: order.get(k[1], 2)):
        yield key, [b for b in bands if (b["output"], b["kind"], b["signal"]) == key]


def _by_bands(what: str, unit: str, signal: str, bands: list[dict[str, Any]], role: str) -> Chart:
    middle = [0.5 * (b["low"] + b["high"]) for b in bands]
    return Chart(
        f"Error of {what} by {signal}",
        label(signal, bands[0]["unit"]),
        f"error [{pretty(unit) or '1'}]",
        middle,
        (
            Trace(
                "mean error ± 2 standard errors",
                [b["mean"] for b in bands],
                "points",
                role,
                reach=[2.0 * b["standard_error"] for b in bands],
                width=[0.5 * (b["high"] - b["low"]) for b in bands],
            ),
        ),
        level=(0.0,),
        small=True,
        live=False,
    )


def _spectrum(what: str, unit: str, bands: list[dict[str, Any]], role: str) -> Chart:
    """``unit`` of the errors; without one they are in standard deviations of the prediction."""
    edges = [b["low"] for b in bands] + [bands[-1]["high"]]
    error = [b["rms"] for b in bands]
    expected = [b["expected_rms"] for b in bands]
    return Chart(
        f"Error of {what} by frequency",
        FREQUENCY,
        f"rms in the band [{pretty(unit)}]" if unit else "standardised rms in the band",
        edges,
        (
            Trace("error", [*error, error[-1]], "steps", role),
            Trace("expected by the model", [*expected, expected[-1]], "steps", "c4"),
        ),
        log="xy",
        small=True,
        live=False,
    )


def residual_figures(symptoms: Document, draw: Drawer) -> Html:
    """Standardised innovations over time, by size, against the normal distribution, and by lag."""
    residuals = symptoms.get("residuals")
    if not residuals:
        return Html("")
    figures = []
    for name, z in residuals["z"].items():
        whiteness = next((w for w in symptoms["whiteness"] if w["output"] == name), None)
        title = f"Standardised innovations of {name}"
        figures += [
            draw(_standardised(title, residuals["t"], "innovation", z)),
            draw(_correlation(name, residuals["autocorrelation"][name], whiteness)),
            draw(_histogram(name, residuals["histogram"][name])),
            draw(_quantiles(name, residuals["quantiles"][name])),
        ]
    return grid(figures)


def auxiliary_figures(symptoms: Document, draw: Drawer) -> Html:
    """Auxiliary residuals: which disturbance stands out, and when."""
    residuals = symptoms.get("residuals") or {}
    figures = []
    for key, what in (("of_outputs", "measurement"), ("of_states", "state")):
        for name, values in residuals.get(key, {}).items():
            if any(v is not None for v in values):
                title = f"Auxiliary residual of the {what} {name}"
                figures.append(draw(_standardised(title, residuals["t"], "disturbance", values)))
    return grid(figures)


def _standardised(title: str, t: Numbers, what: str, values: Numbers) -> Chart:
    points = Trace(what, values, "points", "data")
    return Chart(title, TIME, "standard deviations", t, (points,), level=(-1.96, 1.96))


def _correlation(name: str, found: Document, whiteness: Document | None) -> Chart:
    lags = list(range(1, len(found["r"]) + 1))
    said = "" if whiteness is None else f" (Ljung-Box {probability(_p(whiteness))})"
    return Chart(
        f"Autocorrelation of the innovations of {name}{said}",
        "lag [samples]",
        "correlation",
        lags,
        (Trace("correlation", found["r"], "bars", "data", width=[0.35] * len(lags)),),
        level=(-found["limit"], found["limit"]),
        live=False,
    )


def _p(whiteness: Document) -> float:
    p = whiteness["p_value"]
    return float("nan") if p is None else float(p)


def _histogram(name: str, found: Document) -> Chart:
    edges, density = found["edges"], found["density"]
    middle = [0.5 * (a + b) for a, b in pairwise(edges)]
    half = 0.5 * (edges[1] - edges[0]) if len(edges) > 1 else 0.5
    normal = [math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) for x in middle]
    return Chart(
        f"Distribution of the innovations of {name}",
        "standard deviations",
        "density",
        middle,
        (
            Trace("innovations", density, "bars", "data", width=[half] * len(middle)),
            Trace("normal distribution", normal, "line", "model"),
        ),
        live=False,
    )


def _quantiles(name: str, found: Document) -> Chart:
    normal = found["normal"]
    return Chart(
        f"Quantiles of the innovations of {name}",
        "normal distribution",
        "innovations",
        normal,
        (
            Trace("innovations", found["sample"], "points", "data"),
            Trace("as expected", normal, "line", "model"),
        ),
        live=False,
    )


def sentences(symptoms: Document) -> Html:
    """What is wrong in words."""
    return bullets(map(prose, symptoms["sentences"]), "sentences")
