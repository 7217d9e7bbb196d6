"""Figures of results: the charts of reports, drawn by matplotlib (extra ``plot``, imported then only)."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.errors import OptionError
from engine.estimation.em import EmResult
from engine.presentation.examination import estimate_document, trace_document
from engine.presentation.report.chart import Picture, Ranking, Trace, column
from engine.presentation.report.comparison import (
    WHAT,
    around,
    auxiliary_charts,
    by_bands,
    compared,
    errors_over_time,
    over_time,
    relabelled,
    residual_charts,
)
from engine.presentation.report.comparison import against_data as against_data_charts
from engine.presentation.report.design import growth_chart, input_charts, prediction_charts
from engine.presentation.report.diagnosis_cause import force_charts, rankings
from engine.presentation.report.diagnosis_gain import held_out_charts
from engine.presentation.report.estimate import (
    convergence_charts,
    simulated_charts,
    smoothed_charts,
)
from engine.presentation.report.parts import Document
from engine.presentation.report.style import LIGHT
from engine.presentation.report.svg import y_axis
from engine.units import SECOND

FORMATS = ("svg", "png")
# Points from which a curve becomes pixels within an SVG, so that it opens at once.
MANY_POINTS = 5000
TWO_SIDED = 1.96  # standard deviations of a 95 % band
QUIET_COLOUR = "#888888"
COLOURS = dict(re.findall(r"--chart-(\w+): (#\w+)", LIGHT))  # by role, as in reports


class Figures(dict[str, Any]):
    """Matplotlib figures by name."""

    def save(self, folder: str | Path, formats: Sequence[str] = FORMATS) -> list[Path]:
        """Write ``<name>.svg`` and ``<name>.png`` (or what ``formats`` lists) into a folder."""
        for one in formats:
            if one not in FORMATS:
                raise OptionError(f"format '{one}' is not one of {', '.join(FORMATS)}", "formats")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        written = []
        for name, figure in self.items():
            for one in formats:
                written.append(folder / f"{name}.{one}")
                figure.savefig(written[-1], dpi=150)
        return written

    def _repr_html_(self) -> str:
        return "".join(
            f'<img alt="{escape(name)}" src="data:image/png;base64,{_png(figure)}">'
            for name, figure in self.items()
        )


def axes(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, list[Any]]:
    """An empty figure of ``size`` inches with its panels. Raises OptionError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError("figures need matplotlib: pip install 'rbps[plot]'", "figures") from error
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


Group = tuple[str, Sequence[Picture], int]  # name, charts and columns of a figure


def of_document(document: Document) -> Figures:
    """The figures of a diagnosis, an estimation or a simulation, from its JSON document.

    Diagnosis: ``wrong``, ``where``, ``residuals``, ``candidates``; ``force`` and ``gain`` where there are
    such. Estimation: ``convergence``, and ``states`` and ``free-run`` of each series. Simulation:
    ``outputs`` and ``states``. Design: ``input``, ``predictions`` and ``probability``.
    """
    groups: Iterable[Group] = ()
    if diagnosis := document.get("diagnosis"):
        groups = _of_diagnosis(diagnosis)
    elif design := document.get("design"):
        groups = (
            ("input", input_charts(design), 1),
            ("predictions", prediction_charts(design), 1),
            ("probability", [growth_chart(design)], 1),
        )
    elif document.get("examination"):
        groups = _of_estimate(document)
    elif simulation := document.get("simulation"):
        groups = (
            one
            for name, key in (("outputs", "y"), ("states", "states"))
            for one in _of_each(name, simulation, simulated_charts, simulation["units"], key)
        )
    clock = (document.get("diagnosis") or document).get("time_unit")
    return Figures(
        {name: figure(charts, columns, clock) for name, charts, columns in groups if charts}
    )


def _of_diagnosis(d: Document) -> Iterator[Group]:
    units, symptoms = d["channels"]["outputs"], d["symptoms"]
    run = against_data_charts(symptoms["free_run"], "free_run", units)
    yield "wrong", [*run, *errors_over_time(symptoms, units)], 1
    yield "where", [one for what in WHAT for one in by_bands(symptoms[what], what, units)], 3
    yield "residuals", [*residual_charts(symptoms), *auxiliary_charts(symptoms)], 2
    yield "candidates", rankings(d["rounds"]), 1
    yield "force", force_charts(d["unnamed"] or {}), 1
    yield "gain", held_out_charts(d["gain"] or {}, units), 1


def _of_estimate(document: Document) -> Iterator[Group]:
    yield "convergence", convergence_charts(document), 2
    states, units = document["states"], document["model"]["outputs"]
    yield from _of_each("states", states, smoothed_charts, states["units"])
    runs = {"series": [one.get("free_run") for one in document["examination"]["series"]]}
    yield from _of_each("free-run", runs, against_data_charts, "free_run", units)


def _of_each(name: str, group: Document, make: Any, *given: Any) -> Iterator[Group]:
    """A figure for each series, numbered where there are several."""
    several = len(group["series"]) > 1
    for i, one in enumerate(group["series"]):
        yield f"{name}-{i + 1}" if several else name, make(one, *given), 1


