"""What other rules of decision would have made of the same series, from the evidence kept in their rows.

Only rules that are bolder than those of :mod:`engine.diagnose` can be judged so: they leave fewer names
in a set and fewer answers ``unknown``, and need nothing that the rows do not hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.diagnose.rounds import GENERIC, MARGIN, UNNAMED_MARGIN
from engine.studies.blind import figures as f
from engine.studies.report import markdown
from engine.studies.study import Row

LEFT = 0.005  # alpha's share of a later round: at or below, what is left is an alarm by any rule


@dataclass(frozen=True)
class Rule:
    """``margin`` of a set, ``unnamed`` that of the force without a name, and whether what is left counts."""

    margin: float = MARGIN
    unnamed: float = UNNAMED_MARGIN
    left: bool = True


RULES = {
    "as it is": Rule(),
    "names within 1 of the best in the set, not 2": Rule(margin=1.0),
    "no sets: the best name": Rule(margin=0.0),
    "a name must beat the unnamed force by 2, not 6": Rule(unnamed=MARGIN),
    "what is left at 5 % after noise does not matter": Rule(left=False),
    "all of it: within 1, by 2, what is left does not matter": Rule(1.0, MARGIN, False),
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
                str(f.oracle_share(at_40)),
                str(f.rate(alarmed, f.in_set)),
                str(f.rate(at_40, f.wrong)),
                str(f.rate([decided(row, rule) for row in weak], f.wrong)),
                str(f.rate([decided(row, rule) for row in outside], f.wrong)),
            ]
        )
    head = ["rule", "exact name, LR 40", "share of the oracle's", "truth in the set"]
    wrong = ["wrong names, LR 40", "LR 15", "not in the catalogue"]
    return markdown([*head, *wrong], lines)


def decided(row: Row, rule: Rule) -> Row:
    """The row with set and verdict by another rule."""
    if not f.alarm(row) or not row["set"]:
        return row
    rounds = [scores(text) for text in str(row["evidence"]).split("|")]
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
    verdict, one = row["verdict"], len(str(row["causes"]).split()) == 1
    forgiven = not rule.left and len(rounds) == 2 and rounds[1][0] > LEFT
    if verdict == "unknown" and one and forgiven and max(unnamed, default=-np.inf) < max(named):
        verdict = "set"
    if verdict == "set" and one and len(kept) == 1:
        verdict = "named"
    return {**row, "set": " ".join(kept), "verdict": verdict}


def scores(evidence: str) -> tuple[float, dict[str, float]]:
    """p-value of a round, and the scores by name."""
    words = evidence.split()
    return float(words[1]), dict(zip(words[2::2], map(float, words[3::2]), strict=True))


def _unnamed(name: str) -> bool:
    return name.partition(":")[0] == GENERIC
