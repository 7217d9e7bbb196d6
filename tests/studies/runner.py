"""Spread the missing runs of an arm over processes, keeping each one as it is finished."""

from __future__ import annotations

import multiprocessing
import os
import random
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path

from tests.studies.progress import Progress
from tests.studies.store import Store
from tests.studies.study import Arm, Row, Study, Table

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def make_runs(
    arm: Arm,
    runs: int | Sequence[int],
    directory: Path,
    seed: int = 0,
    workers: int | None = None,
    fresh: bool = False,
) -> Table:
    """Make runs 0 .. runs - 1 of an arm, or those named, except what is on disk; return all there are.

    ``workers`` processes (default: all cores), each with one thread; 1 stays in this process.
    """
    workers = workers or os.cpu_count() or 1
    wanted = range(runs) if isinstance(runs, int) else runs
    if fresh and wanted:
        for suffix in (".csv", ".json"):
            (directory / f"{arm.name}{suffix}").unlink(missing_ok=True)
    store = Store(directory, arm, seed)
    missing = [run for run in wanted if run not in store.rows]
    random.Random(seed).shuffle(
        missing
    )  # cells come in turn: what is there when it is stopped is of all
    if missing:
        progress = Progress(arm.name, len(wanted), len(wanted) - len(missing))
        last = time.monotonic()

        def keep(run: int, row: Row) -> None:
            nonlocal last
            store.add(run, row)
            now = time.monotonic()
            store.spend(now - last, workers)  # at every run, so that an interrupted study counts
            last = now
            progress.step()

        if workers == 1:
            for run in missing:
                keep(run, arm.work(seed, run))
        else:
            _in_processes(arm, missing, seed, min(workers, len(missing)), keep)
        store.sort()
    return store.table()


def _in_processes(
    arm: Arm, missing: list[int], seed: int, workers: int, keep: Callable[[int, Row], None]
) -> None:
    for name in THREADS:  # inherited by the fresh interpreters, read when they import NumPy
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        waiting: dict[Future[Row], int] = {pool.submit(arm.work, seed, run): run for run in missing}
        try:
            while waiting:
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    keep(waiting.pop(future), future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def make_study(
    study: Study,
    directory: Path,
    runs: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    fresh: bool = False,
) -> str:
    """Make a study's runs, write its Markdown and its plot; return the Markdown.

    ``runs`` shortens every arm to that many runs; with 0 only what is on disk is reported.
    """
    tables = {
        arm.name: make_runs(
            arm, n if runs is None else min(n, runs), directory, seed, workers, fresh
        )
        for arm, n in study.arms.items()
    }
    for arm, choose in study.selected.items():
        chosen = list(choose(tables))[:runs]
        tables[arm.name] = make_runs(arm, chosen, directory, seed, workers, fresh)
    text = f"# {study.title}\n\n{study.report(tables).strip()}\n"
    (directory / f"{study.name}.md").write_text(text)
    study.plot(tables, directory / f"{study.name}.png")
    return text
