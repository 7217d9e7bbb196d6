"""How far apart two causes are in an experiment, and how often a diagnosis of it names the right one.

Let cause i be true, and Delta the difference of the readings that i and its rival j predict. The rival may
still adapt its parameters, along the sensitivities Gamma_j of its readings, as far as their covariance P_j
lets it. With S the covariance of the readings about a prediction (process noise, measurement noise, first
state) twice the log-likelihood ratio of i against the adapted j is about N(D, 4 D),

    D_ij(u) = Delta' (S + Gamma_j P_j Gamma_j')^{-1} Delta
            = min over d of |L^{-1} (Delta - Gamma_j d)|^2 + d' P_j^{-1} d,      S = L L'

(Hunter, Reiner 1965; Buzzi-Ferraris, Forzatti 1983; Atkinson, Fedorov 1975). L^{-1} is a Kalman filter along
the rival's run, so process noise counts, and D is a sum over time. A diagnosis of the new record alone
estimates all parameters again: then P_j is without end, but for LOOSE.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.design.alarm import Alarm
from engine.design.candidates import Candidate
from engine.design.noise import NoiseRoom, noise_room
from engine.design.residuals import NUMBERS, Residuals
from engine.design.runs import Experiments, Runs, linearised, of_many
from engine.diagnose.search.calibration import SERIES
from engine.diagnose.search.likeness import NEEDED, SAME, TIE, contains
from engine.diagnose.search.rounds import MARGIN
from engine.estimation.expectation import parameter_scale
from engine.kernels.whitening import whitened
from engine.statespace.model import Array

LOOSE = 100.0  # sizes of a parameter by which it may be anywhere before a record tells of it
STEPS = 8  # Gauss-Newton steps of a rival that adapts
TRIES = (1.0, 0.5, 0.2, 0.05)  # lengths of them
SETTLED = 0.01  # a gain in D below this share, or this much, ends them
DRAWS = 1200  # of log-likelihood ratios
CALIBRATIONS = 10, 40  # of these, whose calibration is simulated: at least, and at most
TINY = 1e-12  # below which a D is none
LEAST_APART = 1e-3  # share of D below which a rival has nothing of the cause


def precision(candidate: Candidate, anew: bool) -> Array:
    """P_j^{-1} (p, p) of the free parameters: what holds them beside the new record."""
    sizes = [parameter_scale(candidate.model, candidate.theta, k) for k in candidate.indices]
    loose = np.diag(1.0 / (LOOSE * np.array(sizes)) ** 2)
    return loose if anew else loose + candidate.information


def whiten(runs: Runs, changes: Array, seen: NDArray[np.bool_]) -> Array:
    """L^{-1} of changes (B, n, ny, k) of the readings that a run's model predicts; ``seen`` (n, ny)."""
    d = np.ascontiguousarray(changes)
    return np.asarray(whitened(runs.J, runs.H, runs.Q, runs.R, runs.P1, d, seen))


