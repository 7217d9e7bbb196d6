"""Noise that is on a reading before anything is done to it, as in a logger that smooths what it has read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import add_linear_states, beside
from engine.diagnose.effects.effect import Split, per_point
from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Array, MixedModel, Parameter

LEFT = 1e-6  # of its variance: what still comes afterwards, for no reading is exact


def noise_too(name: str) -> Parameter:
    """Held parameter of the effect ``name``: whether it does to a reading's noise what it does to the rest."""
    return Parameter(f"{name}_noise", 0.0, "1", (0.0, 1.0), "1: it does so to the noise as well")


def noise_inside(
    model: MixedModel, setting: Setting, channel: str, kept: Callable[[Any], Any]
) -> MixedModel:
    """The model with the noise of a reading as a state, where the last of the effect's own values is 1.

    The state is so large that what is ``kept(own)``, a number or (M,), of its variance is R, as it was before.
    """
    split, row = Split(model), list(model.outputs).index(channel)
    u1 = np.array([setting.first(name) for name in model.inputs])

    def variance(a: Array, u: Any, t: Any, record: Any, own: Any) -> Any:
        R = model.observation(a, u, t, record)[2]
        return own[-1] * (1.0 - LEFT) / kept(own) * R[..., row, row]

    def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
        at_first = np.mean(variance(a, u1, setting.span[0], record, own))
        return np.zeros((len(a), 1)), np.zeros((1, model.nz)), at_first

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        step = model.transition(a, u, t, dt, record)
        return beside(step, len(a), [[0.0]], variance(a, u, t, record, own))

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = model.observation(a, u, t, record)
        C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
        C[..., row, -1] = 1.0
        return h, C, with_part(R, row, 1.0 - own[-1] * (1.0 - LEFT), len(a))

    states = {f"noise_{channel}": setting.unit(channel)}
    return add_linear_states(model, split, states, dynamics, begin, measurement=measurement)


def with_part(R: Array, row: int, left: Any, M: int) -> Array:
    """R with what is ``left``, a number or (M,), of the variance of one reading's noise."""
    share = np.sqrt(left)
    R = per_point(R, M, share)
    share = np.reshape(share, (-1, 1)) if np.ndim(share) else share
    R[..., row, :] *= share
    R[..., :, row] *= share
    return R
