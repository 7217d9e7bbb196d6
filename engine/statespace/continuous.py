"""Models written as differential equations, made discrete for whatever time step the data have.

With x = (a, z), inputs held over a step and E dw dw' = Qc dt,

    dx = (f(a, u, t, theta) + A(a, u, t, theta) z) dt + dw

is linearised in a where the step begins. With J = df/da there and d = a - a_t,

    d(d, z) = ([J A] (d, z) + f) dt + dw

is linear, and discretised exactly by :func:`engine.discretize` (van Loan). So z stays linear, noise of a
rate reaches what it is the rate of within the step, and a stiff but stable equation cannot run away. A
linear model is exact for any dt. Else the error of a run falls as dt^2 where A does not depend on a, as
dt where it does, and a series may be refined (:meth:`engine.Series.refined`), as a diagnosis does by itself.

Source: T. Ozaki, "A bridge between nonlinear time series models and nonlinear stochastic dynamical
systems: a local linearization approach", Statistica Sinica 2 (1992) 113-135.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from engine.statespace.discretization import discretize
from engine.statespace.model import Array, MixedModel
from engine.statespace.shapes import as_matrix, as_rows

Drift: TypeAlias = Callable[[Array, Any, Any, Any], tuple[Any, Any]]
Matrix: TypeAlias = Callable[[Array, Any, Any, Any], Any]

SHORT = 1e-3  # of what a step moves a state: half the distance over which J is a difference
LEAST = 1e-7  # of the state's value, below which differences are rounding


def continuous(
    *,
    drift: Drift,
    diffusion: Matrix,
    jacobian: Matrix | None = None,
    **fields: Any,
) -> MixedModel:
    """A model given by differential equations; it knows that its dt is a real one.

    Parameters
    ----------
    drift : function (a, u, t, theta) -> f, A
        Rates: f (M, nx) or a list of rows, A (nx, nz) or (M, nx, nz), each state's unit per second. What may
        be written is as for ``dynamics`` in :mod:`engine.statespace.model`; t is the middle of the step.
    diffusion : function (a, u, t, theta) -> Qc
        Intensity of the noise (nx, nx) or (M, nx, nx): covariance per second.
    jacobian : function (a, u, t, theta) -> J, optional
        df/da, (nx, na) or (M, nx, na) per second; by default differences of f.
    **fields
        The other fields of :class:`engine.MixedModel`: name, measurement, initial, nonlinear, linear, inputs,
        outputs, parameters, ...

    Returns
    -------
    MixedModel
        With ``continuous=True``.

    Raises
    ------
    ModelError
        As :class:`engine.MixedModel` does; for functions of wrong shape when they are first used.

    Examples
    --------
    A pendulum with a torque, its rate linear:

    >>> import numpy as np, engine
    >>> pendulum = engine.continuous(
    ...     name="pendulum", nonlinear={"angle": "rad"}, linear={"rate": "rad/s"},
    ...     inputs={"torque": "1/s^2"}, outputs={"y": "rad"},
    ...     parameters=[engine.Parameter("w2", 40.0, "1/s^2", (0.0, 1e3), "gravity over length")],
    ...     drift=lambda a, u, t, theta: ([0.0, u[0] - theta.w2 * np.sin(a[:, 0])], [[1.0], [-0.2]]),
    ...     diffusion=lambda a, u, t, theta: np.diag([0.0, 1e-4]),
    ...     measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[1e-4]]),
    ...     initial=lambda theta: (engine.Gaussian([0.5], [[0.01]]), [0.0], [[0.1]]),
    ... )
    >>> pendulum.continuous
    True

    """
    channels = {key: fields.get(key) or {} for key in ("nonlinear", "linear")}
    na, nz = (len(channels[key]) for key in ("nonlinear", "linear"))
    dynamics = _Discretized(drift, diffusion, jacobian, na, nz)
    return MixedModel(dynamics=dynamics, continuous=True, **fields)


@dataclass(frozen=True)
class _Discretized:
    """``dynamics`` of a model from its ``drift`` and ``diffusion``."""

    drift: Drift
    diffusion: Matrix
    jacobian: Matrix | None
    na: int
    nz: int

    def __call__(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Array, Array, Array]:
        (M, na), nx, middle = a.shape, self.na + self.nz, t + 0.5 * dt
        f, A = self._rates(a, u, middle, theta)
        Qc = as_matrix(self.diffusion(a, u, middle, theta), M, nx, nx, "diffusion: Qc")
        J = self._jacobian(a, u, middle, theta, self._reach(a, f, Qc, dt))
        F, Qc = _common(np.concatenate(_beside(J, A), axis=-1)), _common(Qc)
        lost = np.asarray(~(np.isfinite(F).all(axis=(-2, -1)) & np.isfinite(Qc).all(axis=(-2, -1))))
        if lost.any():  # of a run that has run away: it stays lost, and no other with it
            F, Qc = (np.where(lost[..., None, None], 0.0, matrix) for matrix in (F, Qc))
        step, drive, Q = discretize(F, np.eye(nx), Qc, dt=dt)
        moved = drive @ f[:, :, None]
        moved[:, :na, 0] += a
        moved[np.broadcast_to(lost, M)] = np.nan
        return moved[:, :, 0], step[..., na:], Q

    def _rates(self, a: Array, u: Any, t: Any, theta: Any) -> tuple[Array, Array]:
        M, nx = a.shape[0], self.na + self.nz
        f, A = self.drift(a, u, t, theta)
        return as_rows(f, M, nx, "drift: f"), as_matrix(A, M, nx, self.nz, "drift: A")

    def _reach(self, a: Array, f: Array, Qc: Array, dt: Any) -> Array:
        """Half the distance (M, na) of a difference: a share of what the step moves, in any unit."""
        length = np.reshape(dt, (-1, 1))
        noise = np.sqrt(np.maximum(np.diagonal(Qc, axis1=-2, axis2=-1), 0.0) * length)
        h = SHORT * (np.abs(f) * length + noise)[:, : self.na] + LEAST * np.abs(a)
        return np.where(h > 0.0, h, LEAST)

    def _jacobian(self, a: Array, u: Any, t: Any, theta: Any, h: Array) -> Array:
        """J = df/da, (nx, na) or (M, nx, na)."""
        M, nx, na = a.shape[0], self.na + self.nz, self.na
        if self.jacobian is not None:
            return as_matrix(self.jacobian(a, u, t, theta), M, nx, na, "jacobian: J")
        J = np.empty((M, nx, na))
        for i in range(na):
            ends = []
            for side in (h[:, i], -h[:, i]):
                beside = a.copy()
                beside[:, i] += side
                ends.append((beside[:, i], self._rates(beside, u, t, theta)[0]))
            (high, above), (low, below) = ends
            J[:, :, i] = (above - below) / (high - low)[:, None]
        return J


def _beside(*matrices: Array) -> list[Array]:
    """Matrices with leading axes of equal length, apart from their columns."""
    M = max(len(matrix) if matrix.ndim == 3 else 1 for matrix in matrices)
    return [np.broadcast_to(matrix, (M, *matrix.shape[-2:])) for matrix in matrices]


def _common(matrix: Array) -> Array:
    """One matrix where those of all rows are equal: what is common to all particles is fast."""
    alike = matrix.ndim == 3 and (len(matrix) == 1 or bool((matrix == matrix[0]).all()))
    return np.asarray(matrix[0]) if alike else matrix
