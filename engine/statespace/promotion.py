"""Move linear states among the nonlinear ones, so that a nonlinear function of them can be added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np

from engine.errors import OptionError
from engine.kernels.gaussian import log_normal_common, psd_cholesky
from engine.statespace.evaluation import hands_rows_on
from engine.statespace.model import Array, Density, Gaussian, MixedModel
from engine.statespace.shapes import through

NEGLIGIBLE = 1e-12  # of the largest variance: below this there is no randomness to condition on
AFFINE = 1e-10  # relative: how far off its tangent a function may be and count as affine


@dataclass(frozen=True)
class Joint:
    """p(a) N(b; mean(a), cov(a)) as one density of (a, b), whatever p(a) is.

    ``density`` of a (M, na); ``given`` maps a to the mean (M, k) and the covariance, (k, k) or (M, k, k).
    """

    density: Density
    given: Callable[[Array], tuple[Array, Array]]
    na: int

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw (n, na + k)."""
        a = np.asarray(self.density.sample(rng, n), dtype=float)
        mean, cov = self.given(a)
        e = rng.standard_normal(mean.shape)
        if cov.ndim == 2:
            return np.hstack([a, mean + e @ psd_cholesky(cov).T])
        b = [m + psd_cholesky(P) @ x for m, P, x in zip(mean, cov, e, strict=True)]
        return np.hstack([a, np.reshape(b, mean.shape)])

    def log_density(self, x: Array) -> Array:
        """Evaluate at x (M, na + k) -> (M,); a fixed component contributes nothing."""
        a, b = np.ascontiguousarray(x[:, : self.na]), x[:, self.na :]
        mean, cov = self.given(a)
        out = np.asarray(self.density.log_density(a), dtype=float)
        b = np.ascontiguousarray(b)
        if cov.ndim == 2:
            return np.asarray(out + log_normal_common(b, mean, psd_cholesky(cov)))
        each = [
            log_normal_common(one[None], m[None], psd_cholesky(P))[0]
            for one, m, P in zip(b, mean, cov, strict=True)
        ]
        return np.asarray(out + np.array(each))


def product(density: Density, given: Callable[[Array], tuple[Array, Array]], na: int) -> Density:
    """:class:`Joint`, as one Gaussian where it is one: p(a) Gaussian, mean affine, covariance constant."""
    if not isinstance(density, Gaussian):
        return Joint(density, given, na)
    root = psd_cholesky(density.cov)
    steps = _steps(na)
    mean, cov = given(density.mean + steps @ root.T)
    slopes = mean[1 : 1 + na] - mean[0]
    off = np.abs(mean - mean[0] - steps @ slopes)
    if cov.ndim == 3 or (off > AFFINE * (np.abs(mean) + np.abs(steps) @ np.abs(slopes))).any():
        return Joint(density, given, na)
    k = mean.shape[1]
    whole = np.zeros((na + k, na + k))
    whole[:na, :na], whole[na:, na:] = density.cov, cov + slopes.T @ slopes
    whole[:na, na:] = root @ slopes
    whole[na:, :na] = whole[:na, na:].T
    return Gaussian(np.concatenate([density.mean, mean[0]]), whole)


@cache  # it is the same for every theta
def _steps(na: int) -> Array:
    """Steps (., na) from the mean: none, one along each axis, and four along all of them."""
    mixed = np.random.default_rng(0).standard_normal((4, na))
    return np.vstack([np.zeros(na), np.eye(na), mixed])


def as_nonlinear(model: MixedModel) -> MixedModel:
    """The same model with x = (a, z) as its nonlinear state and no linear one; made once."""
    if model.nz == 0:
        return model
    if "nonlinear" not in model.derived:
        model.derived["nonlinear"] = promote(model, list(model.linear))
    return cast(MixedModel, model.derived["nonlinear"])


def promote(model: MixedModel, names: Sequence[str]) -> MixedModel:
    """The same model with the linear states ``names`` appended to its nonlinear ones.

    p(a_1) may be any density, and z_{1|0}, P_{1|0} may depend on a_1. States that are nonlinear already
    are left where they are. Raises OptionError for an unknown state.
    """
    for name in names:
        if name not in model.nonlinear and name not in model.linear:
            raise OptionError(
                f"model '{model.name}' has no state '{name}'; it has "
                f"{', '.join([*model.nonlinear, *model.linear])}",
                "effects",
            )
    moved = [name for name in model.linear if name in names]
    if not moved:
        return model
    na, nz = model.na, model.nz
    linear = list(model.linear)
    out = np.array([linear.index(name) for name in moved])
    stay = np.array([i for i in range(nz) if i not in out], dtype=int)
    order = np.concatenate([np.arange(na), na + out, na + stay])

    @hands_rows_on
    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = model.transition(a[:, :na], u, t, dt, theta)
        f = f + through(A.take(out, -1), a[:, na:])
        A, Q = A.take(order, -2).take(stay, -1), Q.take(order, -2).take(order, -1)
        return f.take(order, 1), A, Q

    @hands_rows_on
    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = model.observation(a[:, :na], u, t, theta)
        return h + through(C.take(out, -1), a[:, na:]), C.take(stay, -1), R

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        start = model.start(theta)

        def moved_part(a: Array) -> tuple[Array, Array]:
            z, P = start.linear(a)
            return z[:, out], P[..., out[:, None], out]

        def z1(a: Array) -> Array:
            """What is left of z_1 given the moved part: Gaussian conditioning, report, Theorem A.1."""
            z, P = start.linear(a[:, :na])
            return z[:, stay] + through(_gain(P, out, stay), a[:, na:] - z[:, out])

        def P1(a: Array) -> Array:
            _, P = start.linear(a[:, :na])
            gain = _gain(P, out, stay)
            rest: Array = P[..., stay[:, None], stay] - gain @ P[..., out[:, None], stay]
            return rest

        density = product(start.density, moved_part, na)
        return density, z1, P1 if callable(start.P1) else P1(np.zeros((1, na + len(out))))

    return replace(
        model,
        nonlinear={**model.nonlinear, **{name: model.linear[name] for name in moved}},
        linear={linear[i]: model.linear[linear[i]] for i in stay},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def _gain(P: Array, out: Array, stay: Array) -> Array:
    """P[stay, out] P[out, out]^+, in units in which the moved part has variance one or none."""
    S = P[..., out[:, None], out]
    d = np.sqrt(np.diagonal(S, axis1=-2, axis2=-1))
    d = np.where(d > 0.0, d, 1.0)
    scaled = np.linalg.pinv(S / (d[..., :, None] * d[..., None, :]), NEGLIGIBLE, hermitian=True)
    gain: Array = P[..., stay[:, None], out] @ (scaled / (d[..., :, None] * d[..., None, :]))
    return gain
