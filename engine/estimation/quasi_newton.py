"""Newton steps on the log-likelihood itself, and their averaging: some ten E steps in place of EM's hundreds.

Fisher's identity turns the E step at theta into the score s(theta), an estimate with Monte Carlo noise. The
metric B is the information of the moment filter's likelihood, which has none:

    theta + B^{-1} s(theta)

lands next to the maximum where EM moves by a few per cent of the way. Far away the first steps are EM's. Then
a step is no longer than a trust region allows, in standard errors sqrt(d' B d), and is taken back where
neither the filter's log-likelihood nor the slopes at its two ends say that it gained. Near the maximum what is
left is the noise of s: every E step gives an image theta + B^{-1} s and is made at the mean of the images
before it, which is stochastic approximation with the gain B^{-1} / k (Robbins, Monro 1951; Cappe, Moulines,
Ryden 2005, ch. 11). It has settled when the images show no trend and the noise of their mean costs little.

Random numbers are fresh in every iteration. Common ones do not help: at half a standard error apart the scores
of two smoothers with the same numbers differ as much as with others, since resampling has chosen otherwise.
Therefore B is not learnt from differences of scores. Where the moment filter cannot follow the model there is
no metric, and the step is EM's. So it is where that filter's information is far more than the complete-data
one, which proves it wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.distributions import chi2_quantile
from engine.estimation.convergence import mean_point
from engine.estimation.expectation import parameter_scale
from engine.estimation.maximization import scoring_step, step_within
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import Array, BaseModel

FAR_DECREMENT = 100.0  # s' B^{-1} s above which the first steps are EM's ...
EM_STEPS = 8  # ... for so many iterations at most
FIRST_ERRORS = 3.0  # standard errors that the first step may be long ...
GROWTH = 3.0  # ... how much longer the next may be where that was too little ...
SHRINKAGE = 0.35  # ... and how long one that comes after a loss
NEAR_ERRORS = 1.5  # a step of so many standard errors begins the averaging
IMAGE_ERRORS = 5.0  # an image is at most so far from where its E step was made
ANCHOR_ERRORS = 3.0  # further from where it was computed, the metric is computed again
NOISY_DECREMENT = 100.0  # below this a step that did not halve it met the noise of the score
FEW_IMAGES = 4  # show no trend yet
MIN_IMAGES = 8  # before the mean may settle
SLACK = 0.1  # of what noise may cost may be trend where there is no noise
CHI2_95 = 3.84  # quantile of chi^2 with one degree of freedom
REACH_SIZES = 2.0  # typical sizes of a parameter that it may move in one step
EDGE_ERRORS = 0.05  # standard errors from a bound count as being there
EDGE_SHARE = 0.5  # of the way to a bound, at most, is gone in a step
TINY = 1e-300
RIDGE = 1e-10  # of the metric scaled to a unit diagonal
LEAST, MOST = 1e-4, 1.2  # of the complete-data information is in the metric
REFUTED = 3.0  # times it there cannot be: noise alone leaves less than MOST


@dataclass(frozen=True, eq=False)
class Seen:
    """What an E step at theta told: score (n,), complete-data information (n, n), log-likelihood.

    ``x`` (n,) are the values of the parameters they are taken in; ``wide``: see
    :func:`engine.estimation.e_steps.nats_apart`.
    """

    theta: Array
    x: Array
    score: Array
    complete: Array
    value: float
    wide: float

    @property
    def finite(self) -> bool:
        """Whether it can be used."""
        return bool(np.isfinite(self.value) and np.isfinite(self.score).all())


@dataclass(frozen=True, eq=False)
class Memory:
    """What an iteration leaves to the next: the point stepped from, its score and metric.

    ``image`` is that of the E step made ``at``; ``images`` counts the E steps that are averaged so far, 0 on
    the way; ``radius`` is that of the trust region in standard errors.
    """

    base: Array
    score: Array
    metric: Array
    value: float
    radius: float
    at: Array
    image: Array
    images: int = 0
    settled: bool = False

    def row(self) -> Array:
        """As numbers (4 n + n^2 + 4,), for a checkpoint."""
        last = [self.value, self.radius, self.images, self.settled]
        return np.concatenate(
            [self.base, self.score, self.at, self.image, self.metric.ravel(), last]
        )

    @classmethod
    def of(cls, row: Array, n: int) -> Memory | None:
        """The inverse of :meth:`row`; None where an iteration left none."""
        if row.shape != (width(n),) or not np.isfinite(row[-2]):
            return None
        base, score, at, image, metric, last = np.split(row, np.cumsum([n, n, n, n, n * n]))
        value, radius, images, settled = last.tolist()
        metric = metric.reshape(n, n)
        return cls(base, score, metric, value, radius, at, image, int(images), settled > 0.0)


def width(n: int) -> int:
    """Numbers in the row of a :class:`Memory` of n parameters."""
    return 4 * n + n * n + 4


@dataclass(frozen=True, eq=False)
class Ascent:
    """The rule that names the next values of the parameters ``indices`` (n,) of a model.

    ``information(theta)`` gives the metric (n, n) or None; ``rows`` is the number of samples; ``worth``: nats
    per parameter that the noise of the estimate may cost. ``exact`` scores have no noise, and nothing is
    averaged.
    """

    model: BaseModel
    indices: NDArray[np.intp]
    information: Callable[[Array], Array | None]
    rows: int
    worth: float
    exact: bool = False

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper (n,)."""
        return self.model.lower[self.indices], self.model.upper[self.indices]

    def next(self, seen: Seen, before: Sequence[Memory], k: int) -> tuple[Array, Memory] | None:
        """The next point (n,) and what to remember after iteration k; None where the step should be EM's."""
        last = before[-1] if before else None
        if last is not None and last.images:
            averaged = self._average(seen, before)
            if averaged is not None:
                return averaged
            fallen = not seen.value > last.value - seen.wide
            last = replace(last, images=0) if fallen else None  # not near the maximum after all
        gain = np.inf if last is None else _gain(seen, last)
        if last is not None and gain < 0.0:
            length = min(_length(seen.x - last.base, last.metric), last.radius)
            return self._step(replace(last, radius=SHRINKAGE * length))
        metric = self._metric(seen) if seen.finite else None
        if metric is None:
            return None
        here = Memory(seen.x, seen.score, metric, seen.value, FIRST_ERRORS, seen.x, seen.x)
        if last is None:
            far = self._newton(here)[1] ** 2 > FAR_DECREMENT
            return None if far and k <= EM_STEPS else self._step(here)
        here = replace(here, radius=_radius(seen.x - last.base, gain, last))
        decrement, was = self._newton(here)[1] ** 2, self._newton(last)[1] ** 2
        noisy = 0.5 * was < decrement and was < NOISY_DECREMENT
        if noisy and not self.exact and abs(seen.value - last.value) < seen.wide:
            here = replace(here, images=1, image=self._image(here))
            return here.image, here
        return self._step(here)

    def refuted(self, seen: Seen) -> bool:
        """Whether the information cannot be right, as it is far more than all states known would give."""
        theta = free_thetas(seen.theta, self.indices, seen.x[None])[0]
        found, known = self.information(theta), np.diag(seen.complete) > 0.0
        if self.exact or found is None or not known.any() or not np.isfinite(found).all():
            return False
        return bool(_shares(found, seen.complete, known)[0][-1] > REFUTED)

    def _metric(self, seen: Seen) -> Array | None:
        found = self.information(free_thetas(seen.theta, self.indices, seen.x[None])[0])
        if found is None or not np.isfinite(found).all():
            return None
        # exact, it needs no correction; next to 0 the complete-data one of a variance is no measure of it
        return whole(found, seen.complete) if self.exact else bounded(found, seen.complete)

    def _step(self, here: Memory) -> tuple[Array, Memory]:
        """A step from the base within the trust region; a short one begins the averaging."""
        d, length = self._newton(here)
        if self.exact:
            here = replace(here, settled=0.5 * length**2 <= self.worth * len(d))
        elif length <= min(NEAR_ERRORS, here.radius):
            here = replace(here, images=1, image=self._image(here))
            return here.image, here
        longest = _length(d, here.metric)
        if not longest > 0.0:  # all are held at bounds
            return here.base, here
        return self._within(here.base, d * min(1.0, here.radius / longest)), here

    def _average(self, seen: Seen, before: Sequence[Memory]) -> tuple[Array, Memory] | None:
        """The mean of the images, or None where they go on moving."""
        last, image = before[-1], seen.x
        if seen.finite:
            image = self._image(replace(last, base=seen.x, score=seen.score))
        here = replace(last, at=seen.x, image=image)
        averaged = [*before[len(before) - last.images :], here]
        images = np.array([m.image for m in averaged])
        residuals = images - np.array([m.at for m in averaged])
        used, settled = window(residuals, last.metric, self.worth)
        if not (used and seen.value > last.value - seen.wide):
            return None
        middle = mean_point(images[-used:])
        here = replace(here, images=used, settled=settled)
        if used >= MIN_IMAGES and _length(middle - here.base, here.metric) > ANCHOR_ERRORS:
            metric = self._metric(replace(seen, x=middle))
            if metric is not None:
                at = replace(here, base=middle, score=np.zeros_like(middle), metric=metric)
                here = replace(at, settled=False)
        return middle, here

    def _image(self, here: Memory) -> Array:
        d, length = self._newton(here)
        return self._within(here.base, d * min(1.0, IMAGE_ERRORS / max(length, IMAGE_ERRORS)))

    def _newton(self, here: Memory) -> tuple[Array, float]:
        """B^{-1} s with what is drawn beyond a bound held, and its length, the root of s' B^{-1} s.

        Damped where a component would be longer than its reach; the length is that of the whole step.
        """
        x, score, metric = here.base, here.score, here.metric
        lower, upper = self.bounds
        theta = free_thetas(self.model.theta(), self.indices, x[None])[0]
        sizes = [parameter_scale(self.model, theta, int(k)) for k in self.indices]
        reach = REACH_SIZES * np.array(sizes)
        margin = EDGE_ERRORS / np.sqrt(np.maximum(np.diag(metric), TINY))
        margin = np.minimum(margin, 0.25 * (upper - lower))
        low, high = lower + margin, upper - margin
        whole = float(score @ scoring_step(x, score, metric, low, high, RIDGE))
        d = step_within(x, score, metric, low, high, RIDGE, reach)
        return d, float(np.sqrt(max(whole, 0.0)))

    def _within(self, x: Array, d: Array) -> Array:
        """x + d, at most a share of the way to a bound."""
        lower, upper = self.bounds
        low = x - EDGE_SHARE * (x - lower)
        high = x + EDGE_SHARE * (upper - x)
        out: Array = np.clip(x + d, low, high)
        return out


