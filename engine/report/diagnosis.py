"""The report of a diagnosis: the verdict at a glance, then the four questions, then what was testable."""

from __future__ import annotations

import math
from typing import Any

from engine.report.asked import asked_first
from engine.report.chart import Chart, Trace
from engine.report.comparison import (
    TIME,
    against_data,
    auxiliary_figures,
    errors_over_time,
    fits,
    residual_figures,
    sentences,
    where_it_is,
)
from engine.report.html import Html, bullets, join, table, tag
from engine.report.parts import (
    Document,
    Drawer,
    Report,
    cards,
    equations,
    facts,
    grid,
    label,
    measured,
    plus_minus,
    pretty,
    prose,
    section,
)
from engine.report.svg import hbars
from engine.words import listed, number, percent, probability

TONE = {"nothing": "good", "named": "accent", "set": "warn", "unknown": "warn"}
SHOWN = 12  # candidates in a picture


def diagnosis_report(d: Document, draw: Drawer) -> Report:
    """The whole report."""
    units = d["channels"]["outputs"]
    symptoms = d["symptoms"]
    return Report(
        f"Diagnosis of the model {d['model']}",
        join([_verdict(d), _answers(d), grid(_hero(symptoms, units, draw))]),
        (
            *section(
                "wrong",
                "1. What is wrong",
                sentences(symptoms) or tag("p", "Nothing stands out."),
                fits(symptoms),
                grid(errors_over_time(symptoms, units, draw)),
                tag("h3", "Where the error lives"),
                where_it_is(symptoms, units, draw),
                tag("h3", "One-step predictions and their residuals"),
                tag(
                    "p",
                    "Pictures, not verdicts: a fitted process noise hides much from them.",
                    class_="hint",
                ),
                grid(against_data(symptoms["one_step"], "one_step", units, draw)),
                residual_figures(symptoms, draw),
                _folded("Auxiliary residuals", auxiliary_figures(symptoms, draw)),
            ),
            *section("cause", "2. The cause", *_cause(d, draw)),
            *section("extension", "3. The extension", *_extension(d)),
            *section("gain", "4. The gain", *_gain(d, units, draw)),
            *section("testable", "What these data could have shown", *_testable(d)),
            *section("notes", "Notes", bullets(d["notes"]), _seconds(d)),
        ),
    )


# ---- at a glance ------------------------------------------------------------------------------


def _verdict(d: Document) -> Html:
    word = tag("span", d["verdict"], class_=f"verdict {TONE[d['verdict']]}")
    said = tag("p", word, " ", d["sentence"], class_="said")
    names = [tag("p", _headline(cause), class_="cause") for cause in d["causes"]]
    if d["verdict"] == "unknown":
        names = [tag("p", "Closest: ", _headline(cause)) for cause in d["causes"]]
        if d["unnamed"]:
            names.insert(0, tag("p", prose(d["unnamed"]["sentence"]), class_="cause"))
    if not names:
        tested, seen = len(d["detectable"]), sum(x["testable"] for x in d["detectable"])
        text = (
            f"{tested} effects were looked for, {_p(d['p_value'])} for all of them together; {seen} of "
            "them would have been seen at the sizes listed below."
        )
        names = [tag("p", text)]
    return join([said, *names])


def _headline(cause: Document) -> Html:
    """``Coulomb friction 0.52 ± 0.03 N``, with the names it cannot be told from."""
    parts: list[object] = [
        tag("strong", _capital(cause["title"])),
        " ",
        plus_minus(cause["size"], cause["standard_error"], cause["unit"]),
    ]
    when = {k: v for k, v in cause["parameters"].items() if k.endswith(("_time", "_frequency"))}
    parts += [f", {k.rpartition('_')[2]} {number(v, 5)}" for k, v in when.items()]
    if len(cause["equivalent"]) > 1:
        others = listed(list(cause["equivalent"][1:]), "or")
        parts.append(tag("span", f", not told apart from {others}", class_="hint"))
    return join(parts)


