"""What reports are made of: sections of HTML, and who draws their charts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from engine.diagnose.gain.adoption import NOT_MEASURED
from engine.presentation.cause_sentences import NOTHING_ADDED
from engine.presentation.report.chart import CHART_POINTS, TIME_AXIS, Picture, Ranking
from engine.presentation.report.html import Html, join, tag
from engine.presentation.report.svg import svg_element
from engine.words import digits, estimate, factor, number, probability, tidy

Document = Mapping[str, Any]


class Drawer(Protocol):
    """Makes the element of a chart."""

    def __call__(self, chart: Picture) -> Html:
        """The element."""


@dataclass
class OnPage:
    """For a page with scripts: charts over a long axis become places for them, with data in ``charts``.

    Of long curves over time fewer points are given, with their extremes. ``zoom`` = (from, to) in time
    gives ``finer`` instead: {number of the chart: more of its points there}.
    """

    zoom: tuple[float, float] | None = None
    charts: list[dict[str, Any]] = field(default_factory=list)
    finer: dict[int, dict[str, Any]] = field(default_factory=dict)

    def __call__(self, chart: Picture) -> Html:
        """A place with its number, or SVG where there is nothing to zoom into."""
        if isinstance(chart, Ranking) or not chart.live:
            return svg_element(chart)
        if self.zoom is not None and chart.sync == TIME_AXIS and len(chart.x) > CHART_POINTS:
            self.finer[len(self.charts)] = chart.within(*self.zoom).thinned().spec()
        self.charts.append(chart.thinned().spec() | {"points": len(chart.x)})
        size = "figure live wide" if chart.wide else "figure live"
        return tag("div", class_=size, data_chart=len(self.charts) - 1)


@dataclass(frozen=True)
class Section:
    """One part of a report: a heading with something below it."""

    id: str
    title: str
    body: Html


@dataclass(frozen=True)
class Report:
    """A report: its title, what is understood at a glance, then the sections."""

    title: str
    summary: Html
    sections: tuple[Section, ...]


def section(id_: str, title: str, *parts: object) -> list[Section]:
    """A section, or none where all its parts are empty."""
    body = join(part for part in parts if part)
    return [Section(id_, title, body)] if body else []


def grid(charts: Iterable[Picture], draw: Drawer, small: bool = False) -> Html:
    """Charts side by side where there is room; small ones three in a row."""
    drawn = [draw(chart) for chart in charts]
    class_ = "figures small" if small else "figures"
    return tag("div", *drawn, class_=class_) if drawn else Html("")


SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def pretty(unit: str) -> str:
    """A unit as it is printed: ``1e8 m^3`` becomes ``10⁸ m³``, ``N*s/m`` becomes ``N s/m``."""
    text = re.sub(r"\b1e(-?\d+)", lambda m: "10" + _above(m[1]), tidy(unit))
    return _raised(text).replace("*", " ")


def prose(sentence: str) -> str:
    """A sentence with its units and signs as they are printed."""
    text = re.sub(r"\bx 1e(-?\d+)", lambda m: "× 10" + _above(m[1]), sentence)
    return _raised(text).replace("+-", "±")


def _above(power: str) -> str:
    """An exponent as superscripts, without the zero that Python writes before it."""
    return str(int(power)).translate(SUPERSCRIPT)


def _raised(text: str) -> str:
    """With powers of names and of brackets as superscripts: ``m^2``, ``(m/s)^(-1)``."""
    power = r"(?<=[^\W_]|\))\^(?:\((-?\d+)\)|(-?\d+)(?!\.?\d))"
    return re.sub(power, lambda m: (m[1] or m[2]).translate(SUPERSCRIPT), text)


def label(name: str, unit: str) -> str:
    """``level [V]``."""
    return f"{name} [{pretty(unit)}]" if tidy(unit) else name


def measured(value: float | None, unit: str, digits: int = 3) -> str:
    """``256 × 10⁸ m³``."""
    return f"{number(value, digits)} {_times(unit)}{pretty(unit)}".strip()


def plus_minus(value: float | None, error: float | None, unit: str = "") -> str:
    """``0.52 ± 0.03 N``, ``(256 ± 12) × 10⁸ m³``."""
    if error is None:
        return measured(value, unit, 4)
    both = f"{number(value, digits(value, error, 4))} ± {number(error, 2)}"
    if _times(unit):
        both = f"({both})"
    return f"{both} {_times(unit)}{pretty(unit)}".strip()


def estimated(value: float | None, error: float | None, unit: str) -> str:
    """``0.52 ± 0.03 N``; in words where the data determine no number."""
    said = estimate(value, error, unit)
    return plus_minus(value, error, unit) if "+-" in said else prose(said)


def with_time(cause: Document) -> str:
    """The size of a cause with its standard error; of a delay in time, too, where the document has it.

    Of a wave its amplitude, which documents of earlier versions do not have.
    """
    if (amplitude := cause.get("amplitude")) is not None:
        return f"amplitude {estimated(amplitude, cause['amplitude_error'], cause['unit'])}"
    said = estimated(cause["size"], cause["standard_error"], cause["unit"])
    return said + prose(cause.get("late", ""))


def _times(unit: str) -> str:
    """What stands between a number and a unit that has a factor itself."""
    return "× " if factor(unit) else ""


def facts(items: Iterable[tuple[str, object]]) -> Html:
    """Names with values, side by side."""
    shown = [tag("div", tag("dt", name), tag("dd", value)) for name, value in items if value != ""]
    return tag("dl", *shown, class_="facts") if shown else Html("")


def cards(items: Iterable[tuple[str, str, object]]) -> Html:
    """The answers at a glance: (id of its section, question, answer)."""
    made = [
        tag("a", tag("h3", question), tag("div", answer), href=f"#{id_}", class_="answer")
        for id_, question, answer in items
    ]
    return tag("div", *made, class_="answers")


def equations(lines: Iterable[str], added: Iterable[str] = ()) -> Html:
    """Equations line by line; those that were added are marked."""
    old = [tag("code", line) for line in lines]
    new = [tag("code", line, class_="added") for line in added]
    return tag("div", *old, *new, class_="formulas") if old or new else Html("")


def capital(title: str) -> str:
    """With a capital letter first."""
    return title[:1].upper() + title[1:]


def p_value(of: Document) -> str:
    """``p = 0.012`` of what has one, ``p <= 0.0029`` where it is at its floor; also of one that is not there.

    Documents of earlier versions do not know about the floor.
    """
    value = of["p_value"]
    return probability(float("nan") if value is None else value, of.get("at_floor", False))


def signed(value: float | None) -> str:
    """A number with its sign."""
    return f"+{number(value)}" if value is not None and value > 0.0 else number(value)


def adopted(gain: Document, how: str) -> Html:
    """The decision with its reason; documents of before there were reasons have none."""
    said = "Adopted." if gain["adopt"] else "Not adopted: it does worse on held-out data."
    decision = gain.get("decision", {})
    tone = "good" if gain["adopt"] else "bad"
    if not gain["adopt"] and decision.get("outcome") in ("no evidence", "adopted"):
        tone = "warn"
    return tag("p", decision.get(how, said), class_=tone)


def without_gain(d: Document) -> Html:
    """Why there is no gain: nothing was added, or nothing was held out."""
    if NOT_MEASURED in d["notes"]:
        return tag("p", NOT_MEASURED, class_="warn")
    return tag("p", NOTHING_ADDED)


def folded(title: str, body: Html) -> Html:
    """What can be unfolded; nothing where there is nothing."""
    return tag("details", tag("summary", title), body) if body else Html("")
