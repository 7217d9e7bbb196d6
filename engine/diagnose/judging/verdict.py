"""From the rounds of a search to a verdict and its causes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.diagnose.judging.findings import (
    AS_LIKELY,
    CONTRADICTED,
    LESS_LIKELY,
    SAME,
    WAS_LIKELIER,
    Cause,
    Detectable,
    LookAlike,
    Verdict,
)
from engine.diagnose.refits.amplitude import amplitude_of
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.likeness import as_foreseen, merely_wider
from engine.diagnose.refits.refitted import LEAST_ERRORS, Refit, further_parameters
from engine.diagnose.refits.rounds import MARGIN, UNNAMED_MARGIN, Round
from engine.diagnose.screening.score_columns import UNTESTABLE
from engine.diagnose.screening.screen import Screen
from engine.estimation.quasi_ml import QuasiFit
from engine.statespace.model import MixedModel, Theta
from engine.words import enumerated, number, probability, with_unit

POWER = 0.84  # normal quantile of 80 %
ALIKE = 0.7  # |cos| from which two effects are called look-alikes
PATCHES = 2  # effects in turn that are trusted; more stand for something else
LEFT = 0.2  # of alpha: a p-value of at most this says that something is left; alpha would fail true names
SHOWN = 5  # look-alikes listed, or all that are not ruled out where these are more
NEAREST = 3  # effects listed as what something more may be
RULED_OUT = 6.0  # of 2 x log-likelihood less costs: 20 times as likely; with less none is ruled out


def verdict_of(search: Search, alpha: float) -> Verdict:
    """The verdict: see the rules in :mod:`engine.diagnose`."""
    named = [r for r in search.rounds if r.equivalent]
    if not named:
        return Verdict.UNKNOWN if search.alarm_left else Verdict.NOTHING
    if search.alarm_left or any(map(unnamed_is_better, named)) or patchwork(search, alpha):
        return Verdict.UNKNOWN
    return names_of(search)


def names_of(search: Search) -> Verdict:
    """The verdict of a search whose names hold."""
    named = [r for r in search.rounds if r.equivalent]
    return Verdict.NAMED if all(len(set_of(r)) == 1 for r in named) else Verdict.SET


def doubts(search: Search, alpha: float) -> list[str]:
    """Why the names that were found are not said, in sentences."""
    named = [r for r in search.rounds if r.equivalent]
    names = " and ".join(r.refits[0].effect.name for r in named)
    out = [
        f"An unnamed force explains what {r.refits[0].effect.name} explains as well: the name is not trusted."
        for r in named
        if unnamed_is_better(r)
    ]
    if patches := patchwork(search, alpha):
        out.append(
            "What was found one step ahead looks like patches on a cause that is not in the catalogue: "
            f"{patches}. Register the effect you suspect and diagnose again."
        )
    elif named and search.alarm_left:
        last = search.rounds[-1]
        why = "no effect explains it" if last.refits else "max_effects leaves no room for it"
        p = probability(last.screen.p_value, last.screen.at_floor)
        out.append(
            f"Something more is seen one step ahead beside {names} ({p}), and {why}: no name is trusted."
        )
    elif search.small_rest:
        out.append(_more(search.rounds[-1].screen, names))
    elif named and not search.of_the_steps and not search.rounds[-1].equivalent:
        out.extend(_perhaps_more(search.rounds[-1].screen, names, alpha))
    return out


def _more(left: Screen, names: str) -> str:
    """A sentence on a small rest that has no name."""
    p = probability(left.p_value, left.at_floor)
    return (
        f"Something more is seen beside {names} ({p}), a small part of what was wrong, and nothing settles "
        f"what it is{_nearest(left)}. It may be how the data were made: a clock, another program's steps."
    )


def _nearest(left: Screen) -> str:
    """What a screen's best tests look like, in words after a sentence; "" where nothing was tested."""
    tested = [s for s in left.scores if not (s.effect.traits.unnamed or s.effect.traits.outliers)]
    nearest = sorted(tested, key=lambda s: (s.p_value, -s.statistic, s.effect.name))[:NEAREST]
    names = [s.effect.name for s in nearest]
    return f": it looks most like {enumerated(names, 'or')}" if names else ""


def _perhaps_more(left: Screen, names: str, alpha: float) -> list[str]:
    """A sentence on what a last screen sees at ``alpha``, though too little for a further name; or none.

    The more often one looks the less a chance finding may count, so a further effect must be seen more clearly
    than the first. But who has only the names would take the model with them for whole.
    """
    if left.p_value > alpha:
        return []
    p = probability(left.p_value, left.at_floor)
    return [
        f"Something more may be there beside {names} ({p}), less clearly seen than a further effect must be"
        f"{_nearest(left)}. To ask about it by itself, diagnose the extended model."
    ]