def bounded(information: Array, complete: Array, least: float = LEAST) -> Array | None:
    """The information (n, n) between ``least`` and MOST times the complete-data one; None where it has none.

    What the data hold of the parameters is less than they would with all states known; a metric that says
    otherwise is wrong, and would make steps shorter than EM's. Where it says so by far it is none.
    """
    known = np.diag(complete) > 0.0
    if not (np.diag(information)[known] > 0.0).all():
        return None
    out = np.zeros_like(complete)
    if known.any():
        values, root = _shares(information, complete, known)
        if values[-1] > REFUTED:
            return None
        out[np.ix_(known, known)] = (root * np.clip(values, least, MOST)) @ root.T
    return out


def _shares(information: Array, complete: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Information in shares of the complete-data one (n,), ascending, and the root (n, n) they belong to."""
    scale = np.sqrt(np.diag(complete)[known])
    square = np.ix_(known, known)
    L = np.linalg.cholesky(complete[square] / scale[:, None] / scale + RIDGE * np.eye(known.sum()))
    half = np.linalg.solve(L, information[square] / scale[:, None] / scale)
    values, vectors = np.linalg.eigh(np.linalg.solve(L, half.T))
    return values, scale[:, None] * (L @ vectors)


def whole(information: Array, complete: Array) -> Array | None:
    """The information (n, n) where there is a complete-data one, as it is; None where it lacks there."""
    known = np.diag(complete) > 0.0
    if not (np.diag(information)[known] > 0.0).all():
        return None
    return np.where(known[:, None] & known, information, 0.0)


def _length(d: Array, metric: Array) -> float:
    """Of a step d (n,), in standard errors."""
    return float(np.sqrt(max(float(d @ metric @ d), 0.0)))


def _gain(seen: Seen, last: Memory) -> float:
    """What a step gained: by the filter where that is plain, else by the slopes at its ends."""
    if not seen.finite:
        return -np.inf
    by_filter = seen.value - last.value
    by_slopes = float(0.5 * (last.score + seen.score) @ (seen.x - last.base))
    return by_filter if abs(by_filter) > max(seen.wide, 0.5 * abs(by_slopes)) else by_slopes


def _radius(d: Array, gain: float, last: Memory) -> float:
    """The trust region after a step d that gained: by how good the forecast of the gain was."""
    length = _length(d, last.metric)
    expected = float(last.score @ d) - 0.5 * length**2
    if gain < 0.25 * expected:
        return 0.5 * length
    return max(last.radius, GROWTH * length) if gain > 0.5 * expected else last.radius


def window(residuals: Array, metric: Array, worth: float) -> tuple[int, bool]:
    """How many of the last images show no trend, 0 for none, and whether their mean has settled.

    ``residuals`` (j, n) are the images minus the points at which their E steps were made, means of the images
    before. Those of the newer half are nothing but noise, which successive differences tell, where these means
    have arrived.
    """
    j, n = residuals.shape
    scale = np.sqrt(np.maximum(np.diag(metric), TINY))
    values, vectors = np.linalg.eigh(metric / scale[:, None] / scale)
    w = (residuals * scale) @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    slack = min(SLACK * worth * n, SLACK)
    for used in range(j, FEW_IMAGES - 1, -1):
        new = w[j - used // 2 :]
        spread = 0.5 * float((np.diff(w[j - used :], axis=0) ** 2).sum()) / (used - 1)
        moved = float((new.mean(axis=0) ** 2).sum())
        # a sum of squares with this mean has its largest quantiles where it is a single square
        if moved <= CHI2_95 * spread * 4.0 / used + slack:
            enough = used >= MIN_IMAGES or spread <= slack
            return used, enough and 0.5 * spread / used <= worth * n and _flat(w[j - used :], slack)
    return j if j < FEW_IMAGES else 0, False


def _flat(w: Array, slack: float) -> bool:
    """Whether none of the directions of w (k, n) alone shows a trend: noise in others hides it in their sum."""
    used, n = w.shape
    spread = 0.5 * (np.diff(w, axis=0) ** 2).sum(axis=0) / (used - 1)
    moved = w[used - used // 2 :].mean(axis=0) ** 2
    limit = chi2_quantile(1.0 - 0.05 / n, 1) * spread * 4.0 / used
    return bool((moved <= limit + slack).all())
