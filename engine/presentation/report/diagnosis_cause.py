"""The cause: what was named, its look-alikes, the evidence of the candidates, the unnamed force."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from engine.diagnose.judging.findings import LookAlike
from engine.presentation import over_horizon
from engine.presentation.cause_sentences import UNTESTABLE, gained, standing, with_others
from engine.presentation.report.chart import Chart, Numbers, Ranking, Trace
from engine.presentation.report.comparison import TIME, around
from engine.presentation.report.html import Html, table, table_of, tag
from engine.presentation.report.parts import (
    Document,
    Drawer,
    capital,
    equations,
    facts,
    folded,
    grid,
    label,
    p_value,
    prose,
    with_time,
)
from engine.presentation.report.priority import asked_first
from engine.words import number

RANKED_CANDIDATES = 12  # candidates in a picture
HOW_RANKED = (
    "Refitted effects: green could not be told apart; orange is the unnamed force, which a cause has to beat. "
    "Screened effects: the line is what a single one needs to be an alarm among all."
)


def cause_section(d: Document, draw: Drawer) -> list[object]:
    """Everything about it."""
    parts: list[object] = []
    for k, cause in enumerate(d["causes"], 1):
        title = capital(cause["title"])
        parts.append(tag("h3", f"{k}. {title}" if len(d["causes"]) > 1 else title))
        parts += _cause(cause)
    if not d["causes"]:
        parts.append(tag("p", "None named."))
    if d["unnamed"]:
        parts += [tag("h3", "An unnamed force"), tag("p", prose(d["unnamed"]["sentence"]))]
        parts.append(grid(force_charts(d["unnamed"]), draw))
    parts += two_criteria(d.get("free_run"), draw)
    if beside := d.get("over_horizon"):
        parts += [
            tag("h3", "Over the horizon"),
            tag("p", over_horizon.said(beside), class_="hint"),
            table(over_horizon.head(beside), over_horizon.rows(beside), "numbers"),
            tag("p", beside["sentence"]),
        ]
    if ranked := rankings(d["rounds"]):
        said = tag("p", HOW_RANKED, class_="hint")
        parts += [tag("h3", "Candidates and their evidence"), said, grid(ranked, draw)]
    if untestable := [x["effect"] for x in d["detectable"] if not x["testable"]]:
        first = asked_first(untestable)
        rest = len(untestable) - len(first)
        more = f" and {rest} more" if rest else ""
        every = tag("p", ", ".join(untestable)) if rest else Html("")
        parts += [
            tag("h3", "Not testable with this experiment"),
            tag("p", f"{', '.join(first)}{more}: {UNTESTABLE}."),
            folded("All that were not testable", every),
        ]
    return parts


def _cause(cause: Document) -> list[object]:
    about = facts(
        [
            ("effect", tag("code", cause["effect"])),
            ("size", with_time(cause)),
            ("p-value, all effects together", p_value(cause)),
            ("2 × log-likelihood gained", _gained(cause)),
            ("enters through", cause["where"]),
        ]
    )
    parts: list[object] = [about, equations([], [cause["equation"]])]
    if cause["experiment"]:
        parts.append(tag("p", cause["experiment"], class_="advice"))
    if cause["look_alikes"]:
        parts += [tag("h4", "Look-alikes"), _look_alikes(cause)]
    return parts


def _gained(cause: Document) -> str:
    return gained(cause["gain"]) + with_others(cause.get("together", ()), cause.get("beside", ()))


def two_criteria(asked: Document | None, draw: Drawer) -> list[object]:
    """What the likelihood and the free run say, which one decides, and the free run's candidates."""
    if not asked:
        return []
    rows = [("likelihood, one step ahead", asked["likelihood"], not asked["decides"])]
    if asked["free_run"]:
        rows.append(("free run, on rows left out", asked["free_run"], asked["decides"]))
    body = [
        (name, said["verdict"], ", ".join(said["effects"]), "decides" if decides else "")
        for name, said, decides in rows
    ]
    charts = [
        Ranking(
            f"Round {k}: what is left of the free run's error on rows left out",
            "per cent of the error without",
            [
                (" + ".join(c["effects"]), 100.0 * c["held_out"] / one["held_out"],
                 "after" if c["survives"] else "data")
                for c in one["judged"][:RANKED_CANDIDATES]
            ],
        )
        for k, one in enumerate(asked["rounds"], 1)
        if one["judged"]
    ]  # fmt: skip
    return [
        tag("h3", "Two criteria"),
        table(("criterion", "verdict", "effects", ""), body, "words"),
        tag("p", asked["reason"], class_="hint"),
        grid(charts, draw),
        *_missing(asked["missing"], draw),
    ]


