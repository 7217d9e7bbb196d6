"""Random numbers: what a user gives for them, checked."""

from __future__ import annotations

from numbers import Integral
from typing import TypeAlias

import numpy as np

from engine.errors import OptionError

Rng: TypeAlias = np.random.Generator | int


def generator(rng: Rng) -> np.random.Generator:
    """The generator, or a new one from a seed. Raises OptionError for anything else."""
    if isinstance(rng, np.random.Generator):
        return rng
    check_seed(rng, "rng")
    return np.random.default_rng(rng)


def check_seed(seed: object, name: str = "seed") -> None:
    """Raise OptionError unless the argument ``name`` is a whole number that is not negative."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or int(seed) < 0:
        or_else = " or a numpy.random.Generator" if name == "rng" else ""
        raise OptionError(f"{name} = {seed!r}; a whole number from 0 on{or_else} is needed", name)
