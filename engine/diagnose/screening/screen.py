"""Score tests of every effect at once, from the base model's filter and small extensions of it.

With s_kt = d log p(y_t | y_{1:t-1}) / d size_k at size zero and the information

    H_kl = sum nu_t,k' S_t^{-1} nu_t,l + 1/2 tr(S_t^{-1} S_t,k S_t^{-1} S_t,l) = v_k . v_l

(nu_t,k, S_t,k the derivatives of the innovations and their covariance), the estimated parameters
gamma are projected out,

    s~_kt = s_kt - H_kg H_gg^{-1} s_gt,    v~_k likewise,
    T_k = (sum_t s~_kt)^2 / |v~_k|^2 ~ chi2(1),   size_k = sum_t s~_kt / |v~_k|^2,   se_k = 1 / |v~_k|.

rho_k = |v~_k|^2 / |v_k|^2 is what the data can still say about k once the parameters are fitted. What k
explains here is e_k = size_k v~_k, summed over its columns where several are tested together (sine and
cosine), and |P_l e_k| / |e_k| is how much of it l explains as well, P_l the projection on l's columns. The
smaller of the two ways is their likeness: |cos| of v~_k and v~_l where both have one column. Families over
an unknown time or frequency count as one test by their maximum. The family-wise p-value is Westfall and
Young's min-p over multiplier draws, in which every time's contribution s~_t keeps its size and gets a
random sign. Where few times make up a score, its values are scaled by what its draws are larger than chi2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.diagnose.effects.effect import Effect
from engine.diagnose.screening.score_columns import UNTESTABLE, Column, Projection
from engine.distributions import chi2_isf, chi2_sf
from engine.statespace.model import Array

MULTIPLIER_DRAWS = 499  # at least
DECIDING = 2.5  # of which so many would be enough for a p-value at the level
COUNTED_DRAWS = 10  # draws above a value, from which their count is its p-value
EDGE = 0.05  # of the draws tell how heavy their tail is
SAME = 1e-9  # of it: so near it draws are alike but for rounding
CLEARLY_HEAVIER = 2.5  # a tail than chi2: in 499 draws of chi2 the 95 % point scatters by a fifth


@dataclass(frozen=True, eq=False)
class Score:
    """The result of one effect: ``statistic`` T_k, ``size`` and ``se`` in its unit, ``p_value`` of this test.

    ``at`` are the values of its other parameters where the statistic was largest; ``rho`` the share
    of information left beside the fitted parameters; ``statistic`` is 0 where not testable.
    """

    effect: Effect
    statistic: float
    size: float
    se: float
    p_value: float
    rho: float
    at: tuple[float, ...]
    tests: float = 1.0  # independent chi2 tests that the maximum over its family amounts to
    degrees: int = 1
    boldness: float = 1.0  # the logarithm of a p-value over what it should be

    def p_of(self, value: float) -> float:
        """The p-value of a value of this statistic, such as a refitted likelihood ratio."""
        p_value = min(1.0, self.tests * float(chi2_sf(value, self.degrees)))
        return float(p_value ** (1.0 / self.boldness))


@dataclass(frozen=True, eq=False)
class Screen:
    """All scores, best first; ``p_value`` family-wise; ``likenesses`` (n, n) of every two effects.

    ``lowest`` (n,) are the draws' smallest p-values; ``simulated`` the number of series by
    which p-values were calibrated, see :mod:`engine.diagnose.refits.calibration`, 0 where they were not.
    Where the screen is one of several chances of an alarm, it has this ``share`` of the error.
    ``refits_floor`` is the least that ``p_value`` can be where simulated refits gave it, 0 where none did.
    """

    scores: tuple[Score, ...]
    p_value: float
    threshold: float
    likenesses: Array
    lowest: Array
    simulated: int = 0
    share: float = 1.0
    refits_floor: float = 0.0

    @property
    def at_floor(self) -> bool:
        """Whether ``p_value`` is the least that so many draws can give, so that it may be any smaller."""
        return self.p_value in (self.family_wise(0.0), self.refits_floor)

    @property
    def smallest(self) -> float:
        """The smallest p-value of a single test."""
        return min(score.p_value for score in self.scores)

    def family_wise(self, p_value: float) -> float:
        """How probable so small a p-value is among all of these tests."""
        drawn = (1.0 + float((self.lowest <= p_value).sum())) / (len(self.lowest) + 1.0)
        return min(1.0, drawn / self.share)

    def sharing(self, share: float) -> Screen:
        """The same screen as one of several chances, with a share of the family-wise error."""
        one = replace(self, share=share)
        return replace(one, p_value=one.family_wise(one.smallest))

    def with_untested(self, elsewhere: Sequence[Score]) -> Screen:
        """The screen with effects that it could not test, and that were tested ``elsewhere``.

        Here they show nothing; from there they have what makes a p-value of a likelihood ratio.
        """
        known = {score.effect.name for score in self.scores}
        new = {score.effect.name: score for score in elsewhere if score.effect.name not in known}
        nothing = (
            replace(one, statistic=0.0, size=0.0, se=np.inf, p_value=1.0, rho=0.0)
            for one in new.values()
        )
        n = len(self.scores)
        likenesses = np.eye(n + len(new))
        likenesses[:n, :n] = self.likenesses
        return replace(self, scores=(*self.scores, *nothing), likenesses=likenesses)

    def family_wise_at(self, boldness: float) -> float:
        """The family-wise p-value of what was seen, if all p-values were so bold."""
        return self.family_wise(self.smallest ** (1.0 / boldness))

    def likeness(self, one: int, other: int) -> float:
        """How much of what either of two effects explains the other does, too, by their place in ``scores``."""
        return float(self.likenesses[one, other])


@dataclass(frozen=True, eq=False)
class Test:
    """One test: an effect with one or several columns, projected, of which the largest counts."""

    effect: Effect
    s: Array  # (n, T)
    norm: Array  # (n,) |v~|^2
    rho: Array  # (n,)
    at: tuple[tuple[float, ...], ...]
    vectors: Array  # (degrees, .) v~ of the best place, orthogonal
    degrees: int = 1  # columns that are tested together, as the two of a harmonic
    tries: int = 1  # places that this one was chosen from
    known: tuple[float, float] | None = None  # statistic and p-value, where they are not of scores

    @property
    def explained(self) -> Array:
        """What it explains at its best place: its columns, each times its estimated size."""
        if self.degrees == 1:
            return np.asarray(self.vectors[0])
        best = int(np.argmax(self.statistics(self.s.sum(axis=1)))) * self.degrees
        own = slice(best, best + self.degrees)
        norm = self.norm[own]
        sizes = np.divide(self.s[own].sum(axis=1), norm, out=np.zeros(len(norm)), where=norm > 0.0)
        return np.asarray(sizes @ self.vectors)

    def best_of(self, tries: int) -> Test:
        """The best place alone, as chosen from so many."""
        best = int(np.argmax(self.statistics(self.s.sum(axis=1))))
        own = slice(best * self.degrees, (best + 1) * self.degrees)
        return replace(
            self,
            s=self.s[own],
            norm=self.norm[own],
            rho=self.rho[own],
            at=(self.at[best],),
            tries=tries,
        )

    def statistics(self, totals: Array) -> Array:
        """Statistics (..., n / degrees) from sums over time (..., n) of s~, one-sided if it must be."""
        if self.known is not None:
            return np.full((*totals.shape[:-1], 1), self.known[0])
        use = self.norm > 0.0
        standard = np.where(use, totals / np.sqrt(np.where(use, self.norm, 1.0)), 0.0)
        if self.effect.one_sided:
            standard = np.maximum(standard, 0.0)
        squares = standard**2
        if self.degrees > 1:
            squares = squares.reshape(*squares.shape[:-1], -1, self.degrees).sum(axis=-1)
        return np.asarray(squares)


def screen(tests: Sequence[Test], rng: np.random.Generator, alpha: float) -> Screen:
    """All tests together: each statistic, each p-value, and the family-wise p-value.

    ``threshold`` is the statistic a single two-sided test needs at the family-wise level ``alpha``.
    """
    T = tests[0].s.shape[1]
    n = max(MULTIPLIER_DRAWS, int(np.ceil(DECIDING / alpha)) - 1)
    signs = rng.choice(np.array([-1.0, 1.0]), size=(n, T))
    observed, drawn, tests_each = [], [], []
    for test in tests:
        found = test.statistics(test.s.sum(axis=1))
        draws = test.statistics(signs @ test.s.T).max(axis=-1)
        tail = 0.5 if test.effect.one_sided else 1.0
        family = found.size > 1
        tail_of = _tail(draws, test.degrees, float(found.size) if family else tail, family)
        tests_each.append(tail_of.tests if family else tail * test.tries)
        if test.known is not None:
            observed.append(test.known[1])
            drawn.append(rng.random(n))
        elif test.tries > 1 or test.effect.traits.of_record or test.effect.traits.of_starts:
            # the best of many places, nearly independent: Bonferroni; or made of the first readings alone,
            # whose signs say nothing
            p_value = min(1.0, test.tries * float(chi2_sf(found.max(), test.degrees)))
            # records may begin closer together than the model says: it says only what is not known
            closer = test.effect.traits.of_starts and float(test.s.sum()) < 0.0
            observed.append(1.0 if closer else p_value)
            drawn.append(rng.random(n))
        else:
            # data and draws go by the same rule, so that its error is in both
            p_values = tail_of.p_values(found.max(), draws)
            observed.append(float(p_values[0]))
            drawn.append(p_values[1:])
    lowest = np.min(drawn, axis=0)
    threshold = float(chi2_isf(max(float(np.quantile(lowest, alpha)), 1e-12), 1))
    scores = [_score(*of) for of in zip(tests, observed, tests_each, strict=True)]
    order = sorted(range(len(tests)), key=lambda i: (observed[i], -scores[i].statistic))
    likenesses = _likenesses([tests[i] for i in order])
    result = Screen(tuple(scores[i] for i in order), 1.0, threshold, likenesses, lowest)
    return replace(result, p_value=result.family_wise(result.smallest))


def _score(test: Test, p_value: float, effective: float) -> Score:
    totals = test.s.sum(axis=1)
    statistics = test.statistics(totals)
    best = int(np.argmax(statistics)) * test.degrees
    norm = float(test.norm[best])
    testable = norm > 0.0 and test.rho[best] > UNTESTABLE
    return Score(
        test.effect,
        float(statistics.max()) if testable else 0.0,
        float(totals[best]) / norm if testable else 0.0,
        norm**-0.5 if testable else np.inf,
        p_value if testable else 1.0,
        float(test.rho[best]),
        test.at[best // test.degrees],
        effective,
        test.degrees,
    )


def _likenesses(tests: Sequence[Test]) -> Array:
    """How much of what either of two tests explains the other does, too, (n, n); 0 where one is nothing."""
    longest = max(test.vectors.shape[1] for test in tests)  # of some the means' part is all
    columns = np.concatenate([_as_long(_unit(test.vectors), longest) for test in tests])
    explained = np.concatenate([_as_long(_unit(test.explained[None]), longest) for test in tests])
    owners = np.repeat(np.arange(len(tests)), [len(test.vectors) for test in tests])
    squares = np.zeros((len(tests), len(tests)))
    np.add.at(squares, owners, (columns @ explained.T) ** 2)
    shares = np.sqrt(squares)
    return np.asarray(np.minimum(shares, shares.T))


def _as_long(rows: Array, n: int) -> Array:
    """Rows (., m) of n numbers, those beyond m zero."""
    return np.pad(rows, ((0, 0), (0, n - rows.shape[1])))


def _unit(rows: Array) -> Array:
    """Rows (n, .) of length one, those that are zero left so."""
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(np.divide(rows, norms, out=np.zeros_like(rows), where=norms > 0.0))


@dataclass(frozen=True)
class _Tail:
    """The tail of a statistic: chi2 of the largest of so many independent ``tests``, or as heavy as draws are.

    Of a heavy one ``edge`` is the draws' 95 % point, and ``excess`` how far from it those beyond are on
    average. ``counted`` is how many draws above a value tell its p-value themselves.
    """

    tests: float
    degrees: int
    counted: float
    edge: float = 0.0
    excess: float = np.inf

    def p_values(self, value: float, draws: Array) -> Array:
        """p (1 + n,) of a value and of the draws: by the draws above where these are many, else by the tail."""
        values, heavy = np.append(value, draws), np.isfinite(self.excess)
        if heavy:
            by_tail = beyond(values, self.edge, self.excess)
        else:
            by_tail = np.minimum(1.0, self.tests * chi2_sf(values, self.degrees))
        if not np.isfinite(self.counted):
            return np.asarray(by_tail)
        above = len(draws) - np.searchsorted(np.sort(draws), values)
        by_count = (1.0 + above) / (len(draws) + 1.0)
        if heavy:  # and no less than the share of other draws above: few signs make few values
            others = above - np.append(0, np.ones(len(draws)))
            by_tail = np.maximum(by_tail, others / (len(draws) + 1.0))
        return np.where(above >= self.counted, by_count, by_tail)


def beyond(values: Array, edge: Array | float, excess: Array | float) -> Array:
    """p of values beyond a 95 % point: exponential, with the mean of what others exceed it by.

    Source: T. A. Knijnenburg, L. F. A. Wessels, M. J. T. Reinders, I. Shmulevich, "Fewer permutations, more
    accurate P-values", Bioinformatics 25 (2009) i161-i168.
    """
    with np.errstate(over="ignore"):
        return np.minimum(1.0, EDGE * np.exp(-(values - edge) / excess))


def _tail(draws: Array, degrees: int, most: float, fewer: bool) -> _Tail:
    """The tail with the draws' 95 % point: that of ``most`` tests, but for scatter, or of ``fewer``.

    Where a few outlying times make up a score, a random sign leaves it as large as it is: such a score is no
    evidence, and its draws must not hide the evidence of others. So the tail is that of the draws. As chi2 of
    more tests some of them would be as improbable as what is sure; as chi2 of a larger scale what all draws
    stay far below would be probable: noise that grows, say, which the last rows show most.
    """
    edge = float(np.quantile(draws, 1.0 - EDGE))
    p_edge = float(chi2_sf(edge, degrees))
    if p_edge * CLEARLY_HEAVIER * most >= EDGE:
        of_all = EDGE / p_edge if fewer else most
        return _Tail(of_all, degrees, COUNTED_DRAWS if fewer else np.inf)
    excess = float(np.mean(draws[draws > edge] - edge)) if (draws > edge).any() else 0.0
    return _Tail(most, degrees, COUNTED_DRAWS, edge, max(excess, SAME * edge))


def make_test(
    effect: Effect,
    chunks: Iterable[Sequence[tuple[tuple[float, ...], Column]]],
    projection: Projection,
    degrees: int = 1,
) -> Test | None:
    """Project an effect's columns, chunk by chunk; None where it has none."""
    parts: list[tuple[Array, Array, Array]] = []
    at: list[tuple[float, ...]] = []
    best, vectors = -1.0, np.zeros((degrees, 0))
    for columns in chunks:
        if not columns:
            continue
        s = np.array([c.s for _, c in columns])
        v = np.array([c.v for _, c in columns])
        with np.errstate(over="ignore", invalid="ignore"):
            before = _squares(v)
            along, s = projection.along(s, v)
            norm = before - _squares(along)
            lost = ~np.isfinite(before + norm + s.sum(axis=1) ** 2)
        for each in (s, v, along, before, norm):
            each[lost] = 0.0  # a filter that runs away shows nothing
        rho = np.divide(norm, before, out=np.zeros(len(before)), where=before > 0.0)
        nothing = rho <= UNTESTABLE
        for each in (v, along, norm):
            each[nothing] = 0.0
        if degrees > 1:
            s, v = _decorrelate(s, projection.apart(v, along), degrees)
            along, norm = np.zeros_like(along), _squares(v)
        parts.append((s, norm, rho))
        at += [point for point, _ in columns[::degrees]]
        use = norm > 0.0
        statistics = np.where(use, s.sum(axis=1) ** 2 / np.where(use, norm, 1.0), 0.0)
        together = statistics.reshape(-1, degrees).sum(axis=1)
        k = int(np.argmax(together))
        if together[k] > best:
            own = slice(k * degrees, (k + 1) * degrees)
            best, vectors = float(together[k]), projection.apart(v[own], along[own])
    if not parts:
        return None
    s, norm, rho = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Test(effect, s, norm, rho, tuple(at), vectors, degrees)


def _squares(rows: Array) -> Array:
    """|v|^2 (n,) of rows (n, .)."""
    return np.asarray(np.einsum("ij,ij->i", rows, rows))


def _decorrelate(s: Array, v: Array, degrees: int) -> tuple[Array, Array]:
    """Columns tested together made orthogonal, so that their statistics add."""
    s, v = s.copy(), v.copy()
    for start in range(0, len(v), degrees):
        for i in range(start, start + degrees):
            for j in range(start, i):
                norm = float(v[j] @ v[j])
                if norm > 0.0:
                    c = float(v[i] @ v[j]) / norm
                    v[i] -= c * v[j]
                    s[i] -= c * s[j]
    return s, v
