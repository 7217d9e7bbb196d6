"""Sums over the parts of a spectrum: of drawn readings, of what they are compared with, of shares of noises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.design.noise import NoiseRoom
from engine.statespace.model import Array

PARTS = 24  # of a spectrum, and one more for readings beside it
NUMBERS = 100_000  # that are drawn at once, about: records times readings
MOST, FEWEST = 400, 50  # records that are drawn


def records_of(N: int) -> int:
    """How many records of N readings are drawn."""
    return int(np.clip(NUMBERS // max(N, 1), FEWEST, MOST))


@dataclass(frozen=True, eq=False)
class Sums:
    """Of K records y in each part: ``power`` (K, B), y' y; ``products`` (K, B, p), y' columns."""

    power: Array
    products: Array

    def of(self, rows: NDArray[np.intp]) -> Sums:
        """Some of the records."""
        return Sums(self.power[rows], self.products[rows])

    def plus(self, x: Array, gram: Array) -> Sums:
        """These records, over and over, with the first column x times added, x (D,).

        ``gram`` (B, p, p) are products of the columns with each other.
        """
        k = np.arange(len(x)) % len(self.power)
        size = x[:, None]
        power = self.power[k] + 2.0 * size * self.products[k, :, 0] + size**2 * gram[:, 0, 0]
        return Sums(power, self.products[k] + size[..., None] * gram[:, 0])


@dataclass(frozen=True, eq=False)
class Parts:
    """Of the spectrum of N readings, block by block in a ``basis`` (M, M): ``starts`` (B - 1,) of its parts.

    The last of the B parts are further readings, beside the N.
    """

    basis: Array
    starts: NDArray[np.intp]
    N: int

    @classmethod
    def of(cls, room: NoiseRoom, N: int) -> Parts:
        """Parts alike in number, and in the shares of each noise."""
        level = np.arange(1.0, len(room.shares) + 1.0) @ room.shares
        way = np.cumsum(np.abs(np.diff(level, prepend=level[0])))
        along = np.linspace(0.0, 1.0, len(level)) + way / max(float(way[-1]), 1e-3)
        edges = np.linspace(0.0, along[-1], PARTS + 1)[:-1]
        return cls(room.basis, np.unique(np.searchsorted(along, edges)), N)

    @property
    def each(self) -> NDArray[np.intp]:
        """Members of the basis in each part but the last, (B - 1,)."""
        return np.diff(np.append(self.starts, len(self.basis)))

    @property
    def blocks(self) -> int:
        """Blocks of M readings; the last one is cut off."""
        return -(-self.N // len(self.basis))

    @property
    def numbers(self) -> Array:
        """How many of the N readings each part has, (B,)."""
        seen = self._blocks(np.ones((1, self.N)), self.basis**2).sum(axis=1)
        return np.append(np.add.reduceat(seen, self.starts, axis=1)[0], 0.0)

    def means(self, shares: Array) -> Array:
        """Means (k, B) of shares (k, M); further readings have none."""
        return np.pad(np.add.reduceat(shares, self.starts, axis=1) / self.each, ((0, 0), (0, 1)))

    def sums(self, rows: Array, columns: Array) -> Sums:
        """Of rows (K, N + h), beside columns (N + h, p)."""
        own, other = (self._blocks(x[:, : self.N], self.basis) for x in (rows, columns.T))
        ends = [*self.starts[1:], len(self.basis)]
        products = [
            np.tensordot(own[..., i:j], other[..., i:j], axes=((1, 2), (1, 2)))
            for i, j in zip(self.starts, ends, strict=True)
        ]
        power = np.add.reduceat((own**2).sum(axis=1), self.starts, axis=1)
        further = rows[:, self.N :]
        return Sums(
            np.column_stack([power, (further**2).sum(axis=1)]),
            np.stack([*products, further @ columns[self.N :]], axis=1),
        )

    def drawn(self, d: Array, h: int, rng: np.random.Generator) -> Array:
        """Records (K, N + h) of noise whose variance in each part is d (K, B), of further ones 1."""
        scale = np.repeat(np.sqrt(d[:, :-1]), self.each, axis=1)[:, None]
        noise = rng.standard_normal((len(d), self.blocks, len(self.basis))) * scale
        rows = (noise @ self.basis.T).reshape(len(d), -1)[:, : self.N]
        return np.concatenate([rows, rng.standard_normal((len(d), h))], axis=1)

    def _blocks(self, rows: Array, basis: Array) -> Array:
        """Rows (K, N) in a basis (M, M), block by block of M readings: (K, blocks, M)."""
        whole = np.zeros((len(rows), self.blocks * len(basis)))
        whole[:, : self.N] = rows
        return np.asarray(whole.reshape(len(rows), -1, len(basis)) @ basis)