def _missing(one: Document | None, draw: Drawer) -> list[object]:
    """The curve of a force that has no name."""
    if not one:
        return []
    title = f"A function of {one['source']} that acts on {one['target']}"
    x_label, curve = label(one["source"], one["source_unit"]), one["curve"]
    chart = _force(title, x_label, one["unit"], curve["x"], curve)
    told = "What the model's own parameters can do as well, such as its straight part, is not in the curve."
    return [tag("p", f"{one['sentence']} {told}"), grid([chart], draw)]


def _force(title: str, x_label: str, unit: str, x: Numbers, curve: Document) -> Chart:
    """A force with its band."""
    mean = curve["mean"]
    band = around(mean, curve["standard_deviation"], 2.0)
    one = Trace("force ± 2 standard deviations", mean, band=band, role="before")
    return Chart(title, x_label, label("force", unit), x, (one,), level=(0.0,))


def _look_alikes(cause: Document) -> Html:
    def told(o: LookAlike) -> Html:
        class_ = "good" if o.ruled_out else "warn"
        return tag("span", standing(o, cause["equivalent"]), class_=class_)

    return table_of(
        [LookAlike(**one) for one in cause["look_alikes"]],
        {
            "effect": lambda o: tag("code", o.effect),
            "by these data": told,
            "likeness": lambda o: number(round(o.likeness, 2)),
            "2 × log-likelihood gained": lambda o: gained(o.gain),
            "what tells it apart": lambda o: o.difference,
        },
        "words",
    )


def rankings(rounds: list[dict[str, Any]]) -> list[Ranking]:
    """The candidates of each round by their evidence."""
    ranked = (_ranked(found, f"Round {k}: ") for k, found in enumerate(rounds, 1))
    return [one for one in ranked if one.rows]


def _ranked(found: dict[str, Any], name: str) -> Ranking:
    if found["refitted"]:
        bars = [
            (r["title"], r["score"], "after" if r["equivalent"] else "data")
            for r in found["refitted"][:RANKED_CANDIDATES]
        ]
        if found["unnamed"]:
            bars.append(("unnamed force", found["unnamed"]["score"], "before"))
        bars = sorted(_finite(bars), key=lambda bar: -bar[1])
        return Ranking(f"{name}refitted effects", "2 × log-likelihood gained, less costs", bars)
    bars = [(x["title"], _evidence(x["p_value"]), "data") for x in found["screened"]]
    needed = math.erfc(math.sqrt(0.5 * found["threshold"]))  # chi2 with one degree of freedom
    shown, said = _finite(bars[:RANKED_CANDIDATES]), "-log10 of each one's p-value"
    return Ranking(f"{name}screened effects", said, shown, _evidence(needed))


def _evidence(p: float) -> float:
    return -math.log10(max(p, 1e-300))


def _finite(bars: list[tuple[str, float, str]]) -> list[tuple[str, float, str]]:
    return [bar for bar in bars if math.isfinite(bar[1])]


def force_charts(force: Document) -> list[Chart]:
    """The unnamed force over time with its band."""
    curves = force.get("curves")
    if not curves:
        return []
    title = f"The unnamed force on {force['target']}"
    return [replace(_force(title, TIME, force["unit"], curves["t"], curves), wide=True)]
