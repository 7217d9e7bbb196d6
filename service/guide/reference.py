"""What the Guide makes of the code: the catalogue of effects with pictures, and the API."""

from __future__ import annotations

import inspect
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

import engine
from engine.arrays import Array
from engine.diagnose import Effect, all_effects
from engine.diagnose.effects.setting import Setting
from engine.errors import EngineError
from engine.models.registry import get_model
from engine.statespace.model import Gaussian, MixedModel, Parameter
from engine.words import tidy

WIDTH, HEIGHT, POINTS = 150, 60, 121
# models whose channels show kinds that a single state cannot
SHIPPED = ("oscillator", "servo", "tanks")
DRIFTS = ("drift", "ramp", "parameter-drift")


def effects() -> str:
    """Every kind of the catalogue as it enters a small model, with a picture of what it adds."""
    shown = "".join(_effect(one, model) for one, model in catalogue())
    return f'<div class="catalogue">{shown}</div>'


def catalogue() -> list[tuple[Effect, MixedModel]]:
    """Each kind once, with the model that it enters."""
    found: dict[str, tuple[Effect, MixedModel]] = {}
    for model in (_single(), *map(get_model, SHIPPED)):
        setting = Setting(model, span=(0.0, 10.0), dt=0.1)
        # those that are looked for beside a drift, too
        drifts = tuple(p.name for e in all_effects(setting, DRIFTS) for p in e.parameters)
        for one in all_effects(replace(setting, found=drifts)):
            found.setdefault(one.kind, (one, model))
    return [found[kind] for kind in sorted(found)]


def _single() -> MixedModel:
    """One state x, driven by u and read as y."""
    none = np.zeros((1, 0))

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [theta.k * a[:, 0] + u[0]], none, [[0.01]]

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0]], none, [[0.01]]

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))

    return MixedModel(
        name="x", dynamics=dynamics, measurement=measurement, initial=initial, nonlinear={"x": "m"},
        inputs={"u": "m"}, outputs={"y": "m"}, parameters=[Parameter("k", 0.9)],
    )  # fmt: skip


def _effect(one: Effect, model: MixedModel) -> str:
    units = ", ".join(
        f"{p.name} [{unit}]" if (unit := tidy(p.unit)) else p.name for p in one.parameters
    )
    alike = "; ".join(f"{kind}: {why}" if why else kind for kind, why in one.look_alikes.items())
    return (
        f'<article id="{escape(one.kind)}"><h3><code>{escape(one.name)}</code></h3>{picture(one, model)}'
        f"<p>{escape(one.title[:1].upper() + one.title[1:])}</p><pre>{escape(one.equation)}</pre>"
        f'<p class="hint">Parameters: {escape(units)}</p>'
        + (f'<p class="hint">Looks like {escape(alike)}</p>' if alike else "")
        + "</article>"
    )


def picture(one: Effect, model: MixedModel) -> str:
    """What an effect of size 1 adds, over the state, the input or time; "" where that is no curve."""
    for axis in ("x", "u", "t"):
        found = _added(one, model, axis)
        if found is not None:
            return _svg(*found, axis)
    return ""


def _added(one: Effect, model: MixedModel, axis: str) -> tuple[Array, Array] | None:
    """The axis and what is added to a state, else to a reading; None where nothing changes along it."""
    try:
        extended = one.apply(model)
        own = [1.0 if p.name == one.size.name else float(p.default) for p in one.parameters]
        theta = np.clip(extended.theta([*model.theta(), *own]), extended.lower, extended.upper)
        x = np.linspace(0.0, 10.0, POINTS) if axis == "t" else np.linspace(-2.0, 2.0, POINTS)
        before = _run(model, model.theta(), axis, x, model)
        change = _run(extended, theta, axis, x, model) - before
    except (EngineError, ValueError, IndexError, FloatingPointError):
        return None
    if change.shape[1] == 0 or not np.isfinite(change).all():
        return None
    column = int(np.argmax(np.ptp(change, axis=0)))
    y = change[:, column]
    return (x, y) if np.ptp(y) > 1e-9 else None


def _run(one: MixedModel, theta: Array, axis: str, values: Array, base: MixedModel) -> Array:
    """The base's next states and readings by a model, with ``values`` of the state, the input or time."""
    rows, record = [], one.record(theta)
    for value in values.tolist():
        a = np.zeros((1, one.na))
        a[0, 0] = value if axis == "x" else 0.5
        u = np.full(base.nu, value if axis == "u" else 0.0)
        t = value if axis == "t" else 0.0
        f = one.transition(a, u, t, 0.1, record)[0][0, : base.nx]
        h = one.observation(a, u, t, record)[0][0]
        rows.append(np.concatenate([f, h]))
    return np.array(rows)


def _svg(x: Array, y: Array, axis: str) -> str:
    across = (x - x[0]) / np.ptp(x) * WIDTH
    up = HEIGHT - 4 - (y - y.min()) / np.ptp(y) * (HEIGHT - 8)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, up, strict=True))
    word = {"x": "the state", "u": "the input", "t": "time"}[axis]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img" '
        f'aria-label="what it adds, over {word}"><polyline points="{points}" fill="none" '
        'stroke="currentColor" stroke-width="2"/></svg>'
        f'<p class="hint">over {word}</p>'
    )


def api() -> str:
    """Everything of ``engine`` that is public, with its docstring."""
    return "".join(
        _entry(name, getattr(engine, name)) for name in sorted(engine.__all__, key=str.lower)
    )


def _entry(name: str, thing: Any) -> str:
    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        signature = ""
    text = inspect.getdoc(thing) or ""
    is_class = inspect.isclass(thing)
    members = [
        f"<h4>.{escape(key)}</h4><p>{escape(about.partition(chr(10))[0])}</p>"
        for key, value in (vars(thing).items() if is_class else ())
        if not key.startswith("_") and (about := inspect.getdoc(value))
        and (callable(value) or isinstance(value, property) or hasattr(value, "func"))
    ]  # fmt: skip
    kind = "class " if is_class else ""
    return (
        f'<section id="{escape(name)}"><h3><code>{kind}engine.{escape(name)}</code></h3>'
        f'<pre class="small">{escape(name + signature)}</pre><pre>{escape(text)}</pre>'
        f"{''.join(members)}</section>"
    )
