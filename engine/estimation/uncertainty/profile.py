"""Along the profile likelihood of one parameter: its slope at values further and further from the estimate.

The other parameters follow by scoring. On a curved ridge the information at the estimate leads them astray
elsewhere, so that it changes along the way as the moment filter's does. Where they do not arrive the step is
halved. For linear Gaussian models each step of the curve is held against the likelihood itself, and is halved
until they agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from engine.errors import ModelError
from engine.estimation.uncertainty.observed import score_decrement
from engine.estimation.uncertainty.roots import good_guess, root_of_inverse
from engine.estimation.uncertainty.score import Score
from engine.statespace.model import Array
from engine.ties import scaled_inverse

STEP_ERRORS = 0.7  # between the values of theta_k, in standard errors ...
GROWTH = 1.25  # ... and by how much it grows from one to the next ...
FLAT_GROWTH, FLAT_NATS = 2.0, 0.1  # ... or where the likelihood fell by less than so many nats
SIDE_POINTS = 60  # on one side at most
# Nats beyond the end: the step is halved, so that the spline has a point nearby.
OVERSHOOT_NATS = 1.5
LEAST_STEP = 0.01  # standard errors, or of the room to the bound: it is not halved any more
BEYOND_NATS = 0.3  # nats that the last point is beyond the end
NEAR_ERRORS = 0.01  # standard errors from a bound count as being there
# So far away a likelihood that falls by so little while the distance grows by its own length has levelled off.
FAR_ERRORS, LEVEL_NATS = 240.0, 0.1
# Nats by which the other parameters may be away from their maximum: beside noise ...
LAG_NATS = 0.01
EXACT_LAG = 1e-4  # ... and without any, ...
CORRECTIONS = 3  # ... after this many steps towards it at most,
EXACT_CORRECTIONS = 8  # each of which brings them nearer
AGREED_NATS = 0.03  # between the likelihood itself and the integral of its slope over one step


@dataclass(frozen=True, eq=False)
class Point:
    """Of a profile: the parameters x (n,), slopes (R,), dx / dx_k (n,), and its height where that is exact."""

    x: Array
    slopes: Array
    direction: Array
    height: float

    @property
    def slope(self) -> float:
        """Their mean."""
        return float(self.slopes.mean())


@dataclass(frozen=True, eq=False)
class March:
    """Along the profile of one parameter after the other, away from the estimate."""

    score: Score
    covariance: Array
    replicates: int
    seeds: np.random.SeedSequence

    @cached_property
    def _information_at_estimate(self) -> Array:
        return scaled_inverse(self.covariance)

    @cached_property
    def _guide(self) -> Array | None:
        """A root (n, n) of the moment filter's information at the estimate, where that is much as here."""
        found, L = (
            self.score.information(self.score.x),
            root_of_inverse(self._information_at_estimate),
        )
        return None if found is None or not good_guess(L.T @ found @ L) else _cholesky(found)

    def profile(self, k: int, fall: float) -> tuple[Array, Array, tuple[float, float]]:
        """Values of parameter k in order (P,), and the slopes of its profile there (R, P).

        Then how far its interval may reach: to the outermost values, or to a bound before which the
        likelihood did not fall enough.
        """
        start = self._at(k, self.score.x)
        if start is None:
            return self.score.x[[k]], np.zeros((self.replicates, 1)), (np.nan, np.nan)
        points, outermost = [start], []
        for sign in (-1.0, 1.0):
            side, reach = self._side(k, sign, start, fall)
            outermost.append(reach)
            points += side
        points.sort(key=lambda point: float(point.x[k]))
        at, slopes = np.array([p.x[k] for p in points]), np.array([p.slopes for p in points])
        return at, slopes.T, (outermost[0], outermost[1])

    def _side(self, k: int, sign: float, start: Point, fall: float) -> tuple[list[Point], float]:
        """Points on one side until the curve has fallen, and how far that side reaches; NaN if not found."""
        sd = float(np.sqrt(self.covariance[k, k]))
        lower, upper = self.score.bounds
        bound = float(lower[k] if sign < 0.0 else upper[k])
        step, fallen = STEP_ERRORS * sd, 0.0
        points = [start]
        while len(points) <= SIDE_POINTS:
            last = points[-1]
            room = abs(bound - last.x[k])
            if room < NEAR_ERRORS * sd or self._level(k, start, last):
                return points[1:], bound
            length = min(step, 0.9 * room)  # at a bound a variance may be zero
            there = self._after(k, points, sign * length)
            now = np.inf if there is None else _fallen(k, [*points, there])
            if now > fall + OVERSHOOT_NATS and 0.5 * length > LEAST_STEP * min(sd, room):
                step = 0.5 * length
                continue
            if there is None:
                break
            points.append(there)
            if now > fall + BEYOND_NATS:
                return points[1:], float(there.x[k])
            step = length * (FLAT_GROWTH if now - fallen < FLAT_NATS else GROWTH)
            fallen = now
        return points[1:], np.nan

    def _after(self, k: int, points: list[Point], step: float) -> Point | None:
        """The point of the profile after the last one, a ``step`` away; None where it is not surely that."""
        last = points[-1]
        try:
            there = self._at(k, last.x + step * last.direction)
        except (ModelError, ArithmeticError, np.linalg.LinAlgError):
            return None
        if there is None or not self.score.exact:
            return there
        heights = _heights(k, [*points, there])
        rise = there.height - last.height
        return there if abs(rise - (heights[-1] - heights[-2])) < AGREED_NATS else None

    def _level(self, k: int, start: Point, last: Point) -> bool:
        """Whether the profile has levelled off, so far as noise of its slope lets it be seen."""
        distance = abs(last.x[k] - start.x[k])
        noise = last.slopes.std() / np.sqrt(len(last.slopes))
        far = distance > FAR_ERRORS * np.sqrt(self.covariance[k, k])
        return bool(far and (abs(last.slope) - 2.0 * noise) * distance < LEVEL_NATS)

    def _at(self, k: int, x: Array) -> Point | None:
        """The point of the profile next to x, None where the other parameters do not arrive there."""
        exact, before = self.score.exact, np.inf
        x = self._clipped(x, k)
        for _ in range(1 + (EXACT_CORRECTIONS if exact else CORRECTIONS)):
            scores = self._scores(x)
            v, other = self._directions(k, x, scores)
            decrement, noise = score_decrement(other, scores)
            here, lag = x, 0.5 * decrement
            if lag <= (EXACT_LAG if exact else LAG_NATS) or (exact and lag > before):
                break
            x, before = self._clipped(x + other @ scores.mean(axis=0), k), lag
        if lag > LAG_NATS + 0.5 * noise:
            return None
        if not exact:
            return Point(
                self._clipped(here + other @ scores.mean(axis=0), k), scores @ v, v, np.nan
            )
        return Point(here, scores @ v, v, self.score.value(here) + lag)

    def _scores(self, x: Array) -> Array:
        """(R, n) with random numbers of their own: noise at one value is not that at the next."""
        scores = np.array([self.score.at(x, w)[0] for w in self.seeds.spawn(self.replicates)])
        if not np.isfinite(scores).all():
            values = ", ".join(f"{n} = {v:.4g}" for n, v in zip(self.score.names, x, strict=True))
            raise ModelError(f"the likelihood is not finite at {values}, near the estimate")
        return scores

    def _directions(self, k: int, x: Array, scores: Array) -> tuple[Array, Array]:
        """dx / dx_k along the profile (n,), and I_oo^{-1} (n, n) of the other parameters.

        Others that are at the edge of their room and drawn further out stay there.
        """
        s, (low, high) = scores.mean(axis=0), self._room()
        held = ((x <= low) & (s < 0.0)) | ((x >= high) & (s > 0.0))
        held[k] = True
        moving = np.flatnonzero(~held)
        information = self._information(x)
        v, other = np.zeros(len(x)), np.zeros((len(x), len(x)))
        v[k] = 1.0
        if moving.size:
            inverse = scaled_inverse(information[np.ix_(moving, moving)])
            v[moving] = -inverse @ information[moving, k]
            other[np.ix_(moving, moving)] = inverse
        return v, other

    def _information(self, x: Array) -> Array:
        """That at the estimate (n, n), changed as the moment filter's is from there to x."""
        there = None if self._guide is None else self.score.information(x)
        root = None if there is None else _cholesky(there)
        if root is None or self._guide is None:
            return self._information_at_estimate
        change = root @ np.linalg.inv(self._guide)
        return np.asarray(change @ self._information_at_estimate @ change.T)

    def _room(self) -> tuple[Array, Array]:
        """How far each parameter may go: nearly to its bounds."""
        x, (lower, upper) = self.score.x, self.score.bounds
        return x - 0.999 * (x - lower), x + 0.999 * (upper - x)

    def _clipped(self, x: Array, k: int) -> Array:
        """The others within their room; parameter k is left alone."""
        out: Array = np.clip(x, *self._room())
        out[k] = x[k]
        return out


def _cholesky(matrix: Array) -> Array | None:
    """Its Cholesky factor, None where it has none."""
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return None


def _heights(k: int, points: Sequence[Point]) -> Array:
    """The curve (P,) at points in turn, from its slopes."""
    at, slopes = np.array([p.x[k] for p in points]), np.array([p.slope for p in points])
    order = np.argsort(at)
    return np.asarray(PchipInterpolator(at[order], slopes[order]).antiderivative()(at))


def _fallen(k: int, points: Sequence[Point]) -> float:
    """How far below its highest value the curve is at the last of the points."""
    heights = _heights(k, points)
    return float(heights.max() - heights[-1])
