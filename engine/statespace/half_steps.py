"""A model whose dt is a real time step, and the same one with two steps of half the length in place of one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.statespace.model import Array, MixedModel
from engine.statespace.promotion import as_nonlinear

SHORTER = 1e-3  # of the step: over so short a time the state of a model with a real dt hardly moves
HARDLY = 0.1  # of its move over the whole step
ROUNDING = 1e-6  # of its move: what two half-steps may differ by and be the same


def step(model: MixedModel, theta: Array, x: Array, u: Any, t: Any, dt: Any) -> Array:
    """Means (M, nx) one step after x (M, nx)."""
    na = model.na
    with np.errstate(all="ignore"):
        f, A, _ = model.transition(np.ascontiguousarray(x[:, :na]), u, t, dt, model.record(theta))
        return np.asarray(f + np.einsum("...ij,...j->...i", A, x[:, na:]))


def in_parts(base: MixedModel, a: Array, u: Any, t: Any, dt: Any, record: Any, n: int = 2) -> Array:
    """Means (M, nx) after n equal steps in one from a (M, nx), of a model without linear states."""
    for k in range(n):
        a = base.transition(a, u, t + k / n * dt, dt / n, record)[0]
    return a


def in_half_steps(model: MixedModel) -> MixedModel:
    """The model with the means of two half-steps and the noise of one; all states are nonlinear."""
    base = as_nonlinear(model)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        _, A, Q = base.transition(a, u, t, dt, theta)
        return in_parts(base, a, u, t, dt, theta), A, Q

    return replace(base, dynamics=dynamics)


def halving_changes(
    model: MixedModel, theta: Array, x: Array, u: Array, t: Array, dt: Array
) -> bool:
    """Whether dt is a real time step, and halving it changes something; at rows x (n, nx), u (n, nu), t, dt."""
    # states that only scale noise have no memory
    others = ~np.isin([*model.nonlinear, *model.linear], model.scale_states)
    whole = step(model, theta, x, u.T, t, dt)
    half = step(model, theta, x, u.T, t, 0.5 * dt)
    twice = step(model, theta, half, u.T, t + 0.5 * dt, 0.5 * dt)
    short = step(model, theta, x, u.T, t, SHORTER * dt)
    moved, little, change = (
        np.sqrt(np.mean(np.square(each), axis=0))[others]
        for each in (whole - x, short - x, twice - whole)
    )
    return bool((little <= HARDLY * moved).all() and (change > ROUNDING * moved).any())
