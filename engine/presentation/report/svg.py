"""Charts as SVG by hand: no library, no style of its own, colours by class so that the page decides."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.presentation.report.chart import Band, Chart, Numbers, Picture, Ranking, Trace, column
from engine.presentation.report.html import Html, tag, text
from engine.words import number

# Widths drawn for: a third of a page or a phone, half a page, and a page.
SMALL_WIDTH, NARROW_WIDTH, WIDE_WIDTH = 380, 520, 1080
LOW_HEIGHT, USUAL_HEIGHT, TALL_HEIGHT = 220, 250, 300
# Around the axes, for the words; left of the numbers at the y axis, and for each of their letters.
LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN, BOTTOM_MARGIN = 62, 18, 10, 46
LABEL_MARGIN, LETTER_WIDTH = 28, 9.5
LOG_RANGE = 1e-12  # of the largest value: what a logarithmic axis shows at most
BUCKETS_PER_UNIT = 1.5  # curves are thinned to so many buckets per unit of width


@dataclass(frozen=True)
class Axis:
    """A range of values on a range of pixels."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: Any) -> Any:
        """The pixel of a value, or of each of several."""
        low, high = self.low, self.high
        if self.log:
            value, low, high = np.log10(value), math.log10(low), math.log10(high)
        return self.start + (value - low) / (high - low) * (self.end - self.start)

    def ticks(self, wanted: int) -> list[float]:
        """Round values within the range, about as many as wanted."""
        if self.log:
            first, last = math.ceil(math.log10(self.low)), math.floor(math.log10(self.high))
            every = max(1, math.ceil((last - first + 1) / wanted))
            powers = [10.0**k for k in range(first, last + 1, every)]
            between = [m * 10.0**k for k in range(first - 1, last + 1) for m in (1.0, 2.0, 5.0)]
            inside = [v for v in between if self.low <= v <= self.high]
            if len(powers) >= 3:
                return powers
            if len(inside) >= 3:
                return inside
        raw = (self.high - self.low) / max(wanted, 1)
        unit = 10.0 ** math.floor(math.log10(raw))
        step = unit * next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * unit >= raw * 0.999)
        begin, end = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(begin, end + 1)]


def svg_element(chart: Picture) -> Html:
    """A figure: title, legend, and the chart; a wide one also drawn narrow, for small screens."""
    if isinstance(chart, Ranking):
        return _hbars(chart)
    if chart.small:
        sizes = [(SMALL_WIDTH, LOW_HEIGHT, "chart-svg")]
    elif chart.wide:
        wide, narrow = (WIDE_WIDTH, TALL_HEIGHT), (NARROW_WIDTH, USUAL_HEIGHT)
        sizes = [(*wide, "chart-svg for-wide"), (*narrow, "chart-svg for-narrow")]
    else:
        sizes = [(NARROW_WIDTH, USUAL_HEIGHT, "chart-svg")]
    pictures = [svg(chart, width, height, class_) for width, height, class_ in sizes]
    head = tag("figcaption", text(chart.title))
    return tag("figure", head, legend(chart), *pictures, class_=f"figure{' wide' * chart.wide}")


def legend(chart: Chart) -> Html:
    """What each colour is, where a chart has more than one curve or a band."""
    if not chart.has_legend:
        return Html("")
    items = []
    for t in chart.traces:
        kind = "band" if t.band is not None else "dashed" if t.dash else t.kind
        items.append(tag("li", tag("i", class_=f"{kind} r-{t.role}"), t.label))
    return tag("ul", *items, class_="key")


def svg(chart: Chart, width: int, height: int, class_: str = "chart-svg") -> Html:
    """The chart alone, ``width`` by ``height`` units."""
    chart = chart.thinned(int(BUCKETS_PER_UNIT * width * _columns(chart)))
    y = y_axis(chart, height - BOTTOM_MARGIN, TOP_MARGIN)
    longest = max(len(number(tick, 4)) for tick in y.ticks(_rows(height)))
    left = max(LEFT_MARGIN, LABEL_MARGIN + LETTER_WIDTH * longest)
    x = _axis(_xs(chart), left, width - RIGHT_MARGIN, "x" in chart.log, 0.0)
    parts, xs = [*_grid(chart, x, y, width, height)], column(chart.x)
    for level in chart.level:
        if y.low <= level <= y.high:
            parts.append(_line(x.start, y(level), x.end, y(level), "level"))
    for t in chart.traces:
        if t.band is not None:
            parts.append(_band(xs, t.band, x, y, t.role))
    for t in chart.traces:
        parts += _trace(xs, t, x, y)
    said = "; ".join(t.label for t in chart.traces)
    return drawn(parts, width, height, f"{chart.title}: {said} over {chart.x_label}", class_)


