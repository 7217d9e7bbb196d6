"""Along the edge of where a model can be had, which several parameters have together.

An oscillator written with the root of w^2 - c^2 / 4 cannot be had where it is overdamped. With a maximum
beyond that edge each of both parameters is held next to it, and neither may move without the other. Near theta
the edge is a plane n'd = 1: how far it is along each parameter k tells n_k. The scoring step is then the one of

    max g'd - 1/2 d'H d    with    n'd <= room,    d = H^{-1} (g - lambda n).

The edge may be bent, so what has left it is brought back by the parameter that does so with the least.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.arrays import Array

LOOKED = 1e-3  # of a parameter's scale: so far at least the edge is looked for
CLOSE = 1e-8  # of it: so far from the edge a place is kept, that its direction can be told
CLOSEST = 1e-13  # of it: a distance that is as good as none
HALVINGS = 40
ROOM = 0.9  # of the way to the edge, that a step may go
LENGTHS = 0.5 ** np.arange(12.0)  # of a step
SLIGHT = 0.1  # nats expected, with which a place counts as the highest where no step of any length is better
RIDGE = 1e-8  # of the information scaled to a unit diagonal


@dataclass(frozen=True, eq=False)
class Place:
    """Free parameters x (n,), their log-likelihood, gradient (n,) and information (n, n)."""

    x: Array
    value: float
    g: Array
    H: Array


@dataclass(frozen=True, eq=False)
class Edge:
    """Between ``lower`` and ``upper`` (n,), for parameters of a ``scale`` (n,); whether a model ``can`` be had.

    ``likelihoods`` of points (K, n) are -inf where it cannot; ``at`` a point tells what is known there.
    """

    lower: Array
    upper: Array
    scale: Array
    can: Callable[[Array], bool]
    likelihoods: Callable[[Array], Array]
    at: Callable[[Array], Place]

    def climbed(
        self, here: Place, tolerance: float, converged: bool, most: int
    ) -> tuple[Place, bool]:
        """The highest place along the edge, and whether no more than the tolerance is expected beyond it.

        After ``most`` steps it ends wherever it is. Where no edge is seen and nothing is gained, it is as
        ``converged`` says: where it is the filter that is lost, a bound that was learnt holds the place.
        """
        idle = 0  # steps in turn that gained next to nothing, as at a kink
        for _ in range(most):
            step, normal = self._step(here, tolerance)
            expected = float(here.g @ step)
            if not expected > tolerance:
                return here, True
            ended = expected <= SLIGHT or (converged and not normal.any())
            if idle > 1:
                return here, ended
            trials = np.clip(here.x + LENGTHS[:, None] * step, self.lower, self.upper)
            ways = np.array([self._brought_back(x, normal) for x in trials])
            values = self.likelihoods(ways)
            best = int(np.argmax(values))
            if not values[best] > here.value:
                return here, ended
            there = self.at(ways[best])
            if not np.isfinite(there.value):
                return here, False
            idle = idle + 1 if there.value - here.value < 0.1 * tolerance else 0
            here = there
        return here, False

    def _step(self, here: Place, tolerance: float) -> tuple[Array, Array]:
        """The step d (n,), and n (n,), which is not looked for where the step is worth no more than that."""
        x, g, diagonal = here.x, here.g, np.diag(here.H)
        held = ((x <= self.lower) & (g < 0.0)) | ((x >= self.upper) & (g > 0.0))
        moving = np.flatnonzero(~held & (diagonal > 0.0))
        out = np.zeros_like(x)
        if not moving.size:
            return out, out
        unit = 1.0 / np.sqrt(diagonal[moving])
        H = here.H[np.ix_(moving, moving)] * np.outer(unit, unit) + RIDGE * np.eye(len(unit))
        free = np.linalg.solve(H, g[moving] * unit)
        out[moving] = free * unit
        if not float(g @ out) > tolerance:
            return out, np.zeros_like(x)
        normal = self._normal(x, out)
        n = normal[moving] * unit
        room = min(ROOM, 1.0 - CLOSE * float(np.abs(normal * self.scale).max()))
        if float(n @ free) > room:
            along = np.linalg.solve(H, n)
            free = free - along * ((n @ free - room) / (n @ along))
            out[moving] = free * unit
        return out, normal

    def _brought_back(self, x: Array, normal: Array) -> Array:
        """Where the model can be had, from x (n,) on; x itself where that is not to be found."""
        if not normal.any() or self.can(x):
            return x
        k = int(np.argmax(np.abs(normal) * self.scale))
        there, far = x.copy(), -np.sign(normal[k]) * CLOSEST * self.scale[k]
        for _ in range(HALVINGS):
            there[k] = np.clip(x[k] + far, self.lower[k], self.upper[k])
            if self.can(there):
                break
            far *= 2.0
        else:
            return x
        near = 0.5 * far
        for _ in range(HALVINGS):
            there[k] = np.clip(x[k] + 0.5 * (near + far), self.lower[k], self.upper[k])
            near, far = (near, 0.5 * (near + far)) if self.can(there) else (0.5 * (near + far), far)
        inside = far - np.sign(normal[k]) * CLOSE * self.scale[k]
        there[k] = np.clip(x[k] + inside, self.lower[k], self.upper[k])
        return there

    def _normal(self, x: Array, step: Array) -> Array:
        """n (n,): 1 / how far the edge is along each parameter; 0 where it is farther than the step."""
        out = np.zeros_like(x)
        for k, reach in enumerate(np.maximum(np.abs(step), LOOKED * self.scale)):
            for sign in (1.0, -1.0):
                far = self._distance(x, k, sign * reach)
                if far:
                    out[k] = max(out[k], 1.0 / far, key=abs)
        return out

    def _distance(self, x: Array, k: int, reach: float) -> float:
        """How far the edge is along parameter k, with its sign; 0 where there is none within ``reach``."""

        def can(way: float) -> bool:
            there = x.copy()
            there[k] += way
            inside = self.lower[k] <= there[k] <= self.upper[k]
            return not inside or self.can(there)

        if can(reach):
            return 0.0
        near, far = 0.0, reach
        for _ in range(HALVINGS):
            middle = 0.5 * (near + far)
            near, far = (middle, far) if can(middle) else (near, middle)
        return float(np.sign(reach) * max(abs(near), CLOSEST * self.scale[k]))
