"""Checks a model once, when it is registered, with errors that say what to put right."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from engine.errors import EngineError, ModelError
from engine.model import Array, MixedModel

_Result = TypeVar("_Result")

ROWS = 3  # particles tried at once: enough to tell (M, n) from (n,)


def check_model(model: MixedModel) -> None:
    """Raise ModelError unless the model's names, shapes, values and covariances are usable."""
    _check_names(model)
    theta = model.record(model.theta())
    a = _call(model, "initial", partial(_check_start, model, theta))
    u = np.zeros(model.nu)
    for t in (0.0, 1.0):
        f, A, Q = _call(model, "dynamics", partial(model.transition, a, u, t, 1.0, theta))
        h, C, R = _call(model, "measurement", partial(model.observation, a, u, t, theta))
        for name, value in (("dynamics: f", f), ("dynamics: A", A), ("dynamics: Q", Q)):
            _check_finite(model, name, value)
        for name, value in (("measurement: h", h), ("measurement: C", C), ("measurement: R", R)):
            _check_finite(model, name, value)
        check_covariance(model, "dynamics: Q", Q)
        check_covariance(model, "measurement: R", R)
        if np.any(np.diagonal(R, axis1=-2, axis2=-1) <= 0.0):
            raise ModelError(
                f"model '{model.name}', measurement: R has a zero on its diagonal; every output "
                "needs measurement noise, at least the sensor's resolution"
            )


def check_covariance(model: MixedModel, where: str, S: Array) -> None:
    """Raise ModelError unless every S is symmetric and non-negative."""
    if S.size == 0:
        return
    scale = max(float(np.abs(S).max()), 1e-300)
    if np.abs(S - np.swapaxes(S, -1, -2)).max() > 1e-9 * scale:
        raise ModelError(f"model '{model.name}', {where} is not symmetric:\n{S}")
    lowest = float(np.linalg.eigvalsh(S).min())
    if lowest < -1e-9 * scale:
        raise ModelError(
            f"model '{model.name}', {where} has the negative eigenvalue {lowest:g}; "
            "a covariance must be non-negative"
        )


def _check_names(model: MixedModel) -> None:
    groups = {
        "nonlinear states": model.nonlinear,
        "linear states": model.linear,
        "inputs": model.inputs,
        "outputs": model.outputs,
    }
    if not model.name or not isinstance(model.name, str):
        raise ModelError("a model needs a name")
    if not model.outputs:
        raise ModelError(f"model '{model.name}' has no outputs; name at least one")
    if not model.nx:
        raise ModelError(f"model '{model.name}' has no states; name nonlinear or linear ones")
    for what, group in groups.items():
        if not hasattr(group, "items"):
            raise ModelError(
                f"model '{model.name}': {what} must map names to units, like {{'v': 'm/s'}}"
            )
    channels = [name for names in groups.values() for name in names]
    doubled = sorted({name for name in channels if channels.count(name) > 1})
    if doubled:
        raise ModelError(f"model '{model.name}' uses the channel name '{doubled[0]}' twice")
    parameters = [p.name for p in model.parameters]
    for p in model.parameters:
        if not p.name.isidentifier() or p.name.startswith("_"):
            raise ModelError(
                f"model '{model.name}': the parameter name '{p.name}' is not a Python identifier"
            )
        if parameters.count(p.name) > 1:
            raise ModelError(f"model '{model.name}' has two parameters named '{p.name}'")
        if not p.bounds[0] < p.bounds[1]:
            raise ModelError(
                f"model '{model.name}', parameter '{p.name}': bounds {p.bounds} are not (low, high)"
            )
        if not p.bounds[0] <= p.default <= p.bounds[1]:
            raise ModelError(
                f"model '{model.name}', parameter '{p.name}': default {p.default:g} is outside "
                f"its bounds {p.bounds}"
            )


def _check_start(model: MixedModel, theta: object) -> Array:
    start = model.start(theta)
    a = np.asarray(start.density.sample(np.random.default_rng(0), ROWS), dtype=float)
    if a.shape != (ROWS, model.na):
        raise ModelError(f"p(a_1) draws shape {a.shape}; ({ROWS}, {model.na}) is needed")
    log_p = np.asarray(start.density.log_density(a))
    if log_p.shape != (ROWS,):
        raise ModelError(f"log p(a_1) has shape {log_p.shape}; ({ROWS},) is needed")
    z, P = start.linear(a)
    _check_finite(model, "initial: z1", z)
    _check_finite(model, "initial: P1", P)
    check_covariance(model, "initial: P1", P)
    return a


def _call(model: MixedModel, name: str, call: Callable[[], _Result]) -> _Result:
    """Call a model's function, putting the model's and the function's name before any error."""
    try:
        return call()
    except EngineError as error:
        text = str(error)
        raise ModelError(
            text if text.startswith("model '") else f"model '{model.name}', {text}"
        ) from error
    except Exception as error:
        raise ModelError(
            f"model '{model.name}': {name} raised {type(error).__name__}: {error}"
        ) from error


def _check_finite(model: MixedModel, where: str, value: Array) -> None:
    if not np.isfinite(value).all():
        raise ModelError(
            f"model '{model.name}', {where} is not finite at the default parameters: {value}"
        )
