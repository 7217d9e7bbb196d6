"""A round of the search: what was refitted in it, ranked, and the set that cannot be told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from engine.data.series import Series
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.likeness import as_foreseen, distinct, rank, repaired_elsewhere
from engine.diagnose.refits.refitted import Refit, further_parameters
from engine.diagnose.screening.screen import Screen

MARGIN = 2.0  # of the score: a likelihood ratio of e
UNNAMED_MARGIN = 6.0  # over a force that nobody named, which is always possible
FORESEEN = (
    2.0  # times its statistic, at most, an effect gains when it is refitted: noise shrinks with it
)
ANYWAY = 6.0  # of the score: so near the best, what is there anyhow leads, where its size is the one foreseen
EVEN = 0.05  # of the score: what refits leave undone, so that it may not decide which name leads


@dataclass(frozen=True, eq=False)
class Round:
    """What the screen saw, what was refitted (best first), the unnamed force, the set that remains.

    ``contradicted`` are members that the set had until held-out data spoke against them.
    """

    screen: Screen
    refits: tuple[Refit, ...]
    generic: Refit | None
    equivalent: tuple[Refit, ...]
    contradicted: tuple[Refit, ...] = ()


def settle(
    screen: Screen,
    refits: Sequence[Refit],
    series: Series,
    setting: Setting,
    margin: float = MARGIN,
) -> Round:
    """Refits ranked by their score; those within a margin of the best named one are a set."""
    unnamed = [r for r in refits if r.effect.traits.unnamed]
    ranked = sorted((r for r in refits if not r.effect.traits.unnamed), key=lambda r: -r.score)
    within = [r for r in ranked if r.score >= ranked[0].score - margin]
    anyway = [
        r for r in ranked if r.score >= ranked[0].score - ANYWAY and as_foreseen(r.effect, r.fit)
    ]
    if anyway:  # others must be ahead of it, for their sizes are fitted
        ahead = (r for r in within if r is not anyway[0] and r.score > anyway[0].score + margin)
        equivalent = (anyway[0], *distinct(list(ahead), series, setting))
    else:
        equivalent = _led(distinct(within, series, setting), setting)
    if equivalent:  # of effects that are the same here, the name that stands for them leads
        ranked = [equivalent[0], *(r for r in ranked if r is not equivalent[0])]
    top = max(unnamed, key=lambda r: r.score) if unnamed else None
    return Round(screen, tuple(ranked), top, equivalent)


def _led(equivalent: Sequence[Refit], setting: Setting) -> tuple[Refit, ...]:
    """The set with the plainest of its best names in front, in any unit: of drag and of a square, say.

    Of two as plain the one of a reading: it leaves the state alone, and all that comes after. Before all of
    them a parameter that was held, unless it says that something else is to be repaired than what leads.
    A size that may as well be zero leaves the lead to an effect with fewer parameters whose size may not. So
    does noise to what is none: noise that changes says where errors are large, a cause what they are as well.
    """
    if not equivalent:
        return ()
    best = equivalent[0].effect
    for r in equivalent:
        if r.effect.family == "parameter" and not repaired_elsewhere(r.effect, best, setting):
            return (r, *(one for one in equivalent if one is not r))
    even = [r for r in equivalent if r.score >= equivalent[0].score - EVEN]
    outputs = setting.model.outputs

    def order(r: Refit) -> tuple[tuple[int, int], bool, str]:
        return rank((r.effect,), setting), r.effect.channel not in outputs, r.effect.name

    first = min(even, key=order)
    few = further_parameters(first.effect)
    fewer = [r for r in equivalent if further_parameters(r.effect) < few]
    if fewer and not first.is_sure:  # a bend from far away, of which a constant force is seen, say
        first = next((r for r in fewer if r.is_sure), first)
    if first.effect.family == "noise" and not first.effect.traits.outliers:
        first = next((r for r in equivalent if r.effect.family != "noise" and r.is_sure), first)
    return (first, *(r for r in equivalent if r is not first))
