"""Figures of results, from plain arrays. Matplotlib (extra ``plot``) is imported when one is drawn."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.errors import OptionError
from engine.words import tidy

Array: TypeAlias = NDArray[np.float64]

DATA, MODEL, QUIET = "#222222", "#c44e52", "#888888"
FORMATS = ("svg", "png")
MANY = 5000  # points from which a curve becomes pixels within an SVG, so that it opens at once
TWO_SIDED = 1.96  # standard deviations of a 95 % band


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


def convergence(
    units: Mapping[str, str],
    trace: Array,
    estimate: Array,
    log_likelihood: Array,
    ess: Array,
    intervals: Array | None = None,
) -> Any:
    """Iterates of each parameter, the log-likelihood and the effective sample size.

    ``units`` maps the n parameters that were free to their units; ``trace`` (K+1, n), ``estimate``
    (n,), ``log_likelihood`` and ``ess`` (K,); ``intervals`` (n, 2) are drawn as bands, NaN is none.
    """
    n = len(units)
    rows = -(-(n + 2) // 2)
    figure, panels = axes(rows, 2, (9.0, 2.2 * rows))
    k = np.arange(len(trace))
    for i, (name, unit) in enumerate(units.items()):
        panel = panels[i]
        if intervals is not None and np.isfinite(intervals[i]).all():
            panel.axhspan(*intervals[i], color=MODEL, alpha=0.15, linewidth=0.0, label="95 %")
        panel.axhline(estimate[i], color=MODEL, linewidth=0.8, linestyle="--", label="estimate")
        panel.plot(k, trace[:, i], color=DATA, linewidth=1.0)
        panel.set(ylabel=label(name, unit))
    panels[0].legend(loc="best", fontsize=8)
    for panel, values, name in (
        (panels[n], log_likelihood, "log-likelihood"),
        (panels[n + 1], ess, "effective sample size"),
    ):
        panel.plot(k[1:], values, color=DATA, linewidth=1.0)
        panel.set(ylabel=name)
        panel.ticklabel_format(useOffset=False)
    panels[n + 1].set_ylim(bottom=0.0)
    for panel in panels[n + 2 :]:
        panel.set_visible(False)
    for panel in panels[: n + 2][-2:]:
        panel.set(xlabel="iteration")
    return figure


def states(t: Array, units: Mapping[str, str], mean: Array, sd: Array | None = None) -> Any:
    """Curves (T, n), named with their units, and 95 % bands from ``sd`` (T, n); t in seconds."""
    figure, panels = axes(len(units), 1, (9.0, 2.2 * len(units)))
    for i, (panel, (name, unit)) in enumerate(zip(panels, units.items(), strict=True)):
        if sd is not None:
            half = TWO_SIDED * sd[:, i]
            band(panel, t, mean[:, i] - half, mean[:, i] + half)
        curve(panel, t, mean[:, i], color=MODEL)
        panel.set(ylabel=label(name, unit))
    panels[-1].set(xlabel="t [s]")
    return figure


def against_data(
    t: Array,
    units: Mapping[str, str],
    measured: Array,
    computed: Array,
    computed_as: str,
    lower: Array | None = None,
    upper: Array | None = None,
) -> Any:
    """Measured outputs (T, n) with computed ones above, their differences below."""
    figure, panels = axes(2 * len(units), 1, (9.0, 4.4 * len(units)))
    for i, (name, unit) in enumerate(units.items()):
        top, bottom = panels[2 * i], panels[2 * i + 1]
        if lower is not None and upper is not None:
            band(top, t, lower[:, i], upper[:, i])
        curve(top, t, computed[:, i], color=MODEL, label=computed_as)
        dots(top, t, measured[:, i], label="measured")
        dots(bottom, t, measured[:, i] - computed[:, i])
        bottom.axhline(0.0, color=QUIET, linewidth=0.6)
        top.set(ylabel=label(name, unit))
        bottom.set(ylabel=f"measured - {computed_as}")
        top.legend(loc="best", fontsize=8)
    panels[-1].set(xlabel="t [s]")
    return figure


def curve(panel: Any, t: Array, values: Array, **style: Any) -> None:
    """A line."""
    panel.plot(t, values, linewidth=1.0, rasterized=len(t) > MANY, **style)


def dots(panel: Any, t: Array, values: Array, **style: Any) -> None:
    """Measured values."""
    panel.plot(t, values, ".", color=DATA, markersize=2.5, rasterized=len(t) > MANY, **style)


def band(panel: Any, t: Array, low: Array, high: Array) -> None:
    """A shaded band."""
    panel.fill_between(
        t, low, high, color=MODEL, alpha=0.18, linewidth=0.0, rasterized=len(t) > MANY
    )


def label(name: str, unit: str) -> str:
    """``velocity [m/s]``."""
    return f"{name} [{tidy(unit)}]" if tidy(unit) else name


def _png(figure: Any) -> str:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return base64.b64encode(out.getvalue()).decode("ascii")
