"""A diagnosis as a page for people."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from engine.diagnose.extended import at_bounds, in_the_library
from engine.diagnose.gain.adoption import NOT_MEASURED, in_full, in_short, ran_away
from engine.diagnose.refits.latent_force import UnnamedForce, unnamed_force
from engine.diagnose.refits.rounds import UNNAMED_MARGIN
from engine.errors import EngineError
from engine.presentation import over_horizon
from engine.presentation.cause_sentences import (
    NOTHING_ADDED,
    SMALLEST,
    UNTESTABLE,
    experiment,
    gained,
    headline,
    in_time,
    looked_for,
    not_told_apart,
    phrased,
    sample_step,
    standing,
    took,
    value_of,
)
from engine.presentation.report.priority import asked_first
from engine.words import (
    ends,
    enumerated,
    fit_quality,
    number,
    percent,
    probability,
    tidy,
    with_unit,
)

if TYPE_CHECKING:
    from engine.diagnose.diagnosis import Diagnosis
    from engine.diagnose.free_run.second_opinion import SecondOpinion
    from engine.diagnose.gain.gain import Gain
    from engine.diagnose.judging.findings import Cause, Detectable, Verdict

WIDTH = 100
NAMES = 36  # columns for the names of candidates


def page(diagnosis: Diagnosis, every: bool = False) -> str:
    """The verdict with its cause and gain, then the four questions, then what was testable.

    Of the sizes that would have been found, those are listed that are asked about first, or ``every`` one.
    """
    lines = [*_head(diagnosis)]
    for title, body in (
        ("1. What is wrong", _wrong(diagnosis)),
        ("2. The cause", _cause(diagnosis)),
        ("3. The extension", _extension(diagnosis)),
        ("4. The gain", _gain(diagnosis)),
        ("What these data could have shown", _testable(diagnosis, every)),
        ("Notes", _notes(diagnosis)),
    ):
        lines += ["", title, "-" * len(title), *body]
    return "\n".join(lines) + "\n"


def _head(d: Diagnosis) -> Iterator[str]:
    series = d.series
    outputs = enumerated(list(d.model.outputs))
    further = d.records - 1
    more = f", and {further} more record{'s' * (further > 1)}" if further else ""
    yield f"Diagnosis of model '{d.model.name}' on {len(series)} samples of {outputs}{more}"
    yield "=" * WIDTH
    yield from _wrapped(f"{d.verdict.value.upper()}: {d.verdict.sentence}", "")
    for fault in d.faults:
        yield from _wrapped(f"Look at the record first. {fault}", "  ")
    for said in d.stopped:
        yield from _wrapped(said, "  ")
    if d.by_record:
        yield from _wrapped(d.by_record, "  ")
    elif d.verdict.value == "unknown" and (known := _known(d)):
        yield from _wrapped(known, "  ")
    for said in d.why if d.causes else ():
        yield from _wrapped(said, "  ")
    for k, cause in enumerate(d.causes):
        closest = "Closest: " if d.verdict.value == "unknown" and k == 0 else ""
        yield from _wrapped(f"{closest}{_marker(d, k)}{_headline(d, cause)}", "  ")
        if others := not_told_apart(cause.equivalent, cause.together):
            yield from _wrapped(others, "      ")
        if cause.in_other_words:
            same = enumerated(list(cause.in_other_words), "or")
            yield from _wrapped(f"in other words, the same on these data: {same}", "      ")
        if cause.not_ruled_out:
            less = enumerated(list(cause.not_ruled_out), "or")
            yield from _wrapped(
                f"less likely or not as simple, but not ruled out: {less}", "      "
            )
    if d.verdict.value == "unknown" and d.over_horizon is not None and d.over_horizon.instead:
        yield from _wrapped(d.over_horizon.instead, "  ")
    if not d.causes:
        for said in d.why if d.verdict.value == "nothing" else ():
            yield from _wrapped(said, "  ")
        if d.unsearched is not None:
            yield from _wrapped(d.unsearched.sentence, "  ")
        said = looked_for(probability(d.p_value, d.p_at_floor), [x.testable for x in d.detectable])
        yield from _wrapped(said, "  ")
    if d.p_bootstrap is not None:
        p = probability(d.p_bootstrap, d.p_bootstrap_at_floor)
        yield from _wrapped(
            f"By parametric bootstrap (simulated, refitted, screened again): {p}.", "  "
        )
    if d.gain is not None:
        yield from _wrapped(gain_line(d.gain, d.trusted), "  ")


def _headline(d: Diagnosis, cause: Cause) -> str:
    return headline(cause, sample_step(d.series), d.series.time_unit)


def _marker(d: Diagnosis, k: int) -> str:
    return "" if len(d.causes) == 1 else f"{k + 1}. "


def _known(d: Diagnosis) -> str:
    """What is known of something that has no name: where it acts and how large it is."""
    force = unnamed(d)
    if force is not None:
        return force.sentence
    return d.symptoms.sentences[0] if d.symptoms.sentences else ""


def gain_line(gain: Gain, named: bool = True) -> str:
    """The gain in one line."""
    text = (
        f"On {gain.samples} held-out samples: log-density {_signed(gain.log_density)} "
        f"({probability(gain.p_value)} of no gain)"
    )
    for output in gain.outputs:
        if ran_away(output):
            text += f"; free run of {output.output} runs away"
            continue
        text += (
            f"; free run of {output.output} {with_unit(output.rmse_before, output.unit)} rms before, "
            f"{with_unit(output.rmse_after, output.unit)} after"
        )
    return f"{text}. {in_short(gain, named)}"


def _wrong(d: Diagnosis) -> Iterator[str]:
    if not d.symptoms.sentences:
        yield "  Nothing stands out."
    for sentence in d.symptoms.sentences:
        yield from _wrapped(sentence, "  - ")
    for w in d.symptoms.whiteness:
        yield from _wrapped(
            f"Standardised innovations of {w.output}: variance {number(w.variance)}, Ljung-Box "
            f"{probability(w.p_value)} over {w.lags} lags (no verdict rests on this: fitted noise hides much)",
            "  - ",
        )


def _cause(d: Diagnosis) -> Iterator[str]:
    if not d.causes:
        yield "  None named."
    for k, cause in enumerate(d.causes):
        yield from _wrapped(f"{_marker(d, k)}{_headline(d, cause)}; enters: {cause.where}", "  ")
        yield from _wrapped(cause.equation, "      ")
        for other in cause.look_alikes:
            state = standing(other, cause.equivalent)
            text = f"{other.effect}: {state} (likeness {number(round(other.likeness, 2))}"
            if other.gain is not None:
                text += f", 2 x log-likelihood gained {gained(other.gain)}"
            text += ")"
            if other.difference:
                text += f"; it {phrased(other.difference)}"
            yield from _wrapped(text, "      - ")
        advice = experiment(cause)
        if advice:
            yield from _wrapped(advice, "      ")
    force = unnamed(d)
    if force is not None:
        yield from _wrapped(force.sentence, "  ")
    if d.free_run is not None:
        yield from _wrapped(criteria(d.free_run), "  ")
    if d.over_horizon is not None:
        beside = asdict(d.over_horizon)
        yield from _wrapped(f"{over_horizon.said(beside)} {d.over_horizon.sentence}".rstrip(), "  ")
        yield from _columns([over_horizon.head(beside), *over_horizon.rows(beside)])


def _columns(rows: list[list[str]]) -> Iterator[str]:
    """Aligned: the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    widths[0] = min(widths[0], NAMES)
    for name, *cells in rows:
        lines = textwrap.wrap(name, NAMES, break_on_hyphens=False) or [""]
        yield from (f"      {line}" for line in lines[:-1])
        values = "  ".join(f"{x:>{w}}" for x, w in zip(cells, widths[1:], strict=True))
        yield f"      {lines[-1]:<{widths[0]}}  {values}"