def patchwork(search: Search, alpha: float) -> str:
    """Why the effects found in turn look like patches on one cause that is not in the catalogue, "" if not.

    So they do where more than two are needed; where one of two is a property of the noise, which is
    how the rest of a cause looks that another effect explains in part, unless each gains more beside the
    other than by itself; or where something is still seen, at ``LEFT * alpha``, after two effects or after
    noise. Outliers, which hide others, count in the last rule only, and an error of the model's steps in none.
    Steps that came at one time, with pulses that are a part of them, count as one. So do a wave and its
    overtones.
    """
    # what the model's own steps get wrong is there beside whatever is found
    found = [one.effect for one in search.named if not as_foreseen(one.effect, one.fit)]
    same = {*search.at_once[1:], *_overtones(search)}
    found = [effect for effect in found if effect.name not in same]
    effects = counted(found)
    noises = [effect.name for effect in effects if effect.family == "noise"]
    if len(effects) > PATCHES:
        return f"more than {PATCHES} effects are needed"
    if noises and len(effects) > 1 and not search.has_noise_apart:
        return f"{noises[0]} is a property of the noise, as what another effect leaves of a cause looks"
    still = not (search.rounds[-1].equivalent or search.of_the_steps)
    if still and (noises or len(found) > 1):
        left = search.rounds[-1].screen
        if left.p_value <= LEFT * alpha:
            names = " and ".join(effect.name for effect in found)
            return f"something is still seen beside {names} ({probability(left.p_value, left.at_floor)})"
    return ""


def _overtones(search: Search) -> list[str]:
    """Harmonics at a multiple of the frequency of another: what repeats, as a season does, is no pure wave."""
    waves = []
    for effect in (one.effect for one in search.named):
        if effect.traits.course is not Course.HARMONIC:
            continue
        fit, name = search.final, effect.timing.name
        if name in fit.free:
            waves.append((effect.name, fit.theta[name], fit.standard_errors[fit.free.index(name)]))
    return [
        name
        for name, f, error in waves
        if any(
            (k := round(f / lowest)) > 1
            and abs(f - k * lowest) <= LEAST_ERRORS * np.hypot(error, k * own)
            for _, lowest, own in waves
        )
    ]


def counted(effects: Iterable[Effect]) -> list[Effect]:
    """Those that count: outliers hide others, and a drift and its bend are one."""
    return [e for e in effects if not (e.traits.outliers or e.traits.bends)]


def unnamed_is_better(found: Round) -> bool:
    """Whether the unnamed force explains at least as much as the best named effect."""
    return found.generic is not None and found.generic.score >= found.refits[0].score


def set_of(found: Round) -> tuple[str, ...]:
    """Names of the effects that cannot be told apart, the best first."""
    names = [r.effect.name for r in found.equivalent]
    generic = found.generic
    if generic is not None and generic.score >= found.refits[0].score - UNNAMED_MARGIN:
        names.append(generic.effect.name)
    return tuple(names)


def named_by(search: Search) -> tuple[Cause, ...]:
    """The causes it names, in the order in which they were found."""
    named = [r for r in search.rounds if r.equivalent]
    causes = [cause_of(r, search.final) for r in named]
    names = [cause.effect for cause in causes]
    looked_back = not any(r.refits[0].effect.traits.outliers for r in named)
    for k, cause in enumerate(causes):
        if looked_back and cause.effect not in search.unweighed:
            causes[k] = replace(cause, beside=tuple(n for n in names if n != cause.effect))
    return tuple(causes)


def cause_of(found: Round, final: QuasiFit | None = None) -> Cause:
    """The best effect of a round, with what was held against it; its size as in the ``final`` fit, if given.

    The round's own fit knows nothing of what was found later, and the size in it has that mixed in.
    """
    best = found.refits[0]
    effect = best.effect
    if final is not None and effect.size.name in final.free:
        best = replace(best, fit=final)
    amplitude, amplitude_error = amplitude_of(effect, best.fit)
    return Cause(
        effect.name,
        effect.title,
        effect.family,
        effect.equation,
        best.size,
        effect.size.unit,
        best.standard_error,
        {p.name: float(best.fit.theta[p.name]) for p in effect.parameters},
        found.screen.p_value,
        best.gain,
        set_of(found),
        _look_alikes(found, best),
        units={p.name: p.unit for p in effect.parameters},
        at_floor=found.screen.at_floor,
        amplitude=amplitude,
        amplitude_error=amplitude_error,
    )


