"""From rows to figures: names, sets, alarms, gains, with their intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.kinds.colored import LATENT
from engine.diagnose.refits.refitted import further_parameters
from engine.statespace.model import Array
from tests.studies.blind.bases import typical
from tests.studies.statistics import wilson
from tests.studies.study import Row, Table

TIE = 0.1  # of the score: a pulse on an integrator is a step of its reading
ALARMS = ("named", "set", "unknown")
RESAMPLES = 2000
ANY_ROWS = 1000  # an effect's family and number of parameters do not depend on them


@dataclass(frozen=True)
class Rate:
    """``events`` of ``of``, with the Wilson interval of 95 %."""

    events: int
    of: int

    @property
    def value(self) -> float:
        """The share, NaN of nothing."""
        return self.events / self.of if self.of else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson."""
        return wilson(self.events, self.of)

    def __str__(self) -> str:
        if not self.of:
            return "-"
        low, high = self.interval
        return f"{100 * self.value:.0f} % ({self.events} of {self.of}; {100 * low:.0f}-{100 * high:.0f} %)"


def rate(rows: Iterable[Row], event: Callable[[Row], bool]) -> Rate:
    """How often something happens."""
    seen = [event(row) for row in rows]
    return Rate(sum(seen), len(seen))


def exact(row: Row) -> bool:
    """Named, rightly, and nothing else."""
    return row["verdict"] == "named" and row["causes"] == row["hidden"]


def wrong(row: Row) -> bool:
    """Named confidently, and not right: a wrong name, or a further one beside the right one."""
    return row["verdict"] == "named" and row["causes"] != row["hidden"]


def alarm(row: Row) -> bool:
    """Any verdict but ``nothing``."""
    return row["verdict"] in ALARMS


def in_set(row: Row) -> bool:
    """Whether the truth is in the first round's set."""
    return str(row["hidden"]) in str(row["set"]).split()


def set_size(row: Row) -> int:
    """Effects in the first round's set."""
    return len(str(row["set"]).split())


def place(effect: str) -> str:
    """The state, output, input or parameter that an effect enters at."""
    channel = effect.partition(":")[2]
    return channel.partition("->")[2] or channel


def right_equation(row: Row) -> bool:
    """Whether the first cause enters where the truth does."""
    causes = str(row["causes"]).split()
    return bool(causes) and place(causes[0]) == place(str(row["hidden"]))


def oracle_right(row: Row) -> bool:
    """Whether refitted likelihoods less costs prefer the truth, or something that predicts the very same."""
    return float(row["score_truth"]) >= float(row["score_rival"]) - TIE


def likeliest(row: Row) -> bool:
    """Whether the truth has the largest refitted likelihood of all, whatever further parameters cost.

    Its rivals are those kept in the row, the best of the first round with costs: with more of them it
    could only be right less often.
    """
    T = float(row["rows"])
    rivals = [
        score + further_parameters(effect_of(row, name)) * float(np.log(T))
        for name, score in scores(str(row["evidence"]).split("|")[0])[1].items()
        if name != row["hidden"] and name.partition(":")[0] != LATENT
    ]
    return float(row["ratio_truth"]) >= max(rivals, default=-np.inf) - TIE


def effect_of(row: Row, name: str) -> Effect:
    """The effect that a row names."""
    return _effect(str(row["base"]), name)


@cache
def _effect(base: str, name: str) -> Effect:
    return make_effect(name, typical(base, ANY_ROWS))


def scores(evidence: str) -> tuple[float, dict[str, float]]:
    """p-value of a round, and the scores by name."""
    words = evidence.split()
    return float(words[1]), dict(zip(words[2::2], map(float, words[3::2]), strict=True))


def same_again(row: Row) -> bool:
    """The same verdict and causes with another seed."""
    return f"{row['verdict']} {row['causes']}".strip() == row["again"]


@dataclass(frozen=True)
class Share:
    """A sum as a share of another over the same series, with a bootstrap interval of 95 % over them."""

    parts: Array
    wholes: Array

    @property
    def value(self) -> float:
        """The share, NaN of nothing."""
        total = float(self.wholes.sum())
        return float(self.parts.sum()) / total if total > 0.0 else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Percentiles over resampled series."""
        n = len(self.parts)
        picks = np.random.default_rng(0).integers(n, size=(RESAMPLES, n))
        shares = self.parts[picks].sum(axis=1) / self.wholes[picks].sum(axis=1)
        low, high = np.nanpercentile(shares, [2.5, 97.5])
        return float(low), float(high)

    def __str__(self) -> str:
        if not np.isfinite(self.value):
            return "-"
        low, high = self.interval
        return f"{100 * self.value:.0f} % ({100 * low:.0f}-{100 * high:.0f} %)"


def share_of(rows: Sequence[Row], oracle: Callable[[Row], bool]) -> Share:
    """Exact names as a share of an oracle's."""
    return Share(
        np.array([float(exact(row)) for row in rows]),
        np.array([float(oracle(row)) for row in rows]),
    )


def gain_share(table: Table) -> Share:
    """Held-out log-density gained by what was found, as a share of the true extension's."""
    gain, truth = table.numbers("gain"), table.numbers("gain_truth")
    both = np.isfinite(gain) & np.isfinite(truth)
    return Share(gain[both], truth[both])


def miss(row: Row) -> str:
    """What came out in place of the exact name."""
    if not alarm(row):
        return "nothing"
    names = [name for name in str(row["causes"]).split() if name != row["hidden"]]
    among = [name for name in str(row["set"]).split() if name != row["hidden"]]
    if row["verdict"] == "set" and in_set(row) and among:
        return f"set with {', '.join(among)}"
    if str(row["causes"]).split()[:1] == [row["hidden"]]:
        more = f", then {', '.join(names)}" if names else " with something left"
        return f"{row['verdict']}: right{more}"
    return f"{row['verdict']}: {', '.join(names or among) or 'no name'}"


def chosen(table: Table, **values: object) -> list[Row]:
    """Rows with the given values, compared as text or number; series that ended in an error left out."""
    return [
        row
        for row in table.rows
        if row["verdict"] != "error" and all(_same(row[k], v) for k, v in values.items())
    ]


def _same(cell: float | str, value: object) -> bool:
    if isinstance(value, (int, float)):
        return float(cell) == float(value)
    return cell == value


def confusion(
    rows: Sequence[Row],
) -> tuple[list[str], list[str], np.ndarray[tuple[int, int], np.dtype[np.int64]]]:
    """Hidden effects, answers, and counts: an answer is the first cause's kind if it was named."""
    count: dict[str, Counter[str]] = {}
    for row in rows:
        hidden = f"{row['base']} {row['hidden'] or 'clean'}"
        count.setdefault(hidden, Counter())[answer(row)] += 1
    verdicts = ["set", "unknown", "nothing"]
    names = sorted({a for c in count.values() for a in c} - set(verdicts))
    columns = [*names, *verdicts]
    return list(count), columns, np.array([[c[a] for a in columns] for c in count.values()])


def answer(row: Row) -> str:
    """The named causes' kinds, or the verdict."""
    if row["verdict"] != "named":
        return str(row["verdict"])
    return str(row["causes"]).split()[0].partition(":")[0]
