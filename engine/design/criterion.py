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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from engine.design.candidates import Candidate
from engine.design.runs import Experiments, Runs, linearised, of_many
from engine.diagnose.search.rounds import MARGIN
from engine.estimation.expectation import either_side, parameter_scale
from engine.kernels.whitening import whitened
from engine.statespace.model import Array

LOOSE = 100.0  # sizes of a parameter by which it may be anywhere before a record tells of it
STEPS = 8  # Gauss-Newton steps of a rival that adapts
TRIES = (1.0, 0.5, 0.2, 0.05)  # lengths of them
SETTLED = 0.01  # a gain in D below this share, or this much, ends them
DRAWS = 4000  # of log-likelihood ratios
MOST_ROWS = 200  # readings from which the room of a rival's noise is found
NOISE_STEP = 0.02  # of a noise parameter's size, for differences


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
class Contest:
    """Cause i in an experiment against each of its rivals, who have adapted.

    ``columns`` of each rival: L^{-1} of Delta, of the sensitivities of i, and of those of the rival, at all
    readings in order (n ny, 1 + p_i + p_j); ``known`` (p_j, 1 + p_i + p_j) the same of what holds the rival's
    parameters, as further readings; ``room`` the readings' worth of its noise, see :func:`noise_room`.
    ``spread`` (p_i, p_i) is the covariance of i's own parameters.
    """

    name: str
    rivals: tuple[str, ...]
    columns: tuple[Array, ...]
    known: tuple[Array, ...]
    room: tuple[float, ...]
    spread: Array
    ny: int

    def at(self, n: int) -> Array:
        """L^{-1} of Delta and of i's sensitivities beside the adapted rivals, in the first n readings' rows.

        Returns their products (m, m, 1 + p_i, 1 + p_i) for m rivals.
        """
        p, left = len(self.spread), []
        for W, known in zip(self.columns, self.known, strict=True):
            part = np.concatenate([W[: n * self.ny], known])
            own, other = part[:, : 1 + p], part[:, 1 + p :]
            free = np.zeros((other.shape[1],) * 2)
            left.append(own - other @ adaptation(other.T @ other, other.T @ own, free))
        rows = n * self.ny  # what holds two rivals has nothing to do with each other
        products = np.array([[one[:rows].T @ two[:rows] for two in left] for one in left])
        for k, one in enumerate(left):
            products[k, k] += one[rows:].T @ one[rows:]
        return products

    def distance(self, n: int) -> Array:
        """D (m,) against each rival in the first n rows."""
        return np.diagonal(self.at(n)[:, :, 0, 0]).copy()

    def probability(self, n: int, asked: Array, alarm: float, seed: int) -> float:
        """How often i wins against all rivals in the first n rows.

        2 log LR of each must exceed ``asked`` (m - 1,); the last rival is the model without a cause, against
        which a statistic of ``alarm`` is needed. Averaged over what is not known of i's own parameters.
        """
        products = self.at(n)
        rng = np.random.default_rng(seed)
        p = len(self.spread)
        draws = np.ones((DRAWS, 1 + p))
        draws[:, 1:] = rng.standard_normal((DRAWS, p)) @ _root(self.spread).T
        m = len(products)
        D = products.reshape(m * m, -1) @ (draws[:, :, None] * draws[:, None]).reshape(DRAWS, -1).T
        D = np.ascontiguousarray(D.T).reshape(DRAWS, m, m)
        e = np.einsum("kij,kj->ki", _root(D), rng.standard_normal((DRAWS, len(products))))
        own = np.diagonal(D, axis1=1, axis2=2)
        ratio = own + 2.0 * e
        room = np.array(self.room) * n * self.ny / len(self.columns[0])
        base = ratio[:, -1] + e[:, -1] ** 2 / np.maximum(own[:, -1], 1e-12)
        base = np.maximum(base, 0.0)
        statistic = base / (1.0 + base / room[-1])
        positive = np.maximum(ratio[:, :-1], 0.0)
        gained = np.where(
            ratio[:, :-1] > 0.0, room[:-1] * np.log1p(positive / room[:-1]), ratio[:, :-1]
        )
        right = (gained > asked).all(axis=1) & (statistic > alarm)
        return float(right.mean())


