"""Figures of what a model gets wrong: simulation and prediction against data, residuals, where errors are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.diagnose.symptoms.compare import TRANSIENT
from engine.presentation.report.chart import Band, Chart, Numbers, Picture, Ranking, Trace, column
from engine.presentation.report.html import Html, bullets, join, table_of, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    grid,
    label,
    measured,
    p_value,
    pretty,
    prose,
)
from engine.units import SECOND, frequency_in
from engine.words import fit_quality, percent

TIME, FREQUENCY = "time [s]", "frequency [Hz]"  # axes, where times are in seconds
WHAT = {"free_run": "Free-run simulation", "one_step": "One-step prediction"}


def relabelled(chart: Picture, time_unit: str | None) -> Picture:
    """The same chart with another unit on its axis of time or of frequency; None are seconds."""
    if time_unit in (None, SECOND) or isinstance(chart, Ranking):
        return chart
    frequency = label("frequency", frequency_in(time_unit))
    labels = {TIME: label("time", time_unit), FREQUENCY: frequency}
    return replace(chart, x_label=labels.get(chart.x_label, chart.x_label))


def clocked(draw: Drawer, time_unit: str | None) -> Drawer:
    """The same drawer for times in another unit."""

    def drawn(chart: Picture) -> Html:
        return draw(relabelled(chart, time_unit))

    return drawn


def around(mean: Numbers, sd: Numbers, times: float) -> Array:
    """The band (2, n) of so many standard deviations to either side of a mean."""
    half = times * column(sd)
    return np.stack([column(mean) - half, column(mean) + half])


def over_time(title: str, y_label: str, t: Numbers, *traces: Trace, **more: Any) -> Chart:
    """Curves over time; ``more`` are further members of the chart."""
    return Chart(title, TIME, y_label, t, traces, **more)


def compared(
    name: str,
    unit: str,
    t: Numbers,
    computed: tuple[str, Numbers],
    measured: Numbers | None = None,
    band: Band | None = None,
    **more: Any,
) -> Chart:
    """What was ``computed`` of a channel (as what, values) with its band, and what was measured."""
    traces = [Trace(*computed, band=band)]
    if measured is not None:
        traces.append(Trace("measured", measured, "points", "data"))
    return over_time(more.pop("title", name), label(name, unit), t, *traces, **more)


def against_data(
    comparison: Document | None, what: str, units: Document, wide: bool = False
) -> list[Chart]:
    """Measured and simulated or predicted with its band, a chart for each output."""
    c = (comparison or {}).get("curves")
    if c is None:
        return []
    said = f"{'simulated' if what == 'free_run' else 'predicted'}, 95 % band"
    charts = []
    for name, unit in units.items():
        computed, band = (said, c["y"][name]), (c["lower"][name], c["upper"][name])
        title, seen = f"{WHAT[what]} of {name} and the data", c["measured"][name]
        charts.append(compared(name, unit, c["t"], computed, seen, band, title=title, wide=wide))
    return charts


def errors_over_time(symptoms: Document, units: Document) -> list[Chart]:
    """Measured less simulated, and less predicted, over time: a chart for each output."""
    charts = []
    for name, unit in units.items():
        traces = []
        for what, role in (("free_run", "model"), ("one_step", "data")):
            if curves := (symptoms[what] or {}).get("curves"):
                e = _errors(curves, name, settled=what == "one_step")
                traces.append(Trace(WHAT[what].lower(), e, "line", role))
        if traces:
            t = symptoms["one_step"]["curves"]["t"]
            title = f"Error of {name} over time (measured less simulated)"
            y_label, wide = label(name, unit), len(units) == 1
            charts.append(over_time(title, y_label, t, *traces, level=(0.0,), wide=wide))
    return charts


def _errors(curves: Document, name: str, settled: bool) -> Array:
    """Measured less computed; where ``settled``, without predictions from next to nothing, as the first one."""
    y, readings = column(curves["y"][name]), column(curves["measured"][name])
    width = column(curves["upper"][name]) - column(curves["lower"][name])
    known = np.isfinite(width)
    most = TRANSIENT * np.median(width[known]) if settled and known.any() else math.inf
    return np.where(width > most, np.nan, readings - y)


def fits(symptoms: Document) -> Html:
    """How wrong simulation and prediction are, output by output."""

    def expected(f: Document) -> str:
        return measured(f["expected_rmse"], f["unit"]) if f["expected_rmse"] else ""

    return table_of(
        [
            {**fit, "what": name}
            for what, name in WHAT.items()
            for fit in (symptoms[what] or {"fits": ()})["fits"]
        ],
        {
            "": lambda f: f"{f['what']} of {f['output']}",
            "rms error": lambda f: measured(f["rmse"], f["unit"]),
            "expected by the model": expected,
            "fit": lambda f: fit_quality(f["fit"]).removeprefix("fit "),
            "inside the 95 % band": lambda f: "" if f["inside"] is None else percent(f["inside"]),
        },
    )


def where_it_is(symptoms: Document, units: Document, draw: Drawer) -> Html:
    """Mean errors by bands of every signal and of time, and the errors' spectrum."""
    parts = []
    for what, title in WHAT.items():
        if charts := by_bands(symptoms[what], what, units):
            note = "mean error ± 2 standard errors in bands of every signal"
            parts += [tag("h4", f"{title}: {note}"), grid(charts, draw, small=True)]
    return join(parts)


