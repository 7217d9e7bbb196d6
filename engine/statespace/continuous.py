"""Models written as differential equations, made discrete for the time steps of the data.

With x = (a, z), inputs held over a step and E dw dw' = Qc dt,

    dx = (f(a, u, t, theta) + A(a, u, t, theta) z) dt + dw

is linearised in a where the step begins. With J = df/da there and d = a - a_t,

    d(d, z) = ([J A] (d, z) + f) dt + dw

is linear, and discretised exactly by :func:`engine.discretize` (van Loan). So z stays linear, noise of a
rate reaches what it is the rate of within the step, and a stiff but stable equation cannot run away. A
linear model is exact for any dt. Else the error of a run falls as dt^2 where A does not depend on a, as
dt where it does, and a series may be refined (:meth:`engine.Series.refined`), as a diagnosis does by itself.
Fits, estimations and free runs say where it should be.

Source: T. Ozaki, "A bridge between nonlinear time series models and nonlinear stochastic dynamical
systems: a local linearization approach", Statistica Sinica 2 (1992) 113-135.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from engine.errors import ModelError
from engine.kernels.local_linearization import beside, difference_quotients, step_of
from engine.statespace.model import Array, MixedModel
from engine.statespace.reads import fields_read, loops, reads
from engine.statespace.recorded import Recorded
from engine.statespace.recorded.stand_ins import Within, traceable
from engine.statespace.rows import frozen, is_rows
from engine.statespace.shapes import as_matrix, as_rows, is_symmetric, stacked
from engine.statespace.traced_step import TracedStep

Drift: TypeAlias = Callable[[Array, Any, Any, Any], tuple[Any, Any]]
Matrix: TypeAlias = Callable[[Array, Any, Any, Any], Any]

TIME, THETA = 2, 3  # positions of t and theta among the arguments of all of them, after a and u


def continuous(
    *,
    drift: Drift,
    diffusion: Matrix,
    jacobian: Matrix | None = None,
    **fields: Any,
) -> MixedModel:
    """A model given by differential equations, discretised for the time steps of the data.

    One step a sample is exact for linear equations with inputs that are held. Others, and inputs on a
    straight line (``hold="foh"``), which a step takes at their mean, may need several: ``series.refined(k)``
    makes k, and results say where one is too long.

    Parameters
    ----------
    drift : function (a, u, t, theta) -> f, A
        Rates of change of x = (a, z): f (M, nx) or a list of rows, A (nx, nz) or (M, nx, nz), in each state's
        unit per unit of time. It is written as ``dynamics`` of :class:`engine.MixedModel`; t is the middle
        of the step.
    diffusion : function (a, u, t, theta) -> Qc
        Intensity of the process noise (nx, nx) or (M, nx, nx): covariance per unit of time.
    jacobian : function (a, u, t, theta) -> J, optional
        Derivatives df/da, (nx, na) or (M, nx, na), per unit of time; by default differences of f.
    **fields
        The other fields of :class:`engine.MixedModel`: name, measurement, initial, nonlinear, linear, inputs,
        outputs, parameters, ...

    Returns
    -------
    MixedModel
        The model with its ``dynamics`` and ``continuous=True``: a diagnosis may step it more finely.

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
    dynamics = _Discretized(drift, diffusion, jacobian, na, nz, fields)
    return MixedModel(dynamics=dynamics, continuous=True, **fields)


class _Repeated:
    """A record of several parameter vectors, so many times over; the same record gives the same one again."""

    def __init__(self) -> None:
        self.last: tuple[Any, Any] = (None, None)

    def __call__(self, theta: Any, times: int) -> Any:
        """The record ``theta`` with each of its arrays (M,) as (``times`` M,)."""
        known, record = self.last
        if known is not theta:
            record = theta._make(
                frozen(np.tile(value, times)) if is_rows(value) else value for value in theta
            )
            self.last = theta, record
        return record

    def __reduce__(self) -> tuple[Any, ...]:  # a record cannot be pickled, and is made again
        return _Repeated, ()


