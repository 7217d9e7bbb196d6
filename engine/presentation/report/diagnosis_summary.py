"""The top of a diagnosis' report: the verdict, and the four questions answered in a line or two."""

from __future__ import annotations

from engine.diagnose.judging.findings import AS_GOOD, AS_LIKELY, LESS_LIKELY, SAME
from engine.presentation.cause_sentences import looked_for, not_told_apart
from engine.presentation.report.html import Html, join, tag
from engine.presentation.report.parts import (
    Document,
    adopted,
    capital,
    cards,
    measured,
    p_value,
    prose,
    signed,
    with_time,
    without_gain,
)
from engine.words import bounds, enumerated, number, percent

APART = {  # look-alikes in the headline, by what their difference begins with
    "in other words the same on these data": (SAME,),
    "less likely or not as simple, but not ruled out": (AS_GOOD, AS_LIKELY, LESS_LIKELY),
}
TONE = {"nothing": "good", "named": "accent", "set": "warn", "unknown": "warn"}


def verdict(d: Document) -> Html:
    """The word, the sentence, and the names."""
    word = tag("span", d["verdict"], class_=f"verdict {TONE[d['verdict']]}")
    said = tag("p", word, " ", d["sentence"], class_="said")
    names = [tag("p", _headline(cause), class_="cause") for cause in d["causes"]]
    if d["verdict"] == "unknown":
        said = tag("p", word, " ", _known(d), class_="said")
        near = [
            ("" if k else "Nearest names: ", _headline(one)) for k, one in enumerate(d["causes"])
        ]
        why = [tag("p", prose(one)) for one in d.get("why", ()) if near]
        names = [tag("p", d["sentence"]), *why, *(tag("p", *one, class_="hint") for one in near)]
    if not names:
        testable = [x["testable"] for x in d["detectable"]]
        names = [tag("p", looked_for(p_value(d), testable))]
        if unsearched := d.get("unsearched"):
            names = [tag("p", prose(unsearched["sentence"])), *names]
        if d["verdict"] == "nothing":
            names = [*(tag("p", prose(one)) for one in d.get("why", ())), *names]
    faults = [tag("p", f"Look at the record first. {prose(one)}") for one in d.get("faults", ())]
    stopped = [tag("p", prose(one)) for one in d.get("stopped", ())]
    differ = [tag("p", prose(d["by_record"]))] if d.get("by_record") else []
    return join([said, *faults, *stopped, *differ, *names])


def _known(d: Document) -> str:
    """What is known of something that has no name: where it acts, how large it is, which curve shows it."""
    if d["unnamed"]:
        return f"{prose(d['unnamed']['sentence'])} Its course is drawn under the cause."
    symptoms = d["symptoms"]
    for what, said in (("free_run", "simulated"), ("one_step", "predicted")):
        run = symptoms[what]
        if run is not None and run["regions"]:
            worst, fit = run["regions"][0], run["fits"][0]
            return (
                f"The {said} {fit['output']} is {measured(fit['rmse'], fit['unit'])} rms off the data, most of "
                f"all {_place(worst)}; the curve below shows it."
            )
    return str(d["sentence"])


def _headline(cause: Document) -> Html:
    """``Coulomb friction 0.52 ± 0.03 N``, with the names it cannot be told from."""
    parts = [tag("strong", capital(cause["title"])), " ", with_time(cause), cause.get("when", "")]
    if others := not_told_apart(cause["equivalent"], cause.get("together", ())):
        parts.append(tag("span", f", {others}", class_="hint"))
    for words, begins in APART.items():
        names = [o["effect"] for o in cause["look_alikes"] if o["difference"].startswith(begins)]
        if names:
            parts.append(tag("span", f", {words}: {enumerated(names, 'or')}", class_="hint"))
    return join(parts)