def _capital(title: str) -> str:
    return title[:1].upper() + title[1:]


def _p(value: float | None) -> str:
    return probability(float("nan") if value is None else value)


def _answers(d: Document) -> Html:
    return cards(
        [
            ("wrong", "What is wrong", _wrong_at_a_glance(d["symptoms"])),
            ("cause", "The cause", _cause_at_a_glance(d)),
            ("extension", "The extension", _extension_at_a_glance(d)),
            ("gain", "The gain", _gain_at_a_glance(d["gain"])),
        ]
    )


def _wrong_at_a_glance(symptoms: Document) -> Html:
    run = symptoms["free_run"]
    if run is None:
        return Html("The free-running simulation runs away.")
    parts = []
    for f in run["fits"]:
        big = tag("b", measured(f["rmse"], f["unit"]))
        expected = f["expected_rmse"]
        more = f", where {measured(expected, f['unit'])} is expected" if expected else ""
        parts.append(tag("p", f"Simulated {f['output']} is ", big, f" rms off the data{more}."))
    if run["regions"]:
        parts.append(tag("p", f"Most telling: {_place(run['regions'][0])}.", class_="hint"))
    return join(parts)


def _place(region: Document) -> str:
    low, high = (measured(region[k], region["unit"]) for k in ("low", "high"))
    name = region["signal"]
    if region["lowest"]:
        where = f"{name} below {high}"
    elif region["highest"]:
        where = f"{name} above {low}"
    else:
        where = f"{name} between {low} and {high}"
    return f"{where} ({percent(region['share_error'])} of the squared error)"


def _cause_at_a_glance(d: Document) -> Html:
    if d["verdict"] == "unknown":
        said = tag("p", tag("b", "Unknown"), ": something acts that no known effect settles.")
        names = listed([cause["title"] for cause in d["causes"]])
        return join([said, tag("p", f"Closest: {names}", class_="hint") if names else ""])
    if not d["causes"]:
        return tag("p", f"None: {_p(d['p_value'])} for all effects together.")
    parts = []
    for cause in d["causes"]:
        name = tag("b", _capital(cause["title"]))
        parts.append(tag("p", name, f", {_p(cause['p_value'])}"))
        if len(cause["equivalent"]) > 1:
            rest = len(cause["equivalent"]) - 1
            parts.append(tag("p", f"or {rest} other{'s' * (rest > 1)} like it", class_="hint"))
    return join(parts)


def _extension_at_a_glance(d: Document) -> Html:
    if not d["causes"]:
        return tag("p", "None: the model stays as it is.")
    return join([tag("p", tag("code", cause["equation"])) for cause in d["causes"]])


def _gain_at_a_glance(gain: Document | None) -> Html:
    if gain is None:
        return tag("p", "Nothing was added, so nothing is gained or lost.")
    parts = []
    for o in gain["outputs"]:
        after = measured(o["rmse_after"], o["unit"])
        big = tag("b", f"{number(o['rmse_before'])} → {after}")
        parts.append(tag("p", f"Error of simulated {o['output']} on held-out data: ", big))
    if not parts:
        parts.append(tag("p", f"Log-density on held-out data: {_signed(gain['log_density'])}"))
    return join([*parts, _adopted(gain, "in_short")])


def _adopted(gain: Document, how: str) -> Html:
    """The decision with its reason; documents of before there were reasons have none."""
    said = "Adopted." if gain["adopt"] else "Not adopted: it does worse on held-out data."
    said = gain["decision"][how] if "decision" in gain else said
    return tag("p", said, class_="good" if gain["adopt"] else "bad")


def _hero(symptoms: Document, units: Document, draw: Drawer) -> list[Html]:
    figures = against_data(symptoms["free_run"], "free_run", units, draw, wide=True)
    return figures or against_data(symptoms["one_step"], "one_step", units, draw, wide=True)