def by_bands(comparison: Document | None, what: str, units: Document) -> list[Chart]:
    """The same of simulation or of prediction, as charts."""
    said, role = ("simulated", "model") if what == "free_run" else ("predicted", "data")
    return [
        _spectrum(f"{said} {output}", units[output] if role == "model" else "", bands, role)
        if kind == "frequency"
        else _by_bands(f"{said} {output}", units[output], signal, bands, role)
        for (output, kind, signal), bands in _by_signal((comparison or {"bands": []})["bands"])
    ]


def _by_signal(
    bands: list[dict[str, Any]],
) -> Iterator[tuple[tuple[str, str, str], list[dict[str, Any]]]]:
    keys = dict.fromkeys((b["output"], b["kind"], b["signal"]) for b in bands)
    order = {"time": 0, "frequency": 1}
    for key in sorted(keys, key=lambda k: order.get(k[1], 2)):
        yield key, [b for b in bands if (b["output"], b["kind"], b["signal"]) == key]


def _by_bands(what: str, unit: str, signal: str, bands: list[dict[str, Any]], role: str) -> Chart:
    low, high, mean, error = (
        column([b[key] for b in bands]) for key in ("low", "high", "mean", "standard_error")
    )
    half, said = 0.5 * (high - low), "mean error ± 2 standard errors"
    trace = Trace(said, mean, "points", role, reach=2.0 * error, width=half)
    axes = label(signal, bands[0]["unit"]), f"error [{pretty(unit) or '1'}]"
    title, middle = f"Error of {what} by {signal}", 0.5 * (low + high)
    return Chart(title, *axes, middle, (trace,), level=(0.0,), small=True, live=False)


def _spectrum(what: str, unit: str, bands: list[dict[str, Any]], role: str) -> Chart:
    """``unit`` of the errors; without one they are in standard deviations of the prediction."""
    edges = [b["low"] for b in bands] + [bands[-1]["high"]]
    error, expected = (
        [*(b[key] for b in bands), bands[-1][key]] for key in ("rms", "expected_rms")
    )
    traces = (
        Trace("error", error, "steps", role),
        Trace("expected by the model", expected, "steps", "c4"),
    )
    title = f"Error of {what} by frequency"
    y_label = f"rms in the band [{pretty(unit)}]" if unit else "standardised rms in the band"
    return Chart(title, FREQUENCY, y_label, edges, traces, log="xy", small=True, live=False)


def residual_charts(symptoms: Document) -> list[Chart]:
    """Standardised innovations over time, by size, against the normal distribution, and by lag."""
    residuals = symptoms.get("residuals") or {"z": {}}
    charts = []
    for name, z in residuals["z"].items():
        whiteness = next((w for w in symptoms["whiteness"] if w["output"] == name), None)
        title = f"Standardised innovations of {name}"
        charts += [
            _standardised(title, residuals["t"], "innovation", z),
            _correlation(name, residuals["autocorrelation"][name], whiteness),
            _histogram(name, residuals["histogram"][name]),
            _quantiles(name, residuals["quantiles"][name]),
        ]
    return charts


def auxiliary_charts(symptoms: Document) -> list[Chart]:
    """Auxiliary residuals: which disturbance stands out, and when."""
    residuals = symptoms.get("residuals") or {}
    return [
        _standardised(
            f"Auxiliary residual of the {what} {name}", residuals["t"], "disturbance", values
        )
        for key, what in (("of_outputs", "measurement"), ("of_states", "state"))
        for name, values in residuals.get(key, {}).items()
        if any(v is not None for v in values)
    ]


def _standardised(title: str, t: Numbers, what: str, values: Numbers) -> Chart:
    points = Trace(what, values, "points", "data")
    return over_time(title, "standard deviations", t, points, level=(-1.96, 1.96))


def _correlation(name: str, found: Document, whiteness: Document | None) -> Chart:
    lags, limit = range(1, len(found["r"]) + 1), found["limit"]
    said = "" if whiteness is None else f" (Ljung-Box {p_value(whiteness)})"
    title = f"Autocorrelation of the innovations of {name}{said}"
    bars = Trace("correlation", found["r"], "bars", "data", width=np.full(len(lags), 0.35))
    axes = "lag [samples]", "correlation"
    return Chart(title, *axes, lags, (bars,), level=(-limit, limit), live=False)


def _histogram(name: str, found: Document) -> Chart:
    edges = column(found["edges"])
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    normal = np.exp(-0.5 * middle**2) / math.sqrt(2.0 * math.pi)
    traces = (
        Trace("innovations", found["density"], "bars", "data", width=half),
        Trace("normal distribution", normal, "line", "model"),
    )
    title = f"Distribution of the innovations of {name}"
    return Chart(title, "standard deviations", "density", middle, traces, live=False)


def _quantiles(name: str, found: Document) -> Chart:
    normal = found["normal"]
    traces = (
        Trace("innovations", found["sample"], "points", "data"),
        Trace("as expected", normal, "line", "model"),
    )
    title = f"Quantiles of the innovations of {name}"
    return Chart(title, "normal distribution", "innovations", normal, traces, live=False)


def sentences(symptoms: Document) -> Html:
    """What is wrong in words."""
    return bullets(map(prose, symptoms["sentences"]), "sentences")
