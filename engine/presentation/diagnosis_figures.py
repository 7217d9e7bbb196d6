"""A diagnosis in pictures. Matplotlib is imported only when they are drawn (extra ``plot``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from engine.diagnose.symptoms.curves import LAGS
from engine.diagnose.symptoms.error_localization import Region, single_bands
from engine.diagnose.symptoms.residuals import autocorrelation
from engine.presentation.diagnosis_text import unnamed
from engine.presentation.plots import axes, label
from engine.statespace.model import Array
from engine.words import tidy

if TYPE_CHECKING:
    from engine.diagnose.diagnosis import Diagnosis
    from engine.diagnose.symptoms.symptoms import Symptoms

DATA, RUN, AFTER = "#222222", "#c44e52", "#2a7f5f"
SHOWN = 15  # candidates in a round's ranking

VAGUE = 20.0  # times the usual width of a prediction's band: nothing was predicted yet


def figures(diagnosis: Diagnosis) -> dict[str, Any]:
    """``wrong``, ``where``, ``residuals``, ``candidates``; ``force`` and ``gain`` where there are such."""
    symptoms = diagnosis.symptoms
    outputs = dict(diagnosis.model.outputs)
    out = {
        "wrong": _wrong(symptoms, outputs),
        "where": _where(symptoms, outputs),
        "residuals": _residuals(symptoms, diagnosis),
        "candidates": _candidates(diagnosis),
    }
    force = unnamed(diagnosis)
    if force is not None:
        figure, (panel,) = axes(1, 1, (9.0, 3.2))
        _band(panel, force.t, force.mean - 2.0 * force.sd, force.mean + 2.0 * force.sd, RUN)
        panel.plot(force.t, force.mean, color=RUN)
        panel.axhline(0.0, color=DATA, linewidth=0.6)
        panel.set(title=f"Unnamed force on {force.target}", xlabel="t [s]", ylabel=tidy(force.unit))
        out["force"] = figure
    if diagnosis.gain is not None:
        out["gain"] = _gain(diagnosis)
    return {name: figure for name, figure in out.items() if figure is not None}


def _band(panel: Any, t: Array, low: Array, high: Array, color: str) -> None:
    panel.fill_between(t, low, high, color=color, alpha=0.18, linewidth=0.0)


def _wrong(symptoms: Symptoms, outputs: dict[str, str]) -> Any:
    """Measured and free run with its band; below, the errors of the free run and of predictions."""
    figure, panels = axes(2 * len(outputs), 1, (9.0, 5.0 * len(outputs)))
    t, y = symptoms.series.t, symptoms.series.y
    for i, (name, unit) in enumerate(outputs.items()):
        top, bottom = panels[2 * i], panels[2 * i + 1]
        run, predicted = symptoms.free_run, symptoms.one_step
        if run is not None:
            _band(top, t, run.lower[:, i], run.upper[:, i], RUN)
            top.plot(t, run.y[:, i], color=RUN, linewidth=1.0, label="free run, 95 % band")
            bottom.plot(t, y[:, i] - run.y[:, i], color=RUN, linewidth=0.8, label="free run")
        top.plot(t, y[:, i], ".", color=DATA, markersize=2.5, label="measured")
        width = predicted.upper[:, i] - predicted.lower[:, i]
        told = width < VAGUE * np.nanmedian(width)  # not before the state is known
        error = np.where(told, y[:, i] - predicted.y[:, i], np.nan)
        bottom.plot(t, error, color=DATA, linewidth=0.6, label="one-step prediction")
        bottom.axhline(0.0, color="#888888", linewidth=0.5)
        top.set(ylabel=label(name, unit))
        bottom.set(ylabel=f"error of {label(name, unit)}", xlabel="t [s]")
        top.legend(loc="best", fontsize=8)
        bottom.legend(loc="best", fontsize=8)
    return figure


def _where(symptoms: Symptoms, outputs: dict[str, str]) -> Any:
    """Mean error +- 2 standard errors by bands of every signal and time, and the spectrum."""
    parts: list[tuple[str, list[Region]]] = []
    for title, comparison in (("free run", symptoms.free_run), ("prediction", symptoms.one_step)):
        if comparison is None:
            continue
        for output in outputs:
            mine = [r for r in comparison.regions if r.output == output]
            for signal in dict.fromkeys(r.signal for r in mine):
                parts.append((title, single_bands([r for r in mine if r.signal == signal])))
    if not parts:
        return None
    columns = min(3, len(parts))
    rows = -(-len(parts) // columns)
    figure, panels = axes(rows, columns, (3.6 * columns, 2.6 * rows))
    for panel, (title, regions) in zip(panels, parts, strict=False):
        _by_bands(panel, title, regions, outputs)
    for panel in panels[len(parts) :]:
        panel.set_visible(False)
    return figure


def _by_bands(panel: Any, title: str, regions: list[Region], outputs: dict[str, str]) -> None:
    if not regions:
        return
    first = regions[0]
    low, high = np.array([[r.low, r.high] for r in regions]).T
    panel.set_title(f"{title} of {first.output}", fontsize=9)
    panel.set_xlabel(label(first.signal, first.unit), fontsize=8)
    panel.tick_params(labelsize=7)
    if first.kind == "frequency":
        panel.step(low, [r.rms for r in regions], where="post", color=RUN, label="error")
        expected = [r.expected_rms or np.nan for r in regions]
        panel.step(low, expected, where="post", color=DATA, label="expected")
        panel.set(xscale="log", yscale="log")
        panel.set_ylabel("rms in the band", fontsize=8)
        panel.legend(fontsize=7)
        return
    mean = np.array([r.mean for r in regions])
    error = 2.0 * np.array([r.standard_error for r in regions])
    color = RUN if title == "free run" else DATA
    panel.errorbar(
        0.5 * (low + high), mean, yerr=error, xerr=0.5 * (high - low), fmt=".", color=color
    )
    panel.axhline(0.0, color="#888888", linewidth=0.5)
    panel.set_ylabel(f"mean error [{tidy(outputs[first.output]) or '1'}]", fontsize=8)


def _residuals(symptoms: Symptoms, diagnosis: Diagnosis) -> Any:
    """Standardised innovations, their autocorrelation, PIT, and auxiliary residuals."""
    ny = symptoms.z.shape[1]
    figure, panels = axes(2 + ny, 2, (9.0, 2.6 * (2 + ny)))
    t = symptoms.series.t
    for i, name in enumerate(diagnosis.model.outputs):
        z = symptoms.z[:, i]
        left, right = panels[2 * i], panels[2 * i + 1]
        seen = np.isfinite(z)
        left.plot(t, z, ".", color=DATA, markersize=2.5)
        left.set(title=f"standardised innovations of {name}", xlabel="t [s]")
        r, _ = autocorrelation(z, min(LAGS, len(z) // 4))
        right.bar(np.arange(1, len(r) + 1), r, color=DATA, width=0.6)
        for limit in (-1.96, 1.96):
            right.axhline(limit / np.sqrt(max(seen.sum(), 1)), color=RUN, linewidth=0.8)
        right.set(title=f"their autocorrelation, {name}", xlabel="lag [samples]")
    left, right = panels[2 * ny], panels[2 * ny + 1]
    for i, name in enumerate(diagnosis.model.outputs):
        p = symptoms.pit[:, i]
        left.hist(
            p[np.isfinite(p)], bins=20, range=(0, 1), histtype="step", density=True, label=name
        )
    left.axhline(1.0, color="#888888", linewidth=0.6)
    left.set(title="probability integral transform", xlabel="Phi(z)")
    left.legend(fontsize=7)
    for i, name in enumerate(diagnosis.model.outputs):
        right.plot(t, symptoms.of_outputs[:, i], ".", markersize=2.5, label=name)
    right.set(title="auxiliary residuals of the measurements", xlabel="t [s]")
    right.legend(fontsize=7)
    left, right = panels[2 * ny + 2], panels[2 * ny + 3]
    states = [*diagnosis.model.nonlinear, *diagnosis.model.linear]
    for j, name in enumerate(states):
        left.plot(t[1:], symptoms.of_states[:, j], ".", markersize=2.5, label=name)
    left.set(title="auxiliary residuals of the states", xlabel="t [s]")
    left.legend(fontsize=7)
    right.set_visible(False)
    return figure


def _candidates(diagnosis: Diagnosis) -> Any:
    """Each round's refitted effects by score, the unnamed force among them, the set marked."""
    rounds = [r for r in diagnosis.rounds if r.refits]
    if not rounds:
        return _screened(diagnosis)
    figure, panels = axes(len(rounds), 1, (8.0, 0.8 + 0.28 * SHOWN * len(rounds)))
    for k, (panel, found) in enumerate(zip(panels, rounds, strict=True)):
        bars = [(r.effect.name, r.score, r in found.equivalent) for r in found.refits]
        if found.generic is not None:
            bars.append(
                (f"unnamed force ({found.generic.effect.name})", found.generic.score, False)
            )
        bars = sorted(bars, key=lambda bar: -bar[1])[:SHOWN]
        colors = [
            AFTER if inside else (RUN if name.startswith("unnamed") else "#9a9a9a")
            for name, _, inside in bars
        ]
        panel.barh([name for name, _, _ in bars], [score for _, score, _ in bars], color=colors)
        panel.invert_yaxis()
        panel.set(
            title=f"Round {k + 1}: refitted effects (green: not told apart)",
            xlabel="2 x log-likelihood gained, less costs",
        )
    return figure


