"""What a model declares and what its functions return at some points, to be kept: is another one the same?

The points are kept with the numbers, so nothing but the functions has a say in whether these come again.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import asdict
from typing import Any, TypeAlias

import numpy as np

from engine.json_values import plain
from engine.statespace.compare import differ, sizes_of
from engine.statespace.general import NonlinearModel
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

Model: TypeAlias = MixedModel | NonlinearModel

POINTS = 16
DRAWS = 50  # of the first state, which tell its size
SCATTER = (0.0, 0.1, 1.0, 3.0)  # of it, in turn: a start may be known exactly
THETA = 0.1  # by which parameters vary, of their size
CHANNELS = ("nonlinear", "linear", "states", "inputs", "outputs", "reference")
SETTINGS = ("kinematic", "continuous", "steps_counted", "scale_states")


def fingerprint(model: Model) -> dict[str, Any]:
    """What ``model`` declares and returns, as JSON values for :func:`differences`."""
    points = _points(model)
    return {
        "declared": _declared(model),
        "parameters": [_described(one) for one in model.parameters],
        "points": points,
        "values": _values(model, points),
    }


def differences(model: Model, kept: Mapping[str, Any]) -> list[str]:
    """What of ``model`` is not as in the fingerprint ``kept``, such as ``measurement``; empty if nothing is."""
    if [p.name for p in model.parameters] != [one["name"] for one in kept["parameters"]]:
        return ["parameters"]
    declared, values = _declared(model), _values(model, kept["points"])
    pairs = zip(map(_described, model.parameters), kept["parameters"], strict=True)
    return [
        *(key for key, value in kept["declared"].items() if declared.get(key) != value),
        *(
            f"{key} of {now['name']}"
            for now, before in pairs
            for key in ("default", "unit", "bounds", "scale")
            if now[key] != before[key]
        ),
        *(key for key, value in kept["values"].items() if _differ(values.get(key), value)),
    ]


def parameters_in(kept: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The parameters of the model of a fingerprint."""
    return tuple(Parameter(**{**one, "bounds": tuple(one["bounds"])}) for one in kept["parameters"])


def _described(parameter: Parameter) -> dict[str, Any]:
    numbers = {key: float(getattr(parameter, key)) for key in ("default", "scale")}
    return asdict(parameter) | numbers | {"bounds": [float(end) for end in parameter.bounds]}


def _declared(model: Model) -> dict[str, Any]:
    out: dict[str, Any] = {
        key: [[name, plain(value)] for name, value in getattr(model, key, {}).items()]
        for key in CHANNELS
    }
    return out | {key: plain(getattr(model, key, None)) for key in SETTINGS}


def _points(model: Model) -> list[dict[str, Any]]:
    """Parameters near the defaults, states about the first one, inputs and times of several sizes."""
    rng = np.random.default_rng(0)
    middle = np.array([float(p.default) for p in model.parameters])
    size = np.array([abs(p.default) or p.scale or 1.0 for p in model.parameters], dtype=float)
    points = []
    for i in range(POINTS):
        moved = middle + (i > 0) * THETA * size * rng.standard_normal(len(middle))
        theta = np.clip(moved, model.lower, model.upper)
        x = _states(model, theta, rng)
        far = np.sqrt((x**2).mean(axis=0))
        a = x[0] + SCATTER[i % len(SCATTER)] * np.where(far > 0.0, far, 1.0) * rng.standard_normal(
            x.shape[1]
        )
        points.append(
            {
                "theta": theta.tolist(),
                "a": a.tolist(),
                "u": (rng.standard_normal(model.nu) * 10.0 ** rng.integers(-1, 3)).tolist(),
                "t": 10.0 ** rng.uniform(-1.0, 3.0) if i else 0.0,
                "dt": 10.0 ** rng.uniform(-2.0, 0.0),
            }
        )
    return points


def _states(model: Model, theta: Array, rng: np.random.Generator) -> Array:
    """First states (DRAWS, na), or (DRAWS, nx) of a general model; zeros where they cannot be drawn."""
    n = model.na if isinstance(model, MixedModel) else model.nx

    def draw() -> tuple[Array, ...]:
        record = model.record(theta)
        density = (
            model.start(record).density if isinstance(model, MixedModel) else model.initial(record)
        )
        return (np.asarray(density.sample(rng, DRAWS), dtype=float).reshape(DRAWS, n),)

    found = _called(draw)
    return np.zeros((DRAWS, n)) if found is None else np.array(found).reshape(DRAWS, n)


def _values(model: Model, points: list[dict[str, Any]]) -> dict[str, list[list[float] | None]]:
    """What each function returns at each point, as one list of numbers; None where it fails."""
    model = copy(model)  # which knows nothing of the calls so far, and tells nobody of these
    out: dict[str, list[list[float] | None]] = {}
    for point in points:
        for name, function in _functions(model, point).items():
            out.setdefault(name, []).append(_called(function))
    return out


def _functions(model: Model, point: Mapping[str, Any]) -> dict[str, Callable[[], Any]]:
    a, u, theta = (np.array(point[key], dtype=float) for key in ("a", "u", "theta"))
    t, dt, record, a = float(point["t"]), float(point["dt"]), model.record(theta), a[None]
    out: dict[str, Callable[[], Any]] = {
        "dynamics": lambda: model.transitions(a, u, t, dt, record),
        "measurement": lambda: model.observations(a, u, t, 0.0, record),
    }
    if isinstance(model, MixedModel):

        def first() -> tuple[Any, ...]:
            start = model.start(record)
            return *_told_by(start.density, a), *start.linear(a)

        return out | {"initial": first}
    e = np.linspace(0.3, 0.7, model.ny)[None]
    return out | {
        "initial": lambda: _told_by(model.initial(record), a),
        "process_noise": lambda: _told_by(model.process_noise(record), a),
        "measurement_noise": lambda: _told_by(model.measurement_noise(record), e),
    }


def _told_by(density: Any, x: Array) -> tuple[Any, ...]:
    """Numbers of a density; of a Gaussian its moments, as it may be singular."""
    if isinstance(density, Gaussian):
        return density.mean, density.cov
    return (density.log_density(x),)


def _called(function: Callable[[], Any]) -> list[float] | None:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = [np.asarray(x, dtype=float).ravel() for x in function() if x is not None]
        except Exception:  # noqa: BLE001 - a user's function may raise anything at points that nobody chose
            return None
    return list(np.concatenate(found).tolist())


def _differ(now: list[list[float] | None] | None, before: list[list[float] | None]) -> bool:
    """Whether a function returns other numbers by more than rounding, which machines do differently."""
    if now is None or [x is None for x in now] != [x is None for x in before]:
        return True
    pairs = [(x, y) for x, y in zip(now, before, strict=True) if x is not None and y is not None]
    if not pairs or any(len(x) != len(y) for x, y in pairs):
        return bool(pairs)
    x, y = (np.array(one) for one in zip(*pairs, strict=True))
    with np.errstate(all="ignore"):
        return differ((x,), (y,), sizes_of((y,)), True, (np.zeros(1),))
