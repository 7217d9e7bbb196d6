"""General nonlinear, non-Gaussian state-space models; poster, eq. (1).

    x_{t+1} = f(x_t, u_t, theta) + g(x_t, u_t, theta) v_t
    y_t     = h(x_t, u_t, theta) + s(x_t, u_t, theta) e_t

v and e have any densities that can be drawn and evaluated. A model is a few plain NumPy functions,
called with all particles of one time step, or with those of all time steps where it takes them
(u is then (nu, K), t (K,)); :mod:`engine.statespace.model` says what may be written:

    dynamics(x, u, t, dt, theta) -> f, g     f (K, nx) or a list of rows; g (nx, nx), (K, nx, nx) or None = I
    measurement(x, u, t, theta)  -> h, s     h (K, ny) or a list of rows; s (ny, ny), (K, ny, ny) or None = I
    initial(theta), process_noise(theta), measurement_noise(theta) -> densities of x_1, v and e

A density has ``sample(rng, n)`` and ``log_density(values)``: :class:`engine.Gaussian`,
:mod:`engine.statespace.densities`, or your own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError, ModelError
from engine.kernels.gaussian import psd_cholesky_many
from engine.statespace.base import BaseModel
from engine.statespace.checks import TRIED_ROWS
from engine.statespace.declared import check_declared
from engine.statespace.evaluation import ModelFunction
from engine.statespace.model import (
    Array,
    Density,
    Gaussian,
    MixedModel,
    Parameter,
    Theta,
    as_matrix,
    as_rows,
)
from engine.statespace.promotion import as_nonlinear
from engine.statespace.shapes import through

Noise: TypeAlias = Callable[[Any], Density]

DENSITY_DRAWS = 3  # of each density, to look at


@dataclass(frozen=True)
class NonlinearModel(BaseModel):
    """A general state-space model x' = f(x) + g(x) v, y = h(x) + s(x) e with any noise; poster, eq. (1).

    The functions are called with K points at once, x (K, nx), as those of :class:`engine.MixedModel` are. A
    density is any object with ``sample(rng, n)`` and ``log_density(values)``.

    Parameters
    ----------
    name : str
        The name that results and reports show.
    dynamics : callable
        ``dynamics(x, u, t, dt, theta)`` returns f (K, nx) and g: (nx, nx), (K, nx, nx), or None for the unit
        matrix.
    measurement : callable
        ``measurement(x, u, t, theta)`` returns h (K, ny) and s: (ny, ny), (K, ny, ny), or None.
    initial : callable
        ``initial(theta)`` returns the density of the first state x_1.
    process_noise, measurement_noise : callable
        ``process_noise(theta)`` returns the density of v, ``measurement_noise(theta)`` that of e.
    states, outputs : mapping
        {name: unit} of the states x and of the outputs y.
    parameters : sequence of Parameter
        The components of theta.
    inputs : mapping
        {name: unit} of the inputs u.
    description : str
        What is modelled, in a sentence.
    equations : sequence of str
        The equations as lines of text, which pages and reports show.

    Raises
    ------
    ModelError
        Names, bounds or defaults cannot be used.
    """

    name: str
    dynamics: Callable[[Array, Any, Any, Any, Any], tuple[Any, Any]]
    measurement: Callable[[Array, Any, Any, Any], tuple[Any, Any]]
    initial: Noise
    process_noise: Noise
    measurement_noise: Noise
    states: Mapping[str, str]
    outputs: Mapping[str, str]
    parameters: Sequence[Parameter]
    inputs: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    equations: Sequence[str] = ()

    def __post_init__(self) -> None:
        channels = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        check_declared(self.name, channels, ("states",), self.parameters)

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.states)

    # ---- all that the algorithms need; ``theta`` is a record --------------------------------

    def draw_next(
        self, x: Array, u: Any, t: Any, dt: Any, theta: Any, rng: np.random.Generator
    ) -> Array:
        """Draw x_{t+1} (K, nx) given x_t = x (K, nx)."""
        f, g = self.transition(x, u, t, dt, theta)
        v = self.process_noise(theta).sample(rng, len(x))
        return f + (v if g is None else through(g, v))

    def transition(
        self, x: Array, u: Any, t: Any, dt: Any, theta: Any
    ) -> tuple[Array, Array | None]:
        """Evaluate f (K, nx) and g of the step; None stands for the unit matrix."""
        f, g = self.transitions(x, u, t, dt, theta)
        return f, g

    @cached_property
    def transitions(self) -> ModelFunction:
        """``transition``, with what is known of the calls that ``dynamics`` takes."""
        nx = self.nx

        def regular(dynamics: Any) -> Any:
            def call(x: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Array, Array | None]:
                f, g = dynamics(x, u, t, dt, theta)
                f = as_rows(f, len(x), nx, "dynamics: f")
                return f, None if g is None else as_matrix(g, len(x), nx, nx, "dynamics: g")

            return call

        return self.evaluated("dynamics", regular, ((nx,), (nx, nx)))

    def log_transition(self, x_next: Array, f: Array, g: Array | None, theta: Any) -> Array:
        """Evaluate log p(x_{t+1} | x_t) for x_next (..., nx), with f (..., nx) and g of ``transition``."""
        r = x_next - f
        shape = r.shape[:-1]
        v, log_scale = _unscale(r, g, self.name, "g")
        log_p = self.process_noise(theta).log_density(v.reshape(-1, self.nx)).reshape(shape)
        return np.asarray(log_p - log_scale)

    def output(self, x: Array, u: Any, t: Any, theta: Any) -> tuple[Array, Array | None]:
        """Evaluate h (K, ny) and s of the reading; None stands for the unit matrix."""
        h, s = self.observations(x, u, t, 0.0, theta)
        return h, s

    @cached_property
    def observations(self) -> ModelFunction:
        """``output``, likewise; its dt has no meaning."""
        ny = self.ny

        def regular(measurement: Any) -> Any:
            def call(x: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Array, Array | None]:
                h, s = measurement(x, u, t, theta)
                h = as_rows(h, len(x), ny, "measurement: h")
                return h, None if s is None else as_matrix(s, len(x), ny, ny, "measurement: s")

            return call

        return self.evaluated("measurement", regular, ((ny,), (ny, ny)))

    def log_measurement(self, y: Array, x: Array, u: Any, t: Any, theta: Any) -> Array:
        """Evaluate log p(y_t | x_t) (K,) for x (K, nx) and y (ny,) or (K, ny)."""
        h, s = self.output(x, u, t, theta)
        e, log_scale = _unscale(y - h, s, self.name, "s")
        return np.asarray(self.measurement_noise(theta).log_density(e) - log_scale)


def check_general(model: NonlinearModel, theta: Theta, series: Series) -> None:
    """As :func:`engine.statespace.checks.check_start`, for a general model and its densities."""
    if series in model.checked:
        return
    record = model.record(theta)
    for name, n in (
        ("initial", model.nx),
        ("process_noise", model.nx),
        ("measurement_noise", model.ny),
    ):
        try:
            density = getattr(model, name)(record)
            values = np.asarray(
                density.sample(np.random.default_rng(0), DENSITY_DRAWS), dtype=float
            )
            log_p = np.asarray(density.log_density(values), dtype=float)
            alone = [float(np.squeeze(density.log_density(v[None]))) for v in values]
        except EngineError:
            raise
        except Exception as error:
            raise ModelError(
                f"model '{model.name}': {name} raised {type(error).__name__}: {error}"
            ) from error
        shapes = (DENSITY_DRAWS, n), (DENSITY_DRAWS,)
        for what, got, shape in (("draws", values, shapes[0]), ("log density", log_p, shapes[1])):
            if got.shape != shape or not np.isfinite(got).all():
                raise ModelError(
                    f"model '{model.name}', {name}: {what} {got.tolist()} of shape {got.shape}; finite "
                    f"numbers {shape} are needed"
                )
        if not np.allclose(log_p, alone, rtol=1e-9, atol=1e-9):
            raise ModelError(
                f"model '{model.name}', {name}: the log density of a row depends on the other rows; use "
                "axis=1 in sums over its components"
            )
        if name == "initial":
            x = values
    for i in np.unique(np.linspace(0, len(series) - 2, TRIED_ROWS).astype(int)):
        u, t = series.u[i], float(series.t[i])
        f, g = model.transition(x, series.u_step[i], t, float(series.steps[i]), record)
        h, s = model.output(x, u, t, record)
        for name, value in (("f", f), ("g", g), ("h", h), ("s", s)):
            if (
                value is not None
                and not np.isfinite(value).reshape(len(value), -1).any(axis=0).all()
            ):
                raise ModelError(
                    f"model '{model.name}': {name} is not finite at the start values, t = {t:g}"
                )
    model.checked.add(series)


def as_general(model: MixedModel) -> NonlinearModel:
    """A mixed model as a general one: x = (a, z), g = chol Q, s = chol R, Gaussian noise.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).

    Returns
    -------
    NonlinearModel
        The same model. A singular Q has no density to evaluate; general algorithms raise ModelError then.
    """
    full = as_nonlinear(model)
    nx, ny = model.nx, model.ny

    def dynamics(x: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any]:
        f, _, Q = full.transition(x, u, t, dt, theta)
        return f, _factor(Q)

    def measurement(x: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any]:
        h, _, R = full.observation(x, u, t, theta)
        return h, _factor(R)

    return NonlinearModel(
        name=model.name,
        dynamics=dynamics,
        measurement=measurement,
        initial=lambda theta: full.start(theta).density,
        process_noise=lambda theta: Gaussian(np.zeros(nx), np.eye(nx)),
        measurement_noise=lambda theta: Gaussian(np.zeros(ny), np.eye(ny)),
        states=full.nonlinear,
        outputs=model.outputs,
        parameters=model.parameters,
        inputs=model.inputs,
        description=model.description,
        equations=model.equations,
    )


def _factor(S: Array) -> Array:
    L = psd_cholesky_many(S if S.ndim == 3 else S[None])
    return np.asarray(L if S.ndim == 3 else L[0])


def _unscale(r: Array, g: Array | None, name: str, what: str) -> tuple[Array, Any]:
    """g^{-1} r for r (..., n) and log |det g|, g (n, n) or with the leading axes of r's last but one."""
    if g is None:
        return r, 0.0
    if g.shape[-1] == 1:
        scale = g[..., 0]
        if not np.all(scale):
            raise _singular(name, what)
        return r / scale, np.log(np.abs(scale[..., 0]))
    sign, log_det = np.linalg.slogdet(g)
    if not np.all(sign):
        raise _singular(name, what)
    if g.ndim == 2:
        return np.asarray(r @ np.linalg.inv(g).T), log_det
    return np.asarray(np.linalg.solve(g, r[..., None])[..., 0]), log_det


def _singular(name: str, what: str) -> ModelError:
    return ModelError(
        f"model '{name}': {what} is singular, so the density does not exist; give every state "
        "(and output) noise of its own, however small"
    )