def _screened(diagnosis: Diagnosis) -> Any:
    """Without refits: the largest statistics of the screen beside the threshold."""
    scores = [s for s in diagnosis.rounds[0].screen.scores if s.statistic > 0.0][:SHOWN]
    if not scores:
        return None
    figure, (panel,) = axes(1, 1, (8.0, 0.8 + 0.28 * SHOWN))
    panel.barh([s.effect.name for s in scores], [s.statistic for s in scores], color="#9a9a9a")
    panel.axvline(
        diagnosis.rounds[0].screen.threshold, color=RUN, label="a single test's threshold"
    )
    panel.invert_yaxis()
    panel.set(title="Screened effects: no alarm", xlabel="statistic")
    panel.legend(fontsize=8)
    return figure


def _gain(diagnosis: Diagnosis) -> Any:
    """On held-out data: measured, free run before and after, and the log-density gained so far."""
    gain = diagnosis.gain
    if gain is None or not len(gain.t):
        return None
    outputs = dict(diagnosis.model.outputs)
    figure, panels = axes(len(outputs) + 1, 1, (9.0, 2.8 * (len(outputs) + 1)))
    for i, (name, unit) in enumerate(outputs.items()):
        panel = panels[i]
        panel.plot(gain.t, gain.y[:, i], ".", color=DATA, markersize=2.5, label="held-out readings")
        for run, color, when in ((gain.before, RUN, "before"), (gain.after, AFTER, "after")):
            if run is not None:
                panel.plot(gain.t, run[:, i], color=color, linewidth=1.0, label=f"free run {when}")
        panel.set(ylabel=label(name, unit))
        panel.legend(fontsize=8)
    panels[-1].plot(gain.t, np.nancumsum(gain.d), color=AFTER)
    panels[-1].axhline(0.0, color="#888888", linewidth=0.5)
    panels[-1].set(ylabel="log-density gained", xlabel="t [s]")
    return figure
