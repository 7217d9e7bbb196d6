"""Refits that say the same thing in other words, and which of their names stands for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.rates import moved_by
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.refitted import Refit, held_out_terms
from engine.errors import EngineError
from engine.statespace.model import Theta

NEEDED = 2.0  # of the score, that the wider kind must be ahead

SAME = 0.5  # sum of squared differences of log-densities below which two refits say the same
TIE = 0.5  # of the score: among refits that say the same, one this far behind the best fits as well


def distinct(refits: Sequence[Refit], series: Series, setting: Setting) -> tuple[Refit, ...]:
    """The refits without those that say the same in other words.

    A pulse on an integrator is a step of its reading: where two refits predict alike at every
    sample and fit as well, the plainer kind stands for both, or else the one that suits its channel:
    friction a velocity, stiffness a position (:class:`~engine.diagnose.effects.traits.Traits`).
    Where neither does, both stay; and so do a sensor's lasting fault and one of the plant: another repair.
    """
    refits = [r for r in refits if not merely_wider(r, refits)]
    if len(refits) < 2:
        return tuple(refits)
    terms = [held_out_terms(r.fit, series) for r in refits]
    ranks = [rank((r.effect,), setting) for r in refits]

    def stands_for(j: int, i: int) -> bool:
        fits_as_well = refits[j].score >= refits[i].score - TIE
        if not (fits_as_well and ranks[j] < ranks[i]):
            return False
        if repaired_elsewhere(refits[j].effect, refits[i].effect, setting):
            return False
        return float(((terms[i] - terms[j]) ** 2).sum()) < SAME

    n = len(refits)
    return tuple(refits[i] for i in range(n) if not any(stands_for(j, i) for j in range(n)))


def repaired_elsewhere(one: Effect, other: Effect, setting: Setting) -> bool:
    """Whether one of two lasting faults is a sensor's and the other the plant's or what drives it."""
    if one.traits.course is not None or other.traits.course is not None:
        return False
    return {_part(one, setting), _part(other, setting)} == {"sensor", "plant"}


def _part(effect: Effect, setting: Setting) -> str:
    """What is repaired: a "sensor", the "plant" with what drives it, or "" where it is neither.

    A parameter that was held is the plant's where the states move otherwise with another value: the gain of
    an ammeter may say the same as an inductance.
    """
    if effect.family == "parameter":
        points, theta = setting.points(setting.model)
        try:
            states, readings = moved_by(setting.model, theta, points, effect.channel)
        except EngineError:  # with another value the model cannot be used
            return ""
        return "plant" if states else "sensor" if readings else ""
    return {"measurement": "sensor", "state": "plant", "input": "plant"}.get(effect.family, "")


def merely_wider(found: Refit, others: Sequence[Refit]) -> bool:
    """Whether a plainer effect at the same place does as well."""
    return any(
        contains(found.effect, other.effect) and found.score < other.score + NEEDED
        for other in others
    )


def contains(wide: Effect, plain: Effect) -> bool:
    """Whether an effect becomes a plainer one, at the same place, at the end of its parameters' range."""
    places = (wide.channel, wide.channel.partition("->")[0])
    return plain.kind in wide.traits.contains and plain.channel in places


class Estimated(Protocol):
    """A fit, by whichever criterion."""

    @property
    def theta(self) -> Theta:
        """All parameters."""


def as_foreseen(effect: Effect, fit: Estimated) -> bool:
    """Whether its size is what it must be if it is the cause: others would have theirs so by chance."""
    if effect.traits.foreseen is None:
        return False
    low, high = effect.traits.foreseen
    return bool(low <= fit.theta[effect.size.name] <= high)


def rank(effects: Sequence[Effect], setting: Setting) -> tuple[int, int]:
    """Of causes that say the same the one with the least is said: its plainness, and whether it is natural."""
    return (
        sum(effect.traits.plainness for effect in effects),
        sum(unnatural(effect, setting) for effect in effects),
    )


def unnatural(effect: Effect, setting: Setting) -> int:
    """0 where the kind is natural for the channel, 2 where it is for the other sort, 1 where unknown."""
    source, suits = effect.channel.partition("->")[0], effect.traits.suits
    if not suits or source not in setting.states:
        return 1
    if setting.is_rate(source):
        return 0 if suits == "rate" else 2
    if setting.has_rate(source):
        return 0 if suits == "position" else 2
    return 0 if suits == "store" else 1
