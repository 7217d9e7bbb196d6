"""The particle filter's likelihood as a guide to what has no noise, where the moment filter is blind.

A nonlinear state that enters covariances alone, such as a volatility, shows in no moment of y: the moment
filter takes the noise for Gaussian. The random size of an outlier's noise (:mod:`engine.filters.heavy_tails`)
it goes through by :mod:`engine.filters.strata`, which is no more than a start where other states are far from
Gaussian. Parameters that move what has no noise, to
which the Q-function is no guide either, and those that move a jump of the model
(:mod:`engine.estimation.thresholds`), are then moved by the particle filter's likelihood: by differences over
a third of a standard error to either side with common random numbers, and the outer products of the scores of
single rows (Berndt, Hall, Hall, Hausman 1974).

With common random numbers this likelihood still jumps where resampling chooses otherwise. Particles resampled
at every row in the order of their predictions hardly jump where these lie on a line (Malik, Pitt 2011). Where
they lie in space some jumps are left, and more particles are taken. What is left in the slopes of single rows
differs from filter to filter; products of slopes of different filters do not have it in their mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.expectation import either_side, parameter_scale
from engine.estimation.likelihood_step import LIKELIHOOD_STEPS, LikelihoodStep
from engine.estimation.maximization import step_within
from engine.estimation.quasi_ml import derivatives
from engine.estimation.thresholds import jumping
from engine.filters.rbpf import rbpf
from engine.filters.sigma_point import free_thetas
from engine.statespace.model import Array, MixedModel, Theta, stacked

DRAWS = 16  # of a_1, on which it is tried where nonlinear states show ...
SPREADS = 10.0  # ... and so many standard deviations away: a share of outliers may start at next to nothing
SEEDS = 3  # filters whose mean is taken
IN_SPACE = 200  # particles at least where predictions do not lie on a line, or what follows from them jumps
LEAST_INFORMATION = 0.02  # of what the slopes of all filters say with their noise ...
RIDGE = 1e-6  # ... whose products, scaled to a unit diagonal, may be singular
STEP_ERRORS = 0.3  # standard errors that differences reach to either side ...
STEP_SHARE = 0.05  # ... or this share of a parameter's size, where the moment filter knows none ...
MOST_SHARE = 0.3  # ... and at most this one
FALL = 2.0  # nats by which it falls to either side over a difference in a level, more than its noise ...
LEVEL_TRIES = 8  # ... of so many distances, ...
LEVEL_FACTOR = 8.0  # ... by which one differs from the next at most
LEAST_SHARE = 1e-4  # of it: what is far better known is no matter of particles
TRIES = (1.0, 0.4, 0.1)  # shares of a step, of which the best is taken
REACHES = (
    2.0,
    0.5,
    0.1,
)  # sizes of a parameter that it moves at most, if longer steps gain nothing
# sizes of a level that it is looked for away from where it stands
PLACES = np.array([-2.0, -1.0, -0.5, -0.25, 0.25, 0.5, 1.0, 2.0])
PATIENCE = 2  # steps in turn that gain next to nothing
ENOUGH = 0.02  # nats: less is not climbed for
FAILURES = (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError)


def likelihood_of(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Theta,
    n_particles: int,
    indices: NDArray[np.intp],
) -> LikelihoodStep:
    """The likelihood that moves those of the parameters ``indices`` to which the Q-function is no guide.

    That of the moment filter, or of particles where it is blind, or where parameters move a jump of the model.
    """
    jumps = frozenset(indices[jumping(model, theta, all_series, indices, n_particles)].tolist())
    if jumps or any(in_noise_only(model, theta, one).any() for one in all_series):
        return ParticleLikelihood(model, all_series, jumps=jumps, n_particles=n_particles)
    return LikelihoodStep(model, all_series)


@np.errstate(all="ignore")
def in_noise_only(model: MixedModel, theta: Theta, series: Series) -> NDArray[np.bool_]:
    """Which nonlinear states (na,) show in covariances alone, as the volatility of a series does.

    Tried on the first of some draws of a_1, with one state after the other moved as far as they spread and
    farther, at rows of little and of much input: with moments of such a state in place of it, y tells nothing
    of it. False where no covariance depends on a state either, or where the model, which need not be right so
    far out, raises something.
    """
    na = model.na
    shows, noisy = np.zeros(na, dtype=bool), np.zeros(na, dtype=bool)
    if not na:
        return shows
    record, rng = model.record(theta), np.random.default_rng(0)
    draws = np.asarray(model.start(record).density.sample(rng, DRAWS), dtype=float)
    middle, reach = draws.mean(axis=0), SPREADS * draws.std(axis=0)
    steps = len(series) - 1  # the last row begins none
    rows = {0, steps // 2, steps - 1, *np.abs(series.u_step[:steps]).argmax(axis=0).tolist()}
    for row in rows:
        t, dt = float(series.t[row]), float(series.steps[row])
        for i in range(na):
            a = np.repeat(draws[:1], DRAWS, axis=0)
            a[:, i] = np.linspace(middle[i] - reach[i], middle[i] + reach[i], DRAWS)
            try:
                h, C, R = model.observations.once(a, series.u[row], t, 0.0, record)
                f, A, Q = model.transitions.once(a, series.u_step[row], t, dt, record)
            except Exception:  # noqa: BLE001 - whatever a user's function raises out there
                return np.zeros(na, dtype=bool)
            others = np.delete(np.arange(model.nx), i)
            means = (h, stacked(C), f[:, others], stacked(A)[:, others])
            shows[i] |= any(map(_differ, means))
            noisy[i] |= _differ(stacked(R)) or _differ(stacked(Q)[:, others[:, None], others])
    return np.asarray(noisy & ~shows)


def _differ(rows: Array) -> bool:
    """Whether the values of some draws differ."""
    return bool((rows != rows[:1]).any())


@dataclass(frozen=True, eq=False)
class ParticleLikelihood(LikelihoodStep):
    """Scoring on the particle filter's likelihood, with common random numbers for all theta.

    Slopes at a theta are ``known`` once they were asked for: scores are drawn many times at one point.
    """

    n_particles: int = 50
    seeds: tuple[int, ...] = tuple(range(SEEDS))
    known: dict[tuple[bytes, bytes], tuple[Array, Array]] = field(default_factory=dict)

    @property
    def whose(self) -> str:
        """Whose likelihood it is, in words."""
        return "the particle filter's"

    @property
    def telling(self) -> float:
        """Less than of the moment filter, for the random numbers are common."""
        return 0.1

    @property
    def trusted(self) -> bool:
        """It is the particle filter's own word."""
        return True

    def drawn(self, seed: np.random.SeedSequence) -> ParticleLikelihood:
        """The same by one filter with random numbers of its own."""
        return replace(self, seeds=(int(seed.generate_state(1)[0]),), known={})

    def __call__(self, theta: Theta, indices: NDArray[np.intp]) -> tuple[Theta, NDArray[np.bool_]]:
        """Theta after a step in the parameters ``indices`` (n,), and which of them could not be moved."""
        try:
            found, _, information = self._climb(theta, indices, 1, self.worth)
        except FAILURES:
            return theta, np.ones(len(indices), dtype=bool)
        return found, ~(np.diag(information) > 0.0)

    def ahead(
        self, theta: Theta, free: Sequence[str], worth: float | None = None
    ) -> tuple[Theta, float]:
        """A likelier point that scoring in the ``free`` parameters reaches, and by how much (nats)."""
        try:
            indices = self.model.free_indices(free)
            least = ENOUGH if worth is None else min(worth, ENOUGH)
            start = self._beyond(theta, indices)
            found, gain, _ = self._climb(start, indices, 2 * LIKELIHOOD_STEPS, least)
            gain += 0.0 if start is theta else self.of(start) - self.of(theta)
        except FAILURES:
            return theta, 0.0
        return found, gain

    def _beyond(self, theta: Theta, indices: NDArray[np.intp]) -> Theta:
        """Theta, or what is likeliest of it with one level of a jump far from there: few states tell of one."""
        best, highest = theta, self.of(theta) if self.jumps else np.nan
        for k in sorted(self.jumps.intersection(indices.tolist())):
            x = np.asarray(theta)
            values = x[k] + PLACES * parameter_scale(self.model, x, k)
            within = np.clip(values, self.model.lower[k], self.model.upper[k])
            for one in free_thetas(x, np.array([k]), within[:, None]):
                there = Theta(one, theta.names)
                value = self.of(there)
                if value > highest:
                    best, highest = there, value
        return best

    def of(self, theta: Theta, series: Series | None = None) -> float:
        """Log-likelihood of one series, or of all; NaN where it cannot be had."""
        try:
            which = self.all_series if series is None else [series]
            return float(self._terms(np.asarray(theta), which).sum(axis=1).mean())
        except FAILURES:
            return np.nan

    def information(self, theta: Array, indices: NDArray[np.intp]) -> Array | None:
        """Of the parameters ``indices`` (n, n), or None where it cannot be had."""
        try:
            return self._slopes(np.asarray(theta), indices)[1]
        except FAILURES:
            return None

    def score(self, theta: Theta, indices: NDArray[np.intp]) -> tuple[Array, Array]:
        """Gradient (n,) and information (n, n) in the parameters ``indices``. Raises ModelError."""
        return self._slopes(np.asarray(theta), indices)

    def _filter(self, theta: Array, one: Series, seed: int) -> Array:
        n = max(self.n_particles, IN_SPACE if self.model.nx > 1 or self.jumps else 1)
        run = rbpf(self.model, theta, one, n, seed, resampling="sorted", ess_threshold=1.0)
        return np.asarray(run.log_likelihood_terms)

    def _terms(self, theta: Array, which: Sequence[Series] | None = None) -> Array:
        """log p(y_t | y_{1:t-1}) (seeds, rows), all series one after the other; raises where not finite."""
        model, every = self.model, self.all_series if which is None else which
        out = [np.concatenate([self._filter(theta, one, k) for one in every]) for k in self.seeds]
        if not np.isfinite(out).all():
            raise ModelError(f"model '{model.name}': the likelihood is not finite here")
        return np.array(out)

    def _slopes(self, theta: Array, indices: NDArray[np.intp]) -> tuple[Array, Array]:
        """Gradient (n,) and information (n, n): over some of a standard error to either side, within bounds."""
        key = theta.tobytes(), indices.tobytes()
        if key not in self.known:
            self.known[key] = self._differences(theta, indices)
        return self.known[key]

    def _differences(self, theta: Array, indices: NDArray[np.intp]) -> tuple[Array, Array]:
        each = np.zeros((len(indices), len(self.seeds), self.rows))
        for i, (k, step) in enumerate(zip(indices, self._steps(theta, indices), strict=True)):
            if int(k) in self.jumps:
                each[i] = self._slope_of_level(theta, int(k))
                continue
            each[i] = self._slope(theta, int(k), step)
            # the moment filter may know nothing of it, or too much
            size = parameter_scale(self.model, theta, int(k))
            known = float(information_of(each[i : i + 1])[0, 0])
            wider = min(STEP_ERRORS / np.sqrt(max(known, 1e-300)), MOST_SHARE * size)
            if wider > 2.0 * step:
                each[i] = self._slope(theta, int(k), wider)
        return each.mean(axis=1).sum(axis=1), information_of(each)

    def _slope(self, theta: Array, k: int, step: float) -> Array:
        """Of each row's term (seeds, rows), by parameter k over ``step`` to either side, within its bounds."""
        low, high, apart = self._ends(theta, k, step)
        return np.asarray((high - low) / apart)

    def _ends(self, theta: Array, k: int, step: float) -> tuple[Array, Array, float]:
        """Terms (seeds, rows) a ``step`` below and above in parameter k, within bounds, and how far apart."""
        ends = np.array([theta, theta])
        ends[:, k] = np.clip(
            theta[k] + np.array([-step, step]), self.model.lower[k], self.model.upper[k]
        )
        low, high = (self._terms(end) for end in ends)
        return low, high, float(ends[1, k] - ends[0, k])

    def _slope_of_level(self, theta: Array, k: int) -> Array:
        """The same for a level at which the model jumps, over what the likelihood falls by some nats.

        No size of a level tells how well it is known: it depends on where its zero is, and the moment filter
        is blind.
        """
        here = self._terms(theta)
        step = STEP_SHARE * parameter_scale(self.model, theta, k)
        for _ in range(LEVEL_TRIES):
            low, high, apart = self._ends(theta, k, step)
            fall = float((here - 0.5 * (low + high)).sum(axis=1).mean())
            short = FALL / max(fall, FALL / LEVEL_FACTOR**2)
            clipped = apart < 2.0 * step * (1.0 - 1e-9)
            if 0.25 < short < 4.0 or (short > 1.0 and clipped):
                break
            step *= max(np.sqrt(short), 1.0 / LEVEL_FACTOR)
        return np.asarray((high - low) / apart)

    def _steps(self, theta: Array, indices: NDArray[np.intp]) -> Array:
        """How far (n,) differences reach, by the moment filter's information where it has any."""
        sizes = np.array([parameter_scale(self.model, theta, int(k)) for k in indices])
        steps = STEP_SHARE * sizes
        try:
            value, _, H = derivatives(self.model, self.all_series, theta, indices)
        except FAILURES:
            return steps
        known = (np.diag(H) > 0.0) & np.isfinite(value)
        steps[known] = np.minimum(steps[known], STEP_ERRORS / np.sqrt(np.diag(H)[known]))
        least = [
            np.diff([x[k] for x in either_side(self.model, theta, int(k), LEAST_SHARE)])
            for k in indices
        ]
        return np.asarray(np.maximum(steps, np.ravel(least)))

    def _climb(
        self, theta: Theta, indices: NDArray[np.intp], most: int, worth: float
    ) -> tuple[Theta, float, Array]:
        """Theta after scoring steps that gain, by how much, and the information (n, n) before the last one."""
        model, x = self.model, np.array(theta)
        lower, upper = model.lower[indices], model.upper[indices]
        first = value = float(self._terms(x).sum(axis=1).mean())
        H, little = np.zeros((len(indices), len(indices))), 0
        for _ in range(most):
            g, H = self._slopes(x, indices)
            found = value, x
            sizes = np.array([parameter_scale(model, x, int(k)) for k in indices])
            for reach in REACHES:
                step = step_within(x[indices], g, H, lower, upper, RIDGE, reach * sizes)
                if not float(g @ step) > worth:
                    continue
                for share in TRIES:
                    moved = np.clip(x[indices] + share * step, lower, upper)
                    tried = free_thetas(x, indices, moved[None])[0]
                    there = self.of(Theta(tried, theta.names))
                    found = max(found, (there, tried), key=lambda one: one[0])
                if found[0] > value + worth:
                    break
            little = 0 if found[0] > value + worth else little + 1
            same = found[0] <= value
            value, x = found
            if same or little == PATIENCE:
                break
        return Theta(x, theta.names), value - first, H


def information_of(slopes: Array) -> Array:
    """The information (n, n) in the slopes (n, seeds, rows) of single rows by several filters.

    The mean product of slopes of two filters, which have only the likelihood in common; in every direction at
    least a small share of what the product of the mean slopes is, in which noise counts as information.
    """
    mean = slopes.mean(axis=1)
    noisy, seeds = mean @ mean.T, slopes.shape[1]
    scale = np.sqrt(np.diag(noisy))
    known = scale > 0.0
    if seeds < 2 or not known.any():
        return np.asarray(noisy)
    own = np.einsum("isr,jsr->ij", slopes, slopes)
    found = (seeds**2 * noisy - own) / (seeds * (seeds - 1))
    square, scale = np.ix_(known, known), scale[known]
    each = np.outer(scale, scale)
    values, vectors = eigh(found[square] / each, noisy[square] / each + RIDGE * np.eye(len(scale)))
    root = np.linalg.inv(vectors).T
    out: Array = np.zeros_like(noisy)
    out[square] = each * ((root * np.clip(values, LEAST_INFORMATION, 1.0)) @ root.T)
    return out
