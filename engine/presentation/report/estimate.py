"""The report of an estimation, a smoothing or a simulation."""

from __future__ import annotations

import re
from itertools import chain
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.presentation.report.chart import Chart, Numbers, Trace, column
from engine.presentation.report.comparison import (
    against_data,
    around,
    compared,
    fits,
    residual_charts,
    sentences,
    where_it_is,
)
from engine.presentation.report.html import Html, bullets, join, table, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    Report,
    Section,
    equations,
    facts,
    grid,
    label,
    measured,
    pretty,
    section,
)
from engine.words import digits, digits_of_ends, ends, errors_in_words, fit_quality, number

NORMAL = 1.959964  # standard errors to either side of a 95 % interval
FEW_STARTS = 7  # starts beside the one taken whose curves are drawn each


def estimate_report(document: Document, draw: Drawer) -> Report:
    """Estimates, how they converged, smoothed states, simulation against the data, residuals, attempts."""
    model = document.get("model") or {}
    name = model.get("name", "")
    title = f"Estimate of the model {name}" if name else "Estimate"
    numbers = tag("h2", "Estimates"), _warned(document), estimates(document)
    about = tag("p", model["description"]) if model.get("description") else ""
    return Report(
        title,
        join([_outcome(document), _facts(document), *numbers]),
        (
            *section("convergence", "Convergence", grid(convergence_charts(document), draw)),
            *_states(document, draw),
            *_simulated(document, draw),
            *_held_out(document, draw),
            *_examined(document, model, draw),
            *section("attempts", "Attempts", _starts(document), _bootstrap(document, draw)),
            *section("model", "The model", about, equations(model.get("equations", ()))),
        ),
    )


def states_report(document: Document, draw: Drawer) -> Report:
    """Smoothed states at given parameters."""
    found = document.get("log_likelihood") or {}
    items = [("log-likelihood", _uncertain(found))] if found else []
    summary = join([*_said(document), facts(items)])
    return Report("Smoothed states", summary, tuple(_states(document, draw)))


def simulation_report(document: Document, draw: Drawer) -> Report:
    """Simulated outputs and states, outputs beside what was measured."""
    values = document.get("parameters") or {}
    shown = facts((k, number(v, 6)) for k, v in values.items())
    summary = join([*_said(document), shown])
    return Report("Simulation", summary, tuple(_simulated(document, draw)))


def _said(document: Document) -> list[Html]:
    """The message of a result that has no outcome, and how the data were read."""
    message = document.get("message")
    return [tag("p", message, class_="said") if message else Html(""), _warned(document)]


def _simulated(document: Document, draw: Drawer) -> list[Section]:
    simulation = document.get("simulation") or {"series": ()}
    parts: list[Section] = []
    for i, series in enumerate(simulation["series"]):
        errors = series.get("rmse_by_output")
        wrong = errors_in_words(errors, simulation["units"]) if errors else ""
        said = tag("p", f"Wrong by {wrong} rms against the data.") if wrong else ""
        charts = [simulated_charts(series, simulation["units"], k) for k in ("y", "states")]
        shown = grid(chain(*charts), draw)
        parts += _numbered("series", "Simulation", i, simulation, said, shown)
    return parts


def simulated_charts(series: Document, units: Document, group: str) -> list[Chart]:
    """The outputs ("y") of a series beside what was measured, or its "states"."""
    measured = (series.get("measured") or {}) if group == "y" else {}
    t = series["t"]
    return [
        compared(name, units.get(name, ""), t, ("simulated", values), measured.get(name))
        for name, values in series[group].items()
    ]


# ---- summary ----------------------------------------------------------------------------------


def _outcome(document: Document) -> Html:
    outcome = (document.get("outcome") or "").replace("-", " ")
    tone = "good" if outcome == "converged" else "warn"
    message = document.get("message") or ""
    if outcome and (said := re.match(rf"{re.escape(outcome)}[:.]\s*", message, re.IGNORECASE)):
        message = message[said.end() :]  # the badge says it already
        message = message[:1].upper() + message[1:]
    word = tag("span", outcome or "done", class_=f"verdict {tone}")
    return tag("p", word, " ", message, class_="said")


def _warned(document: Document) -> Html:
    """That the errors beside the estimates are none of an estimate, and how the data were read."""
    warnings = [document.get("warning"), *(document.get("notes") or ())]
    return join(tag("p", tag("strong", one), class_="said") for one in warnings if one)


