"""What a study is: arms, each a function of one run's seed, and a report over their rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from engine.errors import EngineError
from engine.statespace.model import Array

Value: TypeAlias = "float | str"
Row: TypeAlias = dict[str, Value]


class StudyError(EngineError):
    """A study cannot be made or read; the message says what to do."""


@dataclass(frozen=True, eq=False)
class Arm:
    """One set of runs: ``work(seed, run)`` makes row ``run``; must be picklable.

    ``name`` is also the name of its CSV file. Arms are shared between studies, and arms on the same
    model see the same data in the same run. ``settings`` are recorded with the rows, which are only
    continued under the same settings.
    """

    name: str
    work: Callable[[int, int], Row]
    settings: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of one arm, sorted by run, and the time they took.

    ``wall`` is seconds on ``workers`` processes; ``settings`` what was recorded.
    """

    rows: list[Row]
    settings: Mapping[str, Any]
    wall: float
    workers: int

    def __len__(self) -> int:
        return len(self.rows)

    def of_runs(self, runs: Iterable[float]) -> Table:
        """The rows of some of the runs."""
        chosen = {int(run) for run in runs}
        return replace(self, rows=[row for row in self.rows if int(row["run"]) in chosen])

    def numbers(self, column: str) -> Array:
        """A column as floats (n,); NaN where a run has no number there."""
        return np.array([_number(row.get(column, "")) for row in self.rows])

    def texts(self, column: str) -> list[str]:
        """A column as text."""
        return [str(row.get(column, "")) for row in self.rows]

    def curves(self, column: str) -> Array:
        """A column of number lists as an array (n, length), short lists ending in NaN."""
        lists = [[float(v) for v in text.split()] for text in self.texts(column)]
        out = np.full((len(lists), max(map(len, lists), default=0)), np.nan)
        for k, values in enumerate(lists):
            out[k, : len(values)] = values
        return out


Tables: TypeAlias = Mapping[str, Table]


@dataclass(frozen=True)
class Study:
    """A table or figure: the arms it needs with their number of runs, its report and its plot.

    ``selected`` arms are made afterwards, for the runs that a function of the other arms' tables names.
    """

    name: str
    title: str
    arms: Mapping[Arm, int]
    report: Callable[[Tables], str]
    plot: Callable[[Tables, Path], None]
    selected: Mapping[Arm, Callable[[Tables], Sequence[int]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [arm.name for arm in (*self.arms, *self.selected)]
        if len(set(names)) < len(names):
            raise StudyError(f"study '{self.name}' names an arm twice")


def _number(value: Value) -> float:
    try:
        return float(value)
    except ValueError:
        return np.nan
