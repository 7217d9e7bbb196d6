"""What a model is: the mixed linear/nonlinear state-space model of paper, eq. (1).

    a_{t+1} = f_a(a_t, u_t, theta) + A_a(a_t, u_t, theta) z_t + w_a
    z_{t+1} = f_z(a_t, u_t, theta) + A_z(a_t, u_t, theta) z_t + w_z      w ~ N(0, Q(a_t, theta))
    y_t     = h(a_t, u_t, theta)   + C(a_t, u_t, theta) z_t   + e_t      e ~ N(0, R(a_t, theta))

A model is three plain NumPy functions and the names of its channels. Each function is called
with all particles of one time step at once:

    dynamics(a, u, t, dt, theta) -> f, A, Q       from t to t + dt, x = (a, z)
    measurement(a, u, t, theta)  -> h, C, R
    initial(theta)               -> p(a_1), z_{1|0}, P_{1|0}

``a`` is (M, na); ``u`` is (nu,); ``t`` and ``dt`` are in the data's unit of time; ``theta`` is a record, so
``theta.k1`` and ``k1, k2 = theta`` both work. What may be returned (nx = na + nz):

    f, h      (M, nx), (M, ny)          or a list of rows, each a number or (M,)
    A, C      (nx, nz), (ny, nz)        common to all particles, or (M, ., .), or a nested list
    Q, R      (nx, nx), (ny, ny)        likewise; symmetric, non-negative, may be singular
    p(a_1)    Gaussian(mean, cov), or any object with ``sample(rng, n)`` and ``log_density(a)``
    z_{1|0}   (nz,) or a function of a_1 (M, na) -> (M, nz)
    P_{1|0}   (nz, nz) or a function of a_1 -> (M, nz, nz); may be zero

A matrix returned without a particle axis is common to all particles, and the engine is much
faster for it.

What must be written: row i of what is returned depends on row i of ``a`` alone, as its rows are
different particles. So ``a[:, 0]``, not ``a[0]``; ``np.where(condition, x, y)`` for a condition on states,
not ``if``; NumPy's functions on states, with ``axis=1`` in sums and norms over them. A function that
breaks this is refused with a ModelError.

What need not be written: anything about ``u``, ``t``, ``dt`` and ``theta`` may be a plain number's, as in
``if t > 5``, ``math.cos(theta.w)``, ``np.linalg.norm(u)``, ``np.diag([1e-4, theta.q])``. The engine also tries
to call a function with many times, u (nu, M) and t (M,), and with many parameter vectors, arrays (M,)
in ``theta``, and finds out by itself whether that gives the same. Where it does not, what the function does
to one row is recorded and done to all (:mod:`engine.statespace.recorded`). Where that is not possible either,
each time or parameter vector is a call of its own, which is slower and as right. A function may write into
``a``, which is its own copy, and into nothing else it is given; see :mod:`engine.statespace.evaluation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from engine.errors import EngineError, ModelError
from engine.statespace.base import Array as Array
from engine.statespace.base import BaseModel
from engine.statespace.base import Parameter as Parameter
from engine.statespace.base import Theta as Theta
from engine.statespace.base import ThetaLike as ThetaLike
from engine.statespace.declared import check_declared
from engine.statespace.evaluation import ModelFunction
from engine.statespace.random_scale import RandomScale
from engine.statespace.shapes import as_matrix as as_matrix
from engine.statespace.shapes import as_rows as as_rows
from engine.statespace.shapes import stacked as stacked
from engine.statespace.trial import is_numeric


class Density(Protocol):
    """A density of a_1."""

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw (n, na)."""

    def log_density(self, a: Array) -> Array:
        """Evaluate at a (M, na) -> (M,)."""


FIRST = "the density of a_1, such as engine.Gaussian(mean, cov), z_{1|0} and P_{1|0} are needed"

