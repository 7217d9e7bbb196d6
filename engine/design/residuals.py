"""What a rival leaves of readings, drawn: its noise is estimated from that, and few readings tell little.

Let v = L^{-1} Delta be the difference that is left, x its size in a record (of which |v| is the mean), e white
and Q an orthonormal basis of what the rival's mean adapts to. A record leaves

    r = (I - Q Q') e + (x - v'e / |v|) v / |v|,

which the rival takes for noise: the variances of its noise become w times as large, where w minimises

    f(w) = log det C + r' C^{-1} r,      C = I + sum_k (w_k - 1) A_k,

with A_k the share of each noise (:mod:`engine.design.noise`), and w instead of w - 1 for one that is none yet.
Twice the log-likelihood lost is the least f less the least f at x = 0, and a score test of the effect has the
statistic (v' C^{-1} r)^2 / v' C^{-1} v. In a basis that makes all A_k diagonal these are sums over a spectrum,
whose neighbours go together. Where w is estimated low, as after the mean has adapted to what the noise drives
most, a statistic is too large without any effect. What an earlier record tells of the rival's parameters
counts as further readings, of known noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.design.noise import NoiseRoom
from engine.statespace.model import Array

PARTS = 24  # of a spectrum
NUMBERS = 100_000  # that are drawn at once, about: records times readings
MOST, FEWEST = 400, 50  # records that are drawn
NEW = 0.05  # times its share is a noise that is none yet, to begin with
STEPS, LONGEST = 12, 1.5  # Fisher scoring on log w, and the longest step of it
SETTLED = 0.002  # share of C by which a last step changes it
SMALL = 1e-6  # ridge of the information, as a share
DEPENDENT = 1e-6  # singular value below which a sensitivity is made of others


@dataclass(frozen=True, eq=False)
class Residuals:
    """Sums over the parts (B,) of a spectrum, of K records that were drawn.

    A ``basis`` (M, M) of a block of readings has its parts at ``starts`` (B,). ``adapted`` (N + h, q) is Q and
    ``direction`` (N,) v / |v|. Of each part: ``shares`` (k, B) of each noise, readings ``n`` (B,), ``share``
    (B,) of v / |v|, squared; ``fixed`` (B,) is what C has of no noise that is ``there`` (k,) and estimated;
    ``power`` (K, B) of what is left beside v, and ``along`` (K, B) its product with v / |v|.
    """

    basis: Array
    starts: NDArray[np.intp]
    adapted: Array
    direction: Array
    shares: Array
    there: NDArray[np.bool_]
    fixed: Array
    n: Array
    share: Array
    power: Array
    along: Array

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
        N = len(v)
        room = room.of(N)
        basis, shares = room.basis, room.shares
        M = len(basis)
        starts = _parts(shares)
        each = np.diff(np.append(starts, M))
        seen = _in_basis(np.ones((1, N)), basis**2)
        records = int(np.clip(NUMBERS // N, FEWEST, MOST))
        adapted, direction = _span(np.concatenate([sensitivities, held])), v / size
        left = _off(rng.standard_normal((records, N)), adapted, rng)
        left -= np.outer(left @ direction, direction)
        shares = np.add.reduceat(shares, starts, axis=1) / each
        rows, own = _in_basis(left, basis), _in_basis(direction[None], basis)
        return cls(
            basis,
            starts,
            adapted,
            direction,
            shares,
            room.there,
            np.maximum(1.0 - shares[room.there].sum(axis=0), 0.0),
            _summed(seen, starts)[0],
            _summed(own**2, starts)[0],
            _summed(rows**2, starts),
            _summed(rows * own, starts),
        )

    def _of(self, x: Array) -> tuple[Array, Array]:
        """Power and product with v / |v|, (D, B) both, of records with effects of these sizes (D,)."""
        k = np.arange(len(x)) % len(self.power)
        size = x[:, None]
        along = self.along[k]
        power = self.power[k] + 2.0 * size * along + size**2 * self.share
        return np.maximum(power, 0.0), along + size * self.share

    def fitted(self, power: Array) -> tuple[Array, Array]:
        """The spectrum (D, B) of C that fits each power (D, B) best, and its f (D,)."""
        a, n = self.shares, self.n
        eta = np.tile(np.where(self.there, 0.0, np.log(NEW)), (len(power), 1))
        pairs = (a[:, None] * a[None]).reshape(-1, a.shape[1])
        d = self.fixed + np.exp(eta) @ a
        for _ in range(STEPS):
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
        return d, (n * np.log(d) + power / d).sum(axis=1)

    def lost(self, x: Array) -> Array:
        """Twice the log-likelihood (D,) that the rival loses by effects of these sizes."""
        alone = self.fitted(self.power)[1][np.arange(len(x)) % len(self.power)]
        there: Array = self.fitted(self._of(x)[0])[1]
        return np.maximum(there - alone, 0.0)

    def statistic(self, x: Array) -> tuple[Array, Array]:
        """The statistics (D,) of a score test for effects of these sizes, and the spectra (D, B) of C."""
        power, along = self._of(x)
        d = self.fitted(power)[0]
        return self._score(along, d), d

    def _score(self, along: Array, d: Array) -> Array:
        score: Array = (along / d).sum(axis=1) ** 2 / (self.share / d).sum(axis=1)
        return score

    def simulated(self, d: Array, rng: np.random.Generator) -> Array:
        """The statistic (D,) in a record without the effect for each spectrum (D, B), estimated again."""
        M, N = len(self.basis), len(self.direction)
        blocks, at_once = -(-N // M), max(NUMBERS // N, 1)
        each = np.diff(np.append(self.starts, M))
        own, out = _in_basis(self.direction[None], self.basis), []
        for k in range(0, len(d), at_once):
            scale = np.repeat(np.sqrt(d[k : k + at_once]), each, axis=1)[:, None]
            rows = rng.standard_normal((len(scale), blocks, M)) * scale
            left = (rows @ self.basis.T).reshape(len(scale), -1)[:, :N]
            rows = _in_basis(_off(left, self.adapted, rng), self.basis)
            again = self.fitted(_summed(rows**2, self.starts))[0]
            out.append(self._score(_summed(rows * own, self.starts), again))
        return np.concatenate(out)


def _parts(shares: Array) -> NDArray[np.intp]:
    """Where parts of a spectrum (k, M) begin: alike in number, and in their shares."""
    level = np.arange(1.0, len(shares) + 1.0) @ shares
    way = np.cumsum(np.abs(np.diff(level, prepend=level[0])))
    along = np.linspace(0.0, 1.0, len(level)) + way / max(float(way[-1]), 1e-3)
    edges = np.linspace(0.0, along[-1], PARTS + 1)[:-1]
    return np.unique(np.searchsorted(along, edges))


def _span(sensitivities: Array) -> Array:
    """An orthonormal basis (N, q) of columns (N, p), whatever their units."""
    sizes = np.linalg.norm(sensitivities, axis=0)
    U, s, _ = np.linalg.svd(sensitivities[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    return np.asarray(U[:, s > DEPENDENT])


def _off(rows: Array, Q: Array, rng: np.random.Generator) -> Array:
    """What a fit leaves of rows (K, N); Q (N + h, q) has further readings, of noise that is drawn."""
    K, N = rows.shape
    further = rng.standard_normal((K, len(Q) - N))
    return np.asarray(rows - (rows @ Q[:N] + further @ Q[N:]) @ Q[:N].T)


def _in_basis(rows: Array, basis: Array) -> Array:
    """Rows (K, N) in a basis (M, M), block by block of M readings: (K, blocks, M)."""
    K, N = rows.shape
    M = len(basis)
    whole = np.zeros((K, -(-N // M) * M))
    whole[:, :N] = rows
    return np.asarray(whole.reshape(K, -1, M) @ basis)


def _summed(rows: Array, starts: NDArray[np.intp]) -> Array:
    """Sums (K, B) of rows (K, blocks, M) over blocks, and over neighbours."""
    return np.asarray(np.add.reduceat(rows.sum(axis=1), starts, axis=1))
