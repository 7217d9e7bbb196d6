"""The state of an estimation: what was asked, what its tasks left, every iteration of the current one.

Tasks are those of ``stages.plan``, one after the other.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from engine.statespace.model import Array, Theta
from service import stages, strict_json
from service.cli.ending import Interrupt
from service.cli.experiment import Experiment
from service.cli.meter import Meter
from service.cli.state_file import StateFile
from service.validation import Prepared


@dataclass(kw_only=True)
class Asked(Experiment):
    """An estimation as it was asked for."""

    command: ClassVar[str] = "fit"
    result: ClassVar[str] = "estimation"
    method: str = "quasi-newton"
    first: str = "none"
    particles: int = 50
    trajectories: int | None = None
    iterations: int = 100
    standard_errors: bool = True
    intervals: str = "symmetric"
    starts: int = 1
    bootstrap: int = 0
    substeps: int = 1


class Recorder:
    """``computations.Progress`` on a state file and a meter; rows are (theta..., log-likelihood, ess, ...)."""

    def __init__(
        self,
        job: Prepared,
        file: StateFile,
        asked: Asked,
        meter: Meter,
        rows: Array | None = None,
        finished: Sequence[Any] = (),
    ) -> None:
        self.file, self.asked, self.meter = file, asked, meter
        self.parameters = job.model.parameter_names  # what the first numbers of a row are
        n = len(self.parameters) + 4
        self.done: list[Array] = [] if rows is None else list(rows[:, :n])
        self.left_over: list[Array] = [] if rows is None else list(rows[1:, n:])
        self.finished = list(finished)  # what the tasks before this one left
        self.plan = stages.plan(job.request)
        self.interrupt = Interrupt()

    @property
    def k(self) -> int:
        """Iterations done of this task."""
        return max(len(self.done) - 1, 0)

    @property
    def task(self) -> int:
        """Number of the task that is computed."""
        return len(self.finished)

    @property
    def name(self) -> str:
        """What is computed, such as ``start 2 of 8``; empty where there is nothing else."""
        if len(self.plan) == 1:
            return ""
        roles = stages.roles(self.plan)
        role = roles[self.task]
        n = roles.count(role)
        return f"{role} {self.task - roles.index(role) + 1} of {n}" if n > 1 else role

    @property
    def steps(self) -> int:
        """Iterations done in all; a task that has ended has used all that it might."""
        return self.asked.iterations * self.task + self.k

    def finish(self, result: Any) -> None:
        """Go on to the next task; ``result`` is kept as JSON, as the service keeps it."""
        self.finished.append(json.loads(strict_json.dumps(result)))
        self.done, self.left_over = [], []
        self.save()

    def rows(self) -> Array:
        """Iterations of the run that is resumed."""
        return np.array(self.done)

    def memory(self) -> Array:
        """What they left to the next."""
        return np.array(self.left_over)

    def start(self, theta: Theta) -> None:
        """Row 0: where the estimation starts."""
        self.done, self.left_over = [np.append(theta, [np.nan] * 4)], []

    def iteration(self, it: Any) -> None:
        """One more row, saved when the last saving is long enough ago."""
        numbers = [it.log_likelihood, it.ess, it.seconds, it.collapsed]
        self.done.append(np.append(it.theta, numbers))
        self.left_over.append(it.memory)
        if self.file.due:
            self.save()
        said = f"log-likelihood {it.log_likelihood:.2f}"
        self.meter.at(self.steps, f"{self.name}, {said}" if self.name else said)
        self.interrupt.check()

    def step(self, k: int, message: str = "", share: float | None = None) -> None:
        """What follows the iterations, or goes before them."""
        if self.interrupt.holding and self.done:
            self.save()
            self.interrupt.let_go()
        self.interrupt.check()
        self.meter.stage(message, share)

    def estimated(self, document: dict[str, Any]) -> None:
        """Nothing: a command prints its result once."""

    def left(self, task: int) -> Any:
        """What an earlier task left."""
        return copy.deepcopy(self.finished[task])

    def save(self) -> None:
        """Write the state; what an iteration left to the next stands behind its row."""
        rows = np.array(self.done)
        if self.left_over and self.left_over[0].size:
            memory = np.array(self.left_over)
            rows = np.hstack([rows, np.vstack([np.full_like(memory[:1], np.nan), memory])])
        self.file.save(rows, self.finished)