def linear_distances(
    truth: Array, runs: Runs, held: Array, away: Array, seen: NDArray[np.bool_]
) -> Array:
    """D (B,) of readings ``truth`` (B, n, ny) against a rival's runs, linear about them.

    ``held`` (p, p) is P_j^{-1}, ``away`` (p,) how far the runs' parameters are from their estimates. NaN where
    a run went so far that its distances overflow.
    """
    W = whiten(runs, np.concatenate([(truth - runs.y)[..., None], runs.dy], axis=-1), seen)
    W = W.reshape(len(truth), -1, W.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        M = W.transpose(0, 2, 1) @ W
    out = np.empty(len(truth))
    for k, one in enumerate(M):
        if not np.isfinite(one).all():
            out[k] = np.nan
            continue
        b = one[1:, :1] - (held @ away)[:, None]
        step = adaptation(one[1:, 1:], b, held)
        out[k] = one[0, 0] + away @ held @ away - float((b * step).sum())
    return np.maximum(out, 0.0)


def adaptation(G: Array, b: Array, P_inverse: Array) -> Array:
    """d (p, k) that solves (G + P^{-1}) d = b, in whatever units the parameters are."""
    if not len(G):
        return np.zeros_like(b)
    A = G + P_inverse
    s = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(A * s[:, None] * s)
    inverse = np.where(values > 1e-13 * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)
    out: Array = s[:, None] * (vectors @ (inverse[:, None] * (vectors.T @ (s[:, None] * b))))
    return out


def adapted(
    truth: Array,
    rival: Candidate,
    held: Array,
    experiment: Experiments,
    seen: NDArray[np.bool_],
    start: Array | None = None,
) -> tuple[Array, Runs, float]:
    """The rival's theta nearest to readings ``truth`` (1, n, ny), its runs there, and D.

    Gauss-Newton on D, which the model makes non-linear, from ``start``; ``held`` (p, p) is P_j^{-1} at the
    estimates.
    """
    indices = rival.indices
    model, theta = rival.model, (rival.theta if start is None else start).copy()
    first = rival.theta[indices]
    least = np.inf
    runs = linearised(model, theta, experiment, indices)
    for _ in range(STEPS):
        W = whiten(runs, np.concatenate([(truth - runs.y)[..., None], runs.dy], axis=-1), seen)
        W = W.reshape(-1, W.shape[-1])
        away = theta[indices] - first
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(W[:, 0] @ W[:, 0] + away @ held @ away)
            G, b = W[:, 1:].T @ W[:, 1:], W[:, 1:].T @ W[:, 0] - held @ away
        if not (np.isfinite(cost) and np.isfinite(G).all() and np.isfinite(b).all()):
            break
        step = adaptation(G, b[:, None], held)[:, 0]
        least = cost
        if float(b @ step) < SETTLED:  # nothing to gain
            break
        moved = np.tile(theta, (len(TRIES), 1))
        moved[:, indices] += np.array(TRIES)[:, None] * step
        moved = np.clip(moved, model.lower, model.upper)
        y, x = of_many(model, moved, experiment)
        there = np.full(len(TRIES), np.inf)
        fine = np.isfinite(y).all(axis=(1, 2))
        away = moved[fine][:, indices] - first
        W = whiten(runs, (truth - y[fine]).transpose(1, 2, 0)[None], seen)
        with np.errstate(over="ignore"):
            there[fine] = (W**2).sum(axis=(0, 1, 2)) + np.einsum("ki,ij,kj->k", away, held, away)
        k = int(np.argmin(there))
        if not there[k] < cost:
            break
        theta, least = moved[k], float(there[k])
        runs = linearised(model, theta, experiment, indices, x[k][None])
        if cost - least < max(SETTLED * cost, SETTLED):
            break
    return theta, runs, least


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
class Contest:
    """Cause i in an experiment against each of its rivals, who have adapted.

    ``columns`` of each rival: L^{-1} of Delta, of the sensitivities of i, and of those of the rival, at all
    readings in order (n ny, 1 + p_i + p_j); ``known`` (p_j, 1 + p_i + p_j) the same of what holds the rival's
    parameters, as further readings; ``noises`` what its noise may explain; ``seen`` (n ny,) which readings
    there are. ``spread`` (p_i, p_i) is the covariance of i's own parameters.
    """

    name: str
    rivals: tuple[str, ...]
    columns: tuple[Array, ...]
    known: tuple[Array, ...]
    noises: tuple[NoiseRoom, ...]
    seen: NDArray[np.bool_]
    spread: Array
    ny: int

    def at(self, n: int) -> tuple[Array, list[Array]]:
        """L^{-1} of Delta and of i's sensitivities beside the adapted rivals, in the first n readings' rows.

        Returns their products (m, m, 1 + p_i, 1 + p_i) for m rivals, and of each rival what is left of Delta in
        the readings there are.
        """
        rows, left = n * self.ny, []
        for W, known in zip(self.columns, self.known, strict=True):
            part = np.concatenate([W[:rows], known])
            p = 1 + len(self.spread)
            own, other = part[:, :p], part[:, p:]
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
        rows = n * self.ny
        other = self.columns[k][:rows, 1 + len(self.spread) :][self.seen[:rows]]
        return Residuals.drawn(self.noises[k], left, other, rng)

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
        p = len(self.spread)
        draws = np.ones((DRAWS, 1 + p))
        draws[:, 1:] = rng.standard_normal((DRAWS, p)) @ _root(self.spread).T
        m = len(products)
        D = products.reshape(m * m, -1) @ (draws[:, :, None] * draws[:, None]).reshape(DRAWS, -1).T
        D = np.ascontiguousarray(D.T).reshape(DRAWS, m, m)
        e = np.einsum("kij,kj->ki", _root(D), rng.standard_normal((DRAWS, m)))
        own = np.diagonal(D, axis1=1, axis2=2)
        # what the sizes gain over the base, each along its own direction beside the base's parameters
        ahead = np.sqrt(own[:, -1]) + e[:, -1] / np.sqrt(np.maximum(own[:, -1], TINY))
        base = ahead**2
        shared = np.sqrt(np.maximum(own[:, -1:] - own[:, :-1], 0.0))
        apart = D[:, -1:, -1] + own[:, :-1] - 2.0 * D[:, -1, :-1]
        fresh = rng.standard_normal((DRAWS, m - 1))
        z = (e[:, -1:] - e[:, :-1]) / np.sqrt(np.maximum(apart, TINY))
        z = np.where(apart > LEAST_APART * own[:, -1:], z, fresh)
        others = (shared + z) ** 2
        # squared, between what i and a rival predict, both fitted, from the cosine of their directions
        cosine = shared / np.sqrt(np.maximum(own[:, -1:], TINY))
        between = base[:, None] + others - 2.0 * cosine * np.abs(ahead)[:, None] * (shared + z)
        ratio = (
            own[:, :-1] + 2.0 * e[:, :-1] + e[:, -1:] ** 2 / np.maximum(own[:, -1:], TINY) - z**2
        )
        gained = ratio.copy()
        for k in range(m - 1):
            noisy = self.residuals(k, n, left[k], rng)
            if noisy is not None:
                lost = noisy.lost(np.sqrt(np.maximum(ratio[:, k], 0.0)))
                gained[:, k] = np.where(ratio[:, k] > 0.0, lost, ratio[:, k])
        noisy = self.residuals(m - 1, n, left[-1], rng)
        if noisy is None:
            statistic, simulated = base, rng.chisquare(1, size=(max(CALIBRATIONS), SERIES))
        else:
            statistic, spectra = noisy.statistic(ahead)
            records = int(np.clip(NUMBERS // (SERIES * len(left[-1])), *CALIBRATIONS))
            middle = ((np.arange(records) + 0.5) / records * DRAWS).astype(int)
            like = spectra[np.argsort(statistic)[middle]]
            simulated = noisy.simulated(np.repeat(like, SERIES, axis=0), rng).reshape(-1, SERIES)
        rivals = (statistic / np.maximum(base, TINY))[:, None] * others
        largest = np.maximum(statistic, rivals.max(axis=1, initial=0.0))
        seen = alarm.raised(largest, left[-1], simulated, seed)
        return float((demand.met(gained, between).all(axis=1) & seen).mean())


def _root(S: Array) -> Array:
    """A factor W with W W' = S for symmetric S (..., n, n), negative eigenvalues from rounding set to zero."""
    values, vectors = np.linalg.eigh(S)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


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
    columns, knowns, names, noises = [], [], [], []
    for rival in [*(c for c in candidates if c is not true), base]:
        held = precision(rival, anew)
        start = starts.get(rival.name)
        theta, runs, _ = adapted(own.y, rival, held, experiment, seen, start)
        Delta = (own.y - runs.y)[..., None]
        W = whiten(runs, np.concatenate([Delta, own.dy, runs.dy], axis=-1), seen)
        columns.append(W[0].reshape(-1, W.shape[-1]))
        noises.append(noise_room(rival, theta, runs, experiment, seen))
        root = _root(held).T
        away = theta[rival.indices] - rival.theta[rival.indices]
        none = np.zeros((len(root), len(true.free)))
        knowns.append(np.concatenate([-(root @ away)[:, None], none, root], axis=1))
        names.append(rival.name)
    return Contest(
        true.name,
        tuple(names),
        tuple(columns),
        tuple(knowns),
        tuple(noises),
        seen.ravel(),
        true.covariance,
        own.y.shape[2],
    )


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