def _facts(document: Document) -> Html:
    trace = document.get("trace") or {}
    items: list[tuple[str, object]] = []
    if document.get("log_likelihood"):
        items.append(("log-likelihood", _uncertain(document["log_likelihood"])))
    if trace.get("iteration"):
        items.append(("iterations", trace["iteration"][-1]))
        spent = [s for s in trace["seconds"] if s is not None]
        if spent:
            items.append(("time per iteration", f"{number(1000.0 * sum(spent) / len(spent))} ms"))
    states = (document.get("states") or {}).get("series") or []
    if states:
        items.append(("samples", sum(len(one["t"]) for one in states)))
    return facts(items)


def _uncertain(value: Document) -> str:
    error = value.get("standard_error")
    return number(value.get("value"), 6) + (f" ± {number(error, 2)}" if error else "")


def estimates(document: Document) -> Html:
    """The table of parameters with standard errors and 95 % intervals."""
    rows = []
    start = {k: v[0] for k, v in (document.get("trace") or {}).get("theta", {}).items() if v}
    for name, found in document["estimate"].items():
        interval = " to ".join(ends(*found["interval"])) if found.get("interval") else ""
        began = number(start[name], 4) if name in start else ""
        value = number(found["value"], digits(found["value"], found["standard_error"], 5))
        said = value, _error(found), interval, pretty(found["unit"]), began
        rows.append((tag("code", name), *said))
    head = ("parameter", "estimate", "standard error", "95 % interval", "unit", "start")
    return table(head, rows, "numbers")


def _error(found: Document) -> str:
    """A standard error, or why there is none."""
    if found.get("silent"):
        return "no influence"
    if found.get("fixed"):
        return "held"
    error = found["standard_error"]
    return "not known" if error is None else number(error, 2)


# ---- convergence ------------------------------------------------------------------------------


def convergence_charts(document: Document) -> list[Chart]:
    """Each free parameter over the iterations, with its interval and the other starts."""
    trace = document.get("trace")
    if not trace:
        return []
    charts, ks = [], trace["iteration"]
    for name, values in trace["theta"].items():
        found = document["estimate"].get(name, {})
        if found.get("fixed"):
            continue
        others = _other_starts(document, name)
        axis = sorted({*ks, *(k for _, its, _ in others for k in its)})
        traces = [_interval(found, len(axis))] if found.get("interval") else []
        traces += _beside(axis, others)
        traces.append(Trace("iterate", _on(axis, ks, values), "line", "model"))
        y_label, level = label(name, found.get("unit", "")), (found["value"],) if found else ()
        charts.append(
            Chart(name, "iteration", y_label, axis, tuple(traces), level=level, sync="iteration")
        )
    for key, title in (("log_likelihood", "Log-likelihood"), ("ess", "Effective sample size")):
        if any(v is not None for v in trace[key]):
            one = Trace(title.lower(), trace[key], "line", "c4")
            charts.append(Chart(title, "iteration", title.lower(), ks, (one,), sync="iteration"))
    return charts


def _interval(found: Document, n: int) -> Trace:
    ends = np.tile(found["interval"], (n, 1)).T
    return Trace("estimate, 95 % interval", [found["value"]] * n, "line", "after", band=ends)


def _other_starts(document: Document, name: str) -> list[tuple[int, Numbers, Numbers]]:
    """(number, iterations, values) of a parameter from the starts that were not taken."""
    taken = document["trace"]["theta"][name][0]
    traces = [
        (i + 1, s["trace"]) for i, s in enumerate(document.get("starts") or ()) if "trace" in s
    ]
    found = [(i, t["iteration"], t["theta"][name]) for i, t in traces]
    return [one for one in found if one[2][0] != taken]


