"""What other rules of decision would have made of the same series, from the evidence kept in their rows.

Smaller margins leave fewer names in a set; a set cannot grow again, as the rows do not hold what it
would grow by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.diagnose.effects.kinds.colored import LATENT
from engine.diagnose.judging.verdict import LEFT
from engine.diagnose.refits.rounds import MARGIN, UNNAMED_MARGIN
from tests.studies.blind import figures as f
from tests.studies.report import markdown
from tests.studies.study import Row

ALPHA = 0.05
ALARM = 0.1 * ALPHA  # of a later round: at or below, what is left is one by any rule


@dataclass(frozen=True)
class Rule:
    """``margin`` of a set, ``unnamed`` that of the force without a name, ``left`` the p-value that counts."""

    margin: float = MARGIN
    unnamed: float = UNNAMED_MARGIN
    left: float = LEFT * ALPHA


RULES = {
    "as it is": Rule(),
    "names within 1 of the best in the set, not 2": Rule(margin=1.0),
    "no sets: the best name": Rule(margin=0.0),
    "a name must beat the unnamed force by 2, not 6": Rule(unnamed=MARGIN),
    "what is left after noise counts at 5 %, not 1 %": Rule(left=ALPHA),
    "what is left after noise does not count": Rule(left=ALARM),
    "within 1, by 2, what is left does not count": Rule(1.0, MARGIN, ALARM),
}


def rules(usual: Sequence[Row], weak: Sequence[Row], outside: Sequence[Row]) -> str:
    """A line for each rule; ``weak`` are the series at LR 15."""
    lines = []
    for name, rule in RULES.items():
        at_40 = [decided(row, rule) for row in usual]
        alarmed = [row for row in at_40 if f.alarm(row)]
        lines.append(
            [
                name,
                str(f.rate(at_40, f.exact)),
                str(f.share_of(at_40, f.likeliest)),
                str(f.share_of(at_40, f.oracle_right)),
                str(f.rate(alarmed, f.in_set)),
                str(f.rate(at_40, f.wrong)),
                str(f.rate([decided(row, rule) for row in weak], f.wrong)),
                str(f.rate([decided(row, rule) for row in outside], f.wrong)),
            ]
        )
    shares = ["share of the oracle's, likelihood alone", "... with costs"]
    head = ["rule", "exact name, LR 40", *shares, "truth in the set"]
    wrong = ["wrong names, LR 40", "LR 15", "not in the catalogue"]
    return markdown([*head, *wrong], lines)


def decided(row: Row, rule: Rule) -> Row:
    """The row with set and verdict by another rule."""
    if not f.alarm(row) or not row["set"]:
        return row
    rounds = [f.scores(text) for text in str(row["evidence"]).split("|")]
    first = rounds[0][1]
    named = [score for name, score in first.items() if not _unnamed(name)]
    unnamed = [score for name, score in first.items() if _unnamed(name)]
    best, *others = str(row["set"]).split()
    kept = [best]
    for name in others:
        within = rule.unnamed if _unnamed(name) else rule.margin
        # of those that are not among the best few, the score is not known: at most the least of these
        if first.get(name, min(named)) >= max(named) - within:
            kept.append(name)
    verdict = row["verdict"]
    causes = [f.effect_of(row, name) for name in str(row["causes"]).split()]
    p_left = rounds[-1][0] if len(rounds) > len(causes) else np.inf
    if any(effect.family == "noise" for effect in causes) or len(causes) > 1:
        was, now = p_left <= Rule().left, p_left <= rule.left
        if now and not was:
            verdict = "unknown"
        alone = len(causes) == 1 and max(unnamed, default=-np.inf) < max(named)
        if was and not now and verdict == "unknown" and alone and p_left > ALARM:
            verdict = "set"
    if verdict == "set" and len(causes) == 1 and len(kept) == 1:
        verdict = "named"
    return {**row, "set": " ".join(kept), "verdict": verdict}


def _unnamed(name: str) -> bool:
    return name.partition(":")[0] == LATENT
