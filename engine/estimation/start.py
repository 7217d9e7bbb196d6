"""Where EM should start: the maximum of the moment filter's likelihood, found in a second or so.

EM contracts slowly and stays in the basin it starts in. The moment filter's likelihood is smooth and
cheap, so it is searched first: by scoring from the start values and from the best of many points
around them, each left as soon as it is not expected to come near the best. It is an approximation, so
what it finds are only ever starts, and EM is shown every maximum that is nearly as high as the highest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.expectation import parameter_scale
from engine.estimation.particle_likelihood import in_noise_only
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods, quasi_ml, share_done
from engine.estimation.vanished import revived
from engine.filters.neighbours import Visited
from engine.filters.sigma_point import free_thetas
from engine.statespace.model import Array, MixedModel, Theta

SEARCHED_ROWS = 2000  # of each series, at most, are searched
CANDIDATES = 96  # points around the start values ...
REACH_SIZES = 2.0  # ... this many sizes of each parameter away at most, within its bounds
IMPROVED_CANDIDATES = (
    3  # of the candidates, the likeliest, are improved besides the start values themselves ...
)
SPREAD_CANDIDATES = 5  # ... and some more, the farthest from each other ...
SPREAD_SHARE = 1.0 / 3.0  # ... in this likeliest share: they may lie below another maximum
HOPE = 10.0  # far from a maximum a search gains more than it expects, up to so many times
RIVAL_NATS = 5.0  # below the highest maximum, another may be the higher one of the true likelihood
MOST_MAXIMA = 3  # are compared
SAME_ERRORS = 1.0  # standard errors that two ends of a search for the same maximum may be apart
CANDIDATES_SHARE = 0.15  # of the whole search: the points


class WarmStart:
    """The maxima for a theta, as far as these rows tell; ``note`` says why where it found nothing.

    ``progress`` is told which share of a search is done. ``once``: a maximum that is known is not climbed to
    its end again, which costs no more than the last digits. Not ``around``: climbs from theta alone, where that
    has a likelihood. ``by_height`` for who cannot compare maxima by particles: the highest comes first, not the
    one above theta.
    """

    def __init__(
        self,
        model: MixedModel,
        all_series: Sequence[Series],
        indices: NDArray[np.intp],
        *,
        rivals: float = RIVAL_NATS,
        progress: Callable[[float], object] = lambda share: None,
        once: bool = False,
        around: bool = True,
        by_height: bool = False,
    ) -> None:
        self.once, self.around, self.by_height = once, around, by_height
        self.model, self.indices, self.rivals, self.progress = model, indices, rivals, progress
        self.searched = [
            one if len(one) <= SEARCHED_ROWS else one.part(0, SEARCHED_ROWS) for one in all_series
        ]
        self.note, self.searches = "", 0
        self.above: Theta | None = None  # of those found, the maximum above the start
        self.apart: Sequence[QuasiFit] = ()  # those found

    def __call__(self, theta: Theta) -> list[Theta]:
        """The maxima found, first the one above theta unless ``by_height``; none with a ``note``."""
        self.searches += 1
        try:
            if not self._blind(theta):
                found = self.maxima(theta)
                return sorted(found, key=lambda one: not self.by_height and one is not self.above)
            self.note = (
                "EM started from the start values: nonlinear states enter noise only, where the moment filter, "
                "which would search for a better start, does not see them."
            )
            return []
        except (ModelError, np.linalg.LinAlgError) as error:
            self.note = (
                f"EM started from the start values; no better start could be searched for: {error}."
            )
            return []

    def maxima(self, theta: Theta) -> list[Theta]:
        """The maxima found that are at most ``rivals`` nats below the highest, that first.

        Deterministic: the candidates are always the same for the same start. Raises ModelError where the
        moment filter cannot follow the model.
        """
        model, indices = self.model, self.indices
        names = [model.parameter_names[k] for k in indices]
        candidates = np.asarray(theta)[None]
        values = np.array([-np.inf]) if self.around else self._likely(candidates)
        if not np.isfinite(values[0]):
            others = free_thetas(theta, indices, _around(model, theta, indices))
            candidates = np.concatenate([candidates, others])
            values = self._likely(candidates)
        starts = _spread(candidates[:, indices], values)
        self.progress(CANDIDATES_SHARE)
        visited = [Visited() for _ in self.searched]  # from one search to the next
        climb = partial(quasi_ml, model, self.searched, free=names, hope=HOPE, visited=visited)
        found: list[QuasiFit] = []
        lost: Exception | None = None
        uphill: QuasiFit | None = None
        for i, start in enumerate(sorted(starts, key=lambda k: -values[k])):
            highest = max((fit.log_likelihood for fit in found), default=-np.inf)

            def tell(k: int, i: int = i) -> None:
                done = (i + share_done(k)) / len(starts)
                self.progress(CANDIDATES_SHARE + (1.0 - CANDIDATES_SHARE) * done)

            try:
                least = highest - self.rivals
                known = found if self.once else ()
                leave = partial(_arrives, found=known, indices=indices)
                fit = climb(candidates[start], target=least, callback=tell, leave=leave)
                uphill = fit if start == 0 else uphill
                if not (fit.given_up and leave(fit.theta, fit.log_likelihood, fit.information)):
                    found.append(fit)
            except (ModelError, np.linalg.LinAlgError) as error:
                lost = lost or error
        if not found and lost is not None:
            raise lost
        found.extend(self._scales_again(found, theta, climb))
        found.sort(key=lambda fit: -fit.log_likelihood)
        if found and (more := revived(found[0], self.searched)) is not found[0]:
            found.insert(0, more)
        apart: list[QuasiFit] = []
        for fit in found:
            near = fit.log_likelihood >= found[0].log_likelihood - self.rivals
            if near and not any(_same(fit, other, indices) for other in apart):
                apart.append(fit)
        self.apart = apart
        out = [_told(fit, theta, indices) for fit in apart[:MOST_MAXIMA]]
        each = zip(out, apart, strict=False)
        same = [one for one, fit in each if uphill is not None and _same(uphill, fit, indices)]
        self.above = same[0] if same else None
        return out

    def _scales_again(
        self, found: Sequence[QuasiFit], theta: Theta, climb: Callable[..., QuasiFit]
    ) -> list[QuasiFit]:
        """Maxima from the highest one found with the parameters of random scales as at the start again.

        Far from the data all readings are outliers, and a search that began there may have ended without any.
        """
        model = self.model
        own = {model.index(name) for one in model.random_scales for name in one.parameters}
        again = [k for k in self.indices if k in own]
        if not again or not found:
            return []
        highest = max(found, key=lambda fit: fit.log_likelihood)
        start = np.array(highest.theta)
        start[again] = np.asarray(theta)[again]
        try:
            return [climb(start)]
        except (ModelError, np.linalg.LinAlgError):
            return []

    def _blind(self, theta: Theta) -> bool:
        """Whether the moment filter sees none of the nonlinear states in any series."""
        # it goes through the values of those one by one
        others = ~np.isin(list(self.model.nonlinear), self.model.scale_states)
        seen = (in_noise_only(self.model, theta, one)[others] for one in self.searched)
        return bool(others.any()) and all(one.all() for one in seen)

    def _likely(self, thetas: Array) -> Array:
        """Log-likelihoods of thetas (K, n_theta), -inf where there is none."""
        values = log_likelihoods(self.model, self.searched, thetas)
        return np.where(np.isfinite(values), values, -np.inf)


def _spread(candidates: Array, values: Array) -> list[int]:
    """The start values, row 0, the likeliest of the others, and of these the farthest from all chosen."""
    order = [int(k) for k in np.argsort(-values, kind="stable") if k]
    chosen = [0, *order[:IMPROVED_CANDIDATES]]
    likely = order[: int(SPREAD_SHARE * len(order))]
    width = np.ptp(candidates, axis=0)
    place = candidates / np.where(width > 0.0, width, 1.0)
    while likely and len(chosen) < 1 + IMPROVED_CANDIDATES + SPREAD_CANDIDATES:
        apart = np.linalg.norm(place[likely, None] - place[chosen], axis=2).min(axis=1)
        chosen.append(likely[int(np.argmax(apart))])
    return list(dict.fromkeys(chosen))


def _told(fit: QuasiFit, theta: Theta, indices: NDArray[np.intp]) -> Theta:
    """What was found; parameters of which these rows tell nothing keep their start, not that of a candidate."""
    values = np.array(fit.theta)
    silent = indices[np.diag(fit.information) == 0.0]
    values[silent] = np.asarray(theta)[silent]
    return Theta(values, theta.names)


def _same(fit: QuasiFit, other: QuasiFit, indices: NDArray[np.intp]) -> bool:
    """Whether two searches ended at the same place, by the information of either."""
    d = (np.asarray(fit.theta) - np.asarray(other.theta))[indices]
    return any(float(d @ one.information @ d) <= SAME_ERRORS**2 for one in (fit, other))


def _arrives(
    theta: Array,
    value: float,
    information: Array,
    found: Sequence[QuasiFit],
    indices: NDArray[np.intp],
) -> bool:
    """Whether a search is so near a maximum that is known that its end would be the same, see :func:`_same`.

    As seen from both, and about as high as a quadratic function is there.
    """
    for fit in found:
        d = (theta - np.asarray(fit.theta))[indices]
        far = max(float(d @ one @ d) for one in (information, fit.information))
        near = far <= SAME_ERRORS**2 and abs(value - fit.log_likelihood) <= SAME_ERRORS**2
        if fit.converged and near:
            return True
    return False


def _around(model: MixedModel, theta: Theta, indices: NDArray[np.intp]) -> Array:
    """Points (CANDIDATES, n) spread evenly over a box around theta."""
    x = np.asarray(theta)[indices]
    reach = REACH_SIZES * np.array([parameter_scale(model, theta, k) for k in indices])
    low: Array = np.maximum(x - reach, model.lower[indices])
    high: Array = np.minimum(x + reach, model.upper[indices])
    share: Array = np.random.default_rng(0).random((CANDIDATES, len(indices)))
    return low + share * (high - low)
