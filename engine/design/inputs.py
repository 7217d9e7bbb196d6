"""Candidate inputs: steps, ramps with reversals, multisines, random binary, each from a few numbers.

A shape is a family with numbers v within [0, 1], which a search can move; the input is always brought within
its bounds, so whatever v is the result may be played.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.design.bounds import InputBounds, allowed
from engine.kernels.excitation import within_bounds
from engine.statespace.model import Array

SHORTEST_PIECE = 0.05  # of the longest piece of a shape
FASTEST = 0.25  # cycles a sample of a multisine at most
SINES = 5
# families by their number of pieces; the names are those that are printed
FAMILIES: dict[str, tuple[int, ...]] = {
    "steps": (3, 8, 24),
    "ramps": (4, 12),
    "multisine": (SINES,),
    "binary": (1,),
}
LEAK = 0.01  # of an input's power about its mean: what may be left in its stop bands
STILL = 1e-9  # of its range: an input that moves by less stands still
FINER = 4  # times the frequencies that a record has of its own, at which stop bands are looked at
ROUNDS = 30  # of taking stop bands out and bringing the rest back into its range
SEEDS = 1_000_000  # random sequences of the binary family


@dataclass(frozen=True, eq=False)
class Shape:
    """One input's family, its number of pieces, and its numbers v (d,) within [0, 1]."""

    family: str
    pieces: int
    v: Array

    def moved(self, i: int, value: float) -> Shape:
        """The same with v_i at another value."""
        v = self.v.copy()
        v[i] = value
        return replace(self, v=v)


Plan = tuple[Shape, ...]  # one for each input


def drawn(rng: np.random.Generator, family: str) -> Shape:
    """A shape of a family at random."""
    pieces = int(rng.choice(FAMILIES[family]))
    numbers = {"steps": 2 * pieces, "ramps": 2 * pieces, "multisine": 2 + 3 * pieces, "binary": 4}
    v = rng.uniform(size=numbers[family])
    if family in ("steps", "ramps"):  # the ends of the range tell most
        bold = rng.uniform(size=pieces) < 0.3
        v[:pieces] = np.where(bold, np.round(v[:pieces]), v[:pieces])
    elif family == "binary" and rng.uniform() < 0.5:
        v[:2] = 0.0, 1.0
    elif family == "multisine" and rng.uniform() < 0.5:
        v[:2] = 0.5, 1.0
    return Shape(family, pieces, v)


def drawn_plan(rng: np.random.Generator, family: str, n_inputs: int) -> Plan:
    """A plan at random; of several inputs each other one has a family of its own."""
    rest = rng.choice(list(FAMILIES), size=n_inputs - 1)
    plan = [drawn(rng, family), *(drawn(rng, str(other)) for other in rest)]
    order = rng.permutation(n_inputs)
    return tuple(plan[i] for i in order)


def played(plan: Plan, bounds: Sequence[InputBounds], T: int, dt: float) -> Array:
    """The inputs (T, nu) of a plan, within their bounds."""
    out = np.empty((T, len(plan)))
    for i, (shape, limits) in enumerate(zip(plan, bounds, strict=True)):
        wanted = limits.low + (limits.high - limits.low) * _raw(shape, T)
        if limits.stopbands:
            wanted = _quieted(wanted, limits, dt)
        out[:, i] = limited(wanted, limits, dt)
    return out


def leakage(u: Array, bounds: InputBounds, dt: float) -> float:
    """The share of the power of an input (T,) about its mean that lies in its stop bands."""
    if not bounds.stopbands:
        return 0.0
    power = np.abs(np.fft.rfft(u - u.mean(), FINER * len(u))) ** 2
    total = float(power.sum())
    if total <= STILL**2 * power.size * len(u) * (bounds.high - bounds.low) ** 2:
        return 0.0
    return float(power[_stopped(len(u), bounds, dt)].sum()) / total


def _stopped(T: int, bounds: InputBounds, dt: float) -> NDArray[np.bool_]:
    """Which frequencies are in a stop band; of one between two of them both."""
    frequency = np.fft.rfftfreq(FINER * T, dt)
    near = 0.5 * frequency[1]
    bands = [
        (frequency >= low - near) & (frequency <= high + near) for low, high in bounds.stopbands
    ]
    return np.asarray(np.any(bands, axis=0))


def _quieted(wanted: Array, bounds: InputBounds, dt: float) -> Array:
    """The input (T,) with what lies in its stop bands taken out, about its mean and within its range.

    By turns, as each undoes a part of the other (Papoulis 1975).
    """
    stopped, T = _stopped(len(wanted), bounds, dt), len(wanted)
    u = wanted
    for _ in range(ROUNDS):
        middle = u.mean()
        spectrum = np.fft.rfft(u - middle, FINER * T)
        spectrum[stopped] = 0.0
        u = np.clip(middle + np.fft.irfft(spectrum, FINER * T)[:T], bounds.low, bounds.high)
        if leakage(u, bounds, dt) <= 0.5 * LEAK:
            break
    return np.asarray(u)


def limited(wanted: Array, bounds: InputBounds, dt: float) -> Array:
    """The nearest input (T,) within its bounds that a wanted one (T,) leads to, sample by sample."""
    bands = _merged(bounds)
    step = np.inf if bounds.rate is None else bounds.rate * dt
    start = np.nan if bounds.start is None else float(bounds.start)
    return np.asarray(within_bounds(wanted, bounds.low, bounds.high, step, bands, start))


def _merged(bounds: InputBounds) -> Array:
    """The forbidden bands (n, 2) in order, those that overlap as one, wide enough to hold the range's ends."""
    bands: list[list[float]] = []
    for low, high in sorted(bounds.forbidden):
        if bands and low < bands[-1][1]:
            bands[-1][1] = max(bands[-1][1], high)
        else:
            bands.append([low, high])
    out = []
    for low, high in bands:
        low_end = -np.inf if not (bounds.low <= low and allowed(bounds, low)) else low
        high_end = np.inf if not (high <= bounds.high and allowed(bounds, high)) else high
        out.append((low_end, high_end))
    return np.reshape(np.array(out, dtype=float), (-1, 2))


def _raw(shape: Shape, T: int) -> Array:
    """The shape (T,) within [0, 1], before bounds."""
    v, k = shape.v, shape.pieces
    if shape.family in ("steps", "ramps"):
        lengths = SHORTEST_PIECE + v[k:]
        ends = np.cumsum(lengths) / lengths.sum()
        time = np.arange(T) / max(T - 1, 1)
        if shape.family == "steps":
            return v[:k][np.minimum(np.searchsorted(ends, time, side="right"), k - 1)]
        return np.interp(time, np.concatenate([[0.0], ends[:-1] / ends[-2]]), v[:k])
    if shape.family == "multisine":
        slowest = 1.0 / T
        frequency = slowest * (FASTEST / slowest) ** v[2::3]
        phase = 2.0 * np.pi * (frequency * np.arange(T)[:, None] + v[4::3])
        wave = np.sin(phase) @ v[3::3]
        wave /= max(float(np.abs(wave).max()), 1e-12)
        return np.asarray(np.clip(v[0] + 0.5 * v[1] * wave, 0.0, 1.0))
    clock = max(round(float(max(T / 4.0, 1.0) ** v[2])), 1)
    bits = np.random.default_rng(int(v[3] * SEEDS)).integers(0, 2, size=T // clock + 1)
    return np.asarray(v[:2][np.repeat(bits, clock)[:T]])