def drawn(
    parts: Iterable[Html], width: int, height: int, said: str, class_: str, **more: str
) -> Html:
    """A picture of ``width`` by ``height`` units, and what is ``said`` where it cannot be seen."""
    box = f"0 0 {width} {height}"
    return tag("svg", *parts, viewBox=box, **more, class_=class_, role="img", aria_label=said)


def y_axis(chart: Chart, start: float, end: float) -> Axis:
    """What of the values is seen, between two pixels."""
    return _axis(_ys(chart), start, end, "y" in chart.log, 0.06)


def _hbars(chart: Ranking) -> Html:
    """Horizontal bars, the longest names written in full above them."""
    shown, line = chart.rows, chart.line
    values = [value for _, value, _ in shown] + ([line] if line is not None else [])
    low, high = min(0.0, *values), max(0.0, *values)
    width, step, bottom = NARROW_WIDTH, 38, 40
    height = step * len(shown) + bottom + 4
    x = Axis(low, high if high > low else low + 1.0, 12, width - 60)
    parts = []
    for tick in x.ticks(5):
        parts.append(_line(x(tick), 2, x(tick), height - bottom, "grid"))
        parts.append(_words(x(tick), height - bottom + 17, number(tick), "middle"))
    for i, (name, value, role) in enumerate(shown):
        top = step * i + 2
        left, right = sorted((x(0.0), x(value)))
        parts.append(_words(x.start, top + 12, name, "start", "name"))
        parts.append(
            tag("rect", x=_n(left), y=_n(top + 18), width=_n(max(right - left, 1.0)), height=10,
                class_=f"bar r-{role}")
        )  # fmt: skip
        parts.append(_words(right + 5, top + 28, number(value), "start"))
    if line is not None:
        parts.append(_line(x(line), 2, x(line), height - bottom, "level"))
    parts.append(_words(width / 2, height - 6, chart.x_label, "middle"))
    said = "; ".join(f"{name} {number(value)}" for name, value, _ in shown)
    picture = drawn(parts, width, height, f"{chart.title}: {said}", "chart-svg")
    return tag("figure", tag("figcaption", text(chart.title)), picture, class_="figure")


# ---- parts --------------------------------------------------------------------------------------


def _rows(height: int) -> int:
    """Lines of the grid."""
    return 4 if height < TALL_HEIGHT else 5


def _columns(chart: Chart) -> int:
    return sum(1 + 2 * (t.band is not None) for t in chart.traces)


def _finite(*several: Numbers | Band) -> Array:
    """All values that are finite."""
    values: Array = np.concatenate([np.zeros(0), *(column(one).ravel() for one in several)])
    return values[np.isfinite(values)]


def _xs(chart: Chart) -> Array:
    """Values of x, with the ends of bars about them."""
    x = column(chart.x)
    widths = [column(t.width) for t in chart.traces if t.width is not None]
    return _finite(x, *(x - half for half in widths), *(x + half for half in widths))


def _ys(chart: Chart) -> Array:
    """Values that must be seen; a band may leave the picture where it is far wider than its curves."""
    seen: list[Numbers] = [chart.level, *(t.y for t in chart.traces)]
    for t in chart.traces:
        if t.kind == "bars" and "y" not in chart.log:
            seen.append((0.0,))
        if t.reach is not None:
            seen += [column(t.y) - column(t.reach), column(t.y) + column(t.reach)]
    values = _finite(*seen)
    around = _finite(*(t.band for t in chart.traces if t.band is not None))
    if values.size and around.size:
        low, high = float(values.min()), float(values.max())
        middle, reach = 0.5 * (low + high), 2.0 * (high - low) or math.inf
        around = np.clip(around, middle - reach, middle + reach)
    return np.concatenate([values, around])


def _axis(values: Array, start: float, end: float, log: bool, room: float) -> Axis:
    if log:
        values = values[values > 0.0]
    empty = (1.0 if log else 0.0, 1.0)
    low, high = (float(values.min()), float(values.max())) if values.size else empty
    if log:
        low = max(low, high * LOG_RANGE)
        if not high > low:
            low, high = 0.5 * low, 2.0 * high
        factor = (high / low) ** room
        return Axis(low / factor, high * factor, start, end, True)
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        size = abs(low) * 0.1 or 1.0
        low, high = low - size, high + size
    more = room * (high - low)
    return Axis(low - more, high + more, start, end)


