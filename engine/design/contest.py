"""How often a diagnosis of an experiment names its true cause.

Cause i, fitted to a record, is ahead of its rival j by 2 log LR, about N(D_ij, 4 D_ij)
(:mod:`engine.design.criterion`), of which j takes a part for noise (:mod:`engine.design.residuals`). It is
named where it leads all rivals as a diagnosis demands it, and where a screen beside the model without a cause
raises an alarm (:mod:`engine.design.alarm`). All of these belong together, and are drawn record by record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.design.alarm import Alarm
from engine.design.candidates import Candidate
from engine.design.criterion import adaptation, adapted, precision, square_root, whiten
from engine.design.noise import NoiseRoom, noise_room
from engine.design.residuals import Residuals, Scores
from engine.design.runs import Experiments, linearised
from engine.design.spectrum import NUMBERS
from engine.diagnose.refits.calibration import SERIES
from engine.diagnose.refits.likeness import NEEDED, SAME, TIE, contains
from engine.diagnose.refits.rounds import MARGIN
from engine.statespace.model import Array

DRAWS = 1200  # of records
CALIBRATIONS = 10, 40  # of these, whose calibration is simulated: at least, and at most
TINY = 1e-12  # below which a D is none
LEAST_APART = 1e-3  # share of D below which a rival has nothing of the cause


@dataclass(frozen=True, eq=False)
class Demand:
    """What a diagnosis asks of a cause beside each of its m - 1 rivals, to name it.

    ``lead`` in 2 log LR, ``cost`` of its further parameters; ``plainer``: it stands for a rival that says the
    same.
    """

    lead: Array
    cost: Array
    plainer: NDArray[np.bool_]

    def met(self, gained: Array, between: Array) -> NDArray[np.bool_]:
        """Which leads ``gained`` (K, m - 1) are enough, where predictions differ by ``between``, squared."""
        score = gained - self.cost
        same = self.plainer & (score >= -TIE) & (between < SAME)
        return np.asarray((score > self.lead) | same)

    def but(self, alike: Sequence[bool]) -> Demand:
        """The same with nothing asked beside some rivals."""
        return replace(self, lead=np.where(alike, -np.inf, self.lead))


@dataclass(frozen=True, eq=False)
class Adapted:
    """A rival of cause i that has adapted.

    ``columns``: L^{-1} of Delta, of the sensitivities of i, and of those of the rival, at all readings in order
    (n ny, 1 + p_i + p_j); ``known`` (p_j, 1 + p_i + p_j) the same of what holds the rival's parameters, as
    further readings; ``noise`` what its noise may explain.
    """

    name: str
    columns: Array
    known: Array
    noise: NoiseRoom


@dataclass(frozen=True, eq=False)
class Contest:
    """Cause i in an experiment against each of its rivals, the last one the model without a cause.

    ``seen`` (n ny,) is which readings there are, ``spread`` (p_i, p_i) the covariance of i's own parameters.
    """

    name: str
    rivals: tuple[Adapted, ...]
    seen: NDArray[np.bool_]
    spread: Array
    ny: int

    def at(self, n: int) -> tuple[Array, list[Array]]:
        """L^{-1} of Delta and of i's sensitivities beside the adapted rivals, in the first n readings' rows.

        Returns their products (m, m, 1 + p_i, 1 + p_i) for m rivals, and of each rival what is left of Delta in
        the readings there are.
        """
        rows, left = n * self.ny, []
        for rival in self.rivals:
            part = np.concatenate([rival.columns[:rows], rival.known])
            own, other = np.split(part, [1 + len(self.spread)], axis=1)
            step = adaptation(other.T @ other, other.T @ own, np.zeros((other.shape[1],) * 2))
            left.append(own - other @ step)
        # what holds two rivals has nothing to do with each other
        products = np.array([[one[:rows].T @ two[:rows] for two in left] for one in left])
        for k, one in enumerate(left):
            products[k, k] += one[rows:].T @ one[rows:]
        there = self.seen[:rows]
        return products, [one[:rows, 0][there] for one in left]

    def residuals(self, k: int, n: int, left: Array, rng: np.random.Generator) -> Residuals | None:
        """What rival k leaves of the first n rows, where ``left`` (N,) is left of Delta."""
        rival, rows, p = self.rivals[k], n * self.ny, 1 + len(self.spread)
        other, held = rival.columns[:rows, p:][self.seen[:rows]], rival.known[:, p:]
        return Residuals.drawn(rival.noise, left, other, held, rng)

    def distance(self, n: int) -> Array:
        """D (m,) against each rival in the first n rows."""
        return np.diagonal(self.at(n)[0][:, :, 0, 0]).copy()

    def probability(self, n: int, demand: Demand, alarm: Alarm, seed: int) -> float:
        """How often i wins against all rivals in the first n rows.

        It must lead each as the ``demand`` says; the last rival is the model without a cause, against which
        the screen must raise an ``alarm``. Averaged over what is not known of i's own parameters.
        """
        products, left = self.at(n)
        rng = np.random.default_rng(seed)
        fits = Fits.drawn(products, self.spread, rng)
        gained = fits.ratio.copy()
        for k in range(gained.shape[1]):
            noisy = self.residuals(k, n, left[k], rng)
            if noisy is not None:
                lost = noisy.lost(np.sqrt(np.maximum(fits.ratio[:, k], 0.0)))
                gained[:, k] = np.where(fits.ratio[:, k] > 0.0, lost, fits.ratio[:, k])
        screen = self.residuals(gained.shape[1], n, left[-1], rng)
        scores, simulated = _screened(screen, fits.size, len(left[-1]), rng)
        rivals = fits.rivals
        if screen is not None:
            rivals = np.column_stack([screen.scores(np.sqrt(x), rng).statistic for x in rivals.T])
        largest = np.maximum(scores.statistic, rivals.max(axis=1, initial=0.0))
        seen = alarm.raised(largest, left[-1], scores.shared, simulated, seed)
        return float((demand.met(gained, fits.between).all(axis=1) & seen).mean())


@dataclass(frozen=True, eq=False)
class Fits:
    """What fits of cause i and of its m - 1 rivals say of K records, in standard deviations of white noise.

    ``size`` (K,) of i's difference from the model without a cause; ``rivals`` (K, m - 1), 2 log LR of each
    rival over that model; ``ratio`` (K, m - 1), 2 log LR of i over each rival; ``between`` (K, m - 1), squared,
    what i and a rival predict differently.
    """

    size: Array
    rivals: Array
    ratio: Array
    between: Array

    @classmethod
    def drawn(cls, products: Array, spread: Array, rng: np.random.Generator) -> Fits:
        """From products (m, m, 1 + p, 1 + p) of :meth:`Contest.at`, and the covariance (p, p) of i's own."""
        m, p = len(products), len(spread)
        draws = np.ones((DRAWS, 1 + p))
        draws[:, 1:] = rng.standard_normal((DRAWS, p)) @ square_root(spread).T
        D = products.reshape(m * m, -1) @ (draws[:, :, None] * draws[:, None]).reshape(DRAWS, -1).T
        D = np.ascontiguousarray(D.T).reshape(DRAWS, m, m)
        e = np.einsum("kij,kj->ki", square_root(D), rng.standard_normal((DRAWS, m)))
        own = np.diagonal(D, axis1=1, axis2=2)
        base = np.maximum(own[:, -1:], TINY)
        # what the sizes gain over the base, each along its own direction beside the base's parameters
        size = np.sqrt(own[:, -1]) + e[:, -1] / np.sqrt(base[:, 0])
        shared = np.sqrt(np.maximum(own[:, -1:] - own[:, :-1], 0.0))
        apart = D[:, -1:, -1] + own[:, :-1] - 2.0 * D[:, -1, :-1]
        fresh = rng.standard_normal((DRAWS, m - 1))
        z = (e[:, -1:] - e[:, :-1]) / np.sqrt(np.maximum(apart, TINY))
        z = np.where(apart > LEAST_APART * own[:, -1:], z, fresh)
        rivals = (shared + z) ** 2
        # from the cosine of their directions
        cosine = shared / np.sqrt(base)
        between = size[:, None] ** 2 + rivals - 2.0 * cosine * np.abs(size)[:, None] * (shared + z)
        ratio = own[:, :-1] + 2.0 * e[:, :-1] + e[:, -1:] ** 2 / base - z**2
        return cls(size, rivals, ratio, between)


