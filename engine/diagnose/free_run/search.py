"""Rounds of the second criterion: screen, refit, choose on rows left out, until nothing is worth more.

In each round effects are screened to first order, alone and in pairs; the best are refitted, others beside
the leading refits, and those compared on rows that each fit has not seen (:mod:`.folds`). What is not worse
than the best, at ``NOT_WORSE`` for all of them together, survives. Survivors that run alike say the same in
other words, and one name stands for them; others are a set.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.null import Alarm, alarm
from engine.diagnose.free_run_fits.candidates import candidates
from engine.diagnose.free_run_fits.columns import CANNOT, columns
from engine.diagnose.free_run_fits.fitted import Fitted, Pick, Rival, finished, with_effects
from engine.diagnose.free_run_fits.folds import (
    Folds,
    folds_of,
    held_out_error,
    losses,
    p_better,
    times,
)
from engine.diagnose.free_run_fits.linear import Linear, Share
from engine.diagnose.refits.likeness import as_foreseen, rank
from engine.diagnose.refits.refitted import LEAST_ERRORS
from engine.diagnose.screening.screening import Progress
from engine.diagnose.search.search import part_of
from engine.statespace.model import Array, Theta
from engine.ties import held_as_open, is_open

STAGE = "free run"
SEEN, ENDED = 0.1, 0.9  # of a round: its alarm, and all but the ends of what survives
SINGLES, PAIRS = 10, 6  # refitted at most: effects alone, and in pairs
LEADS, BESIDE = 3, 4  # refits beside which others are looked for; how many, besides held parameters
LEAST = 0.02  # of the squared error: what an effect takes to first order, to be refitted
JUDGED = 16  # refits that are judged on rows left out ...
FAR = 16.0  # ... of squared errors up to so many times the least: a longer way is not made up for there
SIZES = (1.0, 0.2)  # of the first-order size, from which a refit starts
ENOUGH = 1.2  # of the squared error expected to first order: so near it another start is not tried
APART = 0.05  # of the residuals: two refits that differ less run alike
GAINED = 0.05  # p-value of a gain over the model without
NOT_WORSE = 0.10  # p-value of being no worse than the best, for all together
NEAR = 0.05  # of the error before: parameters that the model has survive where they lose no more
# of the error on rows left out: less is not worth an extension, nor a further parameter
WORTH = 0.1
EARNED = 0.25  # of the same: what a second effect must take beside the first


@dataclass(frozen=True, eq=False)
class Candidate:
    """A refit with the effects it adds, its losses (blocks,) on rows left out, and its own p-values.

    ``held_out`` is its error there: that of the model without, times what is typical of a block. ``p_gain`` is
    of no gain over the model without, ``p_best`` of being no worse than the best candidate.
    """

    fit: Fitted
    added: tuple[Effect, ...]
    losses: Array
    held_out: float
    p_gain: float
    p_best: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects that it adds."""
        return tuple(effect.name for effect in self.added)


@dataclass(frozen=True, eq=False)
class FreeRound:
    """One round: what noise explains, what was screened, what was judged (best first), what survives.

    ``survivors`` are groups of candidates that run alike, the leading name first in each.
    """

    fit: Fitted
    losses: Array
    alarm: Alarm
    screened: tuple[Share, ...]
    candidates: tuple[Candidate, ...]
    survivors: tuple[tuple[Candidate, ...], ...]
    level: float

    @property
    def held_out(self) -> float:
        """Error of the model without more on rows left out."""
        return held_out_error(self.losses)

    @property
    def alarmed(self) -> bool:
        """Whether the free run is further off than noise explains."""
        return self.alarm.p_value <= self.level

    @property
    def not_worse(self) -> float:
        """The p-value, of being no worse than another, at which one of all these is worse."""
        return NOT_WORSE / max(len(self.candidates), 1)

    @property
    def chosen(self) -> Candidate | None:
        """The candidate that the search goes on with."""
        return self.survivors[0][0] if self.survivors else None


def one_round(
    fit: Fitted,
    setting: Setting,
    noisy: Array,
    kinds: Sequence[str] | None,
    rivals: Sequence[Rival],
    alpha: float,
    seed: int,
    progress: Progress,
    more: bool = True,
    ahead: Theta | None = None,
) -> FreeRound:
    """One round beyond ``fit``; ``noisy`` its theta with the noise of the data, ``rivals`` answers to try.

    Nothing is added unless ``more``. ``ahead`` is the likelihood's own fit of this model, where there is one.
    """
    progress(STAGE, 0.0)
    effects = candidates(fit, setting, kinds)
    linear = Linear(fit, columns(fit, effects))
    folds = folds_of(fit.records)
    progress(STAGE, 0.5 * SEEN)
    seen = alarm(linear, noisy, folds, seed, ahead, alpha)
    singles = linear.singles()
    own = losses(fit, folds)
    progress = part_of(progress, SEEN, ENDED)
    if seen.p_value > alpha or not linear.columns or not more:
        return FreeRound(fit, own, seen, tuple(singles), (), (), alpha)
    found = refits(fit, linear, effects, rivals, progress)
    answers = [frozenset(pick.effect.name for pick in rival.picks) for rival in rivals]
    worth = _worth_judging(found, len(fit.effects), answers)
    judged = _judged(fit, own, worth, folds, progress)
    progress(STAGE, 1.0)
    left = survivors(own, judged, setting, min(len(found), JUDGED), fit)
    return FreeRound(fit, own, seen, tuple(singles), tuple(judged), left, alpha)


