"""The model's part of each step of a moment filter, for many parameter vectors at once."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError
from engine.kernels.moments import sigma_points, transform
from engine.statespace.first_state import moments_of_first
from engine.statespace.had import no_number
from engine.statespace.model import Array, MixedModel, stacked


class Thetas:
    """K parameter vectors (K, n_theta) and their records."""

    def __init__(self, model: MixedModel, thetas: Array) -> None:
        self.model = model
        self.thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
        self.K = len(self.thetas)
        self._records: dict[int, Any] = {}

    def record(self, copies: int) -> Any:
        """The record of K ``copies`` rows, ``copies`` for each parameter vector in turn."""
        if copies not in self._records:  # the same at every time step
            self._records[copies] = self.model.records(self.thetas, copies)
        return self._records[copies]


class FilterSteps:
    """The model's part of each step, for K copies of the filter."""

    def __init__(self, model: MixedModel, thetas: Thetas, series: Series) -> None:
        series.check(model)
        self.model, self.thetas, self.series = model, thetas, series
        self.na = model.na
        self.times, self.steps = series.t.tolist(), series.steps.tolist()
        model.transitions.look_again(series.u_step)
        model.observations.look_again(series.u)

    def start(self) -> tuple[Array, Array]:
        """Mean (K, nx) and covariance (K, nx, nx) of x_1 before any measurement."""
        means, covs = self._first
        return means.copy(), covs.copy()

    def start_beside(self) -> tuple[Array, Array]:
        """The same with the copies on the last axis: (nx, K) and (nx, nx, K)."""
        means, covs = self._first
        return means.T.copy(), np.moveaxis(covs, 0, 2).copy()

    @cached_property
    def _first(self) -> tuple[Array, Array]:
        """Moments of x_1; NaN at a theta where they cannot be calculated, unless all are such."""
        nx = self.model.nx
        means, covs = np.full((self.thetas.K, nx), np.nan), np.full((self.thetas.K, nx, nx), np.nan)
        failed: ModelError | None = None
        for k, theta in enumerate(self.thetas.thetas):
            try:
                means[k], covs[k] = first_moments(self.model, theta)
            except ModelError as error:
                if not error.numeric:
                    raise
                failed = error
        if failed is not None and np.isnan(means).all():
            raise failed
        return means, covs

    def observation(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """h (K S, ny), C and R (1 or K S, ., .) at the points a (K S, na)."""
        record = self.thetas.record(len(a) // self.thetas.K)
        h, C, R = self.model.observation(a, self.series.u[t], self.times[t], record)
        return h, stacked(C), stacked(R)

    def transition(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """f (K S, nx), A and Q (1 or K S, ., .) at the points a (K S, na); x_1 where a record begins next."""
        if t + 1 in self.series.begins:
            return self._begin_again(len(a) // self.thetas.K)
        record = self.thetas.record(len(a) // self.thetas.K)
        f, A, Q = self.model.transition(
            a, self.series.u_step[t], self.times[t], self.steps[t], record
        )
        return f, stacked(A), stacked(Q)

    def _begin_again(self, copies: int) -> tuple[Array, Array, Array]:
        m, P = self._first
        model, each = self.model, copies if self.thetas.K > 1 else 1
        nothing = np.zeros((1, model.nx, model.nz))
        return np.repeat(m, copies, axis=0), nothing, np.repeat(P, each, axis=0)

    def through(self, function: Any, t: int, m: Array, P: Array) -> tuple[Array, Array, Array]:
        """Mean, covariance and cross-covariance with x of a function of x ~ N(m, P)."""
        a, z, V, offsets = sigma_points(m, P, self.na)
        rows = a.reshape(a.shape[0] * a.shape[1], self.na)
        f, A, Q = function(t, rows)
        mean, cov, cross = transform(f, A, Q, z, V, offsets, self.na)
        return mean, cov, cross

    def why_lost(self, m: Array, P: Array, t: int) -> str:
        """Why one filter with filtered moments (nx,), (nx, nx) at row t has none at the next; "" if unknown."""
        if not self.na:
            return ""
        means, covs = m[None], P[None]
        a = sigma_points(means, covs, self.na)[0].reshape(-1, self.na)
        why = no_number(self.model, "dynamics", a, self.transition(t, a))
        if why:
            return why
        means, covs, _ = self.through(self.transition, t, means, covs)
        return self.why_unread(means[0], covs[0], t + 1)

    def why_unread(self, m: Array, P: Array, t: int) -> str:
        """Why one filter with predicted moments (nx,), (nx, nx) predicts no reading at row t; "" if unknown."""
        if not self.na:
            return ""
        a = sigma_points(m[None], P[None], self.na)[0].reshape(-1, self.na)
        return no_number(self.model, "measurement", a, self.observation(t, a))


def first_moments(model: MixedModel, theta: Array) -> tuple[Array, Array]:
    """Mean (nx,) and covariance (nx, nx) of x_1 at theta."""
    return moments_of_first(model, model.record(theta))


def lost_at(model: MixedModel, series: Series, t: int, why: str = "") -> ModelError:
    """The error of a filter that has no finite moments, or likelihood, from row t on, and why."""
    return ModelError(
        f"model '{model.name}': the filter is lost at row {t} (t = {series.t[t]:g}); its "
        f"mean or likelihood is not finite. {why or 'Check theta and the density of the first state'}"
    )
