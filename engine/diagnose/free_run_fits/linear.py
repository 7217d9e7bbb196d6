"""The free run beside its fit, to first order: which effects, alone and in pairs, explain what is wrong.

With e the residuals, Gamma their derivatives by the parameters and the first states, g_k what effect k does
to the run and M = I - Gamma Gamma^+, an effect takes away (g_k' M e)^2 / (g_k' M g_k) of e' M e; a pair
likewise with two columns. The same on the rows of a fold, with coefficients from the others, says what it
takes away where nothing was fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.diagnose.free_run_fits.columns import Column
from engine.diagnose.free_run_fits.fitted import Fitted, Pick
from engine.diagnose.free_run_fits.folds import Folds
from engine.kernels.pairs import best_pairs
from engine.statespace.model import Array

OWN = 1e-6  # of a column: less of it beside Gamma is rounding
CUT = 1e-9  # of the largest singular value: directions below it are none
SAME = 0.97  # |cos| of two columns from which they are one, to first order


@dataclass(frozen=True, eq=False)
class Share:
    """What one or two columns take of the squared error, to first order, with the sizes that do so."""

    share: float
    picks: tuple[Pick, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(pick.effect.name for pick in self.picks)


class Linear:
    """One fit and the columns (K) beside it."""

    def __init__(self, fit: Fitted, columns: list[Column]) -> None:
        self.fit = fit
        self.basis = orthonormal(fit.J)
        self.e = self.beside(fit.e)
        kept, projected = [], []
        for column in columns:
            own = self.beside(column.g)
            if np.linalg.norm(own) > OWN * np.linalg.norm(column.g):
                kept.append(column)
                projected.append(own)
        self.columns = kept
        G = np.array(projected).reshape(len(kept), len(fit.e))
        self.lengths: Array = np.linalg.norm(G, axis=1)
        self.Z: Array = G / self.lengths[:, None]
        self.C: Array = self.Z @ self.Z.T
        self.one_sided = np.array([column.effect.one_sided for column in kept], dtype=bool)

    def beside(self, x: Array) -> Array:
        """M x for x (n,) or (n, N)."""
        return np.asarray(x - self.basis @ (self.basis.T @ x))

    def singles(self) -> list[Share]:
        """Every effect at its best probe, the largest share first."""
        z = self.Z @ self.e
        shares = self._single_shares(z[:, None], float(self.e @ self.e))[:, 0]
        best: dict[str, Share] = {}
        for k in np.argsort(-shares):
            column = self.columns[k]
            found = Share(float(shares[k]), (self._pick(int(k), float(z[k])),))
            best.setdefault(column.effect.name, found)
        return list(best.values())

    def pairs(self, most: int) -> list[Share]:
        """The best pairs of effects, each once, the largest share first."""
        z = self.Z @ self.e
        i, j = self._couples
        shares = self._pair_shares(z, float(self.e @ self.e))
        best: dict[frozenset[str], Share] = {}
        for at in np.argsort(-shares):
            a, b = int(i[at]), int(j[at])
            names = frozenset((self.columns[a].effect.name, self.columns[b].effect.name))
            if names in best:
                continue
            c = self.C[a, b]
            sizes = np.array([z[a] - c * z[b], z[b] - c * z[a]]) / (1.0 - c * c)
            picks = self._pick(a, float(sizes[0])), self._pick(b, float(sizes[1]))
            best[names] = Share(float(shares[at]), picks)
            if len(best) == most:
                break
        return list(best.values())

    def _pick(self, k: int, z: float) -> Pick:
        column = self.columns[k]
        return Pick(column.effect, z / float(self.lengths[k]), column.probe)

    def _single_shares(self, z: Array, power: Array | float) -> Array:
        allowed = (z > 0.0) | ~self.one_sided[:, None]
        return np.asarray(np.where(allowed, z * z / power, 0.0))

    @cached_property
    def _couples(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of columns of two effects that are not one to first order."""
        i, j = np.triu_indices(len(self.columns), 1)
        names = np.array([column.effect.name for column in self.columns])
        apart = (np.abs(self.C[i, j]) < SAME) & (names[i] != names[j])
        return i[apart], j[apart]

    def _pair_shares(self, z: Array, power: float) -> Array:
        i, j = self._couples
        c = self.C[i, j]
        zi, zj = z[i], z[j]
        share = (zi * zi + zj * zj - 2.0 * c * zi * zj) / (1.0 - c * c) / power
        up_i = (zi - c * zj > 0.0) | ~self.one_sided[i]
        up_j = (zj - c * zi > 0.0) | ~self.one_sided[j]
        return np.asarray(np.where(up_i & up_j, share, 0.0))

    def held_out_gains(self, E: Array, folds: Folds) -> Array:
        """What the best single and the best pair of each of the series E (n, N) gain on rows left out (N,).

        The larger of the two means over blocks of log(mean squared error without / with); which effects
        are best is decided on all rows, for each series by itself.
        """
        E = E if E.ndim == 2 else E[:, None]
        projected = self.beside(E)
        power = np.maximum((projected**2).sum(axis=0), np.finfo(float).tiny)
        z = self.Z @ projected
        chosen = []
        if len(self.columns):
            k = np.argmax(self._single_shares(z, power), axis=0)
            chosen.append((k, k))
        i, j = self._couples
        if len(i):
            at = best_pairs(np.ascontiguousarray(z), self.C, i, j, self.one_sided)
            chosen.append((i[at], j[at]))
        gains = [self._gains_of(E, folds, a, b) for a, b in chosen]
        return np.max(gains, axis=0) if gains else np.zeros(E.shape[1])

    def _gains_of(self, E: Array, folds: Folds, a: NDArray[np.intp], b: NDArray[np.intp]) -> Array:
        """Of column a (N,), with b (N,) where that is another, for each series of E."""
        G = np.array([column.g for column in self.columns]).T
        gains, blocks = np.zeros(E.shape[1]), 0
        for fold in np.unique(folds.fold):
            out = folds.out(int(fold))
            U, strengths, Vt = np.linalg.svd(scaled(self.fit.J)[~out], full_matrices=False)
            known = strengths > CUT * strengths.max(initial=0.0)
            ahead = scaled(self.fit.J)[out] @ (Vt[known].T / strengths[known])
            E_in, G_in = (x[~out] - U[:, known] @ (U[:, known].T @ x[~out]) for x in (E, G))
            E_out, G_out = (x[out] - ahead @ (U[:, known].T @ x[~out]) for x in (E, G))
            sizes = _two_sizes(E_in, G_in, a, b)
            block = folds.block[out]
            for k in np.unique(block):
                rows = block == k
                without = (E_out[rows] ** 2).mean(axis=0)
                left = E_out[rows] - G_out[rows][:, a] * sizes[0] - G_out[rows][:, b] * sizes[1]
                tiny = np.finfo(float).tiny
                gains += np.log(without + tiny) - np.log((left**2).mean(axis=0) + tiny)
                blocks += 1
        return gains / max(blocks, 1)