def noise_room(
    rival: Candidate,
    theta: Array,
    runs: Runs,
    experiment: Experiments,
    v: Array,
    seen: NDArray[np.bool_],
) -> float:
    """How many readings' worth of noise a rival has to explain a difference v = L^{-1} Delta (n ny,) by.

    Its noise is estimated too, and grows with what it does not explain. Along parameters q of the noise, with
    E = L^{-1} dS/dq L^{-T}, the score of v is v' E v / 2 and the information tr(E_k E_l) / 2, so that twice the
    log-likelihood regained is |v|^4 / (2 m) for small v. A scale common to m readings regains as much, and for
    any v leaves m log(1 + |v|^2 / m) of |v|^2; m is returned.
    """
    rows = np.flatnonzero(seen.ravel())[:MOST_ROWS]
    silent = ~(runs.dy != 0.0).any(axis=(0, 1, 2))
    noise = [k for k, quiet in zip(rival.indices, silent, strict=True) if quiet]
    left = max(seen.sum() - len(rival.free), 1.0)
    if not noise or not float(v @ v) > 0.0:
        return float(left)
    n, ny = seen.shape
    unit = np.zeros((1, n, ny, len(rows)))
    unit.reshape(n * ny, -1)[rows, np.arange(len(rows))] = 1.0
    A = _lower(runs, unit, seen, rows)
    E = []
    for k in noise:
        low, high = either_side(rival.model, theta, k, NOISE_STEP)
        changed = linearised(
            rival.model, high if high[k] > theta[k] else low, experiment, (), runs.x
        )
        B = solve_triangular(_lower(changed, unit, seen, rows).T, A.T, lower=False).T
        E.append(B @ B.T - np.eye(len(rows)))
    part = v[rows]
    score = np.array([0.5 * part @ one @ part for one in E])
    information = np.array([[0.5 * float((one * two).sum()) for two in E] for one in E])
    s = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    gain = float(
        (score * s) @ np.linalg.pinv(information * s[:, None] * s, rcond=1e-6) @ (score * s)
    )
    if not gain > 0.0:
        return float(left)
    room = float(part @ part) ** 2 / (2.0 * gain) * seen.sum() / len(rows)
    return float(min(max(room, 1.0), left))


def _lower(runs: Runs, unit: Array, seen: NDArray[np.bool_], rows: NDArray[np.intp]) -> Array:
    """L^{-1} of the first readings, as a matrix."""
    W = whiten(runs, unit, seen)
    return np.asarray(W.reshape(-1, W.shape[-1])[rows])


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
    columns, knowns, names, rooms = [], [], [], []
    for rival in [*(c for c in candidates if c is not true), base]:
        held = precision(rival, anew)
        start = starts.get(rival.name)
        theta, runs, _ = adapted(own.y, rival, held, experiment, seen, start)
        Delta = (own.y - runs.y)[..., None]
        W = whiten(runs, np.concatenate([Delta, own.dy, runs.dy], axis=-1), seen)
        columns.append(W[0].reshape(-1, W.shape[-1]))
        rooms.append(noise_room(rival, theta, runs, experiment, columns[-1][:, 0], seen))
        root = _root(held).T
        away = theta[rival.indices] - rival.theta[rival.indices]
        none = np.zeros((len(root), len(true.free)))
        knowns.append(np.concatenate([-(root @ away)[:, None], none, root], axis=1))
        names.append(rival.name)
    ny = own.y.shape[2]
    return Contest(
        true.name, tuple(names), tuple(columns), tuple(knowns), tuple(rooms), true.covariance, ny
    )


def asked_of(i: int, candidates: Sequence[Candidate], T: int, anew: bool) -> Array:
    """By how much 2 log LR of i must lead each rival (m - 1,) for a diagnosis of T samples to name it.

    A diagnosis names what leads by MARGIN, further parameters costing log T each; an earlier record counts
    where it is kept.
    """
    true = candidates[i]
    out = []
    for rival in candidates:
        if rival is not true:
            more = (true.further - rival.further) * np.log(max(T, 2))
            out.append(MARGIN + more - (0.0 if anew else true.lead - rival.lead))
    return np.array(out)
