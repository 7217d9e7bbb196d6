"""The truth: differential equations integrated by Runge-Kutta on a grid finer than the samples.

    dx = (rhs(x, u, p) + push) dt + g dW      y_k = see(x(t_k), u(t_k), p) + e_k

Each fine step of h seconds is one classical Runge-Kutta step with u held, and with the white noise held at
its mean over the step, g N(0, 1) / sqrt(h). A :class:`Fault` changes one thing: a force, a parameter, the
driving input, the sensor, its noise, or the finished readings. Plain Python floats; nothing of the engine
is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Numbers: TypeAlias = Sequence[float]
Own: TypeAlias = Mapping[str, float]

LEVELS = ("ordinary", "fine")  # of the sensors' noise: some 5 % and 0.1 % of the signal
SUBSTEPS = 10


@dataclass(frozen=True)
class Plant:
    """The equations of a system and the experiment made with it.

    ``rhs(x, u, p)`` and ``see(x, u, p)`` give lists; ``p`` are the true parameters by name;
    ``intensities`` g per state, in its unit per root second; ``sensors`` the standard deviation of each
    reading by level; ``start(rng)`` the first state; ``inputs(T, dt, rng)`` u (T, nu); ``dt`` in seconds.
    """

    name: str
    dt: float
    states: tuple[str, ...]
    inputs_named: tuple[str, ...]
    outputs: tuple[str, ...]
    p: Mapping[str, float]
    rhs: Callable[[Numbers, Numbers, Mapping[str, float]], list[float]]
    see: Callable[[Numbers, Numbers, Mapping[str, float]], list[float]]
    intensities: tuple[float, ...]
    sensors: Mapping[str, tuple[float, ...]]
    start: Callable[[np.random.Generator], list[float]]
    inputs: Callable[[int, float, np.random.Generator], Array]


Push: TypeAlias = Callable[
    [float, Numbers, Numbers, Numbers, float, Own], tuple[list[float], list[float]]
]


@dataclass(frozen=True)
class Fault:
    """What is wrong in the truth, at a size s; all of its parts are optional.

    ``name`` is the catalogue's (``kind:channel``) or ``outside:kind``. ``push(t, x, m, u, s, own)`` gives
    what is added to dx/dt, and dm/dt of further states that ``begin(x)`` starts; ``changed(t, p, s, own)``
    the parameters; ``drive(u, s, own)`` the input on the fine grid; ``read(y, h, s, own)`` the readings on
    it, before noise; ``noisy(e, std, s, own, rng)`` the noise; ``finish(y, s)`` the finished readings.
    ``own`` are drawn by ``draw(rng, seconds, dt)``: times, frequencies. ``told(s, own)`` are the true values
    of the catalogue's parameters by the endings of their names ("" for the size). ``first`` is a size to
    begin the calibration with, ``most`` the largest that makes sense; ``level`` of the sensors' noise, where
    only one will do.
    """

    name: str
    first: float = 1.0
    most: float = math.inf
    level: str = ""
    begin: Callable[[Numbers], list[float]] = field(default=lambda x: [])
    push: Push | None = None
    changed: Callable[[float, Mapping[str, float], float, Own], Mapping[str, float]] | None = None
    drive: Callable[[Array, float, Own], Array] | None = None
    read: Callable[[Array, float, float, Own], Array] | None = None
    noisy: Callable[[Array, Numbers, float, Own, np.random.Generator], Array] | None = None
    finish: Callable[[Array, float], Array] | None = None
    draw: Callable[[np.random.Generator, float, float], dict[str, float]] = field(
        default=lambda rng, seconds, dt: {}
    )
    told: Callable[[float, Own], dict[str, float]] = field(default=lambda s, own: {"": s, **own})

    @property
    def outside(self) -> bool:
        """Whether no kind of the catalogue describes it."""
        return self.name.startswith("outside:")


@dataclass(frozen=True, eq=False)
class Drawn:
    """Times (T,), recorded inputs (T, nu), readings (T, ny), true states (T, nx), the fault's values."""

    t: Array
    u: Array
    y: Array
    x: Array
    own: dict[str, float]


