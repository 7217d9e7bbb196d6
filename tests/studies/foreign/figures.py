"""From rows to figures; effects that are the same thing in other words count as one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tests.studies.blind.figures import TIE, Rate, Share
from tests.studies.foreign.alike import same
from tests.studies.foreign.runs import CRASH
from tests.studies.study import Row

STRONG = 40.0  # likelihood ratio of the truth in a series from which it must be named
SIZE_APART = 0.25  # standard errors that a size and its twin's may differ by


def right(row: Row, name: str) -> bool:
    """Whether a name is the truth of a row, in whatever words."""
    return same(str(row["system"]), str(row["hidden"]), name)


def crashed(row: Row) -> bool:
    """Whether the diagnosis ended in an exception, in either unit."""
    return CRASH in (row["verdict"], row["twin"])


def alarm(row: Row) -> bool:
    """Any verdict but ``nothing``; a crash is none."""
    return row["verdict"] in ("named", "set", "unknown")


def named_exactly(row: Row) -> bool:
    """Named, rightly, and nothing else."""
    return row["verdict"] == "named" and right(row, str(row["causes"]))


def exact(row: Row) -> bool:
    """One cause, and it is right: named, or a set whose names all are words for the same thing."""
    names = str(row["set"]).split()
    one = row["verdict"] == "set" and len(str(row["causes"]).split()) == 1
    return named_exactly(row) or (one and all(right(row, name) for name in names))


def wrong(row: Row) -> bool:
    """Named confidently, and not right: a wrong name, or a further one beside the right one."""
    return row["verdict"] == "named" and not exact(row)


def in_set(row: Row) -> bool:
    """Whether the truth is in the first round's set."""
    return any(right(row, name) for name in str(row["set"]).split())


def strong(row: Row) -> bool:
    """Whether the true extension's likelihood ratio is above STRONG in this series."""
    return float(row["ratio_truth"]) > STRONG


def oracle_right(row: Row) -> bool:
    """Whether refitted likelihoods less costs prefer the truth, in whatever words."""
    if not row["oracle"]:
        return False
    tie = float(row["score_truth"]) >= float(row["score_rival"]) - TIE
    return tie or right(row, str(row["oracle"]))


def lead(row: Row) -> float:
    """The truth's lead in score over the best rival that is another thing; negative where the rival leads."""
    ahead = float(row["score_truth"]) - float(row["score_rival"])
    same_thing = right(row, str(row["oracle"])) and ahead < 0.0
    return np.inf if same_thing else ahead


def twinned(row: Row) -> bool:
    """Whether the series was diagnosed in other units, too."""
    return bool(row["twin"])


def same_answer(row: Row) -> bool:
    """Whether the same verdict and names came out in other units."""
    if CRASH in (row["verdict"], row["twin"]):
        return False
    return f"{row['verdict']} {row['causes']}".strip() == row["twin"]


def same_size(row: Row) -> bool:
    """Whether the first size, converted, is the same within a part of its standard error."""
    apart = abs(float(row["size"]) - float(row["twin_size"]))
    return apart <= SIZE_APART * float(row["size_error"])


def sized(row: Row) -> bool:
    """Whether sizes can be compared."""
    numbers = [float(row[key]) for key in ("size", "twin_size", "size_error")]
    return twinned(row) and same_answer(row) and bool(np.isfinite(numbers).all())


def share_of_oracle(rows: Sequence[Row]) -> Share:
    """Exact names as a share of the oracle's."""
    return Share(
        np.array([float(exact(row)) for row in rows]),
        np.array([float(oracle_right(row)) for row in rows]),
    )


def met(found: Rate, limit: Callable[[float, float, float], bool]) -> str:
    """``yes`` or ``no``: a rule on the rate and the ends of its interval; "-" of no runs."""
    if not found.of:
        return "-"
    return "yes" if limit(found.value, *found.interval) else "no"
