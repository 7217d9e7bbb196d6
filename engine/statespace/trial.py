"""The test of a call: compared with calls of single rows, of fewer rows, and of scattered ones."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from engine.errors import ModelError
from engine.statespace.compare import (
    Result,
    at_rows,
    copies,
    differ,
    identical,
    larger,
    noise_of,
    sizes_of,
)
from engine.statespace.recorded import NotByRowsError
from engine.statespace.rows import PERTURBATION, Array, Indices, Kind, Rows

# (a, u, t, dt, theta) -> values (M, n), then matrices (r, c) common to all rows, (M, r, c) or None
Regular = Callable[[Array, Any, Any, Any, Any], Result]

SINGLE_ROWS = 4  # of scattered rows that are called alone ...
MORE = 2  # ... and of real ones, besides those with extreme arguments
SEEN = 60  # states of earlier looks that are mixed with those of a new one
COMPANY = 30  # rows that are called together in a brief look, and before many
NUMBERS = (23, 29, 31, 37, 41, 43, 47, 53, 59, 61)  # of scattered rows: a size no matrix has
SPREADS = (0.1, 0.01)  # tried one after the other where a model has no values farther out
UNREPEATED = (
    "called again with the same arguments it returns something else. What it returns may depend on "
    "nothing but its arguments: leave random numbers to the noise, whose size is Q, R or P1, and make what "
    "is remembered from the last call a state"
)
NUMERIC = (ArithmeticError, ValueError)  # what a calculation may meet at a trial of its parameters


class UnrepeatedError(ModelError):
    """A function draws random numbers, or remembers what it did."""


class Trial:
    """What is known of one function from its calls so far.

    ``together`` evaluates many rows, by default as ``regular`` does, to which it is compared row by row.
    ``reuses``: whether it returns memory of its own and writes there again; ``tried_single`` whether a single
    row was looked at for that. ``bounds`` (low, high), each (n_theta,), limit scattered parameters.
    """

    def __init__(
        self, regular: Regular, bounds: tuple[Array, Array], together: Regular | None = None
    ) -> None:
        self._regular, self._bounds = regular, bounds
        self.together = regular if together is None else together
        self.reuses = self.tried_single = False
        self._seen = np.empty((0, 0))  # states of earlier looks

    def agreeing(self, rows: Rows, kind: Kind | None, thorough: bool, seed: int) -> Result | None:
        """The results of one call, None where other calls of the same rows say otherwise."""
        M = len(rows.a)
        # first some of them: a loop over rows may make M times M numbers
        if thorough and kind is not None and M > COMPANY:
            few = np.linspace(0, M - 1, COMPANY).astype(np.intp)
            self.together(*rows.take(kind, few).fresh())
        rng = np.random.default_rng((seed, M))
        raw = self.together(*rows.fresh())
        together = copies(raw) if thorough or self.reuses else raw
        with np.errstate(all="ignore"):
            ends = rows.extremes(kind, rng)
            if not thorough:
                agrees = self._agrees_briefly(rows, kind, together, ends, rng)
                return together if agrees else None
            self._repeat(rows, together)
            order = rng.permutation(M)
            singles = self._singles(rows, kind, [*ends, *order[:MORE]])
            agrees = self._like(rows, kind, together, order, singles)
            self._see_reuse(rows, raw, together)
            agrees = agrees and self._agrees_when_spread(rows, kind, together, rng)
            self._remember(rows.a[order[:SINGLE_ROWS]])
        return together if agrees else None

    def _agrees_briefly(
        self,
        rows: Rows,
        kind: Kind | None,
        together: Result,
        ends: Indices,
        rng: np.random.Generator,
    ) -> bool:
        """Whether some rows agree: with what they were together, or particles among those seen before."""
        some = np.concatenate([ends, rng.integers(0, len(rows.a), min(len(rows.a), COMPANY))])
        if kind is not None:
            singles = self._singles(rows, kind, [*ends, *some[-MORE:]])
            return self._like(rows, kind, together, some, singles)
        before = self._seen if len(self._seen) else rows.a[:0]
        mixed = rows._replace(a=np.concatenate([rows.a[some], before]))
        self._remember(rows.a[some[-SINGLE_ROWS:]])
        n = len(mixed.a)
        singles = self._singles(mixed, None, [0, n - 1, *rng.integers(0, n, MORE)])
        mixture = copies(self.together(*mixed.fresh()))
        return self._like(mixed, None, mixture, rng.permutation(n)[: n // 2], singles)

    def _remember(self, a: Array) -> None:
        self._seen = np.concatenate([a, self._seen])[:SEEN] if len(self._seen) else a

    def single(self, rows: Rows) -> Result:
        """The results for a single row, after seeing whether another call writes into them."""
        raw = self._regular(*rows.fresh())
        self.tried_single = True
        together = copies(raw)
        self._repeat(rows, together)
        self._see_reuse(rows, raw, together)
        return together

    def _repeat(self, rows: Rows, known: Result) -> None:
        """The same call once more. Raises UnrepeatedError where it gives something else."""
        again = copies(self.together(*rows.fresh()))
        if differ(known, again, sizes_of(known), True):
            raise UnrepeatedError(UNREPEATED)

    def _see_reuse(self, rows: Rows, raw: Result, known: Result) -> None:
        """Whether a call with slightly other arguments writes into what was returned before."""
        other = rows.nudged(1.0)
        with np.errstate(all="ignore"), contextlib.suppress(Exception):
            self.together(*other._replace(a=other.a + PERTURBATION))  # also where a is zero
        self.reuses = self.reuses or not identical(raw, known)

    def _agrees_when_spread(
        self, rows: Rows, kind: Kind | None, known: Result, rng: np.random.Generator
    ) -> bool:
        """Whether scattered rows agree; yes where single ones cannot be calculated there."""
        shapes = [rows.a, np.atleast_1d(rows.u), *(x for x in known if x is not None)]
        taken = {n for x in shapes for n in np.shape(x)[1:]} | {len(shapes[1]), len(rows.theta)}
        n = next((n for n in NUMBERS if n not in taken), max(taken) + 1)
        for share in SPREADS:
            drawn = rows.spread(kind, n, self._bounds, share, rng)
            if len(self._seen):  # a condition may hold at some times and not at others
                drawn.a[::2] = self._seen[rng.integers(0, len(self._seen), len(drawn.a[::2]))]
            singles = self._singles(drawn, kind, range(SINGLE_ROWS))
            if any(alone is None for _, alone in singles):
                continue
            try:
                together = copies(self.together(*drawn.fresh()))
                return self._like(drawn, kind, together, rng.permutation(n)[: n // 2], singles)
            except Exception as error:  # noqa: BLE001 - particles out there may be no concern of the model
                only_here = isinstance(error, NotByRowsError) and error.here
                if kind is not None and not only_here:
                    return False
        return True

    def _like(
        self,
        rows: Rows,
        kind: Kind | None,
        together: Result,
        company: Indices,
        singles: Iterable[tuple[int, Result | None]],
    ) -> bool:
        """Whether rows give the same in less company, in another order, and alone.

        A row alone is rounded at its own size, which may be far beyond that of the company, as where it has
        run away.
        """
        sizes = sizes_of(at_rows(together, company))
        now = copies(self.together(*rows.take(kind, company).fresh()))
        pairs = [(at_rows(together, company), now, sizes)]
        there = [(i, one) for i, one in singles if one is not None]
        for i, one in there:
            own = larger(sizes, sizes_of(one))
            pairs.append((at_rows(together, np.array([i])), one, own))
        apart = [pair for pair in pairs if differ(*pair, kind is None)]
        if not apart:
            return True
        every = rows.take(kind, np.append(company, np.array([i for i, _ in there], dtype=np.intp)))
        known = copies(self.together(*every.fresh()))
        nudged = [copies(self.together(*every.nudged(sign))) for sign in (-1.0, 1.0)]
        noise = noise_of(known, nudged)  # some functions magnify rounding
        return not any(differ(*pair, kind is None, noise) for pair in apart)

    def _singles(
        self, rows: Rows, kind: Kind | None, at: Iterable[Any]
    ) -> list[tuple[int, Result | None]]:
        """Some rows, each by itself; None where it cannot be calculated."""
        return [(int(i), self._alone(rows, kind, int(i))) for i in at]

    def _alone(self, rows: Rows, kind: Kind | None, i: int) -> Result | None:
        """Row i by itself; None where it cannot be calculated."""
        try:
            return copies(self._regular(*rows.alone(kind, np.array([i])).fresh()))
        except Exception as error:
            if is_numeric(error):
                return None
            raise


def is_numeric(error: Exception) -> bool:
    """Whether a calculation failed at these values, in contrast to a function that is wrong.

    A power of a negative number, ``theta.q ** 0.5``, is complex in Python, which no function after it takes.
    """
    if isinstance(error, ModelError):
        return error.numeric
    return isinstance(error, NUMERIC) or (isinstance(error, TypeError) and "complex" in str(error))