def figure(charts: Sequence[Picture], columns: int = 1, clock: str | None = None) -> Any:
    """One figure with a panel for each chart, side by side in ``columns``; times are in ``clock``."""
    columns = min(columns, len(charts))
    rows = -(-len(charts) // columns)
    each = max(2.4, *(0.28 * len(c.rows) + 0.8 for c in charts if isinstance(c, Ranking)), 0.0)
    made, panels = axes(rows, columns, (9.0 if columns < 3 else 3.6 * columns, each * rows))
    for panel, chart in zip(panels, charts, strict=False):
        _draw(panel, relabelled(chart, clock))
    for panel in panels[len(charts) :]:
        panel.set_visible(False)
    return made


def _draw(panel: Any, chart: Picture) -> None:
    panel.set_title(chart.title, fontsize=9)
    panel.set_xlabel(chart.x_label, fontsize=8)
    if isinstance(chart, Ranking):
        names, values, roles = zip(*chart.rows, strict=True)
        panel.barh(range(len(names)), values, color=[COLOURS[role] for role in roles])
        panel.set_yticks(range(len(names)), names, fontsize=7)
        panel.invert_yaxis()
        if chart.line is not None:
            panel.axvline(chart.line, color=QUIET_COLOUR)
        return
    panel.set_ylabel(chart.y_label, fontsize=8)
    panel.set(**{f"{axis}scale": "log" for axis in chart.log})
    x, heavy = column(chart.x), len(chart.x) > MANY_POINTS
    for level in chart.level:
        panel.axhline(level, color=QUIET_COLOUR, linewidth=0.6)
    for t in chart.traces:
        y, style = column(t.y), {"color": COLOURS[t.role], "label": t.label}
        if t.band is not None:
            low, high = column(t.band)
            panel.fill_between(
                x, low, high, color=style["color"], alpha=0.18, linewidth=0.0, rasterized=heavy
            )
        if t.kind == "bars":
            panel.bar(x, y, 2.0 * column(() if t.width is None else t.width), **style)
        elif t.reach is not None:
            panel.errorbar(x, y, column(t.reach), t.width, ".", **style)
        elif t.kind == "points":
            panel.plot(x, y, ".", markersize=2.5, rasterized=heavy, **style)
        else:
            line, held = "--" if t.dash else "-", "steps-post" if t.kind == "steps" else "default"
            panel.plot(x, y, line, drawstyle=held, linewidth=1.0, rasterized=heavy, **style)
    if not chart.log:
        panel.ticklabel_format(useOffset=False)
    panel.tick_params(labelsize=7)
    seen = y_axis(chart, 0.0, 1.0)
    panel.set_ylim(seen.low, seen.high)
    if chart.has_legend:
        panel.legend(loc="best", fontsize=7)


def convergence(found: EmResult, intervals: Array | None = None) -> Any:
    """Each free parameter by iteration, the log-likelihood and the effective sample size.

    ``intervals`` (n_theta, 2) are drawn as bands, NaN is none.
    """
    estimate = estimate_document(found.model, found.theta, found.free, None)
    if intervals is not None:
        for one, ends in zip(estimate.values(), intervals, strict=True):
            one["interval"] = ends.tolist() if np.isfinite(ends).all() else None
    trace = trace_document(found.model.parameter_names, vars(found))
    return figure(convergence_charts({"estimate": estimate, "trace": trace}), 2)


def states(
    t: Array, units: Mapping[str, str], mean: Array, sd: Array | None = None, clock: str = SECOND
) -> Any:
    """Curves (T, n), named with their units, and 95 % bands from ``sd`` (T, n); t in ``clock``."""
    charts = []
    for i, (name, unit) in enumerate(units.items()):
        band = None if sd is None else around(mean[:, i], sd[:, i], TWO_SIDED)
        drawn = "mean, 95 % band", mean[:, i]
        charts.append(compared(name, unit, t, drawn, band=band))
    return figure(charts, clock=clock)


def against_data(
    t: Array,
    units: Mapping[str, str],
    measured: Array,
    computed: Array,
    computed_as: str,
    lower: Array | None = None,
    upper: Array | None = None,
    clock: str = SECOND,
) -> Any:
    """Measured outputs (T, n) with computed ones above, their differences below."""
    charts = []
    for i, (name, unit) in enumerate(units.items()):
        band = None if lower is None or upper is None else (lower[:, i], upper[:, i])
        both = (computed_as, computed[:, i]), measured[:, i]
        charts.append(compared(name, unit, t, *both, band))
        wrong = Trace("error", measured[:, i] - computed[:, i], "points", "data")
        said = f"measured - {computed_as}"
        charts.append(over_time(f"Error of {name}", said, t, wrong, level=(0.0,)))
    return figure(charts, clock=clock)


def _png(figure: Any) -> str:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return base64.b64encode(out.getvalue()).decode("ascii")
