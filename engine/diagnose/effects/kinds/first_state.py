"""A record that does not begin where the model says: another mean of the first state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_states
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, Density, Gaussian, MixedModel, Parameter

FROM_THE_MODELS = "how far from the model's it begins"


@dataclass(frozen=True)
class Shifted:
    """A density (of a_1) moved by ``by`` (na,)."""

    density: Density
    by: Array

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """n draws (n, na)."""
        return np.asarray(self.density.sample(rng, n) + self.by)

    def log_density(self, a: Array) -> Array:
        """Of a (M, na): (M,)."""
        return self.density.log_density(a - self.by)


def begin_elsewhere(model: MixedModel, state: str) -> MixedModel:
    """``state``_1 = ... + own parameter; its uncertainty and that of the others stay."""
    split, na = Split(model), model.na
    row = [*model.nonlinear, *model.linear].index(state)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        start, by = model.start(record), np.zeros(model.nx)
        by[row] = own[0]

        def z1(a: Array) -> Array:
            return start.linear(a - by[:na])[0] + by[na:]

        def P1(a: Array) -> Array:
            return start.linear(a - by[:na])[1]

        density = _moved(start.density, by[:na])
        # functions of a_1 only where the model has such, as they cost more
        mean = z1 if callable(start.z1) else z1(np.zeros((1, na)))[0]
        return density, mean, P1 if callable(start.P1) else start.P1

    return on_base(model, split, initial=initial)


def _moved(density: Density, by: Array) -> Density:
    if isinstance(density, Gaussian):
        return Gaussian(density.mean + by, density.cov)
    return Shifted(density, by)


def _start(setting: Setting, channel: str, name: str) -> Effect:
    return Effect(
        "start",
        channel,
        "time",
        f"another first value of {channel} than the model's",
        f"{channel} at the first sample = ... + {name}",
        (Parameter(name, 0.0, setting.unit(channel), description=FROM_THE_MODELS),),
        lambda model: begin_elsewhere(model, channel),
        look_alikes={
            "bias": "does not fade",
            "force": "goes on pushing",
            "step": "comes later and stays",
        },
        traits=Traits(plainness=0, of_record=True),
    )


KINDS: list[Kind] = [at_states("start", _start)]
