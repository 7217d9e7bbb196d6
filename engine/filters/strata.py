"""The moment filter where the scale of a noise is random: one Gaussian for each stratum, kept as one.

A state g that only scales noise shows in no moment of y, so points of its distribution, spread with those of
the other states, would not see what an outlier tells. Each step is taken for the strata of g beside each
other; what they predicted weighs them, and the mean and covariance of the mixture are kept (Harrison and
Stevens 1976). The likelihood is smooth in theta, while a few hundred particles would lose track at every jump
and favour whatever noise is wider.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps, Thetas, lost_at
from engine.filters.taped import tapes_of
from engine.kernels.moment_steps import slopes
from engine.kernels.moments import gaussian_update, sigma_points
from engine.kernels.strata import filter_strata, merge
from engine.kernels.taped import filter_strata_taped
from engine.statespace.model import Array, LinearGaussian, MixedModel
from engine.statespace.on_tape import SHORTEST
from engine.statespace.points import Points

NUMBERS = 4_000_000  # in the arrays of one block of rows, at most


class StrataSteps(FilterSteps):
    """The model's part of each step without the states g, for K J copies: those of each theta in J strata.

    ``log_shares`` (K, J) are the logarithms of the strata's probabilities.
    """

    def __init__(self, model: MixedModel, thetas: Thetas, series: Series) -> None:
        super().__init__(model, thetas, series)
        states = [*model.nonlinear]
        self._at = [states.index(one.state) for one in model.random_scales]
        self.others = np.delete(np.arange(model.nx), self._at)
        self.na = model.na - len(self._at)
        each = [_strata(model, theta) for theta in thetas.thetas]
        self._g = np.concatenate([g for g, _ in each])
        self.log_shares = np.log([shares for _, shares in each])
        self.J = self.log_shares.shape[1]

    def start(self) -> tuple[Array, Array]:
        """Mean (K J, n) and covariance (K J, n, n) of the n other states before any measurement."""
        m, P = super().start()
        return self.renewed(m[:, self.others], self._apart(P))

    def observation(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """h, C and R at the points a (K J S, na) of the others."""
        return super().observation(t, self.with_g(a))

    def transition(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """f, A and Q of the others at their points a (K J S, na)."""
        f, A, Q = super().transition(t, self.with_g(a))
        rows = np.ascontiguousarray(f[:, self.others])
        return rows, np.ascontiguousarray(A[:, self.others]), self._apart(Q)

    def at(self, rows: NDArray[np.intp], transition: bool) -> LinearGaussian:
        """Observation or transition of linear others at many rows, (B, K J, .) and (B or 1, K J, ., .)."""
        each = []
        for k, points in enumerate(self._points):
            f, *matrices = points.at(rows, self.model.record(self.thetas.thetas[k]), transition)
            wide = (np.broadcast_to(x, (len(x), self.J, *x.shape[2:])) for x in matrices)
            each.append((f, *wide))
        f, A, Q = (_side_by_side(parts) for parts in zip(*each, strict=True))
        if not transition:
            return f, A, Q
        others = self.others
        f, A, Q = f[:, :, others], A[:, :, others], Q[:, :, others[:, None], others]
        return np.ascontiguousarray(f), np.ascontiguousarray(A), np.ascontiguousarray(Q)

    @cached_property
    def _points(self) -> list[Points]:
        """The strata of each theta, at every time."""
        g = self._g.reshape(-1, self.J, len(self._at))[:, :, np.argsort(self._at)]
        T = len(self.series)
        return [Points(self.model, self.series, np.broadcast_to(one, (T, *one.shape))) for one in g]

    def renewed(self, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Each stratum's moments (K J, ...) from those that were kept (K, ...)."""
        return np.repeat(mean, self.J, axis=0), np.repeat(cov, self.J, axis=0)

    def merged(self, m: Array, P: Array, log_w: Array) -> tuple[Array, Array, Array]:
        """Mean and covariance (K, ...) of mixtures of N(m, P) (K J, ...), weighed by ``log_w`` (K, J).

        And the logarithm of the sum of the weights (K,).
        """
        total = np.logaddexp.reduce(log_w, axis=1)
        w = np.exp(log_w - total[:, None])[:, :, None]
        n = m.shape[1]
        each = m.reshape(-1, self.J, n)
        mean = (w * each).sum(axis=1)
        d = (each - mean[:, None])[:, :, :, None]
        cov = (w[..., None] * (P.reshape(-1, self.J, n, n) + d * np.swapaxes(d, 2, 3))).sum(axis=1)
        return mean, cov, total

    def seen(self, y_mean: Array, S: Array, log_w: Array) -> tuple[Array, Array]:
        """The predicted readings (B, K, ny), and the S (B, K, ny, ny) by which the score of a shift comes out.

        S^{-1} is the mean of the strata's, weighed by what y_t says of them (``log_w`` (B, K, J)): an outlier
        counts for little, as in the likelihood.
        """
        shape, ny = log_w.shape, y_mean.shape[2]
        y = (np.exp(self.log_shares)[:, :, None] * y_mean.reshape(*shape, ny)).sum(axis=2)
        w = np.exp(log_w - np.logaddexp.reduce(log_w, axis=2)[:, :, None])[..., None, None]
        with suppress(np.linalg.LinAlgError):
            inverses = np.linalg.inv(S).reshape(*shape, ny, ny)
            return y, np.linalg.inv((w * inverses).sum(axis=2))
        return y, (w * S.reshape(*shape, ny, ny)).sum(axis=2)  # of readings without any noise

    def keep(self, kept: dict[str, Array], name: str, t: int, values: Array) -> None:
        """One of the others' moments or slopes as a row of all states': g has no part in any of them."""
        row = kept[name][t]
        row[...] = 0.0
        if name == "H":
            row[:, self.others] = values
        elif name in ("predicted", "filtered", "K"):
            row[self.others] = values
        else:
            row[self.others[:, None], self.others] = values
        if name in ("predicted", "filtered"):
            row[self._at] = np.exp(self.log_shares[0]) @ self._g
        if name in ("P_predicted", "P_filtered"):
            row[self._at, self._at] = 1.0

    def with_g(self, a: Array) -> Array:
        """Points of all nonlinear states, from those of the others."""
        whole = np.empty((len(a), self.model.na))
        whole[:, self.others[: self.na]] = a
        whole[:, self._at] = np.repeat(self._g, len(a) // len(self._g), axis=0)
        return whole

    def _apart(self, P: Array) -> Array:
        """The rows and columns of the others."""
        return np.ascontiguousarray(P[:, self.others[:, None], self.others])


def _side_by_side(parts: Sequence[Array]) -> Array:
    """Of K thetas (B or 1, J, ...) as one (B or 1, K J, ...)."""
    times = max(len(one) for one in parts)
    each = [np.broadcast_to(one, (times, *one.shape[1:])) for one in parts]
    return np.concatenate(each, axis=1)


def _strata(model: MixedModel, theta: Array) -> tuple[Array, Array]:
    """Values of all states g (J, n), and the probability of each (J,): all combinations of their strata."""
    each = []
    for one in model.random_scales:
        each.append(one.strata([theta[model.index(name)] for name in one.parameters]))
    g = np.array([*product(*(middle for middle, _ in each))])
    shares = np.array([*product(*(shares for _, shares in each))]).prod(axis=1)
    return g, shares


def filter_in_strata(run: StrataSteps) -> tuple[Array, Array, Array]:
    """All steps: innovations (T, K, ny), S (T, K, ny, ny), terms of the likelihood (T, K).

    S as :meth:`StrataSteps.seen` has it; zero where nothing was measured.
    """
    series, T, (K, J), ny = run.series, len(run.series), run.log_shares.shape, run.model.ny
    y_mean, S = np.zeros((T, K * J, ny)), np.zeros((T, K * J, ny, ny))
    log_w, terms = np.empty((T, K, J)), np.zeros((T, K))
    if run.na == 0:
        _all_at_once(run, y_mean, S, log_w, terms)
    elif not _by_tape(run, y_mean, S, log_w, terms):
        _step_by_step(run, y_mean, S, log_w, terms)
    innovations, shown = np.full((T, K, ny), np.nan), np.zeros((T, K, ny, ny))
    there = np.flatnonzero(np.asarray(series.observed).any(axis=1))
    predicted, shown[there] = run.seen(y_mean[there], S[there], log_w[there])
    innovations[there] = series.y[there][:, None] - predicted
    return innovations, shown, terms


def _step_by_step(run: StrataSteps, y_mean: Array, S: Array, log_w: Array, terms: Array) -> None:
    """What was predicted, weights and terms, of a model whose other states are not all linear."""
    series, T, shape = run.series, len(run.series), run.log_shares.shape
    measured: NDArray[np.bool_] = np.asarray(series.observed.any(axis=1))
    m, P = run.start()
    for t in range(T):
        log_w[t] = run.log_shares
        if measured[t]:
            y_mean[t], S[t], cross = run.through(run.observation, t, m, P)
            m, P, log_p = gaussian_update(m, P, y_mean[t], S[t], cross, series.y[t])
            log_w[t] += log_p.reshape(shape)
        merge(m, P, log_w[t], terms[t])
        if t < T - 1:
            m, P, _ = run.through(run.transition, t, m, P)
    terms[~measured] = 0.0  # where the shares' sum is 1 but for rounding


def _by_tape(run: StrataSteps, y_mean: Array, S: Array, log_w: Array, terms: Array) -> bool:
    """The same in one call of a kernel; False where the model's functions must be called."""
    if len(run.series) < SHORTEST:
        return False
    m, P = run.start()
    points = sigma_points(m, P, run.na)[0]
    whole = run.with_g(points.reshape(-1, run.na))
    tapes = tapes_of(run, whole)
    if tapes is None:
        return False
    strata = run.log_shares, whole, run.others
    found = y_mean, S, log_w, terms
    done = filter_strata_taped(*tapes.arguments, (m, P), strata, run.series.y, *found)
    if not done and tapes.learn():
        return _by_tape(run, *found)
    return tapes.hold(done, terms)


def _all_at_once(run: StrataSteps, y_mean: Array, S: Array, log_w: Array, terms: Array) -> None:
    """The same of one whose other states are linear, evaluated for many rows in one call."""
    T, y = len(run.series), run.series.y
    m, P = run.start()
    length = max(NUMBERS // (len(m) * m.shape[1] * max(m.shape[1], y.shape[1], 1)), 2)
    first = 0
    while first < T:
        last = T if first + length >= T - 1 else first + length
        seen = run.at(np.arange(first, last), False)
        moved = run.at(np.arange(first, min(last, T - 1)), True)
        own = slice(first, last)
        filter_strata(
            y[own], seen, moved, run.log_shares, m, P, y_mean[own], S[own], log_w[own], terms[own]
        )
        first = last


def path_in_strata(run: StrataSteps, kept: dict[str, Array]) -> float:
    """What one filter saw, ``kept`` as :class:`engine.filters.sigma_point.MomentPath` wants it; its likelihood.

    S as :meth:`StrataSteps.seen` has it, and K likewise the mean of the strata's gains.
    """
    series, T, observed = run.series, len(run.series), np.asarray(run.series.observed)
    total = 0.0
    shares = np.exp(run.log_shares[0])
    m, P = run.start()
    for t in range(T):
        mean, cov, _ = run.merged(m, P, run.log_shares)
        run.keep(kept, "predicted", t, mean[0])
        run.keep(kept, "P_predicted", t, cov[0])
        y_mean, S, cross = run.through(run.observation, t, m, P)
        kept["S_predicted"][t] = run.merged(y_mean, S, run.log_shares)[1][0]
        run.keep(kept, "H", t, slopes(np.tensordot(shares, cross, 1), cov[0]))
        m, P, log_p = gaussian_update(m, P, y_mean, S, cross, series.y[t])
        log_w = log_p[None] + run.log_shares
        mean, cov, term = run.merged(m, P, log_w)
        predicted, seen = run.seen(y_mean[None], S[None], log_w[None])
        kept["innovations"][t], kept["S"][t] = series.y[t] - predicted[0, 0], seen[0, 0]
        gain = _gain(np.exp(log_w[0] - term[0]), S, cross, observed[t])
        run.keep(kept, "K", t, gain)
        run.keep(kept, "filtered", t, mean[0])
        run.keep(kept, "P_filtered", t, cov[0])
        total += float(term[0])
        read = np.isfinite(kept["innovations"][t][observed[t]]).all()
        if not (read and np.isfinite(mean).all() and np.isfinite(total)):
            raise lost_at(run.model, series, t)
        if t < T - 1:
            m, P, cross = run.through(run.transition, t, *run.renewed(mean, cov))
            run.keep(kept, "F", t, slopes(cross[0], cov[0]))
    return total


def _gain(w: Array, S: Array, cross: Array, observed: Array) -> Array:
    """The mean of Cov(x, y) S^{-1} (n, ny) over strata, zero for missing channels."""
    there = np.flatnonzero(observed)
    out = np.zeros((cross.shape[2], cross.shape[1]))
    if there.size:
        gains = np.linalg.solve(S[:, there[:, None], there], cross[:, there])
        out[:, there] = np.tensordot(w, gains, 1).T
    return out
