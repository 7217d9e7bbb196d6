"""The cases: two causes of a system with their sizes, one of them true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.design import Bounds
from engine.design.bounds import InputBounds
from engine.design.candidates import Question
from engine.design.inputs import limited
from engine.design.search import Task
from engine.statespace.model import Array
from tests.studies.design.systems import SYSTEMS, System

Own = dict[str, float]


@dataclass(frozen=True)
class Pair:
    """Two causes with typical values of their parameters; the first is the size.

    ``narrow`` is the share of the inputs' range that is allowed, about its middle; no size is above ``most``.
    """

    system: str
    causes: dict[str, tuple[float, ...]]
    narrow: float = 1.0
    most: float = np.inf


DECIDABLE = (
    Pair("drive", {"drag:velocity": (0.08,), "coulomb:velocity": (0.15,)}),
    Pair("drive", {"drag:velocity": (0.2,), "cubic:velocity": (-0.06,)}),
    Pair("drive", {"coulomb:velocity": (0.12,), "input-deadzone:voltage": (0.25,)}),
    Pair("drive", {"quadratic:velocity": (0.03,), "force:velocity": (0.06,)}),
    Pair("spring", {"cubic:position->velocity": (-1.2,), "drag:position->velocity": (1.2,)}),
    Pair("spring", {"cubic:position->velocity": (-0.5,), "cubic:velocity": (-0.2,)}),
    Pair("spring", {"drag:velocity": (0.25,), "coulomb:velocity": (0.12,)}),
    Pair("tank", {"quadratic:level": (-0.001,), "linear:level": (-0.01,)}),
    Pair("tank", {"linear:level": (-0.02,), "force:level": (0.05,)}),
    Pair("tank", {"quadratic:level": (-0.0015,), "cubic-sensor:gauge": (0.0005,)}),
)
# the same thing in other words, or things that the bounds keep from happening: an overflow above the level
# that must be kept, inputs too small to leave a dead zone or to overcome friction, or a spring's cubic far
# below its noise
UNDECIDABLE = (
    Pair("drive", {"force:velocity": (0.2,), "input-offset:voltage": (0.4,)}),
    Pair("tank", {"force:level": (0.05,), "input-offset:pump": (1.0,)}),
    Pair("oven", {"force:air": (0.3,), "input-offset:heater": (0.6,)}),
    Pair(
        "tank", {"overflow:level": (0.05, 15.0), "saturation-sensor:gauge": (0.7, 15.0)}, most=1.0
    ),
    Pair("drive", {"input-deadzone:voltage": (0.3,), "coulomb:velocity": (0.15,)}, 0.02),
    Pair("spring", {"cubic:position->velocity": (-0.5,), "cubic:velocity": (-0.2,)}, 0.02),
)
SPREAD = 0.3  # of the sizes' logarithm
ROWS = 300  # samples of a designed experiment


@dataclass(frozen=True, eq=False)
class Case:
    """A pair with its sizes drawn."""

    pair: Pair
    causes: dict[str, dict[str, float]]
    true: int
    bounds: Bounds

    @property
    def system(self) -> System:
        """The system."""
        return SYSTEMS[self.pair.system]

    def task(self, question: Question, length: int) -> Task:
        """What inputs of a length are searched for."""
        seen = np.ones(self.system.model.ny, dtype=bool)
        return Task(
            question.candidates, self.bounds, length, self.system.dt, "zoh", 1, seen, anew=True
        )

    @property
    def free(self) -> list[str]:
        """What is estimated."""
        return list(self.system.model.parameter_names)


def drawn(pair: Pair, rng: np.random.Generator) -> Case:
    """A case of a pair: sizes and the true one at random."""
    system, causes = SYSTEMS[pair.system], {}
    for name, values in pair.causes.items():
        size = np.inf
        while size >= pair.most:
            size = values[0] * float(np.exp(SPREAD * rng.standard_normal()))
        causes[name] = dict(zip(_names(name), [size, *values[1:]], strict=False))
    return Case(pair, causes, int(rng.integers(2)), _bounds(system, pair.narrow))


def _names(effect: str) -> list[str]:
    size = "".join(c if c.isalnum() else "_" for c in effect.replace("->", "__"))
    return [size, f"{size}_limit"]


def _bounds(system: System, narrow: float) -> Bounds:
    full = Bounds.of({"inputs": system.inputs, "states": system.states, "dt": system.dt})
    inputs: dict[str, Any] = {}
    for name, one in full.inputs.items():
        centre = 0.5 * (one.low + one.high)
        half = 0.5 * narrow * (one.high - one.low)
        inputs[name] = {"low": centre - half, "high": centre + half, "rate": one.rate}
    return Bounds(inputs, full.states, full.outputs, full.dt, full.sigmas)


def random_binary(
    bounds: Sequence[InputBounds], T: int, dt: float, clock: int, rng: np.random.Generator
) -> Array:
    """Inputs (T, nu) that are at one end of their range or the other, drawn every ``clock`` samples."""
    out = np.empty((T, len(bounds)))
    for i, limits in enumerate(bounds):
        bits = rng.integers(0, 2, size=T // clock + 1)
        ends = np.array([limits.low, limits.high])
        out[:, i] = limited(ends[np.repeat(bits, clock)[:T]], limits, dt)
    return out
