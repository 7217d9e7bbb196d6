"""Checks of what a model's functions return, with errors that say what to put right.

:func:`check_start` looks at the first use of a model with a series, at the start values it is used with and on
the series' own inputs and times; :func:`check_model` when a model is registered and there are no data yet.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import EngineError, ModelError
from engine.kernels.gaussian import any_impossible, impossible
from engine.statespace.compare import Result, copies, differ, sizes_of
from engine.statespace.model import Array, Gaussian, MixedModel
from engine.statespace.shapes import ROUNDING, is_symmetric
from engine.statespace.trial import UNREPEATED, UnrepeatedError, is_numeric

TRIED_DRAWS = 3  # draws of a_1 tried at once: enough to tell (M, n) from (n,)
TRIED_ROWS = 8  # rows of a series on which functions are tried
STEPS_TRIED = (1.0, 1e-3, 1e-6, 1e-9)  # one after the other, without a series
NO_TIME = 1e-9  # of a step: over it nothing moves
BELOW = 1e-6  # of its size: so far below zero it is asked whether a parameter may be
# what covariances are of, for errors
STEP, READING, FIRST_A, FIRST_Z = (
    "dynamics: Q",
    "measurement: R",
    "initial: cov of p(a_1)",
    "initial: P1",
)


def check_start(model: MixedModel, theta: Array, series: Series) -> None:
    """Raise ModelError unless the model can be used on the series from theta on; looks once for each series.

    Shapes must fit, covariances be symmetric and non-negative, and values finite for some of the
    states that a_1 may have.
    """
    if series in model.checked:
        return
    _check_on(model, theta, series)
    model.checked.add(series)


def with_least_noise(
    model: MixedModel, theta: Array, indices: NDArray[np.intp], all_series: Sequence[Series]
) -> MixedModel:
    """The model with a lower bound of 0 for those of the parameters ``indices`` that have to have it.

    These are variances and the like of which none was declared: below 0, a covariance would be none. A search
    keeps to a bound; where likelihoods merely end it would stand still.
    """

    def possible(which: Sequence[int], value: float) -> bool:
        tried = np.array(theta, dtype=float)
        for k in which:
            p = model.parameters[k]
            size = max(abs(tried[k]), abs(p.default), p.scale) or 1.0
            tried[k] = max(value * size, p.bounds[0])
        return failure(model, tried, all_series) is None

    parameters = list(model.parameters)
    asked = [int(k) for k in indices if parameters[k].bounds[0] < 0.0 <= theta[k]]
    asked = [k for k in asked if parameters[k].default >= 0.0]
    if not asked or possible(asked, -BELOW):
        return model
    for k in asked:
        if possible([k], 0.0) and not possible([k], -BELOW):
            parameters[k] = replace(parameters[k], bounds=(0.0, parameters[k].bounds[1]))
    return model.with_parameters(parameters)


def failure(model: MixedModel, theta: Array, all_series: Sequence[Series]) -> ModelError | None:
    """The calculation that fails at theta on some rows of the series; None where the model can be had.

    Raises ModelError where something else is wrong.
    """
    try:
        for one in all_series:
            _check_on(model, theta, one)
    except ModelError as error:
        if not error.numeric:
            raise
        return error
    return None


def _check_on(model: MixedModel, theta: Array, series: Series) -> None:
    """Check all functions on some rows of a series."""
    rows = np.unique(np.linspace(0, len(series) - 2, TRIED_ROWS).astype(int))
    at = ((series.u_step[i], float(series.t[i]), float(series.steps[i])) for i in rows)
    _check_functions(model, theta, at, "the start values")


class Tried(NamedTuple):
    """Inputs (nu,) and the length of a step at which a model can be used, where there are no data."""

    u: Array
    dt: float


def check_model(model: MixedModel) -> Tried:
    """At which inputs and step a model was tried without data, at its default parameters.

    Inputs are 0, else 1, else 1, 2, 3, ...: an equation may divide by a speed, or by how far two inputs are
    apart. The step is 1 s, else shorter: what grows a thousand times faster has no number for its state then.
    Raises ModelError where shapes, values or covariances cannot be used at any of them.
    """
    inputs = (np.zeros(model.nu), np.ones(model.nu), np.arange(1.0, model.nu + 1.0))
    failed: list[ModelError] = []
    for dt in STEPS_TRIED:
        for u in inputs:
            try:
                with np.errstate(all="ignore"):
                    _check_at(model, u, dt)
            except ModelError as error:
                if not error.numeric and not failed:
                    raise
                failed.append(error)  # also one that says what is not so, of numbers far out
            else:
                return Tried(u, dt)
    raise next((one for one in reversed(failed) if not one.numeric), failed[0])


def _check_at(model: MixedModel, u: Array, dt: float) -> None:
    """Raise ModelError unless the model can be used at the inputs u (nu,) and two times."""
    at = ((u, t, dt) for t in (0.0, 1.0))
    for R in _check_functions(model, model.theta(), at, "the default parameters"):
        if np.any(np.diagonal(R, axis1=-2, axis2=-1) <= 0.0):
            raise ModelError(
                f"model '{model.name}', measurement: R has a zero on its diagonal; every output "
                "needs measurement noise, at least the sensor's resolution"
            )


def check_readings(model: MixedModel, C: Array, R: Array, y: Array) -> None:
    """Raise ModelError where particles alone would have to meet a reading: no noise, no linear state in it.

    C (B, ny, nz), R (B, ny, ny), y (T, ny). No particle meets it, or by its draw all do: neither has a
    likelihood.
    """
    exact = (np.diagonal(R, axis1=-2, axis2=-1) <= 0.0).all(axis=0)
    reached = (C != 0.0).any(axis=(0, 2))
    read = ~np.isnan(y).all(axis=0)
    for channel, alone in zip(model.outputs, exact & ~reached & read, strict=True):
        if alone:
            raise ModelError(
                f"model '{model.name}', measurement: R has a zero on its diagonal, of '{channel}', which no "
                "linear state enters; there a particle filter needs noise, at least the sensor's resolution"
            )


def possible_noise(model: MixedModel, where: str, S: Array, t: float) -> Array:
    """The covariances S (n, n) or (M, n, n) of a step or reading at t, NaN where a state's own is none.

    Raises ModelError where all are none, for then it is theta that is impossible. It is asked at every step.
    """
    each = S if S.ndim == 3 else S[None]
    if not any_impossible(each):
        return S
    bad = impossible(each)
    if bad.all():
        check_covariance(model, f"{where} at t = {t:g}", each[0])
    each = each.copy()
    each[bad] = np.nan
    return each


def check_covariance(model: MixedModel, where: str, S: Array) -> None:
    """Raise ModelError unless every finite S is symmetric and non-negative, in whatever units."""
    S = S if S.ndim == 3 else S[None]
    S = S[np.isfinite(S).all(axis=(1, 2))]
    if not any_impossible(S):
        return
    variance = np.diagonal(S, axis1=1, axis2=2)
    size = np.sqrt(np.abs(variance[:, :, None] * variance[:, None, :]))
    check_symmetric(model, where, S)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(S == 0.0, 0.0, S / size)  # +-inf beside a variance of zero
    low = -1.0 if not np.isfinite(scaled).all() else float(np.linalg.eigvalsh(scaled).min())
    if low < -ROUNDING or (variance < 0.0).any():
        raise ModelError(
            f"model '{model.name}', {where} has the negative eigenvalue "
            f"{float(np.linalg.eigvalsh(S).min()):g}; a covariance must be non-negative"
            + (f":\n{S.squeeze()}" if S.size > 1 else ""),
            numeric=True,
        )


def check_symmetric(model: MixedModel, where: str, S: Array) -> None:
    """Raise ModelError where one of S (..., n, n) is not symmetric, which no theta makes right."""
    if not is_symmetric(S):
        raise ModelError(f"model '{model.name}', {where} is not symmetric:\n{S.squeeze()}")


@np.errstate(all="ignore")  # what is not finite is told
def _check_functions(
    model: MixedModel,
    theta: Array,
    at: Iterable[tuple[Array, float, float]],
    what: str,
) -> list[Array]:
    """Check all three functions, dynamics and measurement at some u, t, dt; returns the R."""
    record = model.record(theta)
    a = _check_first(model, record, what)
    noises = []
    for u, t, dt in at:
        f, A, Q = model.transition(a, u, t, dt, record)
        h, C, R = model.observation(a, u, t, record)
        values = {"dynamics: f": f, "dynamics: A": A, "dynamics: Q": Q}
        values |= {"measurement: h": h, "measurement: C": C, "measurement: R": R}
        for name, value in values.items():
            _check_finite(model, name, value, f"{what}, t = {t:g}")
        check_covariance(model, STEP, Q)
        check_covariance(model, READING, R)
        noises.append(R)
        _check_step(model, record, a, (u, t, dt), (f, A))
    return noises


def ignores_dt(model: MixedModel, theta: Array, series: Series) -> bool:
    """Whether the steps of a model are the same however long they are, and move every state."""
    record = model.record(theta)
    a = _check_first(model, record, "the start values")
    at = series.u_step[0], float(series.t[0]), float(series.steps[0])
    return _ignores_dt(model, record, a, at, model.transition(a, *at, record)[:2])


def _ignores_dt(
    model: MixedModel, record: object, a: Array, at: tuple[Array, float, float], known: Result
) -> bool:
    """The same of a step, ``known`` from f and A."""
    f, A = copies(known)
    (u, t, dt), z = at, np.ones((len(a), model.nz))
    short = model.transition(a, u, t, NO_TIME * dt, record)
    if not (np.array_equal(short[0], f) and np.array_equal(short[1], A)):
        return False
    x = np.hstack([a, z])
    moved = np.abs(f + np.einsum("...ij,...j->...i", A, z) - x)
    return bool(np.isfinite(moved).all() and (moved > ROUNDING * np.abs(x)).any(axis=0).all())


def _check_step(
    model: MixedModel, record: object, a: Array, at: tuple[Array, float, float], known: Result
) -> None:
    """Raise ModelError where a ``continuous`` model returns the same for no time at all, and moves by it.

    A step of no length leaves the state where it is. What does not know how long it is, and moves every state,
    is a rate: taken for the next state it is another model, with parameters far off and nothing said.
    """
    if not model.continuous or model.steps_counted:
        return
    if _ignores_dt(model, record, a, at, known):
        raise ModelError(
            f"model '{model.name}', dynamics: what it returns does not depend on dt, though continuous=True "
            "says that steps may be shorter. It is to return the state after a step, not its rate of change: "
            "a[:, 0] + dt * (...). Where the equations are rates, leave dt out and write "
            "engine.continuous(drift=..., diffusion=...), which makes the steps."
        )


def _check_first(model: MixedModel, record: object, what: str) -> Array:
    """Draws of a_1, (M, na), after checking its density and those of z_1."""
    try:
        start = model.start(record)
        a = np.asarray(start.density.sample(np.random.default_rng(0), TRIED_DRAWS), dtype=float)
        if a.shape != (TRIED_DRAWS, model.na):
            raise ModelError(f"p(a_1) draws shape {a.shape}; ({TRIED_DRAWS}, {model.na}) is needed")
        log_p = np.asarray(start.density.log_density(a))
        if log_p.shape != (TRIED_DRAWS,):
            raise ModelError(f"log p(a_1) has shape {log_p.shape}; ({TRIED_DRAWS},) is needed")
        z, P = start.linear(a)
        _check_repeated(model, record, (a, log_p, z, P))
    except EngineError as error:
        text = str(error)
        raise ModelError(
            text if text.startswith("model '") else f"model '{model.name}', {text}",
            numeric=is_numeric(error),
        ) from error
    except Exception as error:
        raise ModelError(
            f"model '{model.name}': initial raised {type(error).__name__}: {error}",
            numeric=is_numeric(error),
        ) from error
    if isinstance(start.density, Gaussian):
        check_covariance(model, FIRST_A, start.density.cov)
        a = np.concatenate([a, start.density.mean[None]])
    _check_finite(model, "initial: p(a_1)", a, what)
    _check_finite(model, "initial: z1", z, what)
    _check_finite(model, "initial: P1", P, what)
    check_covariance(model, FIRST_Z, P)
    return a


def _check_repeated(model: MixedModel, record: object, known: Result) -> None:
    """Raise UnrepeatedError where ``initial`` gives another first state the second time."""
    start = model.start(record)
    a = np.asarray(start.density.sample(np.random.default_rng(0), TRIED_DRAWS), dtype=float)
    again = (a, np.asarray(start.density.log_density(a)), *start.linear(a))
    if differ(known, again, sizes_of(known), True):
        raise UnrepeatedError(f"initial: {UNREPEATED}")


def _check_finite(model: MixedModel, where: str, value: Array, what: str) -> None:
    """Raise ModelError where no state gives a finite value."""
    finite = np.isfinite(value)
    if not (finite.any(axis=0) if where[-1] in "fh" or value.ndim == 3 else finite).all():
        raise ModelError(
            f"model '{model.name}', {where} is not finite at {what}: {value}", numeric=True
        )
