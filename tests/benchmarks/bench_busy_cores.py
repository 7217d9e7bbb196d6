"""One thread of linear algebra or as many as there are: ``python -m tests.benchmarks.bench_busy_cores``.

What a model of two temperatures does at every theta, its discretisation by a matrix exponential, on cores that
are idle and beside as many busy processes as there are cores. With one thread, as all long calls of the engine
have it (:mod:`engine.threads`), and without. Writes ``results/busy-cores.md``.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from engine.threads import single_threaded

RESULTS = Path(__file__).parent / "results"
REPEATS, STEPS = 7, 100


def discretised(loss: float) -> None:
    """A, B and Q of air and wall over a step (van Loan 1978)."""
    F = np.array([[-loss, loss], [0.05, -0.08]])
    noise = np.diag([0.1**2, 0.01**2])
    expm(np.block([[F, np.eye(2)], [np.zeros((2, 4))]]) * 0.25)
    expm(np.block([[-F, noise], [np.zeros((2, 2)), F.T]]) * 0.25)


def spin() -> None:
    """Never sleep."""
    x = 0
    while True:
        x += 1


@contextmanager
def busy(cores: int) -> Iterator[None]:
    """As many processes that never sleep."""
    others = [multiprocessing.Process(target=spin, daemon=True) for _ in range(cores)]
    for one in others:
        one.start()
    try:
        yield
    finally:
        for one in others:
            one.kill()


def taken(call: Callable[[], object]) -> float:
    """Milliseconds a step: the middle of a few runs."""
    each = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        call()
        each.append(time.perf_counter() - began)
    return float(np.median(each)) / STEPS * 1e3


def main() -> None:
    """Measure and write the table."""

    def models() -> None:
        for loss in np.linspace(0.1, 1.0, STEPS):
            discretised(loss)

    alone = single_threaded(models)
    alone()
    cores = os.cpu_count() or 1
    lines = [
        "# One thread for small matrices",
        "",
        f"Made by `python -m tests.benchmarks.bench_busy_cores` on {cores} cores: milliseconds that a model of "
        "two states takes to be discretised by a matrix exponential (van Loan 1978), the middle of "
        f"{REPEATS} times {STEPS}.",
        "",
        "| beside | one thread | all threads | ratio |",
        "| --- | --- | --- | --- |",
    ]
    for others in (0, cores):
        with busy(others):
            one, many = taken(alone), taken(models)
        what = f"{others} busy processes" if others else "nothing"
        lines.append(f"| {what} | {one:.3f} | {many:.3f} | {many / one:.1f} |")
    text = "\n".join(lines) + "\n"
    (RESULTS / "busy-cores.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