# ---- the cause --------------------------------------------------------------------------------


def _cause(d: Document, draw: Drawer) -> list[object]:
    parts: list[object] = []
    for k, cause in enumerate(d["causes"]):
        title = _capital(cause["title"])
        parts.append(tag("h3", f"{k + 1}. {title}" if len(d["causes"]) > 1 else title))
        parts.append(
            facts(
                [
                    ("effect", tag("code", cause["effect"])),
                    ("size", plus_minus(cause["size"], cause["standard_error"], cause["unit"])),
                    ("p-value, all effects together", _p(cause["p_value"])),
                    ("2 × log-likelihood gained", number(cause["gain"])),
                    ("enters through", cause["where"]),
                ]
            )
        )
        parts.append(equations([], [cause["equation"]]))
        if cause["experiment"]:
            parts.append(tag("p", cause["experiment"], class_="advice"))
        if cause["look_alikes"]:
            parts += [tag("h4", "Look-alikes"), _look_alikes(cause["look_alikes"])]
    if not d["causes"]:
        parts.append(tag("p", "None named."))
    if d["unnamed"]:
        parts += [tag("h3", "An unnamed force"), tag("p", prose(d["unnamed"]["sentence"]))]
        parts.append(grid(_force(d["unnamed"], draw)))
    ranked = [_ranked(d["rounds"], k) for k in range(len(d["rounds"]))]
    if any(ranked):
        parts += [
            tag("h3", "Candidates and their evidence"),
            tag(
                "p",
                "Refitted effects: green could not be told apart; orange is the unnamed force, which a "
                "cause has to beat. Screened effects: the line is what a single one needs to be an alarm "
                "among all.",
                class_="hint",
            ),
            grid(ranked),
        ]
    untestable = [x["effect"] for x in d["detectable"] if not x["testable"]]
    if untestable:
        some = ", ".join(asked_first(untestable))
        rest = len(untestable) - len(asked_first(untestable))
        parts += [
            tag("h3", "Not testable with this experiment"),
            tag("p", f"{some}{f' and {rest} more' if rest else ''}: the data do not excite them, or the "
                "fitted parameters take up all they would show."),
            _folded("All that were not testable", tag("p", ", ".join(untestable)) if rest else Html("")),
        ]  # fmt: skip
    return parts


def _look_alikes(found: list[dict[str, Any]]) -> Html:
    rows = [
        (
            tag("code", o["effect"]),
            tag("span", "ruled out" if o["ruled_out"] else "not ruled out",
                class_="good" if o["ruled_out"] else "warn"),
            number(o["likeness"], 2),
            "" if o["gain"] is None else number(o["gain"]),
            o["difference"],
        )
        for o in found
    ]  # fmt: skip
    head = (
        "effect",
        "by these data",
        "likeness",
        "2 × log-likelihood gained",
        "what tells it apart",
    )
    return table(head, rows, "words")


def _ranked(rounds: list[dict[str, Any]], k: int) -> Html:
    found = rounds[k]
    name = f"Round {k + 1}: "
    if found["refitted"]:
        bars = [
            (r["title"], r["score"], "after" if r["equivalent"] else "data")
            for r in found["refitted"][:SHOWN]
        ]  # fmt: skip
        if found["unnamed"]:
            bars.append(("unnamed force", found["unnamed"]["score"], "before"))
        bars.sort(key=lambda bar: -bar[1])
        return hbars(f"{name}refitted effects", "2 × log-likelihood gained, less costs", bars)
    bars = [(x["title"], -math.log10(max(x["p_value"], 1e-300)), "data") for x in found["screened"]]
    needed = math.erfc(math.sqrt(0.5 * found["threshold"]))  # chi2 with one degree of freedom
    title = f"{name}screened effects"
    return hbars(
        title, "-log10 of each one's p-value", bars[:SHOWN], -math.log10(max(needed, 1e-300))
    )