def _screened(
    screen: Residuals | None, size: Array, N: int, rng: np.random.Generator
) -> tuple[Scores, Array]:
    """K scores of a screen of N readings, and statistics (G, SERIES) of records simulated without a cause."""
    if screen is None:
        known = Scores(size**2, np.zeros(len(size)), np.zeros((len(size), 0)))
        return known, rng.chisquare(1, size=(max(CALIBRATIONS), SERIES))
    scores = screen.scores(size, rng)
    records = int(np.clip(NUMBERS // (SERIES * N), *CALIBRATIONS))
    middle = ((np.arange(records) + 0.5) / records * len(size)).astype(int)
    like = np.repeat(scores.d[np.argsort(scores.statistic)[middle]], SERIES, axis=0)
    return scores, screen.simulated(like, rng).reshape(-1, SERIES)


def contest(
    i: int,
    candidates: Sequence[Candidate],
    base: Candidate,
    experiment: Experiments,
    seen: NDArray[np.bool_],
    anew: bool,
    starts: Mapping[str, Array],
) -> Contest:
    """Cause i against all others, and the model without a cause, in one experiment.

    ``starts`` are parameters of rivals to begin with, by their names.
    """
    true = candidates[i]
    own = linearised(true.model, true.theta, experiment, true.indices)
    rivals = []
    for rival in [*(c for c in candidates if c is not true), base]:
        held = precision(rival, anew)
        start = starts.get(rival.name)
        theta, runs, _ = adapted(own.y, rival, held, experiment, seen, start)
        Delta = (own.y - runs.y)[..., None]
        W = whiten(runs, np.concatenate([Delta, own.dy, runs.dy], axis=-1), seen)
        noise = noise_room(rival, theta, runs, experiment, seen)
        root = square_root(held).T
        away = theta[rival.indices] - rival.theta[rival.indices]
        none = np.zeros((len(root), len(true.free)))
        known = np.concatenate([-(root @ away)[:, None], none, root], axis=1)
        rivals.append(Adapted(rival.name, W[0].reshape(-1, W.shape[-1]), known, noise))
    return Contest(true.name, tuple(rivals), seen.ravel(), true.covariance, own.y.shape[2])


def demand_of(i: int, candidates: Sequence[Candidate], T: int, anew: bool) -> Demand:
    """What a diagnosis of T samples asks of cause i, to name it.

    It names what leads by MARGIN, further parameters costing log T each; an earlier record counts where it is
    kept. A rival that contains i must itself be ahead, and of two that say the same the plainer is named.
    """
    true = candidates[i]
    lead, cost, plainer = [], [], []
    for rival in candidates:
        if rival is true:
            continue
        cost.append((true.further - rival.further) * np.log(max(T, 2)))
        cost[-1] -= 0.0 if anew else true.lead - rival.lead
        wider = len(true.effects) == len(rival.effects) == 1 and contains(
            rival.effects[0], true.effects[0]
        )
        lead.append(-NEEDED if wider else MARGIN)
        plainer.append(true.rank < rival.rank)
    return Demand(np.array(lead), np.array(cost), np.array(plainer, dtype=bool))
