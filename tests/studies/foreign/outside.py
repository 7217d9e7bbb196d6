"""What no kind of the catalogue describes."""

from __future__ import annotations

import math

import numpy as np

from tests.studies.foreign.faults import force, onto, sign
from tests.studies.foreign.plant import Fault, Numbers, Own

SWEEP = (0.005, 0.05)  # cycles per sample, of a chirp from the first sample to the last
FLIP = 40.0  # samples that a telegraph stays on average
TURNS = 60  # of it at most


def chirp(state: int, of: int, samples: int, dt: float, first: float) -> Fault:
    """A force that swings faster and faster."""
    low, high = SWEEP[0] / dt, SWEEP[1] / dt
    rate = (high - low) / (samples * dt)
    return force(
        "outside:chirp",
        state,
        of,
        lambda t, x, u, own: math.sin(2.0 * math.pi * (low + 0.5 * rate * t) * t),
        first,
    )


def telegraph(state: int, of: int, first: float) -> Fault:
    """A force that changes its sign at random times."""

    def draw(rng: np.random.Generator, seconds: float, dt: float) -> dict[str, float]:
        turns = np.cumsum(rng.exponential(FLIP * dt, TURNS))
        return {f"turn{k}": float(t) for k, t in enumerate(turns)}

    def value(t: float, x: Numbers, u: Numbers, own: Own) -> float:
        return 1.0 if sum(turn <= t for turn in own.values()) % 2 == 0 else -1.0

    return Fault("outside:telegraph", first, push=onto(state, of, value), draw=draw)


def root_friction(state: int, of: int, scale: float, first: float) -> Fault:
    """Friction like the root of the speed."""
    return force(
        "outside:root-friction",
        state,
        of,
        lambda t, x, u, own: -sign(x[state], scale) * math.sqrt(abs(x[state]) / scale),
        first,
        most=3.0 * first,
    )


def product(
    one: int, other: int, state: int, of: int, zeros: tuple[float, float], first: float
) -> Fault:
    """A force of two states at once: size (x - x0) (y - y0)."""
    return force(
        "outside:product",
        state,
        of,
        lambda t, x, u, own: (x[one] - zeros[0]) * (x[other] - zeros[1]),
        first,
    )


def saturating(state: int, of: int, half: float, first: float) -> Fault:
    """Growth (or decay) that saturates, as enzymes do: -size x / (half + |x|)."""
    return force(
        "outside:saturating",
        state,
        of,
        lambda t, x, u, own: -x[state] / (half + abs(x[state])),
        first,
    )


def trickle(state: int, of: int, power: float, zero: float, scale: float, first: float) -> Fault:
    """A loss to some power above a threshold, as over a notch: -size ((x - zero)+ / scale)^power."""
    return force(
        "outside:notch",
        state,
        of,
        lambda t, x, u, own: -((max(x[state] - zero, 0.0) / scale) ** power),
        first,
    )