def _force(force: Document, draw: Drawer) -> list[Html]:
    curves = force.get("curves")
    if not curves:
        return []
    mean, sd = curves["mean"], curves["standard_deviation"]
    pairs = list(zip(mean, sd, strict=True))
    low = [None if m is None or s is None else m - 2.0 * s for m, s in pairs]
    high = [None if m is None or s is None else m + 2.0 * s for m, s in pairs]
    one = Trace("force ± 2 standard deviations", mean, band=(low, high), role="before")
    return [
        draw(
            Chart(
                f"The unnamed force on {force['target']}",
                TIME,
                label("force", force["unit"]),
                curves["t"],
                (one,),
                level=(0.0,),
                wide=True,
            )
        )
    ]


# ---- the extension ----------------------------------------------------------------------------


def _extension(d: Document) -> list[object]:
    extension = d["extension"]
    before = extension["equations_before"]
    added = extension["equations"][len(before) :]
    parts: list[object] = []
    if not d["causes"]:
        parts.append(tag("p", "None: the model stays as it is."))
        parts.append(equations(before))
    else:
        parts += [tag("h3", "Before"), equations(before)]
        parts += [tag("h3", "After: the same, and"), equations([], added)]
    parts.append(_parameters(d))
    if d["causes"]:
        reference = extension["model"]
        call = f'get_model("{reference["name"]}", effects={reference["with"]!r})'
        parts.append(tag("p", "In the library: ", tag("code", call), class_="hint"))
    return parts


def _parameters(d: Document) -> Html:
    """Every parameter with its standard error: before, and after where something was added."""
    extension, before = d["extension"], d["base_theta"]
    rows: list[list[object]] = []
    for name, value in extension["theta"].items():
        known = name in before
        row: list[object] = [tag("code", name, class_=None if known else "added")]
        row.append(plus_minus(before[name], d["base_standard_errors"].get(name)) if known else "")
        if d["causes"]:
            row.append(plus_minus(value, extension["standard_errors"].get(name)))
        rows.append([*row, pretty(extension["units"][name])])
    head = (
        ["parameter", "before", "after", "unit"]
        if d["causes"]
        else ["parameter", "estimate", "unit"]
    )
    return table(head, rows, "numbers")


# ---- the gain ---------------------------------------------------------------------------------


def _gain(d: Document, units: Document, draw: Drawer) -> list[object]:
    gain = d["gain"]
    if gain is None:
        return [tag("p", "Nothing was added, so nothing is gained or lost.")]
    parts: list[object] = [
        tag(
            "p",
            f"On {gain['samples']} samples ({gain['how']}) that {_unseen(gain)}.",
        ),
        facts(
            [
                ("log-density gained", _signed(gain["log_density"])),
                ("per sample", plus_minus(gain["per_sample"], gain["standard_error"])),
                ("test of no gain (Diebold-Mariano)", _p(gain["p_value"])),
            ]
        ),
    ]
    rows = []
    for o in gain["outputs"]:
        low, high = (number(v) for v in o["interval_difference"])
        rows.append(
            (
                f"free run of {o['output']}",
                measured(o["rmse_before"], o["unit"]),
                measured(o["rmse_after"], o["unit"]),
                f"{number(o['difference'])} ({low} to {high})",
                f"{number(o['fit_before'])} % → {number(o['fit_after'])} %",
            )
        )
    if rows:
        head = ("", "rms before", "rms after", "difference (95 %)", "fit")
        parts.append(table(head, rows, "numbers"))
    parts += [_budget(gain), _adopted(gain, "in_full"), bullets(gain["notes"])]
    parts.append(grid(_held_out(gain, units, draw)))
    return parts


def _unseen(gain: Document) -> str:
    if gain["how"].endswith(("out of the fit", "in turn")):
        return "the estimation of the extension has not seen; its choice has seen most of them"
    return "neither the choice of the extension nor its estimation has seen"


