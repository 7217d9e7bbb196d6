"""What is said of a search: its names, or why none of them is trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging.at_inputs import outliers_at_inputs
from engine.diagnose.judging.contradictions import already_there, as_open, folded, undetermined
from engine.diagnose.judging.dependent_rows import dependent_rows
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.lack_of_fit import LEVEL, LackOfFit, lack_of_fit
from engine.diagnose.judging.one_event import as_between_samples, as_one_event
from engine.diagnose.judging.small_rest import is_small
from engine.diagnose.judging.verdict import doubts, names_of, verdict_of
from engine.diagnose.refits.checkpoint import Kept
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import MARGIN, settle
from engine.diagnose.screening.tails import OUTLYING
from engine.diagnose.steps.step_error import decides
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, whitening
from engine.filters.sigma_point import moment_path
from engine.words import enumerated

NAMES = (Verdict.NAMED, Verdict.SET)
MANY = 1000.0  # times the model's noise: beyond it a number says nothing more
MISFIT = 2.0  # mean squared standardised innovation from which no name can be trusted
# Steps a sample, with which names that they decide between are left as a set, and sizes as they are.
ENOUGH = 4


@dataclass(frozen=True, eq=False)
class Judged:
    """A search, its first round as wide as its steps allow, and what it comes to.

    ``why`` are those of the ``notes`` that say why no name is trusted.
    """

    search: Search
    verdict: Verdict
    notes: tuple[str, ...]
    coarse: bool
    another_shape: bool
    refuted: tuple[str, ...]
    why: tuple[str, ...] = ()


def judged(
    base: QuasiFit,
    series: Series,
    setting: Setting,
    found: Search,
    *,
    alpha: float,
    seed: int,
    kept: Kept,
    unnamed: bool,
    read: bool,
) -> Judged:
    """What is said of a search: its names, or why none of them is trusted.

    None is where ``unnamed``; and how the record was ``read`` may be all that was found.
    """
    notes = []
    found, worth = _widened(found, series, setting, kept)
    if worth:
        notes.append(
            "What the steps of the model get wrong is worth as much as the lead of a name over others "
            f"(2 x log-likelihood {worth:.0f}): those within it are not told apart."
        )
    found, at_once = as_one_event(found, series)
    found, parts = as_between_samples(found, series)
    notes.extend(filter(None, [at_once, *parts]))
    verdict = verdict_of(found, alpha)
    if unnamed and verdict in NAMES:
        verdict = Verdict.UNKNOWN
    why = doubts(found, alpha)
    notes.extend(why)
    if found.of_the_steps:
        notes.append(
            f"Beside what was found, {found.of_the_steps} seemed to be seen. Most of it is gone with steps of "
            "the model half as long: it is what the steps get wrong, and no effect of its own. "
            "Likelihoods gained are those of the shorter steps, sizes those of the longer."
        )
    if found.unweighed:
        notes.append(
            f"Not compared with rivals beside all that was found: {', '.join(found.unweighed)}. Fits of "
            "several effects at once took too many iterations; the rivals are those of the round that found it."
        )
    if found.as_well:
        explain = "together explain" if len(found.as_well) > 1 else "explains"
        are = "are other causes" if len(found.as_well) > 1 else "is another cause"
        why.append(
            f"{enumerated(list(found.as_well))} {explain} the data as well as what was found, and {are}: these "
            "data do not tell which it is."
        )
        notes.append(why[-1])
        verdict = Verdict.UNKNOWN
    named = [r for r in found.rounds if r.equivalent]
    own_terms = already_there(named)
    against = [
        *undetermined(named, base),
        *own_terms.values(),
        *folded(named, series, setting),
        *outliers_at_inputs(named, base, series, seed),
    ]
    notes.extend(as_open(named, base))
    if against:
        notes.extend(against)
        why.extend(against)
        verdict = Verdict.UNKNOWN
    noises = [r.refits[0].effect.name for r in named if r.refits[0].effect.family == "noise"]
    if noises and verdict in NAMES and (told := dependent_rows(found.final, series, noises, seed)):
        notes.append(told)
        why.append(told)
        verdict = Verdict.UNKNOWN
    # beside an error of the steps every shape is in doubt
    doubted = verdict not in NAMES or read or bool(found.of_the_steps)
    shape = None if doubted else _shape_left(found, series, setting, seed)
    if shape is not None and is_small(shape.statistic, found, series):
        # the rest is of the cause's own shape, which decides between names that are as near as that
        wide = _with_all_within(found, shape.statistic, series, setting)
        notes.append(shape.of_a_rest if wide is found else shape.of_a_rest_that_decides)
        found, verdict, shape = wide, names_of(wide), None
    if shape is not None:
        notes.append(shape.sentence)
        why.append(shape.sentence)
        verdict = Verdict.UNKNOWN
    level = misfit(found.final, series, outliers=has_tails(found))
    if level > MISFIT:
        why.append(
            f"One-step errors are {_times(np.sqrt(level))} what the model's noise allows, after "
            "everything that was found: the model is far from these data, or badly started (theta=)."
        )
        notes.append(why[-1])
        verdict = Verdict.UNKNOWN
    # what shows only beside a term of the model acts elsewhere than its name says
    refuted = tuple(r.refits[0].effect.name for r in named) if own_terms else ()
    left = tuple(why) if verdict is Verdict.UNKNOWN else ()
    return Judged(found, verdict, tuple(notes), worth > 0.0, shape is not None, refuted, left)


def _widened(found: Search, series: Series, setting: Setting, kept: Kept) -> tuple[Search, float]:
    """The search with a first round that names all between which the error of the steps may decide.

    And what that error is worth, 0 where it decides nothing.
    """
    named = [r for r in found.rounds if r.equivalent]
    if not named or has_tails(found) or found.of_the_steps:
        return found, 0.0
    first, names = named[0], [r.refits[0].effect.name for r in named]
    try:
        worth = decides(
            first, names, found.final, series, setting, kept.within("half steps"), ENOUGH
        )
    except (EngineError, np.linalg.LinAlgError):
        return found, 0.0
    wide = _with_all_within(found, worth, series, setting)
    return (found, 0.0) if wide is found else (wide, worth)


def _with_all_within(found: Search, worth: float, series: Series, setting: Setting) -> Search:
    """The search with all in the set of its first name whose score is so near; itself where none is."""
    first = next(r for r in found.rounds if r.equivalent)
    refits = [*first.refits, *([] if first.generic is None else [first.generic])]
    wide = settle(first.screen, refits, series, setting, max(MARGIN, worth))
    if {*wide.equivalent} <= {*first.equivalent}:
        return found
    lead = first.refits[0]  # stays, as the last fit holds it
    wide = replace(wide, refits=_led(lead, wide.refits), equivalent=_led(lead, wide.equivalent))
    at = found.rounds.index(first)
    return replace(found, rounds=(*found.rounds[:at], wide, *found.rounds[at + 1 :]))


def _led(lead: Refit, refits: Sequence[Refit]) -> tuple[Refit, ...]:
    return (lead, *(one for one in refits if one is not lead))


def _shape_left(found: Search, series: Series, setting: Setting, seed: int) -> LackOfFit | None:
    """What is left beside the named effects and depends on the states, None without any.

    On the states that they push, where they do: it is their shape that is in doubt.
    """
    if has_tails(found):  # the moment filter does not see outliers
        return None
    named = [r.refits[0].effect for r in found.rounds if r.equivalent]
    pushed = {e.channel.rpartition("->")[2] for e in named if e.family == "state"}
    targets = [name for name in setting.targets if name in pushed] or setting.targets
    states = [name for name in setting.states if name not in setting.model.scale_states]
    lacks = lack_of_fit(found.final, series, targets, states, seed)
    return lacks if lacks is not None and lacks.p_value <= LEVEL else None


def has_tails(found: Search) -> bool:
    """Whether outliers are among what was found."""
    return any(r.refits[0].effect.traits.outliers for r in found.rounds if r.equivalent)


def misfit(fit: QuasiFit, series: Series, outliers: bool = False) -> float:
    """Mean squared standardised innovation: about 1 where the model's noise explains the data.

    With ``outliers`` the values that only they explain are left out.
    """
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    root = whitening(path.S, series.observed)
    z = np.einsum("tij,tj->ti", root, np.nan_to_num(path.innovations))
    usual = np.abs(z) < OUTLYING if outliers else np.ones_like(z, dtype=bool)
    return float((z[usual] ** 2).sum() / max(int((series.observed & usual).sum()), 1))


def _times(factor: float) -> str:
    """A ratio as one says it."""
    return f"{factor:.1f} times" if factor < MANY else f"more than {MANY:.0f} times"
