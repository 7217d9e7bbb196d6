"""The next experiment: the input within bounds that tells the causes of a diagnosis apart.

:func:`design_experiment` searches over steps, ramps with reversals, multisines and random binary inputs for the
one whose least D over all pairs of causes (:mod:`.criterion`) is largest, says how surely a diagnosis of it
names the true cause, and how short the record may be. Causes that no input within the bounds can tell apart are
said to be so, with the further sensor that would.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.design.bounds import Bounds, InputBounds
from engine.design.candidates import Question, before_any
from engine.design.checkpoint import kept_of
from engine.design.design import Design, Experiment, Undecided
from engine.design.rivals import of_diagnosis
from engine.design.search import Task, search
from engine.design.sensors import Sensor
from engine.design.weighing import LEVEL, Weighing
from engine.diagnose.diagnosis import Diagnosis
from engine.diagnose.records import LEAST
from engine.diagnose.refits.checkpoint import Parts
from engine.errors import OptionError, check_count
from engine.randomness import check_seed
from engine.statespace.model import MixedModel, ThetaLike
from engine.threads import single_threaded
from engine.units import SECOND

__all__ = [
    "Bounds",
    "Design",
    "Experiment",
    "InputBounds",
    "Sensor",
    "Undecided",
    "design_experiment",
]

INPUTS = 400  # that are tried, by default
LONGEST = 100_000  # samples

Callback = Callable[[str, float], Any]


@single_threaded
def design_experiment(
    diagnosis: Diagnosis | MixedModel,
    bounds: Bounds | Mapping[str, Any],
    length: int,
    *,
    causes: Sequence[str] | Mapping[str, Any] | None = None,
    theta: ThetaLike = None,
    free: Sequence[str] | None = None,
    anew: bool = True,
    inputs: int = INPUTS,
    seed: int = 0,
    callback: Callback | None = None,
) -> Design:
    """Search for the input that tells causes apart.

    Parameters
    ----------
    diagnosis : Diagnosis or MixedModel
        A diagnosis that ended in a ``set`` or ``unknown``; or a model, before any experiment.
    bounds : Bounds or mapping
        Limits on every input and, where wanted, on states and outputs.
    length : int
        Number of samples T of the experiment.
    causes : sequence of str or mapping, optional
        Names of causes that the diagnosis weighed; by default those it could not tell apart. For a model, a
        mapping {"drag:velocity": size}, or {cause: {parameter: value}} with the effect's own parameters. There
        "information": {"free": names (n,), "matrix": (n, n)} is the inverse covariance that a record gave.
    theta : Theta, mapping, array or None
        Parameters (n_theta,) of a model that has not been diagnosed; its defaults where None.
    free : sequence of str, optional
        Names of the parameters that a diagnosis will estimate, for a model that has not been diagnosed; all by
        default.
    anew : bool
        Whether the new record is diagnosed on its own, all free parameters estimated again. With False, what
        the earlier record told of parameters and causes counts too.
    inputs : int
        How many inputs are tried, at least 1.
    seed : int
        The same seed gives the same design.
    callback : callable, optional
        ``callback(stage, fraction)``; stops the search by raising StopIteration.

    Returns
    -------
    Design
        The input (T, nu), how surely it leads to the right name, the shortest record that reaches 95 %, and
        what cannot be told apart; print it for a short table.

    Raises
    ------
    OptionError
        Bounds, causes or another option cannot be used; ``field`` names it.
    ModelError
        The model's functions cannot be used.
    """
    check_count("inputs", inputs)
    asked = asked_of(diagnosis, bounds, length, causes, theta, free, anew=anew)
    check_seed(seed)
    return asked.designed(int(inputs), seed, callback)


@dataclass(frozen=True, eq=False)
class Asked:
    """What an experiment shall tell apart, of which ``model`` without the causes, and what it may do."""

    model: MixedModel
    question: Question
    task: Task

    def designed(
        self,
        inputs: int = INPUTS,
        seed: int = 0,
        callback: Callback | None = None,
        kept: Parts | None = None,
    ) -> Design:
        """The design; ``kept`` is filled with finished parts, from which a stopped one goes on.

        Other arguments as of :func:`design_experiment`. Raises OptionError where ``kept`` is of another design.
        """
        began, earlier = time.process_time(), [0.0]
        question, task = self.question, self.task

        def tell(stage: str, share: float) -> None:
            if callback is not None:
                callback(stage, min(share, 1.0))

        done = kept_of(kept, question, task, inputs, seed, earlier.append)
        state = search(task, inputs, seed, partial(tell, "inputs"), kept=done.within("inputs"))
        weighing = Weighing(task, question, seed, done)
        undecided = weighing.undecided(state, inputs, partial(tell, "pairs"))
        best = weighing.best(state, undecided)
        shortest = weighing.shortest(best, inputs, undecided, partial(tell, "length"))
        return Design(
            model=self.model,
            causes=tuple(c.name for c in question.candidates),
            titles=tuple(c.title for c in question.candidates),
            bounds=replace(
                task.bounds,
                dt=task.dt,
                hold=task.hold,
                substeps=task.substeps,
                time_unit=task.bounds.time_unit or SECOND,
            ),
            dt=task.dt,
            experiment=best.experiment,
            shortest=shortest,
            undecided=tuple(weighing.settled(undecided, best)),
            predictions=weighing.predictions(best.experiment.u),
            growth=weighing.growth(best, undecided),
            level=LEVEL,
            anew=task.anew,
            tried=state.tried,
            notes=question.notes,
            seconds=time.process_time() - began + sum(earlier),
        )


def asked_of(
    diagnosis: Diagnosis | MixedModel,
    bounds: Bounds | Mapping[str, Any],
    length: int,
    causes: Sequence[str] | Mapping[str, Any] | None = None,
    theta: ThetaLike = None,
    free: Sequence[str] | None = None,
    *,
    anew: bool = True,
    alarm: float | None = None,
    measured: Sequence[str] | None = None,
) -> Asked:
    """What :func:`design_experiment` is asked, once it is seen that it can be.

    With a model in place of a diagnosis, ``alarm`` and ``measured`` are what the document of one told: the
    statistic from which it sees something, and the outputs that are measured. Raises as it does.
    """
    check_count("length", length)
    if not LEAST <= length <= LONGEST:
        raise OptionError(
            f"length = {length} samples; a diagnosis needs {LEAST} at least, and {LONGEST} are tried at most",
            "length",
        )
    limits = Bounds.of(bounds)
    if isinstance(diagnosis, Diagnosis):
        for name, value in (("theta", theta), ("free", free)):
            if value is not None:
                raise OptionError(f"{name}: a diagnosis has its own; leave it out", name)
        if isinstance(causes, Mapping):
            raise OptionError("causes: a diagnosis has sizes of its own; give names only", "causes")
        model = diagnosis.model
        limits.check(model)
        dt = limits.dt or diagnosis.series.dt
        if dt is None:
            raise OptionError(
                "bounds.dt is missing: the diagnosed record is not sampled regularly", "bounds.dt"
            )
        hold = limits.hold or diagnosis.series.hold
        substeps = limits.substeps or diagnosis.substeps
        unit = limits.time_unit or diagnosis.series.time_unit
        limits = replace(limits, dt=dt, hold=hold, substeps=substeps, time_unit=unit)
        question = of_diagnosis(diagnosis, causes)
    elif isinstance(diagnosis, MixedModel):
        model = diagnosis
        limits.check(model)
        if limits.dt is None:
            raise OptionError("bounds.dt is missing: the time between samples", "bounds.dt")
        if not isinstance(causes, Mapping):
            raise OptionError(
                "causes: before any experiment each needs a size, as {'drag:velocity': 0.6}",
                "causes",
            )
        question = before_any(model, causes, theta, limits.dt, free, alarm, measured)
    else:
        raise OptionError(
            f"diagnosis is a {type(diagnosis).__name__}; a Diagnosis or a MixedModel is needed",
            "diagnosis",
        )
    task = Task(
        question.candidates,
        limits,
        int(length),
        float(limits.dt or 1.0),
        limits.hold or "zoh",
        limits.substeps or 1,
        _measured(model, question),
        anew,
    )
    return Asked(model, question, task)


def _measured(model: MixedModel, question: Question) -> NDArray[np.bool_]:
    """Which outputs (ny,) are measured: all but those that the diagnosed record lacks throughout."""
    if question.measured is None:
        return np.ones(model.ny, dtype=bool)
    return np.array([name in question.measured for name in model.outputs])