def _grid(chart: Chart, x: Axis, y: Axis, width: int, height: int) -> Iterable[Html]:
    for tick in y.ticks(_rows(height)):
        yield _line(x.start, y(tick), x.end, y(tick), "grid")
        yield _words(x.start - 6, y(tick) + 4, number(tick, 4), "end")
    for tick in x.ticks(4 if width < NARROW_WIDTH else 5 if width < WIDE_WIDTH else 10):
        yield _line(x(tick), y.end, x(tick), y.start, "grid")
        yield _words(x(tick), y.start + 17, number(tick, 5), "middle")
    yield _words(0.5 * (x.start + x.end), height - 8, chart.x_label, "middle")
    yield tag(
        "text", chart.y_label, transform=f"translate(13 {_n(0.5 * (y.start + y.end))}) rotate(-90)",
        text_anchor="middle",
    )  # fmt: skip


def _trace(xs: Array, t: Trace, x: Axis, y: Axis) -> list[Html]:
    """One curve, and the bars about its points."""
    ys = column(t.y)
    across, down = _pixels(x, xs), _pixels(y, ys)
    parts: list[Html] = []
    if t.width is not None:
        sides = [_pixels(x, xs + sign * column(t.width)) for sign in (-1.0, 1.0)]
        if t.kind == "bars":
            base = y(y.low if y.log else max(min(0.0, y.high), y.low))
            return [
                tag("rect", x=_n(left + 0.5), y=_n(min(top, base)), width=_n(max(right - left - 1.0, 0.5)),
                    height=_n(max(abs(base - top), 0.5)), class_=f"bar r-{t.role}")
                for left, right, top in _known(*sides, down)
            ]  # fmt: skip
        for left, right, at in _known(*sides, down):
            parts.append(_line(left, at, right, at, f"curve r-{t.role}"))
    if t.reach is not None:
        ends = [_pixels(y, ys + sign * column(t.reach)) for sign in (-1.0, 1.0)]
        for low, high, at in _known(*ends, across):
            parts.append(_line(at, low, at, high, f"error r-{t.role}"))
    if t.kind == "points":
        d = "".join(f"M{_n(a)} {_n(b)}h0" for a, b in _known(across, down))
        dots = f"dots r-{t.role}" if len(xs) > 120 else f"dots large r-{t.role}"
        return [*parts, tag("path", d=d, class_=dots)]
    d, class_ = _path(across, down, t.kind == "steps"), f"curve{' dash' * t.dash} r-{t.role}"
    return [*parts, tag("path", d=d, class_=class_)]


def _path(across: Array, down: Array, steps: bool) -> str:
    out = []
    for part in _stretches(across + down):
        first, *others = zip(across[part], down[part], strict=True)
        out.append(f"M{_n(first[0])} {_n(first[1])}")
        out += [f"H{_n(a)}V{_n(b)}" if steps else f"L{_n(a)} {_n(b)}" for a, b in others]
    return "".join(out) or "M0 0"


def _band(xs: Array, band: Band, x: Axis, y: Axis, role: str) -> Html:
    """The area between two curves, in one piece for each stretch without gaps."""
    across = _pixels(x, xs)
    low, high = (_pixels(y, end) for end in np.clip(column(band), y.low, y.high))
    pieces = []
    for part in _stretches(across + low + high):
        if len(part) > 1:
            upper, lower = (
                [f"{_n(a)} {_n(b)}" for a, b in zip(across[part], end[part], strict=True)]
                for end in (high, low)
            )
            pieces.append(f"M{'L'.join([*upper, *reversed(lower)])}Z")
    return tag("path", d="".join(pieces) or "M0 0", class_=f"band r-{role}")


def _pixels(axis: Axis, values: Array) -> Array:
    """Where values are drawn, at its ends what lies beyond them; NaN where nothing is."""
    shown = np.isfinite(values) & ((values > 0.0) | (not axis.log))
    out = np.full(len(values), np.nan)
    out[shown] = axis(values[shown]).clip(*sorted((axis.start, axis.end)))
    return out


def _known(*columns: Array) -> list[list[float]]:
    """Rows of columns (n,) in which there is no gap."""
    rows = np.column_stack(columns)
    kept: list[list[float]] = rows[~np.isnan(rows).any(axis=1)].tolist()
    return kept


def _stretches(values: Array) -> list[NDArray[np.intp]]:
    """Rows (k,) of each stretch of values (n,) without a gap."""
    rows = np.flatnonzero(np.isfinite(values))
    every = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return [part for part in every if part.size]


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    return tag("line", x1=_n(x1), y1=_n(y1), x2=_n(x2), y2=_n(y2), class_=class_)


def _words(x: float, y: float, value: str, anchor: str, class_: str | None = None) -> Html:
    return tag("text", value, x=_n(x), y=_n(y), text_anchor=anchor, class_=class_)


def _n(value: float) -> str:
    """A coordinate to a tenth of a unit."""
    short = f"{value:.1f}"
    return short[:-2] if short.endswith(".0") else short
