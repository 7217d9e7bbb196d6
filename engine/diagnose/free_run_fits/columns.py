"""What small effects would do to the free run: one column of derivatives for each effect and shape."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.free_run_fits.fitted import Fitted, extended_run, first_states, state_names
from engine.errors import EngineError
from engine.forked import each
from engine.simulation.sensitivities import Along
from engine.simulation.simulate import states_of
from engine.statespace.model import Array, MixedModel, Theta

SMALL = 0.01  # of the residuals: what the effect does over the distance of its differences
LONGEST, SHORTEST = 0.1, 1e4  # that distance may be ten times as long, or be much shorter
TRIALS, LEAP = 20, 1e-6  # distances tried, and how much shorter one may be than that before it
LOST = 3  # of them, each 1e9 times as long, at which an effect may do nothing at all: then it does nothing
# a candidate drops out; what a model raises is the first
CANNOT = (EngineError, np.linalg.LinAlgError)


@dataclass(frozen=True, eq=False)
class Column:
    """d(simulated) / d(size) at size 0 (n,), weighed as the residuals; other parameters at ``probe``."""

    effect: Effect
    probe: tuple[float, ...]
    g: Array


@np.errstate(over="ignore", invalid="ignore")  # distances are tried that are far too long
def columns(fit: Fitted, effects: Iterable[Effect]) -> list[Column]:
    """Of every effect at every probe; an effect whose run cannot be had is left out."""
    theta, base = np.asarray(fit.theta), []
    for one, x1, guess in zip(fit.records, fit.x1, fit.problem.runs, strict=True):
        run = run_of(fit.model, theta, one, x1, guess)
        if not np.isfinite(run).all():
            return []
        base.append(Along(fit.model, theta, one, run))

    def found(effect: Effect) -> list[tuple[tuple[float, ...], Array]]:
        try:
            return _of(fit, base, effect)
        except CANNOT:
            return []

    every, out = list(effects), list[Column]()
    with closing(each([partial(found, effect) for effect in every])) as slopes:
        for effect, own in zip(every, slopes, strict=True):
            out += [Column(effect, *one) for one in own]
    return out


def _of(fit: Fitted, base: list[Along], effect: Effect) -> list[tuple[tuple[float, ...], Array]]:
    """The derivatives at each probe of the effect."""
    model = effect.apply(fit.model)
    size, out = len(fit.theta), list[tuple[tuple[float, ...], Array]]()
    along: list[Along] | None = None
    for probe in effect.probes:
        values = np.array([*fit.theta, *(p.default for p in effect.parameters)])
        values[size + 1 : size + 1 + len(probe)] = probe
        theta = model.theta(values)
        along = _along(fit, base, model, theta, along)
        found = None if along is None else slope(fit, model, along, size)
        if found is not None:
            out.append((probe, found[0]))
    return out


def _along(
    fit: Fitted,
    base: list[Along],
    model: MixedModel,
    theta: Theta,
    near: list[Along] | None = None,
) -> list[Along] | None:
    """The runs with the effect of size 0: those of the base where it has no states of its own.

    Else those of the base with such states, which do not act yet: all but these are known. ``near`` are the
    runs at another probe.
    """
    names, known = state_names(model), state_names(fit.model)
    vector, out = np.asarray(theta), []
    if set(names) == set(known):
        at = [known.index(name) for name in names]
        for one, own in zip(fit.records, base, strict=True):
            slopes = own.J[:, at][:, :, at], own.H[:, :, at]
            out.append(Along(model, vector, one, own.x[:, at], slopes))
        return out
    firsts = first_states(model, theta, fit)
    guesses: list[Array | None] = [along.x for along in near or base]
    if near is None:
        both = zip(guesses, firsts, strict=True)
        guesses = [extended_run(model, fit.model, *pair) for pair in both]
    for one, x1, guess in zip(fit.records, firsts, guesses, strict=True):
        run = run_of(model, vector, one, x1, guess)
        if not np.isfinite(run).all():
            return None
        out.append(Along(model, vector, one, run))
    return out


def run_of(
    model: MixedModel, theta: Array, series: Series, x1: Array, guess: Array | None = None
) -> Array:
    """The free run (T, nx) from a first state (nx,); ``guess`` is one nearby."""
    return states_of(model, model.record(theta), series, x1, guess)


def slope(
    fit: Fitted, model: MixedModel, along: Sequence[Along], index: int
) -> tuple[Array, float] | None:
    """The column of a parameter, and half the distance of its differences, in its unit; None for no influence.

    Over that distance it does a small part of what is wrong. Where that is looked for an effect may grow with
    its size far faster than in proportion to it, or be lost in rounding, whatever its unit.
    """
    h, found, lost = model.parameters[index].scale or 1.0, None, 0
    place = np.array([index]), np.array([], dtype=np.intp)
    for _ in range(TRIALS):
        parts = []
        for one, own in zip(fit.records, along, strict=True):
            dy, _ = own.by(*place, np.array([h]))
            parts.append((dy[:, :, 0] / fit.problem.scale)[one.observed])
        g = np.concatenate(parts)
        level = float(np.sqrt(np.mean(g**2)))
        if not np.isfinite(level):
            h *= LEAP
            continue
        if level == 0.0:
            lost += 1
            if lost == LOST:
                break
            h *= 1e9
            continue
        found, wanted = (g, h), SMALL * fit.rms / level
        if wanted == 0.0 or LONGEST < wanted / h < SHORTEST:
            break
        h *= float(np.clip(wanted / h, LEAP, 1.0 / LEAP))
    return found
