"""Charts as SVG by hand: no library, no style of its own, colours by class so that the page decides."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from engine.presentation.report.chart import Chart, Numbers, Ranking, Trace
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

    def __call__(self, value: float) -> float:
        """The pixel of a value."""
        low, high = self.low, self.high
        if self.log:
            value, low, high = math.log10(value), math.log10(low), math.log10(high)
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


def svg_element(chart: Chart | Ranking) -> Html:
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
    drawn = [svg(chart, width, height, class_) for width, height, class_ in sizes]
    head = tag("figcaption", text(chart.title))
    return tag("figure", head, legend(chart), *drawn, class_=f"figure{' wide' * chart.wide}")


def legend(chart: Chart) -> Html:
    """What each colour is, where a chart has more than one curve or a band."""
    if len(chart.traces) < 2 and not any(t.band for t in chart.traces):
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
    parts = [*_grid(chart, x, y, width, height)]
    for level in chart.level:
        if y.low <= level <= y.high:
            parts.append(_line(x.start, y(level), x.end, y(level), "level"))
    for t in chart.traces:
        if t.band is not None:
            parts.append(_band(chart.x, t.band, x, y, t.role))
    for t in chart.traces:
        parts += _trace(chart.x, t, x, y)
    said = "; ".join(t.label for t in chart.traces)
    return tag(
        "svg",
        *parts,
        viewBox=f"0 0 {width} {height}",
        class_=class_,
        role="img",
        aria_label=f"{chart.title}: {said} over {chart.x_label}",
    )


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
    drawn = tag(
        "svg", *parts, viewBox=f"0 0 {width} {height}", class_="chart-svg", role="img",
        aria_label=f"{chart.title}: {said}",
    )  # fmt: skip
    return tag("figure", tag("figcaption", text(chart.title)), drawn, class_="figure")


# ---- parts --------------------------------------------------------------------------------------


def _rows(height: int) -> int:
    """Lines of the grid."""
    return 4 if height < TALL_HEIGHT else 5


def _columns(chart: Chart) -> int:
    return sum(1 + 2 * (t.band is not None) for t in chart.traces)


def _finite(values: Iterable[float | None]) -> list[float]:
    return [v for v in values if v is not None and math.isfinite(v)]


def _xs(chart: Chart) -> list[float]:
    values = _finite(chart.x)
    for t in chart.traces:
        if t.width is not None:
            for at, half in zip(chart.x, t.width, strict=True):
                if at is not None and half is not None:
                    values += [at - half, at + half]
    return values


def _ys(chart: Chart) -> list[float]:
    """Values that must be seen; a band may leave the picture where it is far wider than its curves."""
    values, around = list(chart.level), []
    for t in chart.traces:
        ys = _finite(t.y)
        values += ys
        if t.kind == "bars" and "y" not in chart.log:
            values.append(0.0)
        if t.reach is not None:
            for at, half in zip(t.y, t.reach, strict=True):
                if at is not None and half is not None:
                    values += [at - half, at + half]
        if t.band is not None:
            around += _finite(t.band[0]) + _finite(t.band[1])
    if not around:
        return values
    if not values:
        return around
    middle, span = 0.5 * (min(values) + max(values)), max(values) - min(values)
    reach = 2.0 * span if span > 0.0 else math.inf
    return values + [min(max(v, middle - reach), middle + reach) for v in around]


def _axis(values: list[float], start: float, end: float, log: bool, room: float) -> Axis:
    if log:
        values = [v for v in values if v > 0.0]
    low, high = (min(values), max(values)) if values else (1.0 if log else 0.0, 1.0)
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


def _trace(xs: Numbers, t: Trace, x: Axis, y: Axis) -> list[Html]:
    inside = _clipped(y)
    points = [
        None
        if a is None or b is None or not (_drawable(a, x) and _drawable(b, y))
        else (x(a), inside(y(b)))
        for a, b in zip(xs, t.y, strict=True)
    ]
    parts = []
    if t.width is not None and t.kind == "bars":
        base = y(y.low if y.log else max(min(0.0, y.high), y.low))
        for at, half, p in zip(xs, t.width, points, strict=True):
            if p is not None and at is not None and half is not None:
                left, right = x(at - half), x(at + half)
                top, bottom = sorted((p[1], base))
                parts.append(
                    tag("rect", x=_n(left + 0.5), y=_n(top), width=_n(max(right - left - 1.0, 0.5)),
                        height=_n(max(bottom - top, 0.5)), class_=f"bar r-{t.role}")
                )  # fmt: skip
        return parts
    if t.width is not None or t.reach is not None:
        for i, p in enumerate(points):
            if p is None:
                continue
            at, value = xs[i], t.y[i]
            half = t.width[i] if t.width is not None else None
            if half is not None and at is not None:
                parts.append(_line(x(at - half), p[1], x(at + half), p[1], f"curve r-{t.role}"))
            up = t.reach[i] if t.reach is not None else None
            if up is not None and value is not None:
                ends = inside(y(value - up)), inside(y(value + up))
                parts.append(_line(p[0], ends[0], p[0], ends[1], f"error r-{t.role}"))
    if t.kind == "points":
        d = "".join(f"M{_n(p[0])} {_n(p[1])}h0" for p in points if p is not None)
        dots = f"dots r-{t.role}" if len(points) > 120 else f"dots large r-{t.role}"
        return [*parts, tag("path", d=d, class_=dots)]
    return [
        *parts,
        tag(
            "path", d=_path(points, t.kind == "steps"), class_=f"curve{' dash' * t.dash} r-{t.role}"
        ),
    ]


def _path(points: Iterable[tuple[float, float] | None], steps: bool) -> str:
    out, down, last = [], False, 0.0
    for p in points:
        if p is None:
            down = False
            continue
        if down and steps:
            out.append(f"H{_n(p[0])}V{_n(p[1])}")
        else:
            out.append(f"{'L' if down else 'M'}{_n(p[0])} {_n(p[1])}")
        down, last = True, p[1]
    return "".join(out) or f"M0 {_n(last)}"


def _band(xs: Numbers, band: tuple[Numbers, Numbers], x: Axis, y: Axis, role: str) -> Html:
    """The area between two curves, in one piece for each stretch without gaps."""
    inside, pieces = _clipped(y), []
    run: list[tuple[float, float, float]] = []

    def close() -> None:
        if len(run) > 1:
            upper = "L".join(f"{_n(a)} {_n(high)}" for a, _, high in run)
            lower = "L".join(f"{_n(a)} {_n(low)}" for a, low, _ in reversed(run))
            pieces.append(f"M{upper}L{lower}Z")
        run.clear()

    for at, low, high in zip(xs, *band, strict=True):
        if at is None or low is None or high is None:
            close()
            continue
        run.append((x(at), inside(y(max(low, y.low))), inside(y(min(high, y.high)))))
    close()
    return tag("path", d="".join(pieces) or "M0 0", class_=f"band r-{role}")


def _drawable(value: float, axis: Axis) -> bool:
    return math.isfinite(value) and (value > 0.0 or not axis.log)


def _clipped(y: Axis) -> Callable[[float], float]:
    low, high = sorted((y.start, y.end))
    return lambda pixel: min(max(pixel, low), high)


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    return tag("line", x1=_n(x1), y1=_n(y1), x2=_n(x2), y2=_n(y2), class_=class_)


def _words(x: float, y: float, value: str, anchor: str, class_: str | None = None) -> Html:
    return tag("text", value, x=_n(x), y=_n(y), text_anchor=anchor, class_=class_)


def _n(value: float) -> str:
    """A coordinate to a tenth of a unit."""
    short = f"{value:.1f}"
    return short[:-2] if short.endswith(".0") else short
