"""Effects that no kind of the catalogue described when they were chosen: a chirp, a telegraph force, play.

Chirp and telegraph are forces on one state with a course over time; play is backlash in the first
sensor, whose reading only moves once the play is taken up; the catalogue has it now (``play``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect, add_to_state
from engine.simulation.simulate import Simulation
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.points import Points
from tests.studies.blind.bases import TEST_SHARE, Base

PUSHED = {"linear-2": "z", "mixed-4": "z2", "servo": "velocity", "structure": "v1"}
FLIPS = 0.02  # per sample, of the telegraph force
SWEEP = (0.005, 0.08)  # cycles per sample, of the chirp over the whole record
PLAY = 3.0  # half-widths of the play in standard deviations of the sensor's noise


def course(kind: str, T: int, rng: np.random.Generator) -> Array:
    """A force of unit size over T samples."""
    k = np.arange(T)
    if kind == "chirp":
        low, high = SWEEP
        return np.asarray(np.sin(2.0 * np.pi * (low * k + 0.5 * (high - low) * k**2 / T)))
    flips = np.cumsum(rng.random(T) < FLIPS)
    return np.where(flips % 2 == 0, 1.0, -1.0)


def force(base: Base, kind: str, rows: int, rng: np.random.Generator) -> Effect:
    """The extension that knows the force's course, which only the benchmark does."""
    target = PUSHED[base.name]
    signal = course(kind, rows + int(TEST_SHARE * rows), rng)

    def extend(model: MixedModel) -> MixedModel:
        def term(v: Any, own: Any) -> Any:
            k = np.clip(np.rint(np.asarray(v.t) / base.dt).astype(int), 0, len(signal) - 1)
            return own[0] * signal[k]

        return add_to_state(model, target, term)

    return Effect(
        "outside",
        kind,
        "time",
        f"{kind} force on {target}",
        f"{target}' = ... + dt * size * {kind}(t)",
        (Parameter(f"outside_{kind}", 0.0),),
        extend,
    )


def with_play(model: MixedModel, theta: Array, drawn: Simulation) -> Series:
    """The series with play in its first sensor, before the measurement noise."""
    series = drawn.series
    record = model.record(theta)
    h, C, R = Points(model, series, drawn.a[:, None]).observation(record)
    reading = h[:, 0, 0] + (C[:, 0, 0] * drawn.z).sum(axis=1)
    half = PLAY * float(np.sqrt(R[0, 0, 0, 0]))
    y = series.y.copy()
    y[:, 0] += play(reading, half) - reading
    return Series(y, series.u, t=series.t, y_names=series.y_names, u_names=series.u_names)


def play(x: Array, half: float) -> Array:
    """The play operator with half-width ``half``, starting at x_1."""
    out = np.empty_like(x)
    at = x[0]
    for t, value in enumerate(x):
        at = min(max(at, value - half), value + half)
        out[t] = at
    return out
