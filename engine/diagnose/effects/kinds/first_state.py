"""Records that do not begin where the model says: another mean of the first state, or another scatter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_states
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.first_state import moments_of_first
from engine.statespace.model import Array, Density, Gaussian, MixedModel, Parameter

FROM_THE_MODELS = "how far from the model's it begins"
RECORDS = 4  # whose first states tell how far they scatter


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


def scatter_otherwise(model: MixedModel, state: str) -> MixedModel:
    """Standard deviation of ``state``_1 times exp(own parameter), its correlations as they are."""
    split, na = Split(model), model.na
    row = [*model.nonlinear, *model.linear].index(state)

    def scaled(cov: Array, at: int, factor: float) -> Array:
        cov = np.array(cov, dtype=float)
        cov[..., at, :] *= factor
        cov[..., :, at] *= factor
        return cov

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        start, factor = model.start(record), float(np.exp(own[0]))
        if row < na:
            mean, cov = start.density.mean, start.density.cov  # type: ignore[attr-defined]
            return Gaussian(mean, scaled(cov, row, factor)), start.z1, start.P1

        def P1(a: Array) -> Array:
            return scaled(start.linear(a)[1], row - na, factor)

        return start.density, start.z1, P1 if callable(start.P1) else P1(np.zeros((1, na)))

    return on_base(model, split, initial=initial)


def _scatter(setting: Setting, channel: str, name: str) -> Effect | None:
    """Of many records: a first covariance is often a guess, for which other effects would make up.

    That records begin closer together than it says raises no alarm: it is a rival of what else does.
    """
    model = setting.model
    if len(setting.starts) < RECORDS:
        return None
    theta = model.theta() if setting.record is None else model.theta(setting.record.theta)
    start = model.start(model.record(theta))
    if not isinstance(start.density, Gaussian):
        return None
    _, cov = moments_of_first(model, model.record(theta))
    row = [*model.nonlinear, *model.linear].index(channel)
    if not cov[row, row] > 0.0:
        return None
    return Effect(
        "start-scatter",
        channel,
        "time",
        f"first values of {channel} that scatter otherwise, from record to record, than the model says",
        f"std of {channel} at the first sample of each record times exp({name})",
        (Parameter(name, 0.0, "1", (-4.0, 6.0), "log ratio of standard deviations"),),
        lambda model: scatter_otherwise(model, channel),
        look_alikes={"start": "moves them all"},
        traits=Traits(plainness=0, of_starts=True),
    )


KINDS: list[Kind] = [at_states("start", _start), at_states("start-scatter", _scatter)]