class _Intensity:
    """``diffusion`` in its regular shape."""

    def __init__(self, diffusion: Matrix, nx: int) -> None:
        self.diffusion, self.nx = diffusion, nx

    def __call__(self, a: Array, u: Any, t: Any, theta: Any) -> Array:
        """Qc (1 or M, nx, nx) for the record ``theta`` of numbers and arrays (M,)."""
        Qc = self.diffusion(a.copy(), u, t, theta)
        return stacked(as_matrix(Qc, len(a), self.nx, self.nx, "diffusion: Qc"))

    def __reduce__(self) -> tuple[Any, ...]:  # without what it remembers
        return type(self), (self.diffusion, self.nx)


class _OfThetaAlone(_Intensity):
    """The same of one that reads parameters only, found once for every record of them.

    So one that takes one value of each, as ``np.diag([theta.q, theta.s])``, does not keep the drift from taking
    many.
    """

    last: tuple[Any, Array] = (None, np.empty(0))

    def __call__(self, a: Array, u: Any, t: Any, theta: Any) -> Array:
        """Qc (1 or M, nx, nx) for the record ``theta`` of numbers and arrays (M,)."""
        if not hasattr(theta, "_make"):  # a caller's own record, which may change
            return super().__call__(a, u, t, theta)
        known, Qc = self.last
        if known is not theta:
            Qc = self._found(a, u, t, theta)
            self.last = theta, Qc
        return Qc.copy()

    def _found(self, a: Array, u: Any, t: Any, theta: Any) -> Array:
        many = [name for name, value in zip(theta._fields, theta, strict=True) if is_rows(value)]
        if not many:
            return super().__call__(a, u, t, theta)
        names = fields_read(self.diffusion, THETA)
        read = [name for name in many if names is None or name in names]
        if not read:  # a parameter of the drift may be another in every row
            own = theta._replace(**{name: float(getattr(theta, name)[0]) for name in many})
            return super().__call__(a[:1], u, t, own)
        columns = np.array([getattr(theta, name) for name in read])
        _, first, back = np.unique(columns, axis=1, return_index=True, return_inverse=True)
        each = []
        for k in first:
            own = theta._replace(**{name: float(getattr(theta, name)[k]) for name in many})
            each.append(super().__call__(a[k : k + 1], u, t, own)[0])
        return np.array(each)[back.ravel()]


