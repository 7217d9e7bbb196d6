"""Noise with a memory: coloured noise of a sensor, and unnamed forces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import Begin, add_linear_states, beside
from engine.diagnose.effects.channels import Kind, each_output
from engine.diagnose.effects.effect import Effect, Split
from engine.diagnose.effects.setting import FREQUENCIES, SLOWEST_PROBE, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.units import product

LATENT = "latent"  # the kind of the unnamed force
OSCILLATING = "oscillating"  # the second manner of an unnamed force


def _colored(setting: Setting, channel: str) -> Effect | None:
    """A part of the noise is first-order autoregressive.

    In a state's equation that is what the unnamed slow force is, so there it goes by name only.
    """
    if channel not in setting.model.outputs:
        force = _latent(setting, channel)
        if force is None:
            return None
        return replace(force, kind="colored", title=f"coloured process noise of {channel}")
    name, unit = setting.identifier("colored", channel), setting.unit(channel)
    most = setting.limits(0.0, 100.0 * setting.size(channel) ** 2, 0.0)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            return _ou(model.transition(a, u, t, dt, own_base), len(a), dt, own)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
            C[..., row, -1] = 1.0
            return h, C, R

        states, begin = {f"noise_{channel}": unit}, _stationary(model.nz, 1)
        return add_linear_states(model, split, states, dynamics, begin, measurement=measurement)

    return Effect(
        "colored",
        channel,
        "noise",
        f"coloured measurement noise of {channel}",
        f"{channel} = ... + c,  c an Ornstein-Uhlenbeck process of variance {name}",
        (
            Parameter(name, 0.0, product((unit, 2.0)), most, "variance"),
            _time_parameter(name, setting),
        ),
        extend,
        probes=((2.0 * setting.dt,), (10.0 * setting.dt,)),
        look_alikes={"latent": "moves the state", "lag": "is driven by the reading itself"},
        one_sided=True,
    )


def _latent(setting: Setting, channel: str) -> Effect | None:
    """An unnamed force: a random process in one equation; detects "something".

    First-order and slow (Ornstein-Uhlenbeck), or, as ``state,oscillating``, of second order: a noise
    that swings about a frequency and forgets its phase.
    """
    target, _, manner = channel.partition(",")
    if target not in setting.states or manner not in ("", OSCILLATING):
        return None
    name, unit = setting.identifier(LATENT, channel), setting.rate(target)
    most = setting.limits(0.0, 100.0 * (setting.size(target) / setting.dt) ** 2, 0.0)
    swings = manner == OSCILLATING
    states = {f"force_{target}": unit}
    if swings:
        states = {f"swing_{target}": unit, **states}

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = [*model.nonlinear, *model.linear].index(target)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            step = model.transition(a, u, t, dt, own_base)
            f, A, Q = (_swing if swings else _ou)(step, len(a), dt, own)
            A[..., row, -1] += dt
            return f, A, Q

        return add_linear_states(model, split, states, dynamics, _stationary(model.nz, len(states)))

    parameters = [
        Parameter(name, 0.0, product((unit, 2.0)), most, "variance"),
        _time_parameter(name, setting),
    ]
    probes: tuple[tuple[float, ...], ...] = ((3.0 * setting.dt,), (20.0 * setting.dt,))
    if swings:
        parameters.append(setting.frequency(f"{name}_frequency"))
        probes = tuple((15.0 * setting.dt, f / setting.dt) for f in FREQUENCIES)
    return Effect(
        LATENT,
        channel,
        "noise",
        f"unnamed {'oscillating' if swings else 'slow'} force on {target}",
        f"{target}' = ... + dt * d,  d {'a noisy oscillation' if swings else 'an Ornstein-Uhlenbeck process'} "
        f"of variance {name}",
        tuple(parameters),
        extend,
        probes=probes,
        look_alikes={"colored": "does not move the state"},
        one_sided=True,
        traits=Traits(unnamed=True, swallowed=True),
    )


def _each_latent(setting: Setting) -> list[str]:
    return [name for state in setting.targets for name in (state, f"{state},{OSCILLATING}")]


def _time_parameter(name: str, setting: Setting) -> Parameter:
    bounds = setting.limits(0.3 * setting.dt, max(setting.length, SLOWEST_PROBE * setting.dt))
    return setting.time(f"{name}_time", 5.0 * setting.dt, bounds, "correlation time")


def _stationary(nz: int, k: int) -> Begin:
    """k states of the size's variance each, about zero and independent of the rest."""
    return lambda a, record, own: (np.zeros((len(a), k)), np.zeros((k, nz)), own[0])


def _ou(step: LinearGaussian, M: int, dt: Any, own: Any) -> LinearGaussian:
    """One more linear state d' = exp(-dt/tau) d + w of stationary variance own[0]."""
    keep = np.exp(-dt / own[1])
    return beside(step, M, [[keep]], own[0] * (1.0 - keep * keep))


def _swing(step: LinearGaussian, M: int, dt: Any, own: Any) -> LinearGaussian:
    """Two more linear states that rotate at own[2] Hz and fade with own[1], of variance own[0] each."""
    keep = np.exp(-dt / own[1])
    angle = 2.0 * np.pi * own[2] * dt
    c, s = keep * np.cos(angle), keep * np.sin(angle)
    return beside(step, M, [[c, s], [-s, c]], own[0] * (1.0 - keep * keep))


KINDS: list[Kind] = [
    ("colored", _colored, each_output),
    (LATENT, _latent, _each_latent),
]
