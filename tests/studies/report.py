"""Pieces of the Markdown reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tests.studies.progress import clock
from tests.studies.statistics import Figure, deviation, verdict
from tests.studies.study import Table, Tables

# relative error from which a figure says more about a few runs than about the method
DOMINATED = 0.2


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def against(
    reported: str,
    ours: Figure,
    reported_runs: int,
    decimals: int,
    reported_error: float | None = None,
) -> list[str]:
    """Cells: reported value, ours, its standard error, verdict; ``reported`` as it is printed."""
    places = len(reported.partition(".")[2])
    sigmas = deviation(ours, float(reported), reported_runs, 10.0**-places, reported_error)
    judged = verdict(sigmas)
    if ours.error > DOMINATED * abs(ours.value):
        judged = "cannot be judged: a few runs dominate"
    return [reported, *plain(ours, decimals), judged]


def plain(ours: Figure, decimals: int) -> list[str]:
    """Cells: ours, its standard error."""
    return [f"{ours.value:.{decimals}f}", f"{ours.error:.{decimals}f}"]


def made_with(tables: Tables) -> str:
    """Settings and time of every arm."""
    rows = [
        [f"`{name}.csv`", str(len(table)), describe(table), taken(table)]
        for name, table in tables.items()
    ]
    return "## Settings and time\n\n" + markdown(["runs in", "runs", "settings", "time"], rows)


def describe(table: Table) -> str:
    """Settings as text."""
    return ", ".join(f"{key} = {value}" for key, value in table.settings.items())


def taken(table: Table) -> str:
    """Wall time and the processes it was shared by."""
    return f"{clock(table.wall)} on {table.workers} process{'es' if table.workers > 1 else ''}"