def refits(
    fit: Fitted,
    linear: Linear,
    effects: Sequence[Effect],
    rivals: Sequence[Rival],
    progress: Progress,
) -> list[Fitted]:
    """Effects alone, in pairs, and beside the leading refits, each set of them once, the best fit first.

    Answers of others begin at their own parameters, too: from those of a fit without them there may be no way.
    """
    found: dict[frozenset[str], Fitted] = {}
    n = len(fit.names)

    def add(base: Fitted, picks: Sequence[Pick], share: float, *starts: Fitted) -> None:
        key = frozenset((*base.names[n:], *(pick.effect.name for pick in picks)))
        if key not in found:
            for start in (base, *starts):
                reached = min((f.cost for f in found.values()), default=np.inf)
                best = best_refit(start, picks, (1.0 - share) * base.cost, reached)
                if best is not None and best.cost < found.get(key, base).cost:
                    found[key] = best

    singles = [s for s in linear.singles() if s.share >= LEAST][:SINGLES]
    pairs = [s for s in linear.pairs(PAIRS) if s.share >= LEAST]
    answers = [(rival.picks, 1.0, (fit.begun_at(rival.beside),)) for rival in rivals]
    alone, both = ([(s.picks, s.share, ()) for s in some] for some in (singles, pairs))
    tried = [*answers, *alone, *both]
    for i, (picks, taken, starts) in enumerate(tried):
        progress(STAGE, 0.5 * i / len(tried))
        add(fit, picks, taken, *starts)
    one_more = [f for f in found.values() if len(f.names) == n + 1]
    # the model's, and so plausible
    own = [f for f in one_more if f.effects[-1].family == "parameter"]
    leads = _distinct(one_more)[:LEADS]
    leads += [f for f in own if f not in leads]
    for i, lead in enumerate(leads):
        progress(STAGE, 0.5 + 0.3 * i / len(leads))
        others = [effect for effect in effects if effect.name != lead.names[-1]]
        shares = Linear(lead, columns(lead, others)).singles()
        held = [s for s in shares[BESIDE:] if s.picks[0].effect.family == "parameter"]
        for share in (*shares[:BESIDE], *held):
            if share.share >= LEAST:
                add(lead, share.picks, share.share)
    return sorted(found.values(), key=lambda f: f.cost)


def best_refit(
    fit: Fitted, picks: Sequence[Pick], expected: float, reached: float
) -> Fitted | None:
    """From the first-order sizes, or smaller ones where these end far above ``expected``; None if impossible.

    ``reached`` is the least squared error that any refit has reached.
    """
    best = None
    for factor in SIZES:
        if best is not None and best.cost < ENOUGH * expected:
            break
        scaled = [Pick(pick.effect, factor * pick.size, pick.probe) for pick in picks]
        try:
            found = with_effects(fit, scaled, reached)
        except CANNOT:
            continue
        if np.isfinite(found.cost) and (best is None or found.cost < best.cost):
            best = found
    return best


def _distinct(fits: Iterable[Fitted]) -> list[Fitted]:
    """Sorted by their fit, without those that run like a better one."""
    out: list[Fitted] = []
    for fit in sorted(fits, key=lambda f: f.cost):
        if all(not alike(fit, other) for other in out):
            out.append(fit)
    return out


def alike(one: Fitted, other: Fitted) -> bool:
    """Whether two fits run alike, beside what they leave."""
    return bool(np.linalg.norm(one.e - other.e) <= APART * np.linalg.norm(other.e))


def _worth_judging(
    found: Sequence[Fitted], known: int, answers: Sequence[frozenset[str]]
) -> list[Fitted]:
    """The best fits, what they are made of (effects beyond the ``known`` ones, each alone), and ``answers``."""
    best = [fit for fit in found[:JUDGED] if fit.cost <= FAR * found[0].cost]
    parts = {name for fit in best[:LEADS] for name in fit.names[known:]}
    wanted = {frozenset((name,)) for name in parts} | set(answers)
    return best + [f for f in found[len(best) :] if frozenset(f.names[known:]) in wanted]