def _look_alikes(found: Round, best: Refit) -> tuple[LookAlike, ...]:
    """Effects with a similar footprint, or refitted with a similar gain.

    First all that the data leave open, the likeliest first: what has more parameters gains more than a plainer
    one that is likelier. Then as many that are ruled out, or were not followed, as make SHOWN.
    """
    names = [s.effect.name for s in found.screen.scores]
    place = names.index(best.effect.name) if best.effect.name in names else None
    refits = {r.effect.name: r for r in found.refits}
    against = [r.effect.name for r in found.contradicted]
    near = [r for r in found.refits if r.score >= best.score - MARGIN]
    out: list[tuple[bool, float, LookAlike]] = []
    for i, score in enumerate(found.screen.scores):
        other = score.effect
        if other.name == best.effect.name or score.statistic <= 0.0:
            continue
        likeness = 0.0 if place is None else found.screen.likeness(place, i)
        refit = refits.get(other.name)
        if likeness < ALIKE and refit is None:
            continue
        # close in score and yet not in the set: the plainer name was kept, for the same thing or a part of it
        same = refit is not None and refit.score >= best.score - MARGIN
        followed = refit is not None and not refit.fit.given_up  # only then can it be ruled out
        as_likely = refit is not None and refit.gain >= best.gain - MARGIN
        behind = 0.0 if refit is None else best.score - refit.score
        worse = followed and not same and not as_likely and other.name not in set_of(found)
        less = 0.0 if refit is None else min(best.gain - refit.gain, behind)
        ruled_out = worse and less > RULED_OUT  # parameters more are no evidence against it
        difference = best.effect.look_alikes.get(other.kind, "")
        ahead = behind < (0.0 if other.traits.outliers else -MARGIN)
        if other.name in against:
            difference = CONTRADICTED
        elif ahead and other.name not in set_of(found):  # outliers of a state, see the search
            difference = WAS_LIKELIER
        elif same and other.name not in set_of(found):
            difference = AS_LIKELY if merely_wider(refits[other.name], near) else SAME
        elif as_likely and other.name not in set_of(found):
            difference = AS_LIKELY
        elif worse and not ruled_out:
            difference = f"{LESS_LIKELY} {number(np.exp(0.5 * less), 2)}, too little to rule it out"
            more = further_parameters(other) - further_parameters(best.effect)
            if more > 0:
                difference += f", and has {more} parameter{'s' * (more > 1)} more"
        gain = refit.gain if refit else None
        is_open = refit is not None and followed and not ruled_out
        known = 10.0 * likeness if refit is None else refit.score if is_open else refit.gain
        out.append((is_open, known, LookAlike(other.name, likeness, gain, ruled_out, difference)))
    out.sort(key=lambda one: one[:2], reverse=True)
    most = max(SHOWN, sum(is_open for is_open, *_ in out))
    return tuple(one for *_, one in out[:most])


def detectable_of(seen: Screen, refitted: Sequence[Refit] = ()) -> tuple[Detectable, ...]:
    """The smallest size of each effect that a screen would have shown with 80 % probability.

    Without ``refitted`` ones that no screen shows and that gain by their refit all the same: slopes at size 0
    say too little of a limit, say, that few readings reach.
    """
    shown = {one.effect.name for one in refitted if one.gain > 0.0}
    out = []
    for score in seen.scores:
        if score.effect.traits.unnamed or score.effect.traits.outliers:
            continue  # a detector, and a test whose power is not in its size
        smallest = (np.sqrt(seen.threshold * score.boldness) + POWER) * score.se
        testable = bool(np.isfinite(score.se) and score.rho > UNTESTABLE)
        testable = testable and smallest <= max(map(abs, score.effect.size.bounds))
        if not testable and score.effect.name in shown:
            continue
        out.append(
            Detectable(
                score.effect.name,
                score.effect.title,
                score.effect.size.unit,
                float(smallest) if testable else float("inf"),
                score.rho,
                testable,
            )
        )
    return tuple(sorted(out, key=lambda d: d.effect))


def at_most_in_words(
    extended: MixedModel, theta: Theta, causes: Sequence[Cause], free: Sequence[str]
) -> list[str]:
    """Sentences about causes whose size is the most that is looked for, such as a delay's longest.

    And about those with another of their ``free`` parameters at an end of its range, where an effect becomes
    another one: a path that takes longer than the record goes on is a drift, whatever its input does.
    """
    out = []
    for cause in causes:
        name, *others = cause.parameters or [""]  # the size comes first
        for other in extended.at_bounds(theta, [one for one in others if one in free]):
            p = extended.parameters[extended.index(other)]
            end = "most" if theta[other] > np.mean(p.bounds) else "least"
            out.append(
                f"{other} is the {end} that is looked for, {with_unit(float(theta[other]), p.unit)}: there "
                f"{cause.effect} may stand for an effect of another kind."
            )
        if not extended.at_bounds(theta, [name]):
            continue
        p = extended.parameters[extended.index(name)]
        most = float(p.bounds[1])
        whole = most == 1.0 and p.unit == "1"  # a share: a sensor that clips does so entirely
        if theta[name] > np.mean(p.bounds) and not whole:
            out.append(
                f"The size of {cause.effect} is the most that is looked for, {with_unit(most, p.unit)}: it may "
                "be more."
            )
    return out