@dataclass(frozen=True)
class _Discretized:
    """``dynamics`` of a model from its ``drift`` and ``diffusion``."""

    drift: Drift
    diffusion: Matrix
    jacobian: Matrix | None
    na: int
    nz: int
    fields: Mapping[str, Any] = field(compare=False, repr=False)
    repeated: _Repeated = field(default_factory=_Repeated, compare=False, repr=False)

    def __call__(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Array, Array, Array]:
        a = np.ascontiguousarray(a)  # as kernels are compiled for
        middle, length = t + 0.5 * dt, np.array(dt, dtype=float, ndmin=1)
        f, A = self._rates(a, u, middle, theta)
        Qc = self._intensity(a, u, middle, theta)
        if not is_symmetric(Qc):  # what follows would take the mean of both halves
            name = self.fields["name"]
            raise ModelError(f"model '{name}', diffusion: Qc is not symmetric:\n{Qc.squeeze()}")
        J = self._jacobian(a, f, A, u, middle, length, theta)
        x, step, Q = step_of(a, f, J, stacked(A), Qc, length)
        return (x, step, Q) if len(Q) > 1 else (x, step[0], Q[0])

    def by_rows(self) -> _Discretized:
        """The same for rows of any times and parameters; see :mod:`engine.statespace.recorded`."""
        nx = self.na + self.nz
        J, Qc = self.jacobian, self.diffusion
        if not self._alone:  # else it is called once for each theta
            Qc = Recorded(Qc, ((nx, nx),), several=False)
        return replace(
            self,
            drift=Recorded(self.drift, ((nx,), (nx, self.nz))),
            diffusion=Qc,
            jacobian=None if J is None else Recorded(J, ((nx, self.na),), several=False),
            repeated=_Repeated(),
        )

    @cached_property
    def traced(self) -> TracedStep:
        """The same for one row of numbers that are being recorded."""
        seen = Within()
        drift, diffusion = traceable(self.drift, seen), traceable(self.diffusion, seen)
        jacobian = None if self.jacobian is None else traceable(self.jacobian, seen)
        return TracedStep(drift, diffusion, jacobian, self.sizes, self.nz)

    def reads_argument(self, position: int) -> bool:
        """Of a, u and t what any of its functions reads; the others it reads itself."""
        return position > TIME or any(reads(f, position) for f in self._written)

    def reads_fields(self, position: int) -> frozenset[str] | None:
        """What any of its functions takes of the record of parameters, None where one may take all."""
        each = [fields_read(f, position - 1) for f in self._written]  # they have no dt
        return None if None in each else frozenset[str]().union(*(x for x in each if x is not None))

    def has_loops(self) -> bool:
        """Whether any of its functions has one."""
        return any(map(loops, self._written))

    @property
    def goes_by_rows(self) -> bool:
        """Whether any of what was recorded looks at one particle after the other."""
        return any(getattr(f, "goes_by_rows", False) for f in self._written)

    @property
    def _written(self) -> list[Any]:
        """What the user wrote."""
        return [f for f in (self.drift, self.diffusion, self.jacobian) if f is not None]

    @cached_property
    def sizes(self) -> Array:
        """A size (na,) of each nonlinear state; see :attr:`engine.MixedModel.start_sizes`."""
        return MixedModel(dynamics=self, **self.fields).start_sizes[: self.na]

    @cached_property
    def _intensity(self) -> Callable[[Array, Any, Any, Any], Array]:
        """``diffusion`` as (1 or M, nx, nx), found once for each theta where it reads nothing else."""
        nx = self.na + self.nz
        return (_OfThetaAlone if self._alone else _Intensity)(self.diffusion, nx)

    @cached_property
    def _alone(self) -> bool:
        """Whether the diffusion reads parameters only."""
        return not any(reads(self.diffusion, position) for position in range(TIME + 1))

    def _rates(self, a: Array, u: Any, t: Any, theta: Any) -> tuple[Array, Array]:
        """f (M, nx) and A; in memory of their own, as the function may write into both and into a."""
        M, nx = a.shape[0], self.na + self.nz
        f, A = self.drift(a.copy(), u, t, theta)
        f = as_rows(f, M, nx, "drift: f")
        A = as_matrix(A, M, nx, self.nz, "drift: A")
        return f.copy(), A.copy()

    def _jacobian(
        self, a: Array, f: Array, A: Array, u: Any, t: Any, dt: Array, theta: Any
    ) -> Array:
        """J = df/da, (1 or M, nx, na): of all states and both sides in one call of the drift."""
        M, nx, na = a.shape[0], self.na + self.nz, self.na
        if self.jacobian is not None:
            given = self.jacobian(a.copy(), u, t, theta)
            return stacked(as_matrix(given, M, nx, na, "jacobian: J"))
        if na == 0:
            return np.empty((1, nx, 0))
        points, times = beside(a, _way(f, A, dt), self.sizes), 2 * na
        u = np.tile(u, times) if np.ndim(u) > 1 else u
        t = np.tile(t, times) if np.ndim(t) > 0 else t
        rates, _ = self._rates(points, u, t, self.repeated(theta, times))
        J: Array = difference_quotients(points, rates)
        return J


def _way(f: Array, A: Array, dt: Array) -> Array:
    """How far a step dt (1 or M,) moves the nonlinear states (M, na): by their rates, and by those of z."""
    na = A.shape[-2] - A.shape[-1]
    by_z = (np.abs(A[..., :na, :]) * np.abs(f[:, None, na:])).sum(axis=-1)
    length = dt[:, None]
    return np.asarray(length * np.abs(f[:, :na]) + 0.5 * length**2 * by_z)
