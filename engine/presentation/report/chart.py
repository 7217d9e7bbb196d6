"""A chart as data: drawn as SVG in a report, by matplotlib, and by the page's own script in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.json_values import plain
from engine.presentation.report.downsample import keep

Numbers: TypeAlias = Sequence[float | None] | Array  # a gap is None or NaN
Band: TypeAlias = tuple[Numbers, Numbers] | Array  # low and high
CHART_POINTS = 4000  # of a chart, at most about
TIME_AXIS = "t"  # ``sync`` of charts over time


def column(values: Numbers | Band) -> Array:
    """Numbers as an array (n,), a band as one (2, n); gaps are NaN."""
    return np.asarray(values, dtype=float)


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
    band: Band | None = None
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

    @property
    def has_legend(self) -> bool:
        """Whether there is more than one curve to name, or a band."""
        return len(self.traces) > 1 or any(t.band is not None for t in self.traces)

    def thinned(self, points: int = CHART_POINTS) -> Chart:
        """The same with about so many points at most, extremes kept."""
        if len(self.x) <= points:
            return self
        bands = [t.band for t in self.traces if t.band is not None]
        curves = np.vstack([column(values) for values in (*(t.y for t in self.traces), *bands)])
        return self._rows(keep(curves.T, points))

    def within(self, low: float, high: float) -> Chart:
        """The same between two values of x, which increases, with one point more on either side."""
        x = column(self.x)
        first = max(int(np.searchsorted(x, low, "left")) - 1, 0)
        return self._rows(slice(first, int(np.searchsorted(x, high, "right")) + 1))

    def _rows(self, rows: slice | NDArray[np.intp]) -> Chart:
        def few(trace: Trace) -> Trace:
            own = {name: getattr(trace, name) for name in ("y", "band", "reach", "width")}
            there: Any = {name: column(v)[..., rows] for name, v in own.items() if v is not None}
            return replace(trace, **there)

        return replace(self, x=column(self.x)[rows], traces=tuple(map(few, self.traces)))

    def spec(self) -> dict[str, Any]:
        """What the page's script ``charts.js`` draws."""
        made: dict[str, Any] = plain(
            {
                "title": self.title,
                "xLabel": self.x_label,
                "yLabel": self.y_label,
                "x": self.x,
                "sync": self.sync,
                "log": dict.fromkeys(self.log, True),
                "series": [
                    {
                        "label": t.label,
                        "y": t.y,
                        "kind": t.kind,
                        "colour": t.role,
                        "dash": t.dash,
                        "band": t.band,
                    }
                    for t in self.traces
                ],
            }
        )
        return made


Picture: TypeAlias = Chart | Ranking
