"""What a rival leaves of readings, drawn: its noise is estimated from that, and few readings tell little.

Let v = L^{-1} Delta be the difference that is left, x its size in a record (of which |v| is the mean), e white
and Q an orthonormal basis of what the rival's mean adapts to. Of the readings

    y = e + (x - v'e / |v|) v / |v|

the rival takes for noise what it cannot follow: the variances of its noise become w times as large, where w and
the mean's beta minimise

    f(w, beta) = log det C + r' C^{-1} r,      r = y - Q beta,      C = I + sum_k (w_k - 1) A_k,

with A_k the share of each noise (:mod:`engine.design.noise`), and w instead of w - 1 for one that is none yet.
Twice the log-likelihood lost is the least f less the least f at x = 0. A score test of the effect, beside
everything that is estimated, has the statistic

    (v~' C^{-1} r)^2 / (v~' C^{-1} v~ - c' G^{-1} c),      v~ = v - Q (Q' C^{-1} Q)^{-1} Q' C^{-1} v,

    c_k = 1/2 v~' C^{-1} (A_k C^{-1} - mean) r + what causality adds,      G_kl = 1/2 tr A_k C^{-1} A_l C^{-1}.

c_k is what the innovations that a noise parameter changes have in common with the effect's. Its expectation is
zero without the effect, but a screen cannot know, and takes it out
(:mod:`engine.diagnose.screening.noise_parameters`). An innovation is made of past readings alone: that gives it
a part out of phase, which is drawn, as large as the one in phase.

In a basis that makes all A_k diagonal these are sums over a spectrum, whose neighbours go together. Where w is
estimated low, as after the mean has adapted to what the noise drives most, a statistic is too large without
any effect. What an earlier record tells of the rival's parameters counts as further readings, of known noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.design.criterion import square_root
from engine.design.noise import NoiseRoom
from engine.design.spectrum import NUMBERS, Parts, Sums, records_of
from engine.statespace.model import Array

NEW = 0.05  # times its share is a noise that is none yet, to begin with
STEPS, LONGEST = 12, 1.5  # Fisher scoring on log w, and the longest step of it
FARTHEST = 12.0  # log w, either way
AT_BOUND = -6.0  # log w below which a noise counts as none, and is not estimated
SETTLED = 0.002  # share of C by which a last step changes it
SMALL = 1e-6  # ridge of the information, as a share
MOST_SHARED = 0.99  # of an effect's information
DEPENDENT = 1e-6  # singular value below which a sensitivity is made of others


@dataclass(frozen=True, eq=False)
class Fitted:
    """Of D records: spectra ``d`` (D, B) of C, the least ``f`` (D,), ``beta`` (D, q).

    ``free`` (D, k) are noises that are not at their bound.
    """

    d: Array
    f: Array
    beta: Array
    free: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Scores:
    """Score tests of D records: ``statistic`` (D,), beside the spectra ``d`` (D, B) of C.

    ``shared`` (D,) is the part of an effect's information that noise parameters have taken by chance.
    """

    statistic: Array
    shared: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Residuals:
    """What a rival leaves of K records that were drawn, and of others like them.

    ``columns`` (N + h, 1 + q) are v / |v| and Q, ``gram`` (B, 1 + q, 1 + q) their products in each of the
    ``parts``. ``shares`` (k, B) of each noise, readings ``n`` (B,); ``fixed`` (B,) is what C has of no noise
    that is ``there`` (k,) and estimated. ``noise`` are sums of the records beside v, without an effect.
    """

    parts: Parts
    columns: Array
    gram: Array
    shares: Array
    there: NDArray[np.bool_]
    fixed: Array
    n: Array
    noise: Sums

    @classmethod
    def drawn(
        cls, room: NoiseRoom, v: Array, sensitivities: Array, held: Array, rng: np.random.Generator
    ) -> Residuals | None:
        """Of a rival with these sensitivities (N, p) in N readings; None where its noise is known.

        ``held`` (h, p) are those of what holds its parameters beside these readings.
        """
        size = float(np.linalg.norm(v))
        if not len(room.shares) or not size > 0.0:
            return None
        N, h = len(v), len(held)
        room = room.of(N)
        parts = Parts.of(room, N)
        shares = parts.means(room.shares)
        direction = np.concatenate([v / size, np.zeros(h)])
        columns = np.column_stack([direction, _span(np.concatenate([sensitivities, held]))])
        rows = rng.standard_normal((records_of(N), N + h))
        rows -= np.outer(rows @ direction, direction)
        return cls(
            parts,
            columns,
            parts.sums(columns.T, columns).products.swapaxes(0, 1),
            shares,
            room.there,
            np.maximum(1.0 - shares[room.there].sum(axis=0), 0.0),
            parts.numbers,
            parts.sums(rows, columns),
        )

    def fitted(self, y: Sums) -> Fitted:
        """The noise and the mean that fit each record best."""
        a, n = self.shares, self.n
        eta = np.tile(np.where(self.there, 0.0, np.log(NEW)), (len(y.power), 1))
        d = self.fixed + np.exp(eta) @ a
        open_ = np.arange(len(eta))
        for _ in range(STEPS):
            eta[open_] = self._nearer(y.of(open_), eta[open_], d[open_])
            before, now = d[open_], self.fixed + np.exp(eta[open_]) @ a
            d[open_] = now
            open_ = open_[(np.abs(now - before) >= SETTLED * now).any(axis=1)]
            if not len(open_):
                break
        power, beta = self._left(y, d)
        return Fitted(d, (n * np.log(d) + power / d).sum(axis=1), beta, eta > AT_BOUND)

    def _nearer(self, y: Sums, eta: Array, d: Array) -> Array:
        """log w (D, k) after a step of Fisher scoring from eta, where the spectrum is d."""
        a, n, w = self.shares, self.n, np.exp(eta)
        power = self._left(y, d)[0]
        gradient = w * ((n / d - power / d**2) @ a.T)
        pairs = (a[:, None] * a[None]).reshape(-1, a.shape[1])
        information = ((n / d**2) @ pairs.T).reshape(-1, len(a), len(a))
        information *= w[:, :, None] * w[:, None]
        step = np.clip(_solved(_held(information, SMALL), gradient), -LONGEST, LONGEST)
        return np.asarray(np.clip(eta - step, -FARTHEST, FARTHEST))

    def _left(self, y: Sums, d: Array) -> tuple[Array, Array]:
        """The power (D, B) of r = y - Q beta, and the beta (D, q) of least squares under C."""
        own, with_Q = self.gram[:, 1:, 1:], y.products[..., 1:]
        weights = 1.0 / d
        beta = _solved(np.tensordot(weights, own, axes=1), (weights[:, None] @ with_Q)[:, 0])
        squares = (beta[:, :, None] * beta[:, None]).reshape(len(beta), -1)
        followed = squares @ own.reshape(len(own), -1).T
        return np.maximum(y.power - 2.0 * _times(with_Q, beta) + followed, 0.0), beta

    def lost(self, x: Array) -> Array:
        """Twice the log-likelihood (D,) that the rival loses by effects of these sizes."""
        alone = self.fitted(self.noise).f[np.arange(len(x)) % len(self.noise.power)]
        there: Array = self.fitted(self.noise.plus(x, self.gram)).f
        return np.maximum(there - alone, 0.0)

    def scores(self, x: Array, rng: np.random.Generator) -> Scores:
        """Score tests of effects of these sizes (D,)."""
        y = self.noise.plus(x, self.gram)
        return self._scores(y, self.fitted(y), rng)

    def simulated(self, d: Array, rng: np.random.Generator) -> Array:
        """The statistic (D,) in a record without the effect for each spectrum (D, B), estimated again."""
        N, out = self.parts.N, []
        at_once = max(NUMBERS // N, 1)
        for k in range(0, len(d), at_once):
            rows = self.parts.drawn(d[k : k + at_once], len(self.columns) - N, rng)
            y = self.parts.sums(rows, self.columns)
            out.append(self._scores(y, self.fitted(y), rng).statistic)
        return np.concatenate(out)

    def _scores(self, y: Sums, fit: Fitted, rng: np.random.Generator) -> Scores:
        weights, own = 1.0 / fit.d, self.gram[:, 1:, 1:]
        with_Q = weights @ self.gram[:, 1:, 0]
        follows = _solved(np.tensordot(weights, own, axes=1), with_Q)
        power = weights @ self.gram[:, 0, 0] - (with_Q * follows).sum(axis=1)  # v~' C^{-1} v~
        r_v = y.products[..., 0] - fit.beta @ self.gram[:, 1:, 0].T
        r_Q = y.products[..., 1:] - np.einsum("dq,bqr->dbr", fit.beta, own)
        along = weights * (r_v - _times(r_Q, follows))  # v~' C^{-1} r, part by part
        shared = np.minimum(self._by_chance(along, power, fit, rng) / (power + 1e-300), MOST_SHARED)
        score = along.sum(axis=1) ** 2 / (power * (1.0 - shared) + 1e-300)
        return Scores(np.asarray(score), np.asarray(shared), fit.d)

    def _by_chance(
        self, along: Array, power: Array, fit: Fitted, rng: np.random.Generator
    ) -> Array:
        """c' G^{-1} c (D,) of the noises that are estimated."""
        phi = self.shares / fit.d[:, None] * fit.free[..., None]
        rest = phi - (phi @ self.n)[..., None] / self.n.sum()
        out_of_phase = 0.25 * np.einsum("dkb,dlb,b->dkl", rest, rest, self.n, optimize=True)
        out_of_phase *= power[:, None, None] / self.n.sum()
        c = 0.5 * np.einsum("dkb,db->dk", rest, along)
        c += _times(square_root(out_of_phase), rng.standard_normal(c.shape))
        G = 0.5 * np.einsum("dkb,dlb,b->dkl", phi, phi, self.n, optimize=True)
        return np.asarray((c * _solved(_held(G, SMALL), c)).sum(axis=1))


def _span(sensitivities: Array) -> Array:
    """An orthonormal basis (N, q) of columns (N, p), whatever their units."""
    sizes = np.linalg.norm(sensitivities, axis=0)
    U, s, _ = np.linalg.svd(sensitivities[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    return np.asarray(U[:, s > DEPENDENT])


def _times(A: Array, x: Array) -> Array:
    """A x for each of D, A (D, m, n), x (D, n)."""
    return np.asarray((A @ x[..., None])[..., 0])


def _solved(A: Array, b: Array) -> Array:
    """A^{-1} b for each of D, A (D, n, n), b (D, n)."""
    return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])


def _held(A: Array, share: float) -> Array:
    """Matrices (D, n, n) with a ridge, a share of their trace."""
    size = np.trace(A, axis1=1, axis2=2)[:, None, None]
    return np.asarray(A + (share * size + 1e-300) * np.eye(A.shape[-1]))