def _judged(
    base: Fitted, own: Array, found: Sequence[Fitted], folds: Folds, progress: Progress
) -> list[Candidate]:
    known = len(base.effects)
    rows = []
    for i, fit in enumerate(found):
        progress(STAGE, 0.8 + 0.2 * i / len(found))
        try:
            # fits without a fold go on from there, and one that was left on its way would be judged by them
            fit = finished(fit)
            rows.append((fit, losses(fit, folds)))
        except CANNOT:
            continue
    rows.sort(key=lambda row: times(row[1], own))
    error = held_out_error(own)
    return [
        Candidate(
            fit,
            fit.effects[known:],
            out,
            error * times(out, own),
            p_better(out, own),
            p_better(rows[0][1], out),
        )
        for fit, out in rows
    ]


def survivors(
    own: Array,
    judged: Sequence[Candidate],
    setting: Setting,
    among: int = 0,
    before: Fitted | None = None,
) -> tuple[tuple[Candidate, ...], ...]:
    """Of those that gain, what is not worse than the best, in groups that run alike; the first one is chosen.

    Effects must earn their place, however sure a small gain is, and so must parameters: of what is within
    ``EARNED`` of the best the fewest effects, of these what is within ``WORTH`` of their best, of these the
    fewest parameters. Others survive where they have no more of either. The best is the best of those judged,
    of ``among`` at least. They are added to the fit ``before``.
    """
    unsure = () if before is None else _open(before)
    gaining = [
        c
        for c in judged
        if c.p_gain <= GAINED
        and times(c.losses, own) ** 2 <= 1.0 - WORTH
        and _determined(c, unsure)
    ]
    if not gaining:
        return ()
    # the best of so many is better than it will be again
    level = NOT_WORSE / max(len(judged), among)
    few = min(len(c.added) for c in _within(EARNED, gaining))
    best, *others = (c for c in gaining if len(c.added) <= few)
    near = best.held_out + NEAR * held_out_error(own)
    left = [best] + [
        c
        for c in others
        if p_better(best.losses, c.losses) > level or (_of_the_model(c) and c.held_out <= near)
    ]
    close = _within(WORTH, left)
    fewest = min(c.fit.n_parameters for c in close)
    left = [c for c in left if c.fit.n_parameters <= fewest]
    left.sort(key=lambda c: (c not in close, -c.fit.n_parameters))
    groups: list[list[Candidate]] = []
    for candidate in left:
        for group in groups:
            if alike(candidate.fit, group[0].fit):
                group.append(candidate)
                break
        else:
            groups.append([candidate])
    for group in groups:
        group.sort(key=lambda c: (not _foreseen(c), rank(c.added, setting)))
    groups.sort(key=lambda group: not _of_the_model(group[0]))
    return tuple(map(tuple, groups))


def _errors(fit: Fitted, held: Sequence[int] = ()) -> Array:
    """Standard errors (k,) of the parameters that the run shows, with some held; inf of the tied ones."""
    k = fit.n_parameters
    rest = np.setdiff1d(np.arange(len(fit.p)), np.array(held, dtype=int))
    known = fit.problem.uncertainty(fit.e, fit.J[:, rest])
    errors = np.zeros(len(fit.p))
    errors[rest] = np.where(known.tied, np.inf, np.sqrt(np.maximum(np.diag(known.covariance), 0.0)))
    return errors[:k]


def _open(fit: Fitted) -> tuple[str, ...]:
    """Parameters that may as well be zero, such as all masses and forces together."""
    k = fit.n_parameters
    unsure = is_open(fit.p[:k], _errors(fit), LEAST_ERRORS)
    return fit.problem.names(fit.problem.active[unsure])


def _determined(candidate: Candidate, unsure: Sequence[str] = ()) -> bool:
    """Whether the sizes of all that it adds are away from zero; else it stands in for something else.

    So does what has a parameter of its own that the run does not show: a dead zone wider than the record is the
    straight line within it. What was ``unsure`` without it says nothing against a size that is as open.
    """
    fit = candidate.fit
    names = fit.problem.names(fit.problem.active)
    shown = {name for name, yes in zip(names, fit.problem.shows(fit.J), strict=True) if yes}
    p, may = fit.p[: len(names)], np.isin(names, unsure)
    errors = _errors(fit, held_as_open(p, may, lambda held: _errors(fit, held), LEAST_ERRORS))
    for effect in candidate.added:
        if effect.one_sided or effect.family == "parameter":  # a start value is no zero
            continue
        own = {p.name for p in effect.parameters} - {effect.spread}
        if not own & set(fit.free) <= shown:
            return False
        k = names.index(effect.size.name)
        if not abs(p[k]) >= LEAST_ERRORS * errors[k]:
            return False
    return True


def _within(share: float, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those whose error on rows left out is at most that much larger than the least."""
    best = min(candidates, key=lambda c: c.held_out).losses
    return [c for c in candidates if times(c.losses, best) <= 1.0 + share]


def _foreseen(candidate: Candidate) -> bool:
    """Whether one of its effects has the size that it must have, if it is the cause."""
    return any(as_foreseen(effect, candidate.fit) for effect in candidate.added)


def _of_the_model(candidate: Candidate) -> bool:
    """Whether only parameters that the model has were released: its author knows that such a thing exists."""
    return all(effect.family == "parameter" for effect in candidate.added)