# f, A, Q of N(f + A z, Q) at M points, a step; likewise h, C, R, a reading
LinearGaussian: TypeAlias = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Gaussian:
    """The density N(mean, cov).

    Parameters
    ----------
    mean : array (n,)
        Expected value of each component.
    cov : array (n, n)
        Covariance, symmetric and non-negative; a singular one fixes components exactly.
    """

    mean: Array
    cov: Array

    def __init__(self, mean: ArrayLike, cov: ArrayLike) -> None:
        # copies: a caller may write into its own arrays later, and lays them out as it likes
        m = np.array(mean, dtype=float, ndmin=1, order="C")
        object.__setattr__(self, "mean", m)
        P = np.array(cov, dtype=float, order="C")
        if m.ndim != 1 or P.size != m.size**2:
            raise ModelError(
                f"a Gaussian with mean {m.shape} needs cov ({m.size}, {m.size}); it has {P.shape}"
            )
        object.__setattr__(self, "cov", P.reshape(m.size, m.size))

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw n independent points, (n, na)."""
        from engine.kernels.gaussian import psd_cholesky

        return cast(
            Array, self.mean + rng.standard_normal((n, self.mean.size)) @ psd_cholesky(self.cov).T
        )

    def log_density(self, a: Array) -> Array:
        """Logarithm of the density (M,) at points a (M, na); a fixed component contributes nothing."""
        from engine.kernels.gaussian import log_normal_common, psd_cholesky

        return cast(
            Array,
            log_normal_common(np.ascontiguousarray(a), self.mean[None], psd_cholesky(self.cov)),
        )


Dynamics: TypeAlias = Callable[[Array, Any, Any, Any, Any], tuple[Any, Any, Any]]
Measurement: TypeAlias = Callable[[Array, Any, Any, Any], tuple[Any, Any, Any]]
Initial: TypeAlias = Callable[[Any], tuple[Density | None, Any, Any]]


@dataclass(frozen=True)
class MixedModel(BaseModel):
    """A mixed linear/nonlinear state-space model, paper, eq. (1).

    Each function is called with the M particles of one time step. ``a`` is (M, na) and ``u`` (nu,); ``t`` and
    ``dt`` are in the data's unit of time; ``theta`` has the parameters by name, such as ``theta.k1``. Row i of
    what is returned may depend on row i of ``a`` only, so write ``a[:, 0]`` and ``np.where``. Matrices may have
    a leading axis of M.

    Parameters
    ----------
    name : str
        The name by which :func:`engine.get_model` finds the model, once it is registered.
    dynamics : callable
        ``dynamics(a, u, t, dt, theta)`` returns f (M, nx), A (nx, nz) and Q (nx, nx) of the step from t to
        t + dt, with x = (a, z). Q is symmetric and non-negative, and may be singular.
    measurement : callable
        ``measurement(a, u, t, theta)`` returns h (M, ny), C (ny, nz) and R (ny, ny), the covariance of a
        reading's noise, with no zero on its diagonal.
    initial : callable
        ``initial(theta)`` returns the density of a_1, such as :class:`engine.Gaussian` (None where no state is
        nonlinear), the mean z_{1|0} (nz,) and the covariance P_{1|0} (nz, nz), which may be zero.
    outputs : mapping
        {name of an output y: its unit}.
    parameters : sequence of Parameter
        The components of theta.
    nonlinear, linear, inputs : mapping
        {name: unit} of the states a, of the states z and of the inputs u.
    description : str
        What is modelled, in a sentence.
    equations : sequence of str
        The equations as lines of text, which pages and reports show.
    kinematic : sequence of str
        States whose equation holds by definition, as q' = v does: a diagnosis adds nothing to it.
    reference : mapping
        {channel: the value of its natural zero, in its unit}, such as 20 for a temperature that is counted
        from room temperature. Effects that have a zero of their own (drag, a gain error) count from there. Of
        others it is 0, of temperatures absolute zero, or the middle of the record where the equations do not
        care (a position on a road, all temperatures of a room together).
    continuous : bool
        Whether the model may be stepped more finely than the data: two half-steps agree with one, A and Q
        included, up to the order of the scheme. This is checked when a diagnosis uses it.
    steps_counted : int
        Steps from one sample to the next for which its memory of samples was made, as that of a delay is; only
        series with as many (:meth:`engine.Series.refined`) can be used. 0 where it counts none.
    random_scales : sequence of RandomScale
        States without memory that only scale noise, as :func:`engine.with_mixture` adds them: filters of
        moments go through their values one by one.

    Raises
    ------
    ModelError
        Names, bounds or defaults cannot be used. What the functions return is checked when they are first
        used with data.
    """

    name: str
    dynamics: Dynamics
    measurement: Measurement
    initial: Initial
    outputs: Mapping[str, str]
    parameters: Sequence[Parameter]
    nonlinear: Mapping[str, str] = field(default_factory=dict)
    linear: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    equations: Sequence[str] = ()
    kinematic: Sequence[str] = ()
    reference: Mapping[str, float] = field(default_factory=dict)
    continuous: bool = False
    steps_counted: int = 0
    random_scales: Sequence[RandomScale] = ()

    def __post_init__(self) -> None:
        for name in ("parameters", "equations", "kinematic", "random_scales"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        states = {"nonlinear states": self.nonlinear, "linear states": self.linear}
        every = {**states, "inputs": self.inputs, "outputs": self.outputs}
        check_declared(self.name, every, tuple(states), self.parameters)
        unknown = [name for name in self.kinematic if name not in {**self.nonlinear, **self.linear}]
        if unknown:
            raise ModelError(
                f"model '{self.name}': kinematic state '{unknown[0]}' is not among its states"
            )
        for name, value in self.reference.items():
            channels = [*self.nonlinear, *self.linear, *self.inputs, *self.outputs]
            if name not in channels:
                raise ModelError(
                    f"model '{self.name}': reference of '{name}', which is none of its channels "
                    f"({', '.join(channels)})"
                )
            if not np.isfinite(value):
                raise ModelError(
                    f"model '{self.name}': reference of '{name}' is {value}; a number is needed"
                )

    @cached_property
    def na(self) -> int:
        """Number of nonlinear states."""
        return len(self.nonlinear)

    @cached_property
    def nz(self) -> int:
        """Number of linear states."""
        return len(self.linear)

    @cached_property
    def nx(self) -> int:
        """Number of states, na + nz."""
        return self.na + self.nz

    @cached_property
    def scale_states(self) -> tuple[str, ...]:
        """Names of the states that only scale noise."""
        return tuple(one.state for one in self.random_scales)

    # ---- evaluation with regular shapes; ``theta`` is a record -----------------------------
    #
    # Rows of a (M, na) may have times and parameters of their own: u (nu, M), t (M,), dt (M,), and
    # arrays (M,) in theta. Whatever the user's function takes of these, the result is right; see
    # :mod:`engine.statespace.evaluation`.

    def transition(self, a: Array, u: Any, t: Any, dt: Any, theta: Any) -> LinearGaussian:
        """The step: f (M, nx); A (nx, nz) or (M, nx, nz); Q (nx, nx) or (M, nx, nx). Raises ModelError."""
        f, A, Q = self.transitions(a, u, t, dt, theta)
        return f, A, Q

    def observation(self, a: Array, u: Any, t: Any, theta: Any) -> LinearGaussian:
        """The reading: h (M, ny); C (ny, nz) or (M, ny, nz); R (ny, ny) or (M, ny, ny). Raises ModelError."""
        h, C, R = self.observations(a, u, t, 0.0, theta)
        return h, C, R

    @cached_property
    def transitions(self) -> ModelFunction:
        """``transition``, with what is known of the calls that ``dynamics`` takes."""
        nx, nz = self.nx, self.nz

        def regular(dynamics: Any) -> Any:
            def call(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> LinearGaussian:
                f, A, Q = dynamics(a, u, t, dt, theta)
                return (
                    as_rows(f, len(a), nx, "dynamics: f"),
                    as_matrix(A, len(a), nx, nz, "dynamics: A"),
                    as_matrix(Q, len(a), nx, nx, "dynamics: Q"),
                )

            return call

        return self.evaluated("dynamics", regular, ((nx,), (nx, nz), (nx, nx)))

    @cached_property
    def observations(self) -> ModelFunction:
        """``observation``, likewise; its dt has no meaning."""
        ny, nz = self.ny, self.nz

        def regular(measurement: Any) -> Any:
            def call(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> LinearGaussian:
                h, C, R = measurement(a, u, t, theta)
                return (
                    as_rows(h, len(a), ny, "measurement: h"),
                    as_matrix(C, len(a), ny, nz, "measurement: C"),
                    as_matrix(R, len(a), ny, ny, "measurement: R"),
                )

            return call

        return self.evaluated("measurement", regular, ((ny,), (ny, nz), (ny, ny)))

    def with_parameters(self, parameters: Sequence[Parameter]) -> MixedModel:
        """The same functions with parameters described otherwise; what is known of their calls is kept."""
        model = replace(self, parameters=tuple(parameters))
        for known in ("transitions", "observations", "checked"):
            vars(model)[known] = getattr(self, known)
        return model

    def start(self, theta: Any) -> Start:
        """The initial density p(a_1) N(z_1; z_{1|0}(a_1), P_{1|0}(a_1)), report, eq. (1f).

        Raises ModelError naming the model where the user's function fails.
        """
        try:
            given = self.initial(theta)
        except EngineError:
            raise
        except Exception as error:
            raise ModelError(
                f"model '{self.name}': initial raised {type(error).__name__}: {error}",
                placed=True,
                numeric=is_numeric(error),
            ) from error
        if not isinstance(given, tuple | list) or len(given) != 3:
            raise ModelError(f"initial returned {_told(given)}; {FIRST}")
        density, z1, P1 = given
        if density is None and not self.na:
            density = Gaussian([], np.zeros((0, 0)))
        if not hasattr(density, "sample"):
            raise ModelError(f"initial returned {_told(density)} as the density of a_1; {FIRST}")
        return Start(cast("Density", density), z1, P1, self.nz)

    @cached_property
    def start_sizes(self) -> Array:
        """A size of each state (nx,), in its unit: how uncertain its start is, or where it is; 0 for neither.

        At the default parameters: differences over a share of it depend on no parameter, of noise or else.
        """
        try:
            start = self.start(self.record(self.theta()))
            mean, cov = (np.array(getattr(start.density, one)) for one in ("mean", "cov"))
            z, P = start.linear(mean[None])
        except (AttributeError, TypeError, ValueError, EngineError):  # no moments are told
            return np.zeros(self.nx)
        variances = np.concatenate((np.diagonal(cov), np.diagonal(P if P.ndim == 2 else P[0])))
        spread, value = np.sqrt(np.maximum(variances, 0.0)), np.abs(np.concatenate((mean, z[0])))
        size = np.where(spread > 0.0, spread, value)
        return np.where(np.isfinite(size), size, 0.0)


def _told(value: object) -> str:
    of = f" of {len(value)}" if isinstance(value, tuple | list) else ""
    return f"{type(value).__name__}{of}"


@dataclass(frozen=True)
class Start:
    """The initial density with z_{1|0} and P_{1|0} as functions of a_1."""

    density: Density
    z1: Any
    P1: Any
    nz: int

    def linear(self, a: Array) -> tuple[Array, Array]:
        """z_{1|0} (M, nz); P_{1|0} (nz, nz) or (M, nz, nz) at a_1 = a (M, na)."""
        M, nz = a.shape[0], self.nz
        try:
            z = self.z1(a) if callable(self.z1) else self.z1
            P = self.P1(a) if callable(self.P1) else self.P1
        except EngineError:
            raise
        except Exception as error:
            raise ModelError(
                f"initial: z1 or P1 as a function of a_1 {a.shape} raised {type(error).__name__}: {error}"
            ) from error
        return as_rows(z, M, nz, "initial: z1"), as_matrix(P, M, nz, nz, "initial: P1")
