"""Whether what the likelihood saw is taken for chance: seen none too clearly, and denied by held-out data.

A search that may say anything but ``nothing`` in a share alpha of all clean records says, in these, what fits
their noise. Data that nothing was fitted to do not have that noise, and there it predicts worse.
"""

from __future__ import annotations

from engine.diagnose.gain.adoption import LOSS_NATS, TELLING_ROWS
from engine.diagnose.gain.gain import Gain
from engine.diagnose.refits.found import Search
from engine.words import enumerated, number, probability

SURE = 0.1  # of alpha: what is as improbable as that by chance needs no other data


def is_faint(search: Search, alpha: float) -> bool:
    """Whether all that a search at a level ``alpha`` of false alarms saw may be chance."""
    return all(one.screen.p_value > SURE * alpha for one in search.rounds)


def taken_for_chance(search: Search, gain: Gain | None, alpha: float) -> str:
    """Why what a search at a level ``alpha`` of false alarms found is taken for chance, a sentence; or ""."""
    if gain is None or gain.adopt or gain.samples < TELLING_ROWS:
        return ""
    if not (is_faint(search, alpha) and gain.log_density < -LOSS_NATS):
        return ""
    seen = min((one.screen for one in search.rounds), key=lambda screen: screen.p_value)
    names = enumerated([one.effect.name for one in search.named])
    return (
        f"In the rows searched {names} seemed to be seen ({probability(seen.p_value)}). On data that were not "
        f"searched the model predicts worse with that, by {number(-gain.log_density)} in log-density: it is "
        "taken for chance. More data, or a record that moves more, would tell."
    )