def _signed(value: float | None) -> str:
    return f"+{number(value)}" if value is not None and value > 0.0 else number(value)


def _budget(gain: Document) -> Html:
    """Where the squared error of the free run went, as one bar per output."""
    budget = [b for b in gain.get("budget") or () if b["gone"] >= 0.0]
    if not budget:
        return Html("")
    rows = []
    for b in budget:
        parts, at = [], 0.0
        for key, role in (("gone", "after"), ("left", "before"), ("noise", "data")):
            width = max(100.0 * b[key], 0.0)
            parts.append(
                tag(
                    "rect",
                    x=f"{at:.2f}",
                    y=0,
                    width=f"{width:.2f}",
                    height=8,
                    class_=f"bar r-{role}",
                )
            )
            at += width
        bar = tag(
            "svg", *parts, viewBox="0 0 100 8", preserveAspectRatio="none", class_="budget",
            role="img",
            aria_label=f"{percent(b['gone'])} gone, {percent(b['left'])} left, {percent(b['noise'])} noise",
        )  # fmt: skip
        rows.append((b["output"], bar, *(percent(b[key]) for key in ("gone", "left", "noise"))))
    head = (
        "",
        "squared error of the free run before = 100 %",
        tag("span", tag("i", class_="swatch bars r-after"), "gone"),
        tag("span", tag("i", class_="swatch bars r-before"), "left"),
        tag("span", tag("i", class_="swatch bars r-data"), "noise"),
    )
    return join([tag("h3", "Error budget"), table(head, rows, "budget-table")])


def _held_out(gain: Document, units: Document, draw: Drawer) -> list[Html]:
    curves = gain.get("curves")
    if not curves:
        return []
    figures = []
    for name, unit in units.items():
        traces = [
            Trace(f"simulated {when} the extension", curves[when][name], "line", when)
            for when in ("before", "after")
            if curves[when] is not None
        ]
        traces.append(Trace("measured, held out", curves["measured"][name], "points", "data"))
        figures.append(
            draw(
                Chart(
                    f"Held-out data and simulation of {name}",
                    TIME,
                    label(name, unit),
                    curves["t"],
                    tuple(traces),
                    wide=True,
                )
            )
        )
    gained = Trace("log-density gained", curves["log_density"], "line", "after")
    figures.append(
        draw(
            Chart(
                "Log-density gained so far",
                TIME,
                "log-density",
                curves["t"],
                (gained,),
                level=(0.0,),
                wide=True,
            )
        )
    )
    return figures


# ---- what could have been seen ------------------------------------------------------------------


def _testable(d: Document) -> list[object]:
    rows = {
        x["effect"]: (
            tag("code", x["effect"]),
            x["title"],
            measured(x["smallest"], x["unit"]),
            percent(x["rho"]),
        )
        for x in d["detectable"]
        if x["testable"]
    }
    if not rows:
        return []
    head = ("effect", "", "smallest size found with 80 %", "share left by the parameters")
    first = asked_first(list(rows))
    rest = [row for name, row in rows.items() if name not in first]
    said = (
        "The smallest size of each effect that would have been found with 80 % probability, and the share of "
        "its trace in the data that the fitted parameters leave."
    )
    return [
        tag("p", said, class_="hint"),
        table(head, [rows[name] for name in first]),
        _folded(f"{len(rest)} more effects", table(head, rest) if rest else Html("")),
    ]


def _seconds(d: Document) -> Html:
    total = sum(d["seconds"].values())
    stages = ", ".join(f"{name} {number(s, 2)}" for name, s in d["seconds"].items())
    return tag("p", f"{number(total)} s in all: {stages}.", class_="hint")


def _folded(title: str, body: Html) -> Html:
    return tag("details", tag("summary", title), body) if body else Html("")