def simulate(
    plant: Plant,
    rows: int,
    seed: Sequence[int],
    level: str,
    fault: Fault | None = None,
    size: float = 0.0,
    more: int = 0,
    substeps: int = SUBSTEPS,
) -> Drawn:
    """``rows`` + ``more`` samples; times of the fault lie within the first ``rows``.

    The same ``seed`` gives the same inputs and the same noise with a fault as without.
    """
    streams = np.random.SeedSequence(list(seed)).spawn(5)
    of_inputs, of_start, of_process, of_sensor, of_fault = map(np.random.default_rng, streams)
    T, dt = rows + more, plant.dt
    u = np.asarray(plant.inputs(T, dt, of_inputs), dtype=float)
    own = fault.draw(of_fault, rows * dt, dt) if fault else {}
    fine = np.repeat(u, substeps, axis=0)
    if fault and fault.drive:
        fine = fault.drive(fine, size, own)
    x = _integrated(plant, plant.start(of_start), fine, dt / substeps, of_process, fault, size, own)
    parameters = [plant.p] * len(fine)
    if fault and fault.changed:
        times = np.arange(len(fine)) * (dt / substeps)
        parameters = [fault.changed(t, plant.p, size, own) for t in times.tolist()]
    y: Array = np.array(
        [plant.see(a, b, p) for a, b, p in zip(x.tolist(), fine.tolist(), parameters, strict=True)]
    )
    if fault and fault.read:
        y = fault.read(y, dt / substeps, size, own)
    y, x = y[::substeps], x[::substeps]
    std = plant.sensors[level]
    e: Array = np.asarray(std) * of_sensor.standard_normal((T, len(std)))
    if fault and fault.noisy:
        e = fault.noisy(e, std, size, own, of_fault)
    y = np.asarray(y + e)
    if fault and fault.finish:
        y = fault.finish(y, size)
    return Drawn(dt * np.arange(T, dtype=float), u, y, x, own)


def _integrated(
    plant: Plant,
    first: Numbers,
    u: Array,
    h: float,
    rng: np.random.Generator,
    fault: Fault | None,
    size: float,
    own: Own,
) -> Array:
    """States (K, nx) on the fine grid."""
    n = len(plant.states)
    white = np.asarray(plant.intensities) / math.sqrt(h) * rng.standard_normal((len(u), n))
    push = fault.push if fault else None
    changed = fault.changed if fault else None
    x = [*first, *(fault.begin(first) if fault else [])]
    out = []
    for k, (held, noise) in enumerate(zip(u.tolist(), white.tolist(), strict=True)):
        out.append(x[:n])
        t = k * h
        p = changed(t, plant.p, size, own) if changed else plant.p

        def slope(
            s: float,
            x: list[float],
            held: Any = held,
            noise: Any = noise,
            p: Mapping[str, float] = p,
        ) -> list[float]:
            dx = [a + b for a, b in zip(plant.rhs(x[:n], held, p), noise, strict=True)]
            if push is None:
                return dx
            more, dm = push(s, x[:n], x[n:], held, size, own)
            return [*(a + b for a, b in zip(dx, more, strict=True)), *dm]

        x = runge_kutta(slope, t, x, h)
    return np.array(out)


def runge_kutta(
    slope: Callable[[float, list[float]], list[float]], t: float, x: list[float], h: float
) -> list[float]:
    """One classical Runge-Kutta step of h seconds."""
    half = 0.5 * h
    a = slope(t, x)
    b = slope(t + half, [v + half * d for v, d in zip(x, a, strict=True)])
    c = slope(t + half, [v + half * d for v, d in zip(x, b, strict=True)])
    e = slope(t + h, [v + h * d for v, d in zip(x, c, strict=True)])
    sixth = h / 6.0
    return [
        v + sixth * (p + 2.0 * (q + r) + s) for v, p, q, r, s in zip(x, a, b, c, e, strict=True)
    ]