def criteria(asked: SecondOpinion) -> str:
    """What each of the two criteria says, and which one decides."""
    said = [f"By the likelihood one step ahead: {_answer(asked.likelihood, asked.names)}."]
    if asked.search is not None:
        names = [name for candidate in asked.search.found for name in candidate.names]
        said.append(f"By the free run: {_answer(asked.search.verdict, names)}.")
    said.append(asked.reason)
    if asked.missing is not None:
        said.append(asked.missing.sentence)
    return " ".join(said)


def _answer(verdict: Verdict, names: Sequence[str]) -> str:
    return f"{verdict.value} ({enumerated(list(names))})" if names else verdict.value


def unnamed(d: Diagnosis) -> UnnamedForce | None:
    """Where an unnamed force acts, for a verdict ``unknown`` or a set that holds it."""
    generic = None
    for found in d.rounds:
        if found.generic is None:
            continue
        least = found.generic.score + UNNAMED_MARGIN
        beaten = bool(found.refits) and found.refits[0].score > least
        if d.verdict.value == "unknown" or not beaten:
            generic = found.generic
    if generic is None:
        return None
    try:
        return unnamed_force(generic, d.symptoms.series)
    except EngineError:
        return None


def _extension(d: Diagnosis) -> Iterator[str]:
    if not d.causes:
        yield "  None: the model stays as it is."
    elif d.gain is not None and not d.adopted:
        yield "  Not adopted, as 4 says: the model stays as it is. With what was found it would be"
    elif d.gain is None:
        yield "  Not judged, as 4 says. With what was found the model would be"
    yield from (f"  {line}" for line in d.model.equations)
    for line in list(d.extended.equations)[len(d.model.equations) :]:
        yield from _wrapped(line, "  + ")
    yield from _parameters(d)
    if d.causes:
        yield from _wrapped(in_the_library(d), "  ")