def _two_sizes(E: Array, G: Array, a: NDArray[np.intp], b: NDArray[np.intp]) -> tuple[Array, Array]:
    """Least squares of each series on its two columns; the second size is 0 where both are one.

    Columns of what runs away have products beyond what numbers hold: a power of two, which rounds nothing,
    takes each near 1.
    """
    unit = np.ldexp(1.0, np.frexp(np.abs(G).max(axis=0, initial=0.0))[1])
    A, B = G[:, a] / unit[a], G[:, b] / unit[b]
    aa, bb, ab = ((x * y).sum(axis=0) for x, y in ((A, A), (B, B), (A, B)))
    ae, be = (A * E).sum(axis=0), (B * E).sum(axis=0)
    determinant = aa * bb - ab * ab
    two = (a != b) & (determinant > OWN * aa * bb)
    with np.errstate(all="ignore"):
        first = np.where(two, (bb * ae - ab * be) / determinant, np.where(aa > 0.0, ae / aa, 0.0))
        second = np.where(two, (aa * be - ab * ae) / determinant, 0.0)
    return first / unit[a], second / unit[b]


def scaled(J: Array) -> Array:
    """J with columns of length 1; those that are 0 stay."""
    lengths = np.linalg.norm(J, axis=0)
    return np.asarray(J / np.where(lengths > 0.0, lengths, 1.0))


def orthonormal(J: Array) -> Array:
    """A basis of the columns of J."""
    U, strengths, _ = np.linalg.svd(scaled(J), full_matrices=False)
    return np.asarray(U[:, strengths > CUT * strengths.max(initial=0.0)])
