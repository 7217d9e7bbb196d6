"""What all tables and figures cost together."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tests.studies.progress import clock
from tests.studies.report import markdown
from tests.studies.runner import make_runs
from tests.studies.study import Study

CORES = 2


def times(studies: Iterable[Study], directory: Path, seed: int = 0) -> str:
    """Markdown: the time of the runs on disk by study, shared runs counted once, and the sum.

    Runs are independent of each other, so time on ``CORES`` cores is wall time times processes, divided
    by ``CORES``.
    """
    rows, known, total = [], set[str](), 0.0
    for study in studies:
        tables = {arm.name: make_runs(arm, 0, directory, seed) for arm in study.arms}
        new = [table for name, table in tables.items() if name not in known]
        seconds = sum(table.wall * table.workers for table in new) / CORES
        known.update(tables)
        total += seconds
        runs = sum(len(table) for table in new)
        rows.append([f"`{study.name}`", str(len(tables)), str(len(new)), str(runs), clock(seconds)])
    head = ["study", "sets of runs", "of its own", "runs in these", f"time on {CORES} cores"]
    return (
        f"# Time of all tables and figures\n\n"
        f"Together {clock(total)} on {CORES} cores, as recorded while the runs were made, which was while "
        "other programs used the machine too. Studies share runs; these are counted where they are "
        "made first. Times of runs made by one process are divided by the cores.\n\n"
        + markdown(head, rows)
    )