def _parameters(d: Diagnosis) -> Iterator[str]:
    """Every parameter: before, after and its standard error; only the estimate where nothing was added."""
    fit = d.after
    errors = dict(zip(fit.free, fit.standard_errors.tolist(), strict=True))
    first = f"{'before':>12} {'after':>12}" if d.causes else f"{'estimate':>12}"
    yield f"  {'parameter':<24} {first} {'+-':>10}  unit"
    for parameter in d.extended.parameters:
        name = parameter.name
        before = number(float(d.base_theta[name]), 4) if name in d.model.parameter_names else ""
        values = f"{before:>12} " if d.causes else ""
        error, value = "held", float(d.theta[name])
        shown = value_of(
            value, parameter.unit, errors.get(name), d.series.time_unit, sample_step(d.series)
        )
        values += f"{shown:>12}"
        if name in errors:
            error = number(errors[name], 2) if math.isfinite(errors[name]) else "unknown"
        if name in at_bounds(fit):
            error = "at bound"
        yield f"  {name:<24} {values} {error:>10}  {tidy(parameter.unit)}".rstrip()
    held = at_bounds(d.before) if d.causes else []
    if held:
        yield from _wrapped(f"Before, at a bound: {', '.join(held)}.", "  ")


def _gain(d: Diagnosis) -> Iterator[str]:
    gain = d.gain
    if gain is None:
        yield from _wrapped(NOT_MEASURED if NOT_MEASURED in d.notes else NOTHING_ADDED, "  ")
        return
    yield from _wrapped(
        f"One-step predictive log-density on {gain.samples} samples ({gain.how}): "
        f"{_signed(gain.log_density)} in all, {_signed(gain.per_sample)} +- "
        f"{number(gain.standard_error, 2)} per sample, {probability(gain.p_value)} "
        "(Diebold-Mariano, one-sided).",
        "  - ",
    )
    for o in gain.outputs:
        low, high = ends(*o.interval_difference, o.unit, 3)
        text = (
            f"Free run of {o.output}: {with_unit(o.rmse_before, o.unit)} rms before, "
            f"{with_unit(o.rmse_after, o.unit)} after (difference {number(o.difference)}, 95 % from {low} to "
            f"{high}); {fit_quality(o.fit_before)} before, {fit_quality(o.fit_after)} after"
        )
        if o.share_gone is not None:
            floor = with_unit(o.floor, o.unit)
            text += f"; {_share_gone(o.share_gone)} of the squared error above the noise ({floor}) is gone"
        yield from _wrapped(text + ".", "  - ")
    for note in gain.notes:
        yield from _wrapped(note, "  - ")
    yield from _wrapped(in_full(gain, d.trusted), "  ")


def _share_gone(share: float) -> str:
    return percent(min(share, 1.0)) if share > 0.0 else "none"


def _testable(d: Diagnosis, every: bool) -> Iterator[str]:
    yield from _wrapped(f"{SMALLEST}:", "  ")
    yes = {x.effect: x for x in d.detectable if x.testable}
    shown = list(yes) if every else asked_first(list(yes))
    for item in (yes[name] for name in shown):
        size = with_unit(item.smallest, item.unit)
        size += in_time(item.smallest, item.unit, sample_step(d.series), d.series.time_unit)
        yield f"  {item.effect:<34} {size:>22}   {percent(item.rho):>6}"
    if len(shown) < len(yes):
        yield f"  ... and {len(yes) - len(shown)} more: 'rbps diagnose --all', or .detectable in the library"
    no: list[Detectable] = [x for x in d.detectable if not x.testable]
    if no:
        names = [x.effect for x in no]
        some = names if every else asked_first(names)
        more = f" and {len(no) - len(some)} more" if len(some) < len(no) else ""
        named = f"{', '.join(some)}{more}"
        yield from _wrapped(f"Not testable with this experiment: {named}; {UNTESTABLE}.", "  ")


def _notes(d: Diagnosis) -> Iterator[str]:
    for note in d.notes:
        yield from _wrapped(note, "  - ")
    yield from _wrapped(took(d.seconds), "  - ")


def _signed(value: float) -> str:
    return f"+{number(value)}" if value > 0.0 else number(value)


def _wrapped(text: str, lead: str) -> list[str]:
    indent = " " * len(lead)
    lines = textwrap.wrap(
        text, WIDTH, initial_indent=lead, subsequent_indent=indent, break_on_hyphens=False
    )
    return lines or [""]
