"""A cause in words: what it is, how large, when it happens, and what would tell it from others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from engine.data.series import Series
from engine.diagnose.effects.kinds.colored import LATENT
from engine.diagnose.effects.kinds.noise import RELATIVE
from engine.diagnose.judging.findings import (
    AS_GOOD,
    AS_LIKELY,
    CONTRADICTED,
    LESS_LIKELY,
    SAME,
    WAS_LIKELIER,
    Cause,
    LookAlike,
)
from engine.units import SECOND
from engine.words import digits, enumerated, estimate, moment, number, percent, with_unit

SAMPLES = "samples"  # the unit of a delay

UNTESTABLE = "the data do not excite them, or the fitted parameters take up all they would show"
NOTHING_ADDED = "Nothing was added, so nothing is gained or lost."

SMALLEST = (
    "The smallest size of each effect that would have been found with 80 % probability, and the share of its "
    "trace in the data that the fitted parameters leave"
)


def looked_for(p: str, testable: Sequence[bool]) -> str:
    """What is said where no cause was found, of effects that the data could have shown or not.

    ``p`` is the p-value of all of them together, in words.
    """
    return (
        f"{len(testable)} effects were looked for, {p} for all of them together. "
        f"{sum(testable)} of them would have been seen at the sizes listed below."
    )


def took(seconds: Mapping[str, float]) -> str:
    """How long a diagnosis took, in all and by its stages."""
    stages = ", ".join(f"{name} {number(s, 2)}" for name, s in seconds.items())
    return f"{number(sum(seconds.values()))} s in all: {stages}."


def headline(cause: Cause, step: float | None = None, clock: str = SECOND) -> str:
    """``Coulomb friction (coulomb:velocity) = 0.52 +- 0.03 N, p = 0.002``.

    ``step`` is the time between samples, if it is the same throughout, in ``clock``.
    """
    name = cause.title[:1].upper() + cause.title[1:]
    return (
        f"{name} [{cause.effect}]: {sized(cause)}{late(cause, step, clock)}{when(cause, step)}, "
        f"{cause.probability}{' when it was found' if cause.beside else ''}, "
        f"{_log_likelihood(cause.gain)}"
        f"{with_others(cause.together, cause.beside)}"
    )


def with_others(together: Sequence[str], beside: Sequence[str]) -> str:
    """`` together with y``, ``beside y``: what else has a part in the gain."""
    if together:
        return f" together with {enumerated(list(together))}"
    return f" beside {enumerated(list(beside))}" if beside else ""


def not_told_apart(equivalent: Sequence[str], together: Sequence[str]) -> str:
    """``not told apart from y or z``, of ``equivalent`` x, y and z for a cause x; "" where it is alone.

    Of several that were chosen ``together`` these are what other sets have in its place or in that of all.
    """
    if len(equivalent) < 2:
        return ""
    among = f", by itself or together with {enumerated(list(together))}," if together else ""
    return f"not told apart{among} from {enumerated(list(equivalent[1:]), 'or')}"


def sized(cause: Cause) -> str:
    """``0.52 +- 0.03 N``; of a wave, whose size is its cosine's, ``amplitude 0.158 +- 0.014 m/s``."""
    if cause.amplitude is not None:
        return f"amplitude {estimate(cause.amplitude, cause.amplitude_error, cause.unit)}"
    return estimate(cause.size, cause.standard_error, cause.unit)


def _log_likelihood(gain: float) -> str:
    if gain > 0.0:
        return f"2 x log-likelihood gained {gained(gain)}"
    return "seen in free run alone, as predictions one step ahead gain nothing"


def gained(gain: float | None) -> str:
    """2 x log-likelihood gained: what a free run finds may gain none one step ahead, beside process noise."""
    if gain is None:
        return ""
    return number(gain) if gain > 0.0 else "none"


def sample_step(series: Series) -> float | None:
    """The time from each sample to the next; None where it is not the same throughout."""
    return None if series.dt is None else series.dt * series.substeps


def in_time(value: float | None, unit: str, step: float | None, clock: str) -> str:
    """`` (0.02 s)`` of a number of samples that are ``step`` apart, in ``clock``; "" of all else."""
    if unit != SAMPLES or step is None or value is None or not math.isfinite(value):
        return ""
    return f" ({with_unit(value * step, clock)})"


