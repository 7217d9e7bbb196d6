"""What a rival leaves of readings, drawn: its noise is estimated from that, and few readings tell little.

Let v = L^{-1} Delta be the difference that is left, x its size in a record (of which |v| is the mean), e white
and Q an orthonormal basis of what the rival's mean adapts to. Of the readings

    y = e + (x - v'e / |v|) v / |v|

the rival takes for noise what it cannot follow: the variances of its noise become w times as large, where w and
the mean's beta minimise

    f(w, beta) = log det C + (y - Q beta)' C^{-1} (y - Q beta),      C = I + sum_k (w_k - 1) A_k,

with A_k the share of each noise (:mod:`engine.design.noise`), and w instead of w - 1 for one that is none yet.
Twice the log-likelihood lost is the least f less the least f at x = 0. A score test of the effect, with what
the mean follows projected out under C, has the statistic

    (v' C^{-1} r)^2 / (v' C^{-1} v - v' C^{-1} Q (Q' C^{-1} Q)^{-1} Q' C^{-1} v),      r = y - Q beta.

In a basis that makes all A_k diagonal these are sums over a spectrum, whose neighbours go together. Where w is
estimated low, as after the mean has adapted to what the noise drives most, a statistic is too large without
any effect. What an earlier record tells of the rival's parameters counts as further readings, of known noise:
the last part of the spectrum, whose C is 1 whatever w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.design.criterion import square_root
from engine.design.noise import NoiseRoom
from engine.statespace.model import Array

PARTS = 24  # of a spectrum
NUMBERS = 100_000  # that are drawn at once, about: records times readings
MOST, FEWEST = 400, 50  # records that are drawn
NEW = 0.05  # times its share is a noise that is none yet, to begin with
STEPS, LONGEST = 12, 1.5  # Fisher scoring on log w, and the longest step of it
SETTLED = 0.002  # share of C by which a last step changes it
SMALL = 1e-6  # ridge of the information, as a share
LEAST_LOG = -6.0
DEPENDENT = 1e-6  # singular value below which a sensitivity is made of others


@dataclass(frozen=True, eq=False)
class Readings:
    """Sums over the parts (B,) of a spectrum, of K records: ``power`` (K, B), their product with themselves,
    and ``products`` (K, B, 1 + q) with v / |v| and the columns of Q."""

    power: Array
    products: Array

    def plus(self, x: Array, gram: Array) -> Readings:
        """These records, over and over, with effects of these sizes (D,)."""
        k = np.arange(len(x)) % len(self.power)
        size = x[:, None]
        power = self.power[k] + 2.0 * size * self.products[k, :, 0] + size**2 * gram[:, 0, 0]
        return Readings(power, self.products[k] + size[..., None] * gram[:, 0])


@dataclass(frozen=True, eq=False)
class Parts:
    """Of a spectrum of N readings, in blocks with a ``basis`` (M, M): where they begin, (B - 1,), and the last."""

    basis: Array
    starts: NDArray[np.intp]
    N: int

    @classmethod
    def of(cls, room: NoiseRoom, N: int) -> Parts:
        """Alike in number, and in the shares of each noise."""
        level = np.arange(1.0, len(room.shares) + 1.0) @ room.shares
        way = np.cumsum(np.abs(np.diff(level, prepend=level[0])))
        along = np.linspace(0.0, 1.0, len(level)) + way / max(float(way[-1]), 1e-3)
        edges = np.linspace(0.0, along[-1], PARTS + 1)[:-1]
        return cls(room.basis, np.unique(np.searchsorted(along, edges)), N)

    @property
    def blocks(self) -> int:
        """Of M readings, the last one cut off."""
        return -(-self.N // len(self.basis))

    @property
    def numbers(self) -> Array:
        """How many readings each part has, (B,); in the last one are none of the record itself."""
        seen = self._blocks(np.ones((1, self.N)), self.basis**2).sum(axis=1)
        return np.append(np.add.reduceat(seen, self.starts, axis=1)[0], 0.0)

    def sums(self, rows: Array, columns: Array) -> Readings:
        """Of rows (K, N + h), beside columns (N + h, 1 + q)."""
        own, other = (self._blocks(x[:, : self.N], self.basis) for x in (rows, columns.T))
        ends = [*self.starts[1:], len(self.basis)]
        products = [
            np.tensordot(own[..., i:j], other[..., i:j], axes=((1, 2), (1, 2)))
            for i, j in zip(self.starts, ends, strict=True)
        ]
        power = np.add.reduceat((own**2).sum(axis=1), self.starts, axis=1)
        further = rows[:, self.N :]
        return Readings(
            np.column_stack([power, (further**2).sum(axis=1)]),
            np.stack([*products, further @ columns[self.N :]], axis=1),
        )

    def _blocks(self, rows: Array, basis: Array) -> Array:
        """Rows (K, N) in a basis (M, M), block by block of M readings: (K, blocks, M)."""
        whole = np.zeros((len(rows), self.blocks * len(basis)))
        whole[:, : self.N] = rows
        return np.asarray(whole.reshape(len(rows), -1, len(basis)) @ basis)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Of D records: the spectra ``d`` (D, B) of C, the least ``f`` (D,), and ``beta`` (D, q) of the mean."""

    d: Array
    f: Array
    beta: Array
    free: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Residuals:
    """What a rival leaves of K records that were drawn, and how to draw others.

    ``columns`` (N + h, 1 + q) are v / |v| and Q, ``gram`` (B, 1 + q, 1 + q) their products in each of the
    ``parts``. ``shares`` (k, B) of each noise, readings ``n`` (B,); ``fixed`` (B,) is what C has of no noise
    that is ``there`` (k,) and estimated.
    """

    parts: Parts
    columns: Array
    gram: Array
    shares: Array
    there: NDArray[np.bool_]
    fixed: Array
    n: Array
    readings: Readings

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
        each = np.diff(np.append(parts.starts, len(room.basis)))
        shares = np.add.reduceat(room.shares, parts.starts, axis=1) / each
        direction = np.concatenate([v / size, np.zeros(h)])
        columns = np.column_stack([direction, _span(np.concatenate([sensitivities, held]))])
        rows = rng.standard_normal((int(np.clip(NUMBERS // N, FEWEST, MOST)), N + h))
        rows -= np.outer(rows @ direction, direction)
        return cls(
            parts,
            columns,
            parts.sums(columns.T, columns).products.transpose(1, 0, 2),
            np.pad(shares, ((0, 0), (0, 1))),
            room.there,
            np.append(np.maximum(1.0 - shares[room.there].sum(axis=0), 0.0), 1.0),
            parts.numbers,
            parts.sums(rows, columns),
        )

    def fitted(self, readings: Readings) -> Fitted:
        """The noise and the mean that fit each record best."""
        a, n = self.shares, self.n
        eta = np.tile(np.where(self.there, 0.0, np.log(NEW)), (len(readings.power), 1))
        pairs = (a[:, None] * a[None]).reshape(-1, a.shape[1])
        d = self.fixed + np.exp(eta) @ a
        for _ in range(STEPS):
            power = self._left(readings, d)[0]
            w, before = np.exp(eta), d
            gradient = w * ((n / d - power / d**2) @ a.T)
            information = ((n / d**2) @ pairs.T).reshape(-1, len(a), len(a))
            information *= w[:, :, None] * w[:, None]
            size = np.trace(information, axis1=1, axis2=2)
            information += (SMALL * size[:, None, None] + 1e-300) * np.eye(len(a))
            step = np.linalg.solve(information, gradient[..., None])[..., 0]
            eta = np.clip(eta - np.clip(step, -LONGEST, LONGEST), -12.0, 12.0)
            d = self.fixed + np.exp(eta) @ a
            if (np.abs(d - before) < SETTLED * d).all():
                break
        power, beta = self._left(readings, d)
        return Fitted(d, (n * np.log(d) + power / d).sum(axis=1), beta, eta > LEAST_LOG)

    def _left(self, readings: Readings, d: Array) -> tuple[Array, Array]:
        """The power (D, B) of y - Q beta, and the beta (D, q) of least squares under C."""
        own, with_y = self.gram[:, 1:, 1:], readings.products[..., 1:]
        A = np.tensordot(1.0 / d, own, axes=1)
        b = np.einsum("db,dbq->dq", 1.0 / d, with_y)
        beta = np.linalg.solve(A, b[..., None])[..., 0]
        follows = np.einsum("dq,bqr,dr->db", beta, own, beta, optimize=True)
        return np.maximum(readings.power - 2.0 * (with_y @ beta[..., None])[..., 0] + follows, 0.0), beta

    def lost(self, x: Array) -> Array:
        """Twice the log-likelihood (D,) that the rival loses by effects of these sizes."""
        alone = self.fitted(self.readings).f[np.arange(len(x)) % len(self.readings.power)]
        there: Array = self.fitted(self.readings.plus(x, self.gram)).f
        return np.maximum(there - alone, 0.0)

    def statistic(self, x: Array) -> tuple[Array, Array]:
        """The statistics (D,) of a score test for effects of these sizes, and the spectra (D, B) of C."""
        readings = self.readings.plus(x, self.gram)
        fit = self.fitted(readings)
        return self._score(readings, fit), fit.d

    def _score(self, readings: Readings, fit: Fitted, rng: np.random.Generator = np.random.default_rng(9)) -> Array:
        weights, (n, own) = 1.0 / fit.d, (self.n, self.gram[:, 1:, 1:])
        c = weights @ self.gram[:, 1:, 0]
        A = np.tensordot(weights, own, axes=1)
        follows = np.linalg.solve(A, c[..., None])[..., 0]  # v by Q
        beside_v = readings.products[..., 0] - fit.beta @ self.gram[:, 1:, 0].T
        beside_Q = readings.products[..., 1:] - np.einsum("dq,bqr->dbr", fit.beta, own)
        along = (beside_v - (beside_Q @ follows[..., None])[..., 0]) * weights
        norm = weights @ self.gram[:, 0, 0] - (c * follows).sum(axis=1)
        phi = self.shares * weights[:, None] * fit.free[..., None]
        middle = (phi @ n) / n.sum()
        G = 0.5 * np.einsum("dkb,dlb,b->dkl", phi, phi, n, optimize=True)
        G += 1e-12 * np.trace(G, axis1=1, axis2=2)[:, None, None] * np.eye(len(self.shares)) + 1e-300 * np.eye(len(self.shares))
        cross = 0.5 * np.einsum("dkb,db->dk", phi - middle[..., None], along)
        away = phi - middle[..., None]
        spread = 0.25 * np.einsum("dkb,dlb,b->dkl", away, away, n / n.sum(), optimize=True) * norm[:, None, None]
        cross += np.einsum("dkl,dl->dk", square_root(spread), rng.standard_normal(cross.shape))
        norm -= (cross * np.linalg.solve(G, cross[..., None])[..., 0]).sum(axis=1)
        score: Array = along.sum(axis=1) ** 2 / np.maximum(norm, 1e-300)
        return score

    def simulated(self, d: Array, rng: np.random.Generator) -> Array:
        """The statistic (D,) in a record without the effect for each spectrum (D, B), estimated again."""
        parts, M = self.parts, len(self.parts.basis)
        h, out = len(self.columns) - parts.N, []
        each, at_once = np.diff(np.append(parts.starts, M)), max(NUMBERS // parts.N, 1)
        for k in range(0, len(d), at_once):
            scale = np.repeat(np.sqrt(d[k : k + at_once, :-1]), each, axis=1)[:, None]
            noise = rng.standard_normal((len(scale), parts.blocks, M)) * scale
            rows = (noise @ parts.basis.T).reshape(len(scale), -1)[:, : parts.N]
            rows = np.concatenate([rows, rng.standard_normal((len(scale), h))], axis=1)
            readings = parts.sums(rows, self.columns)
            out.append(self._score(readings, self.fitted(readings)))
        return np.concatenate(out)


def _span(sensitivities: Array) -> Array:
    """An orthonormal basis (N, q) of columns (N, p), whatever their units."""
    sizes = np.linalg.norm(sensitivities, axis=0)
    U, s, _ = np.linalg.svd(sensitivities[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    return np.asarray(U[:, s > DEPENDENT])
