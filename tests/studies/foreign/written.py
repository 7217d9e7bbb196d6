"""A plant together with the model a user wrote for it, and what may be wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from engine.statespace.model import MixedModel
from tests.studies.foreign.plant import Fault, Plant


@dataclass(frozen=True)
class Units:
    """Another person's units: x' = scale x + zero for the channels given, t' = time t.

    Channels that are not given keep their unit. Only channels that have no natural zero of their own in the
    plant, or whose zero the model declares, are given another one.
    """

    scale: Mapping[str, float] = field(default_factory=dict)
    zero: Mapping[str, float] = field(default_factory=dict)
    time: float = 1.0


@dataclass(frozen=True)
class System:
    """``base(level)`` is the model with the start values of a data sheet for a level of noise.

    ``known`` parameters are not estimated; ``noise(level)`` are the true parameters of the noise; ``faults``
    go by short names; ``euler`` marks models that step with Euler's rule, whose results are told apart.
    """

    plant: Plant
    base: Callable[[str], MixedModel]
    faults: Mapping[str, Fault]
    known: tuple[str, ...]
    units: Units
    noise: Callable[[str], Mapping[str, float]]
    rows: int = 400
    euler: bool = False

    @property
    def name(self) -> str:
        """The plant's name."""
        return self.plant.name

    def truth(self, level: str) -> dict[str, float]:
        """The model's parameters as the plant has them."""
        names = self.base(level).parameter_names
        return {n: v for n, v in {**self.plant.p, **self.noise(level)}.items() if n in names}

    def free(self, level: str) -> list[str]:
        """Parameters that are estimated."""
        return [n for n in self.base(level).parameter_names if n not in self.known]


def model(
    *, continuous: bool = True, reference: Mapping[str, float] | None = None, **parts: Any
) -> MixedModel:
    """A MixedModel that declares what this version of the engine can be told.

    ``continuous``: its dt is a real one; ``reference``: natural zeros of channels, in their units.
    """
    known = MixedModel.__dataclass_fields__
    if continuous and "continuous" in known:
        parts["continuous"] = True
    if reference and "reference" in known:
        parts["reference"] = dict(reference)
    return MixedModel(**parts)
