"""The moment filter where the scale of a noise is random: one Gaussian for each stratum, kept as one.

A state g that only scales noise shows in no moment of y, so points of its distribution, spread with those of
the other states, would not see what an outlier tells. Each step is taken for the strata of g beside each
other; what they predicted weighs them, and the mean and covariance of the mixture are kept (Harrison and
Stevens 1976). The likelihood is smooth in theta, while a few hundred particles would lose track at every jump
and favour whatever noise is wider.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import product

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps, Thetas, lost_at
from engine.kernels.moments import gaussian_update, slopes
from engine.statespace.model import Array, MixedModel


class StrataSteps(FilterSteps):
    """The model's part of each step without the states g, for K J copies: those of each theta in J strata.

    ``log_shares`` (K, J) are the logarithms of the strata's probabilities.
    """

    def __init__(self, model: MixedModel, thetas: Thetas, series: Series) -> None:
        super().__init__(model, thetas, series)
        states = [*model.nonlinear]
        self._at = [states.index(one.state) for one in model.random_scales]
        self._others = np.delete(np.arange(model.nx), self._at)
        self.na = model.na - len(self._at)
        each = [_strata(model, theta) for theta in thetas.thetas]
        self._g = np.concatenate([g for g, _ in each])
        self.log_shares = np.log([shares for _, shares in each])
        self.J = self.log_shares.shape[1]

    def start(self) -> tuple[Array, Array]:
        """Mean (K J, n) and covariance (K J, n, n) of the n other states before any measurement."""
        m, P = super().start()
        return self.renewed(m[:, self._others], self._apart(P))

    def observation(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """h, C and R at the points a (K J S, na) of the others."""
        return super().observation(t, self._with_g(a))

    def transition(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """f, A and Q of the others at their points a (K J S, na)."""
        f, A, Q = super().transition(t, self._with_g(a))
        rows = np.ascontiguousarray(f[:, self._others])
        return rows, np.ascontiguousarray(A[:, self._others]), self._apart(Q)

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
        """The predicted reading (K, ny), and the S (K, ny, ny) by which the score of a shift comes out.

        S^{-1} is the mean of the strata's, weighed by what y_t says of them (``log_w`` (K, J)): an outlier
        counts for little, as in the likelihood.
        """
        K, ny = len(log_w), y_mean.shape[1]
        y, own = np.exp(self.log_shares)[:, :, None] * y_mean.reshape(K, self.J, ny), S
        total = np.logaddexp.reduce(log_w, axis=1)
        w = np.exp(log_w - total[:, None])[:, :, None, None]
        with suppress(np.linalg.LinAlgError):
            inverses = np.linalg.inv(S).reshape(K, self.J, ny, ny)
            return y.sum(axis=1), np.linalg.inv((w * inverses).sum(axis=1))
        return y.sum(axis=1), (w * own.reshape(K, self.J, ny, ny)).sum(axis=1)

    def keep(self, kept: dict[str, Array], name: str, t: int, values: Array) -> None:
        """One of the others' moments or slopes as a row of all states': g has no part in any of them."""
        row = kept[name][t]
        row[...] = 0.0
        if name == "H":
            row[:, self._others] = values
        elif name in ("predicted", "filtered", "K"):
            row[self._others] = values
        else:
            row[self._others[:, None], self._others] = values
        if name in ("predicted", "filtered"):
            row[self._at] = np.exp(self.log_shares[0]) @ self._g
        if name in ("P_predicted", "P_filtered"):
            row[self._at, self._at] = 1.0

    def _with_g(self, a: Array) -> Array:
        """Points of all nonlinear states, from those of the others."""
        whole = np.empty((len(a), self.model.na))
        whole[:, self._others[: self.na]] = a
        whole[:, self._at] = np.repeat(self._g, len(a) // len(self._g), axis=0)
        return whole

    def _apart(self, P: Array) -> Array:
        """The rows and columns of the others."""
        return np.ascontiguousarray(P[:, self._others[:, None], self._others])


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
    series, T, K, ny = run.series, len(run.series), run.thetas.K, run.model.ny
    innovations, S = np.full((T, K, ny), np.nan), np.zeros((T, K, ny, ny))
    terms = np.zeros((T, K))
    measured: NDArray[np.bool_] = np.asarray(series.observed.any(axis=1))
    m, P = run.start()
    for t in range(T):
        log_w = run.log_shares
        if measured[t]:
            y_mean, S_t, cross = run.through(run.observation, t, m, P)
            m, P, log_p = gaussian_update(m, P, y_mean, S_t, cross, series.y[t])
            log_w = log_p.reshape(K, run.J) + log_w
            predicted, S[t] = run.seen(y_mean, S_t, log_w)
            innovations[t] = series.y[t] - predicted
        mean, cov, terms[t] = run.merged(m, P, log_w)
        if t < T - 1:
            m, P, _ = run.through(run.transition, t, *run.renewed(mean, cov))
    terms[~measured] = 0.0  # where the shares' sum is 1 but for rounding
    return innovations, S, terms


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
        run.keep(kept, "H", t, slopes(np.tensordot(shares, cross, 1), cov[0]))
        m, P, log_p = gaussian_update(m, P, y_mean, S, cross, series.y[t])
        log_w = log_p[None] + run.log_shares
        mean, cov, term = run.merged(m, P, log_w)
        predicted, seen = run.seen(y_mean, S, log_w)
        kept["innovations"][t], kept["S"][t] = series.y[t] - predicted[0], seen[0]
        gain = _gain(np.exp(log_w[0] - term[0]), S, cross, observed[t])
        run.keep(kept, "K", t, gain)
        run.keep(kept, "filtered", t, mean[0])
        run.keep(kept, "P_filtered", t, cov[0])
        total += float(term[0])
        if not (np.isfinite(mean).all() and np.isfinite(total)):
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
