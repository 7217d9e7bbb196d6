"""The causes that a diagnosis weighed against each other, by the criterion that decided.

Of a diagnosis at hand, and of its document: what :func:`to_ask` writes down is read again by
:func:`engine.design.candidates.before_any`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.design.candidates import (
    INFORMATION,
    NOTHING,
    TOGETHER,
    Candidate,
    Question,
    alarm_of,
    check_number,
    unsuited,
)
from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import FreeRunSearch, noise_fit
from engine.diagnose.judging.findings import Verdict
from engine.errors import OptionError
from engine.estimation.quasi_ml import QuasiFit

MOST = 5  # causes at most: of more, the nearest
NEAREST = 3  # names that are nearest to an ``unknown``


@dataclass(frozen=True, eq=False)
class Rival:
    """What a diagnosis weighed: effects that were refitted together, and their score."""

    effects: tuple[Effect, ...]
    fit: QuasiFit
    score: float

    @property
    def name(self) -> str:
        """Of its effects."""
        return TOGETHER.join(effect.name for effect in self.effects)

    @property
    def unsuited(self) -> str:
        """Why no input can be designed for it; "" where one can."""
        return next((reason for effect in self.effects if (reason := unsuited(effect))), "")

    def candidate(self, setting: Setting) -> Candidate:
        """As a cause to tell apart; times that the likelihood jumps at stay where they are."""
        fit = self.fit
        sought = {name for effect in self.effects for name in effect.sought}
        free = tuple(name for name in fit.free if name not in sought)
        keep = [fit.free.index(name) for name in free]
        return Candidate.of(
            self.effects,
            setting,
            name=self.name,
            model=fit.model,
            theta=np.asarray(fit.theta),
            free=free,
            information=np.asarray(fit.information)[np.ix_(keep, keep)],
            lead=self.score,
        )


@dataclass(frozen=True, eq=False)
class Rivals:
    """What a diagnosis weighed against each other.

    ``before`` is the fit without them, with what was ``taken`` in earlier rounds; ``several`` are those to tell
    apart, the best first, ``every`` are all that were refitted.
    """

    before: QuasiFit
    taken: tuple[Effect, ...]
    several: tuple[Rival, ...]
    every: tuple[Rival, ...]


def of_diagnosis(diagnosis: Diagnosis, causes: Sequence[str] | None) -> Question:
    """The causes that a diagnosis could not tell apart, or those named.

    Of a ``set`` the causes in it; of an ``unknown`` the nearest names too; else the cause and its nearest
    rivals. Raises OptionError where there are not two, or one was not refitted.
    """
    rivals = rivals_of(diagnosis)
    before = rivals.before
    chosen, notes = [], []
    if causes is None:
        if not rivals.several:
            raise OptionError(
                f"the diagnosis says '{diagnosis.verdict.value}': it weighed no causes that an experiment "
                "could tell apart; give a model in place of the diagnosis, and causes= with their sizes",
                "causes",
            )
        wanted = rivals.several
    else:
        known = {one.name: one for one in rivals.every}
        for name in causes:
            if name not in known:
                raise OptionError(
                    f"cause '{name}' was not refitted in the diagnosis; there are "
                    f"{', '.join(known) or 'none'}",
                    "causes",
                )
        wanted = tuple(known[name] for name in dict.fromkeys(causes))
    for one in wanted:
        if one.unsuited:
            notes.append(f"{one.name} was left out: {one.unsuited}.")
        else:
            chosen.append(one)
    if len(chosen) > MOST:
        notes.append(f"Of {len(chosen)} causes the {MOST} nearest are compared.")
    setting = Setting(before.model)
    out = [one.candidate(setting) for one in chosen[:MOST]]
    check_number([one.name for one in out], notes)
    if diagnosis.verdict is Verdict.UNKNOWN:
        notes.append("The diagnosis ended in 'unknown': the true cause may be none of these.")
    return Question(
        tuple(out),
        Candidate(
            NOTHING,
            "none of them",
            before.model,
            np.asarray(before.theta),
            tuple(before.free),
            np.asarray(before.information),
        ),
        alarm_of(diagnosis.search.rounds[0].screen.threshold),
        diagnosis.measured,
        tuple(notes),
    )


def rivals_of(diagnosis: Diagnosis) -> Rivals:
    """By the criterion that decided: of the first round that leaves several, or of the last."""
    told = diagnosis.free_run
    if told is not None and told.decides and told.search is not None and told.search.found:
        return _by_free_run(told.search)
    rounds = [r for r in diagnosis.search.rounds if r.refits]
    if not rounds:
        return Rivals(diagnosis.search.base, (), (), ())
    chosen = next((r for r in rounds if len(r.equivalent) > 1), rounds[-1])
    k = rounds.index(chosen)
    before = diagnosis.search.base if k == 0 else rounds[k - 1].refits[0].fit
    every = [Rival((r.effect,), r.fit, r.score) for r in chosen.refits]
    several = [Rival((r.effect,), r.fit, r.score) for r in chosen.equivalent]
    if len(several) < 2 or diagnosis.verdict is Verdict.UNKNOWN:
        names = {one.name for one in several}
        several += [one for one in every if one.name not in names][:NEAREST]
    taken = tuple(r.refits[0].effect for r in rounds[:k])
    return Rivals(before, taken, tuple(several), tuple(every))


def _by_free_run(found: FreeRunSearch) -> Rivals:
    """The same where the free run decided: groups of refits that run alike, each by its leading name."""
    rounds = [r for r in found.rounds if r.survivors]
    chosen = next((r for r in rounds if len(r.survivors) > 1), rounds[-1])
    leading = [group[0] for group in chosen.survivors]
    if len(leading) < 2:
        alike = {c.names for c in chosen.survivors[0]}
        leading += [c for c in chosen.candidates if c.names not in alike][:NEAREST]
    several = tuple(Rival(c.added, noise_fit(c.fit), 0.0) for c in leading)
    earlier = [r.chosen for r in rounds[: rounds.index(chosen)] if r.chosen is not None]
    taken = tuple(effect for one in earlier for effect in one.added)
    return Rivals(noise_fit(chosen.fit), taken, several, several)


def to_ask(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What a design needs to know of a diagnosis, as values for JSON; None where it weighed fewer than two.

    ``with`` are effects to add to the diagnosed model first, ``theta`` and ``free`` are of that; ``causes``,
    ``alarm`` and ``measured`` are as :func:`before_any` takes them.
    """
    rivals = rivals_of(diagnosis)
    if len(rivals.several) < 2:
        return None
    return {
        "with": [effect.name for effect in rivals.taken],
        "theta": rivals.before.theta.asdict(),
        "free": list(rivals.before.free),
        "causes": {one.name: _told(one.fit) for one in rivals.several},
        "alarm": diagnosis.search.rounds[0].screen.threshold,
        "measured": list(diagnosis.measured),
    }


def _told(fit: QuasiFit) -> dict[str, Any]:
    """What a record told of a cause: its parameters and, where it is in numbers, the information."""
    information = np.asarray(fit.information)
    if not np.isfinite(information).all():
        return fit.theta.asdict()
    return {
        **fit.theta.asdict(),
        INFORMATION: {"free": list(fit.free), "matrix": information.tolist()},
    }