def _beside(axis: list[int], others: list[tuple[int, Numbers, Numbers]]) -> list[Trace]:
    """A few starts each by itself, many by their middle and range."""
    curves = [_on(axis, ks, values) for _, ks, values in others]
    if len(curves) <= FEW_STARTS:
        return [
            Trace(f"start {i}", curve, "line", f"c{2 + k % 5}", dash=True)
            for k, ((i, _, _), curve) in enumerate(zip(others, curves, strict=True))
        ]
    ordered = np.sort(curves, axis=0)  # gaps go to the end
    n = np.isfinite(ordered).sum(axis=0)
    middle, high = (ordered[k, np.arange(len(axis))] for k in (n // 2, n - 1))
    said = "middle and range of the other starts"
    return [Trace(said, middle, "line", "data", (ordered[0], high), dash=True)]


def _on(axis: list[int], ks: Numbers, values: Numbers) -> Array:
    """Values at iterations ks over an axis that may hold more of them and go on after them."""
    return np.interp(axis, column(ks), column(values), right=np.nan)


# ---- states, simulation, residuals --------------------------------------------------------------


def _states(document: Document, draw: Drawer) -> list[Section]:
    states = document.get("states") or {"series": ()}
    parts = []
    for i, series in enumerate(states["series"]):
        shown = grid(smoothed_charts(series, states["units"]), draw)
        parts += _numbered("states", "Smoothed states", i, states, shown)
    return parts


def smoothed_charts(series: Document, units: Document) -> list[Chart]:
    """Each state of a series with its band."""
    charts = []
    for name, mean in series["mean"].items():
        band = around(mean, series["standard_deviation"][name], NORMAL)
        drawn = "smoothed mean, 95 % band", mean
        charts.append(compared(name, units.get(name, ""), series["t"], drawn, band=band))
    return charts


def _held_out(document: Document, draw: Drawer) -> list[Section]:
    """The error on data that the estimate has not seen."""
    held = document.get("held_out")
    if not held:
        return []
    units = {one["output"]: one["unit"] for one in held["outputs"]}
    said = [f"{held['samples']} samples that the estimate has not seen."]
    for o in held["outputs"]:
        error = f"wrong by {measured(o['rmse'], o['unit'])} rms, {fit_quality(o['fit'])}"
        finite = o["rmse"] is not None
        said.append(f"Simulation of {o['output']}: {error if finite else 'it diverges'}.")
    if held["log_density"] is not None:
        said.append(f"Log-density of the predictions {number(held['log_density'], 6)}.")
    charts = [
        compared(name, units.get(name, ""), one["t"], ("simulated", y), one["measured"][name],
                 title=f"Simulation of {name}, held out")
        for one in held["series"]
        for name, y in one["y"].items()
    ]  # fmt: skip
    return section("held-out", "On held-out data", bullets(said, "sentences"), grid(charts, draw))


def _numbered(kind: str, title: str, i: int, group: Document, *parts: object) -> list[Section]:
    """A section of one of the series."""
    of = f", series {i + 1}" if len(group["series"]) > 1 else ""
    return section(f"{kind}-{i}", title + of, *parts)


def _examined(document: Document, model: Document, draw: Drawer) -> list[Section]:
    found = document.get("examination") or {"series": ()}
    units, parts = model.get("outputs", {}), []
    for i, one in enumerate(found["series"]):
        title = "Simulation and prediction"
        if "problem" in one:
            parts += _numbered("simulation", title, i, found, one["problem"])
            continue
        shown = [
            *against_data(one["free_run"], "free_run", units, wide=True),
            *against_data(one["one_step"], "one_step", units, wide=True),
        ]
        seen = sentences(one), fits(one), grid(shown, draw)
        parts += _numbered("simulation", f"{title} against the data", i, found, *seen)
        left = grid(residual_charts(one), draw)
        parts += _numbered("residuals", "Residuals", i, found, left)
        where = where_it_is(one, units, draw)
        parts += _numbered("where", "Where the error is", i, found, where)
    return parts


# ---- attempts ---------------------------------------------------------------------------------


def _starts(document: Document) -> Html:
    starts = document.get("starts") or []
    if not starts:
        return Html("")
    values = [(one.get("log_likelihood") or {}).get("value") for one in starts]
    best = max((value for value in values if value is not None), default=None)
    rows = []
    for i, (one, value) in enumerate(zip(starts, values, strict=True), 1):
        taken = " (taken)" if value is not None and value == best else ""
        ends = _listed(one["start"]), _listed(one.get("estimate") or {})
        likelihood = "" if value is None else number(value, 6)
        rows.append((f"start {i}{taken}", *ends, likelihood, one["outcome"].replace("-", " ")))
    head = ("", "from", "to", "log-likelihood", "outcome")
    return join([tag("h3", "Starts"), table(head, rows, "words")])


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{k} = {number(v, 4)}" for k, v in values.items())


def _bootstrap(document: Document, draw: Drawer) -> Html:
    found = document.get("bootstrap")
    if not found:
        return Html("")
    said = (
        f"{found['runs']} estimations on data simulated at the estimate; {found['failed']} failed."
    )
    rows = [
        (tag("code", name), *(number(q[level], shown) for level in ("0.025", "0.5", "0.975")))
        for name, q in found["quantiles"].items()
        for shown in [digits_of_ends(q["0.025"], q["0.975"])]
    ]
    shown = table(("parameter", "2.5 %", "50 %", "97.5 %"), rows, "numbers") if rows else ""
    charts = [_density(name, values) for name, values in found["estimates"].items() if values]
    return join([tag("h3", "Parametric bootstrap"), tag("p", said), shown, grid(charts, draw)])


def _density(name: str, values: list[float]) -> Chart:
    share, said = (np.arange(len(values)) + 0.5) / len(values), "share of runs below"
    one = Trace(said, share, "points", "data")
    return Chart(f"Bootstrap estimates of {name}", name, said, sorted(values), (one,), live=False)
