"""Effects in the state equation that remember: a missing pole or mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import (
    Begin,
    add_linear_states,
    beside,
    spread_at_first,
)
from engine.diagnose.effects.channels import Kind, at_pairs, each_moved, each_state
from engine.diagnose.effects.effect import MOST_GROWTH, Effect, Split, carried
from engine.diagnose.effects.setting import FREQUENCIES, SLOWEST_PROBE, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter


class _Following:
    """k states that a state ``source`` drives; the distance of the first from it acts on ``target``."""

    def __init__(self, model: MixedModel, source: str, target: str, k: int) -> None:
        self.k, self.na, self.nx, self.nz = k, model.na, model.nx, model.nz
        states = [*model.nonlinear, *model.linear]
        self.row, self.column, self.source = states.index(target), states.index(source), source

    @property
    def begin(self) -> Begin:
        """The first at x_1, the others at zero, with the spread that is the last of the effect's values."""

        def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
            m, G = np.zeros((len(a), self.k)), np.zeros((self.k, self.nz))
            if self.column < self.na:
                m[:, 0] = a[:, self.column]
            else:
                G[0, self.column - self.na] = 1.0
            return m, G, own[-1] ** 2

        return begin

    def __call__(
        self,
        step: LinearGaussian,
        a: Array,
        force: Any,
        drives: Sequence[Any],
        on: Array | None,
    ) -> LinearGaussian:
        """The step with ``force`` (l - x) on the target and ``drives`` x on each of the new states.

        ``on`` ((M,) nx) is what the step makes of one unit of the target, None where nothing acts within it.
        """
        f, A, Q = step
        if on is not None:
            return *self._around(f, A, a, force, drives, on), Q
        A[:, self.row, self.nz] += force
        rows = [(self.row, -force), *((self.nx + i, drive) for i, drive in enumerate(drives))]
        for row, factor in rows:
            if self.column < self.na:
                f[:, row] += factor * a[:, self.column]
            else:
                A[:, row, self.column - self.na] += factor
        return f, A, Q

    def _around(
        self, f: Array, A: Array, a: Array, force: Any, drives: Sequence[Any], on: Array
    ) -> tuple[Array, Array]:
        """Half the force before the step of the model, half after it; the new states follow the mean of x."""
        own, lag = slice(self.nx, self.nx + self.k), 1 + self.nz
        whole = np.concatenate([f[..., None], A], axis=2)  # of 1, z and the new states
        block = whole[:, own, lag:].copy()
        whole[:, own] = 0.0
        whole[:, own, lag:] = np.eye(self.k)
        if self.row == self.column:  # x itself fades to l by its own push
            force = -2.0 * np.expm1(np.minimum(-0.5 * force, MOST_GROWTH))
        half = np.reshape(0.5 * force, (-1, 1))
        x = np.zeros_like(whole[:, 0])
        if self.column < self.na:
            x[:, 0] = a[:, self.column]
        else:
            x[:, 1 + self.column - self.na] = 1.0
        before = -half * x
        before[:, lag] += half[:, 0]
        whole[:, : self.nx] += on[..., None] * before[:, None]
        x = 0.5 * (x + whole[:, self.column] + (before if self.row == self.column else 0.0))
        driven = np.stack(np.broadcast_arrays(*drives), axis=-1)
        whole[:, own] = block @ whole[:, own] + np.reshape(driven, (-1, self.k, 1)) * x[:, None]
        whole[:, self.row] += half * (whole[:, self.nx] - whole[:, self.column])
        return whole[..., 0], whole[..., 1:]


def _pole(setting: Setting, channel: str, name: str, source: str, target: str) -> Effect:
    """A first-order lag of a state that acts back: l' = l + dt (x - l) / tau, a force size (l - x)."""
    spread = spread_at_first(setting, name, source)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        follow = _Following(model, source, target, 1)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            M = len(a)
            keep = np.broadcast_to(np.exp(-dt / own[1]), (M,))
            step = model.transition(a, u, t, dt, own_base)
            on = carried(model, follow.row, step, a, u, t, dt, own_base)
            step = beside(step, M, [[keep]], 0.0)
            return follow(step, a, dt * own[0], [1.0 - keep], on)

        states = {f"lag_{source}": setting.unit(source)}
        return add_linear_states(model, split, states, dynamics, follow.begin)

    return Effect(
        "pole",
        channel,
        "state",
        f"missing pole: a lag of {source} acting on {target}",
        f"l' = l + dt ({source} - l) / {name}_time,  {target}' = ... + dt * {name} * (l - {source})",
        (
            Parameter(name, 0.0, setting.rate(target, setting.unit(source))),
            setting.time_constant(f"{name}_time"),
            spread,
        ),
        extend,
        probes=tuple((k * setting.dt, spread.default) for k in (5.0, SLOWEST_PROBE)),
        held=(spread.name,),
        spread=spread.name,
        look_alikes={"coupling": "acts without delay", "latent": "is not driven by the states"},
        traits=Traits(contains=("linear", "coupling")),
    )


def _mode(setting: Setting, channel: str, name: str, source: str, target: str) -> Effect:
    """A resonance that a state excites and that acts back: q'' = w^2 (x - q) - 2 zeta w q', size (q - x).

    Discretised exactly for x held over the step; its second state is q' / w, in the unit of x.
    """
    unit, spread = setting.unit(source), spread_at_first(setting, name, source)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        follow = _Following(model, source, target, 2)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            M = len(a)
            omega, zeta = 2.0 * np.pi * own[1], own[2]
            damped = np.sqrt(1.0 - zeta * zeta)
            angle, fades = damped * omega * dt, np.exp(-zeta * omega * dt)
            c, s = fades * np.cos(angle), fades * np.sin(angle) / damped
            block = [[np.broadcast_to(c + zeta * s, (M,)), s], [-s, c - zeta * s]]
            step = model.transition(a, u, t, dt, own_base)
            on = carried(model, follow.row, step, a, u, t, dt, own_base)
            step = beside(step, M, block, 0.0)
            return follow(step, a, dt * own[0], [1.0 - block[0][0], s], on)

        own_states = {f"mode_{source}": unit, f"mode_rate_{source}": unit}
        return add_linear_states(model, split, own_states, dynamics, follow.begin)

    return Effect(
        "mode",
        channel,
        "state",
        f"missing mode: a resonance driven by {source} acting on {target}",
        f"q'' = w^2 ({source} - q) - 2 {name}_damping w q',  w = 2 pi {name}_frequency,  "
        f"{target}' = ... + dt * {name} * (q - {source})",
        (
            Parameter(name, 0.0, setting.rate(target, unit)),
            setting.frequency(f"{name}_frequency"),
            Parameter(f"{name}_damping", 0.1, "1", (1e-3, 0.99)),
            spread,
        ),
        extend,
        probes=tuple((f / setting.dt, 0.2, spread.default) for f in FREQUENCIES),
        held=(spread.name,),
        spread=spread.name,
        look_alikes={"pole": "does not ring", "harmonic": "does not depend on the states"},
        traits=Traits(contains=("linear", "coupling", "pole")),
    )


KINDS: list[Kind] = [
    at_pairs("pole", _pole, each_state),
    at_pairs("mode", _mode, each_moved),
]