def answers(d: Document) -> Html:
    """A card for each question."""
    return cards(
        [
            ("wrong", "What is wrong", _wrong_at_a_glance(d["symptoms"])),
            ("cause", "The cause", _cause_at_a_glance(d)),
            ("extension", "The extension", _extension_at_a_glance(d)),
            ("gain", "The gain", _gain_at_a_glance(d)),
        ]
    )


def _wrong_at_a_glance(symptoms: Document) -> Html:
    run = symptoms["free_run"]
    if run is None:
        return Html("The free-running simulation diverges.")
    parts = []
    for f in run["fits"]:
        big = tag("b", measured(f["rmse"], f["unit"]))
        parts.append(tag("p", f"Simulated {f['output']} is ", big, " rms off the data."))
        if f["expected_rmse"]:
            parts.append(tag("p", _expected(f), class_="hint"))
    if run["regions"]:
        parts.append(tag("p", f"Most telling: {_place(run['regions'][0])}.", class_="hint"))
    return join(parts)


def _expected(f: Document) -> str:
    """How much of the error is laid at the process noise, which says nothing for the model."""
    room = measured(f["expected_rmse"], f["unit"])
    if f["rmse"] <= f["expected_rmse"]:
        return (
            f"The model's process noise alone would give {room}, so an error of the model can hide in it. "
            "That is no evidence that the model is right."
        )
    return f"The model's process noise alone would give {room} only."


def _place(region: Document) -> str:
    low, high = (prose(end) for end in bounds(region["low"], region["high"], region["unit"]))
    name = region["signal"]
    if region["kind"] == "time":
        where = f"up to t = {high}" if region["lowest"] else f"from t = {low}"
        where += " on" if region["highest"] else "" if region["lowest"] else f" to {high}"
    elif region["lowest"]:
        where = f"{name} below {high}"
    elif region["highest"]:
        where = f"{name} above {low}"
    else:
        where = f"{name} between {low} and {high}"
    return f"{where} ({percent(region['share_error'])} of the squared error)"


def _cause_at_a_glance(d: Document) -> Html:
    if d["verdict"] == "unknown":
        said = tag("p", tag("b", "Unknown"), ": something acts that no known effect settles.")
        names = enumerated([cause["title"] for cause in d["causes"]])
        instead = (d.get("over_horizon") or {}).get("instead")
        hints = [f"Closest: {names}" if names else "", instead]
        return join([said, *(tag("p", hint, class_="hint") for hint in hints if hint)])
    if not d["causes"]:
        return tag("p", f"None: {p_value(d)} for all effects together.")
    parts = []
    for cause in d["causes"]:
        name = tag("b", capital(cause["title"]))
        parts.append(tag("p", name, f", {p_value(cause)}"))
        if len(cause["equivalent"]) > 1:
            rest = len(cause["equivalent"]) - 1
            parts.append(tag("p", f"or {rest} other{'s' * (rest > 1)} like it", class_="hint"))
    return join(parts)


def _extension_at_a_glance(d: Document) -> Html:
    if not d["causes"]:
        return tag("p", "None: the model stays as it is.")
    said = [tag("p", tag("code", cause["equation"])) for cause in d["causes"]]
    if d["gain"] is not None and not d["gain"]["adopt"]:
        said.append(tag("p", "Not adopted: the model stays as it is.", class_="hint"))
    elif d["gain"] is None:
        said.append(tag("p", "Not judged on other data.", class_="hint"))
    return join(said)


def _gain_at_a_glance(d: Document) -> Html:
    gain = d["gain"]
    if gain is None:
        return without_gain(d)
    parts = []
    for o in gain["outputs"]:
        after = measured(o["rmse_after"], o["unit"])
        big = tag("b", f"{number(o['rmse_before'])} → {after}")
        parts.append(tag("p", f"Error of simulated {o['output']} on held-out data: ", big))
    if not parts:
        parts.append(tag("p", f"Log-density on held-out data: {signed(gain['log_density'])}"))
    return join([*parts, adopted(gain, "in_short")])
