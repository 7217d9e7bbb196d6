"""A chart as data: what is drawn as SVG in a report, and by the page's own script in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.presentation.report.downsample import keep

Numbers = Sequence[float | None] | Array
CHART_POINTS = 4000  # of a chart, at most about
TIME_AXIS = "t"  # ``sync`` of charts over time


@dataclass(frozen=True)
class Trace:
    """One curve of a chart.

    ``kind``: line, points, steps (y holds from its x to the next) or bars. ``role`` is its colour: data,
    model, before, after, bad, c1 ... c6. ``band`` = (low, high) is filled. ``reach`` is half the width of an
    error bar up and down, ``width`` half that of a bar to each side; ``dash`` makes the line a dashed one.
    """

    label: str
    y: Numbers
    kind: str = "line"
    role: str = "model"
    band: tuple[Numbers, Numbers] | None = None
    reach: Numbers | None = None
    width: Numbers | None = None
    dash: bool = False


@dataclass(frozen=True)
class Ranking:
    """Horizontal bars: ``rows`` of (name, value, role), and a ``line`` at a value to compare with."""

    title: str
    x_label: str
    rows: Sequence[tuple[str, float, str]]
    line: float | None = None


@dataclass(frozen=True)
class Chart:
    """Curves over a common x.

    ``log`` names the logarithmic axes ("", "x", "xy"); ``level`` are horizontal lines to compare with;
    ``wide`` charts take the width of the page, ``small`` ones a third of it; ``live`` ones are drawn by
    script where there is one, to be zoomed, and those with the same ``sync`` show one cursor.
    """

    title: str
    x_label: str
    y_label: str
    x: Numbers
    traces: tuple[Trace, ...]
    log: str = ""
    level: tuple[float, ...] = ()
    wide: bool = False
    small: bool = False
    live: bool = True
    sync: str = TIME_AXIS

    def thinned(self, points: int = CHART_POINTS) -> Chart:
        """The same with about so many points at most, extremes kept."""
        if len(self.x) <= points:
            return self
        columns = [c for trace in self.traces for c in (trace.y, *(trace.band or ()))]
        return self._rows(keep(np.array(columns, dtype=float).T, points).tolist())

    def within(self, low: float, high: float) -> Chart:
        """The same between two values of x, which increases, with one point more on either side."""
        x = np.array(self.x, dtype=float)
        first = max(int(np.searchsorted(x, low, "left")) - 1, 0)
        last = min(int(np.searchsorted(x, high, "right")) + 1, len(x))
        return self._rows(range(first, last))

    def _rows(self, rows: Sequence[int]) -> Chart:
        def few(values: Numbers | None) -> Numbers | None:
            return None if values is None else [values[i] for i in rows]

        traces = tuple(
            replace(
                t,
                y=few(t.y) or (),
                band=None if t.band is None else (few(t.band[0]) or (), few(t.band[1]) or ()),
                reach=few(t.reach),
                width=few(t.width),
            )
            for t in self.traces
        )
        return replace(self, x=few(self.x) or (), traces=traces)

    def spec(self) -> dict[str, Any]:
        """What the page's script ``charts.js`` draws."""
        return {
            "title": self.title,
            "xLabel": self.x_label,
            "yLabel": self.y_label,
            "x": list(self.x),
            "sync": self.sync,
            "log": dict.fromkeys(self.log, True),
            "series": [
                {
                    "label": t.label,
                    "y": list(t.y),
                    "kind": t.kind,
                    "colour": t.role,
                    "dash": t.dash,
                    "band": None if t.band is None else [list(t.band[0]), list(t.band[1])],
                }
                for t in self.traces
            ],
        }
