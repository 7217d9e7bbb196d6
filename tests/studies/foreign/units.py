"""The same series and the same model in somebody else's units.

    a' = D a + c,  z' = D z + c,  u' = D u + c,  y' = D y + c,  t' = k t,  theta' = d theta

with D diagonal. The model keeps its functions; a wrapper converts what goes in and what comes out:

    f' = D (f - A D_z^-1 c_z) + c,  A' = D A D_z^-1,  Q' = D Q D      and likewise h, C, R, p(a_1), z_1, P_1
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign.plant import Array
from tests.studies.foreign.written import Units

# {(unit, scale, zero): what it is called}
TEMPERATURES = {
    ("K", 1.8, -459.67): "degF",
    ("K", 1.0, -273.15): "degC",
    ("degC", 1.8, 32.0): "degF",
    ("degC", 1.0, 273.15): "K",
}
PARAMETERS = (1.0, 1e3, 1e-2)  # the parameters' scales, in turn


def converted(model: MixedModel, units: Units) -> MixedModel:
    """The model in other units; its channels and parameters keep their names."""
    da, ca = factors(model.nonlinear, units)
    dz, cz = factors(model.linear, units)
    du, cu = factors(model.inputs, units)
    dy, cy = factors(model.outputs, units)
    dx, cx = np.concatenate([da, dz]), np.concatenate([ca, cz])
    scales = parameter_scales(model)
    k = units.time

    def theirs(a: Any, u: Any, theta: Any) -> tuple[Any, Any, Any]:
        rows = [(u[i] - cu[i]) / du[i] for i in range(len(du))]
        u = np.stack(np.broadcast_arrays(*rows)) if rows else np.zeros(0)
        record = model.record([v / scales[i] for i, v in enumerate(theta)])
        return (a - ca) / da, u, record

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        a, u, record = theirs(a, u, theta)
        f, A, Q = model.transition(a, u, t / k, dt / k, record)
        return (f - A @ (cz / dz)) * dx + cx, scaled(A, dx, 1.0 / dz), scaled(Q, dx, dx)

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        a, u, record = theirs(a, u, theta)
        h, C, R = model.observation(a, u, t / k, record)
        return (h - C @ (cz / dz)) * dy + cy, scaled(C, dy, 1.0 / dz), scaled(R, dy, dy)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        record = model.record([v / scales[i] for i, v in enumerate(theta)])
        density, z1, P1 = model.initial(record)
        if not isinstance(density, Gaussian) or callable(z1) or callable(P1):
            raise TypeError(f"model '{model.name}': only a Gaussian first state is converted")
        there = Gaussian(density.mean * da + ca, scaled(density.cov, da, da))
        return there, np.asarray(z1) * dz + cz, scaled(np.asarray(P1, dtype=float), dz, dz)

    parts: dict[str, Any] = {}
    reference = getattr(model, "reference", None)
    if reference:
        parts["reference"] = {
            name: units.scale.get(name, 1.0) * value + units.zero.get(name, 0.0)
            for name, value in reference.items()
        }
    return replace(
        model,
        name=f"{model.name}-converted",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear=renamed(model.nonlinear, units),
        linear=renamed(model.linear, units),
        inputs=renamed(model.inputs, units),
        outputs=renamed(model.outputs, units),
        parameters=[in_scale(p, d) for p, d in zip(model.parameters, scales, strict=True)],
        **parts,
    )


def converted_series(series: Series, model: MixedModel, units: Units) -> Series:
    """The series of a model in other units."""
    du, cu = factors(model.inputs, units)
    dy, cy = factors(model.outputs, units)
    return Series(
        series.y * dy + cy,
        series.u * du + cu,
        t=series.t * units.time,
        y_names=series.y_names,
        u_names=series.u_names,
    )


def factors(names: Mapping[str, str], units: Units) -> tuple[Array, Array]:
    """Scales and zeros of channels."""
    return (
        np.array([units.scale.get(name, 1.0) for name in names], dtype=float),
        np.array([units.zero.get(name, 0.0) for name in names], dtype=float),
    )


def parameter_scales(model: MixedModel) -> list[float]:
    """Of each parameter of the model."""
    return [PARAMETERS[i % len(PARAMETERS)] for i in range(len(model.parameters))]


def in_scale(parameter: Parameter, scale: float) -> Parameter:
    """A parameter of another unit."""
    low, high = parameter.bounds
    return replace(parameter, default=parameter.default * scale, bounds=(low * scale, high * scale))


def renamed(names: Mapping[str, str], units: Units) -> dict[str, str]:
    """Channels with units of another name where they are others, one that is not known but of temperatures."""

    def there(name: str, unit: str) -> str:
        scale, zero = units.scale.get(name, 1.0), units.zero.get(name, 0.0)
        return TEMPERATURES.get((unit, scale, zero), f"{unit}*")

    changed = {**units.scale, **units.zero}
    return {name: there(name, unit) if name in changed else unit for name, unit in names.items()}


def scaled(matrix: Array, rows: Array, columns: Array) -> Array:
    """diag(rows) matrix diag(columns), of one matrix or many."""
    return np.asarray(matrix * rows[:, None] * columns)


def size_factor(effect: str, model: MixedModel, units: Units) -> float | None:
    """How many times as large an effect's size is in the other units; None where it is not known."""
    kind, _, channel = effect.partition(":")
    source, _, target = channel.partition("->")
    x, y = (units.scale.get(name, 1.0) for name in (source, target or source))
    k = units.time
    if kind.startswith("parameter-"):
        factor = parameter_scales(model)[model.parameter_names.index(target or source)]
        return factor / x if target else factor
    if kind in ("step", "pulse", "episode", "harmonic") and source in model.outputs:
        return x
    if kind == "path":
        return y / x if target in model.outputs else y / x / k
    known = {
        "bias": x,
        "input-offset": x,
        "input-deadzone": x,
        "drift": x / k,
        "cubic-sensor": x**-2,
        "colored": x**2,
        "quantisation": x**2,
        "force": y / k,
        "step": y / k,
        "pulse": y / k,
        "episode": y / k,
        "harmonic": y / k,
        "coulomb": y / k,
        "stribeck": y / k,
        "ramp": y / k**2,
        "linear": 1.0 / k,
        "coupling": y / x / k,
        "deadzone": y / x / k,
        "saturation": y / x / k,
        "pole": y / x / k,
        "mode": y / x / k,
        "drag": y / x**2 / k,
        "quadratic": y / x**2 / k,
        "cubic": y / x**3 / k,
        "hysteresis": y / x / k**2,
        "boucwen": y / x / k**2,
        "cogging": y / k,
        "direct": y / x,
        "overflow": 1.0 / k,
        "relative-noise": 1.0 if source in model.outputs else 1.0 / k,
        "play": x,
        "start": x,
        "slow-sensor": k,
        "slow-input": k,
        "input-coulomb": y,
        "input-drag": y / x**2,
    }
    plain = (
        "gain",
        "gain-step",
        "input-gain",
        "input-gain-step",
        "lag",
        "delay",
        "rectification",
        "saturation-sensor",
    )
    if kind in plain or kind in (
        "input-saturation",
        "heavy-tails",
        "level",
        "variance",
        "correlation",
        "hold",
    ):
        return 1.0
    return known.get(kind)
