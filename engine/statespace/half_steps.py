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


def two_halves(base: MixedModel, a: Array, u: Any, t: Any, dt: Any, record: Any) -> Array:
    """Means (M, nx) after two half-steps from a (M, nx), of a model without linear states."""
    half = base.transition(a, u, t, 0.5 * dt, record)[0]
    return base.transition(half, u, t + 0.5 * dt, 0.5 * dt, record)[0]


def in_half_steps(model: MixedModel) -> MixedModel:
    """The model with the means of two half-steps and the noise of one; all states are nonlinear."""
    base = as_nonlinear(model)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        _, A, Q = base.transition(a, u, t, dt, theta)
        return two_halves(base, a, u, t, dt, theta), A, Q

    return replace(base, dynamics=dynamics)


def halving_changes(
    model: MixedModel, theta: Array, x: Array, u: Array, t: Array, dt: Array
) -> bool:
    """Whether dt is a real time step, and halving it changes something; at rows x (n, nx), u (n, nu), t, dt."""
    # states that only scale noise have no memory
    others = ~np.isin([*model.nonlinear, *model.linear], model.scale_states)
    moves, short, halves = [], [], []
    for own, at, when, long in zip(x, u, t, dt, strict=True):
        here = own[None]
        whole = step(model, theta, here, at, when, long)
        half = step(model, theta, here, at, when, 0.5 * long)
        moves.append(whole - here)
        halves.append(step(model, theta, half, at, when + 0.5 * long, 0.5 * long) - whole)
        short.append(step(model, theta, here, at, when, SHORTER * long) - here)
    whole, little, change = (
        np.sqrt(np.mean(np.square(x), axis=0))[0, others] for x in (moves, short, halves)
    )
    return bool((little <= HARDLY * whole).all() and (change > ROUNDING * whole).any())
