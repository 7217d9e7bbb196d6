"""What small effects would do to the free run: one column of derivatives for each effect and shape."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.free_run.fitted import Fitted, first_states
from engine.errors import EngineError
from engine.simulation.sensitivities import sensitivities
from engine.simulation.simulate import propagate
from engine.statespace.model import Array, MixedModel

SMALL = 0.01  # of the residuals: what the effect does over the distance of its differences
NEAR = 10.0  # that distance may be off by so much
TRIALS = 6  # distances tried
CANNOT = (EngineError, ValueError, ArithmeticError, np.linalg.LinAlgError)  # a candidate drops out


@dataclass(frozen=True, eq=False)
class Column:
    """d(simulated) / d(size) at size 0 (n,), weighed as the residuals; other parameters at ``probe``."""

    effect: Effect
    probe: tuple[float, ...]
    g: Array


def columns(fit: Fitted, effects: Iterable[Effect]) -> list[Column]:
    """Of every effect at every probe; an effect whose run cannot be had is left out."""
    out = []
    for effect in effects:
        try:
            out.extend(_of(fit, effect))
        except CANNOT:
            continue
    return out


def _of(fit: Fitted, effect: Effect) -> list[Column]:
    model = effect.apply(fit.model)
    size, out = len(fit.theta), []
    for probe in effect.probes:
        values = np.array([*fit.theta, *(p.default for p in effect.parameters)])
        values[size + 1 : size + 1 + len(probe)] = probe
        theta = model.theta(values)
        x1 = first_states(model, theta, fit)
        runs = [
            _run(model, np.asarray(theta), one, x) for one, x in zip(fit.records, x1, strict=True)
        ]
        if not all(np.isfinite(run).all() for run in runs):
            continue
        g = _slope(fit, model, np.asarray(theta), runs)
        if g is not None:
            out.append(Column(effect, probe, g))
    return out


def _run(model: MixedModel, theta: Array, series: Series, x1: Array) -> Array:
    na = model.na
    _, a, z = propagate(model, model.record(theta), series, x1[None, :na], x1[None, na:])
    return np.concatenate((a[:, 0], z[:, 0]), axis=1)


def _slope(fit: Fitted, model: MixedModel, theta: Array, runs: list[Array]) -> Array | None:
    """The column, by differences over a distance that does about ``SMALL`` of what is wrong."""
    size = len(fit.theta)
    h = model.parameters[size].scale or 1.0
    place = np.array([size]), np.array([], dtype=np.intp)
    for _ in range(TRIALS):
        parts = []
        for one, run in zip(fit.records, runs, strict=True):
            dy, _ = sensitivities(model, theta, one, run, *place, np.array([h]))
            parts.append((dy[:, :, 0] / fit.problem.scale)[one.observed])
        g = np.concatenate(parts)
        level = float(np.sqrt(np.mean(g**2)))
        if not np.isfinite(level):
            h *= 1e-3
            continue
        if level == 0.0:
            h *= 1e3
            continue
        wanted = SMALL * fit.rms / level
        if not wanted > 0.0 or 1.0 / NEAR < wanted / h < NEAR:
            return g
        h = wanted
    return g if np.isfinite(g).all() and level > 0.0 else None
