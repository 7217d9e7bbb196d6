"""Proposal densities q(a_{t+1} | a_{1:t}, y_{1:t+1}) of the RBPF; report, eqs. (29)-(31).

A proposal is a function of a :class:`Step` that returns the drawn a (M, na) and log q (M,), or
None for log q when it drew from the prediction p(a_{t+1} | a_{1:t}, y_{1:t}) itself. Any such
function may be passed to :func:`engine.rbpf`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from engine.errors import OptionError
from engine.kernels.adapted import draw_adapted, spread_points
from engine.kernels.filtering import draw_prior
from engine.statespace.model import Array, stacked

INFLATION = 1.3  # the adapted covariance is widened: the linearisation is only a guess
DEFENSIVE = 0.1  # share drawn from the prediction, so that no weight exceeds 10 bootstrap weights


@dataclass(slots=True)
class Step:
    """What a proposal may look at: the prediction of x = (a, z) and the new measurement.

    ``mu`` (M, nx) and ``L`` (B, nx, nx) are the predicted moments, report, eq. (22), particle i
    continuing ``ancestors[i]``; ``y`` (ny,) has NaN where a channel is missing; ``u`` (nu,); ``t``
    in seconds; ``theta`` a record. ``roots`` (M, ny), if given, scale the measurement noise of each particle.
    """

    model: Any
    theta: Any
    mu: Array
    L: Array
    ancestors: np.ndarray[Any, np.dtype[np.int64]]
    y: Array
    u: Array
    t: float
    rng: np.random.Generator
    roots: Array | None = None


Proposal: TypeAlias = Callable[[Step], tuple[Array, Array | None]]


def bootstrap(step: Step) -> tuple[Array, None]:
    """Draw from the prediction, report, eq. (23); blind to y."""
    noise = step.rng.standard_normal((len(step.ancestors), step.model.na))
    return draw_prior(step.mu, step.L, step.ancestors, noise), None


def adapted(step: Step) -> tuple[Array, Array | None]:
    """Draw near where y says a should be: an extended Kalman step per particle, safeguarded.

    See :func:`engine.kernels.filtering.draw_adapted`. Without any measurement it is ``bootstrap``. A random
    scale of the noise brings a ``propose(step)`` of its own, see :mod:`engine.filters.scale_mixture_proposal`.
    """
    model, M, na = step.model, len(step.ancestors), step.model.na
    if na == 0 or not any(value == value for value in step.y.tolist()):  # NaN throughout
        return bootstrap(step)
    if model.random_scales:
        drawn: tuple[Array, Array | None] = model.random_scales[-1].propose(step)
        return drawn
    points = spread_points(step.mu, step.L, step.ancestors, na)
    h, C, R = model.observation(points, step.u, step.t, step.theta)
    if step.roots is not None:
        each = np.tile(step.roots, (len(points) // M, 1))
        R = R * each[:, :, None] * each[:, None, :]
    a, log_q = draw_adapted(
        step.mu,
        step.L,
        step.ancestors,
        h,
        stacked(C),
        stacked(R),
        step.y,
        step.rng.standard_normal((M, na)),
        step.rng.random(M),
        DEFENSIVE,
        INFLATION,
    )
    return a, log_q


PROPOSALS: dict[str, Proposal] = {"adapted": adapted, "bootstrap": bootstrap}


def get_proposal(proposal: str | Proposal) -> Proposal:
    """A proposal by name, or the function itself. Raises OptionError."""
    if callable(proposal):
        return proposal
    if proposal not in PROPOSALS:
        raise OptionError(
            f"proposal '{proposal}' is not known; use {' or '.join(PROPOSALS)}, or a function",
            "proposal",
        )
    return PROPOSALS[proposal]