def value_of(value: float, unit: str, error: float | None, clock: str, step: float | None) -> str:
    """A parameter to its error; one of ``clock`` that is not estimated, as when a step comes, as a time."""
    if unit == clock and error is None:
        return moment(value, step)
    return number(value, digits(value, error, 4))


def late(cause: Cause, step: float | None, clock: str) -> str:
    """`` (0.02 s)`` behind the size of a delay that is told in samples; "" of nearly all else.

    Behind a squared share of the reading, as which noise is estimated, `` (2.1 % of the reading)``; of a state
    `` (18 % of biomass in 1 year)``.
    """
    kind, _, channel = cause.effect.partition(":")
    if kind == RELATIVE:
        of = "the reading" if cause.unit == "1" else f"{channel} in 1 {clock}"
        return f" ({percent(math.sqrt(max(cause.size, 0.0)))} of {of})"
    told = cause.unit == SAMPLES and "+-" in estimate(cause.size, cause.standard_error, cause.unit)
    return in_time(cause.size, SAMPLES, step, clock) if told else ""


def when(cause: Cause, step: float | None = None) -> str:
    """``, time 1899 s`` of what happens once, ``, frequency 0.3 Hz`` of what repeats, limits of what has one.

    Of what goes on through the record, ``, over 300 s``: without it, the size of a drift could be a rate.
    Of what ends with the record in which it comes that is said, too.
    ``step`` is the time between samples, if it is the same throughout.
    """
    if cause.where != "time":
        return _limits(cause)
    told = {"time": "time", "end": "end", "frequency": "frequency", "per": "over"}
    own = [(name.rpartition("_")[2], name, value) for name, value in cause.parameters.items()]
    only = any(word == "stays" and value == 0.0 for word, _, value in own)
    return "".join(
        f", {told[word]} {moment(value, step, unit) if word in ('time', 'end') else with_unit(value, unit, 5)}"
        for word, name, value in own
        if word in told
        for unit in (cause.units.get(name, ""),)
    ) + (", in the record of that time only" if only else "")


def _limits(cause: Cause) -> str:
    """``, limit 5 kW``, ``, lower limit 1 m/s`` of what is lost below it, ``, limits -5 V and 5 V`` of both."""
    own = {name.rpartition("_")[2]: (name, value) for name, value in cause.parameters.items()}
    if "limit" not in own:
        return ""
    name, limit = own["limit"]

    def told(value: float) -> str:
        return with_unit(value, cause.units.get(name, ""), 5)

    # as :class:`engine.diagnose.effects.kinds.clip.Clip` has it
    side = own["side"][1] if "side" in own else 1.0
    if side < -0.5:
        return f", lower limit {told(limit)}"
    if side > 0.5:
        return f", limit {told(limit)}"
    if "zero" not in own:
        return f", limit {told(limit)} on both sides"
    low, high = sorted((limit, 2.0 * own["zero"][1] - limit))
    return f", limits {told(low)} and {told(high)}"


def standing(other: LookAlike, equivalent: Sequence[str]) -> str:
    """What the data say of another effect in the place of the cause."""
    if other.ruled_out:
        return "ruled out"
    if other.effect in equivalent:
        return "not told apart"
    if other.difference == SAME:
        return "the same here"
    if other.difference == CONTRADICTED:
        return "left out"
    if other.difference.startswith((AS_GOOD, AS_LIKELY, LESS_LIKELY, WAS_LIKELIER)):
        return "not ruled out"
    return "not ruled out" if other.gain is None else "behind, its refit left early"


def phrased(difference: str) -> str:
    """``is an odd function ...`` for what is written without its verb."""
    return f"is {difference}" if difference.startswith(("a ", "an ")) else difference


def experiment(cause: Cause) -> str:
    """What would tell the effects of a set apart."""
    others = [name for name in cause.equivalent if name != cause.effect]
    if not others:
        return ""
    differences = {o.effect: o.difference for o in cause.look_alikes if o.difference}
    known = [
        f"{name} {phrased(differences[name])}"
        for name in others
        if name in differences and not _force(name)
    ]
    if known:
        return f"To tell them apart, excite what differs: {'; '.join(known)}."
    if all(_force(name) for name in others):
        return (
            "To tell it from an unnamed force, repeat the experiment with the same inputs: what occurs "
            "again has a cause."
        )
    return (
        "To tell them apart, measure where they differ: other amplitudes, both directions, other "
        "frequencies or a longer record."
    )


def _force(effect: str) -> bool:
    """Whether an effect is an unnamed force."""
    return effect.partition(":")[0] == LATENT
