"""One series of a cell: what is hidden in it, and the series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.time_scan import is_timed
from engine.errors import ModelError
from engine.simulation.simulate import simulate
from engine.statespace.model import Array
from tests.studies.blind.bases import BASES, TEST_SHARE, Base, typical
from tests.studies.blind.cells import Cell
from tests.studies.blind.outside import force, with_play

DRAWS = 20  # of a series, where simulations run away
BETWEEN = (0.3, 0.7)  # of the training part: where times lie
PERIODS = (20.0, 80.0)  # samples of a hidden harmonic's period

OUTLIER = 3.0  # times the usual noise


@dataclass(frozen=True, eq=False)
class Hidden:
    """A series with its held-out part and the effect in it (None where clean or play).

    ``own`` are the true values of the effect's own parameters.
    """

    train: Series
    test: Series
    effect: Effect | None
    own: Array


def draw(cell: Cell, size: float, rng: np.random.Generator) -> Hidden:
    """A series of a cell with the effect at a size. Raises ModelError if all draws run away."""
    base = BASES[cell.base]
    for left in range(DRAWS - 1, -1, -1):
        try:
            return _draw(base, cell, size, rng)
        except ModelError:
            if not left:
                raise
    raise AssertionError("unreachable")


def _draw(base: Base, cell: Cell, size: float, rng: np.random.Generator) -> Hidden:
    model, theta = base.model, np.asarray(base.model.theta())
    kind, _, rest = cell.effect.partition(":")
    if cell.effect == "outside:play":
        T = cell.rows + int(TEST_SHARE * cell.rows)
        u = None if base.inputs is None else base.inputs(T, rng)
        series = with_play(model, theta, simulate(model, theta, T, rng, u=u, dt=base.dt))
        return Hidden(series.part(0, cell.rows), series.part(cell.rows, T), None, np.zeros(0))
    effect, own = None, np.zeros(0)
    if kind == "outside":
        effect, own = force(base, rest, cell.rows, rng), np.array([size])
    elif kind:
        effect = make_effect(cell.effect, typical(base.name, cell.rows))
        own = own_values(effect, typical(base.name, cell.rows), size, rng)
    if effect is not None:
        model, theta = effect.apply(model), np.concatenate([theta, own])
    train, test = base.draw(cell.rows, rng, model, theta)
    return Hidden(train, test, effect, own)


def own_values(effect: Effect, setting: Setting, size: float, rng: np.random.Generator) -> Array:
    """The effect's parameters at a size: times and frequencies at random, the rest as they come."""
    first, last = setting.span
    values = []
    for parameter in effect.parameters[1:]:
        value = parameter.default
        if parameter.name.endswith("_time") and is_timed(effect):
            row = round(float(rng.uniform(*BETWEEN)) * (last - first) / setting.dt)
            value = first + row * setting.dt
        elif parameter.name.endswith("_ratio"):
            value = OUTLIER
        elif parameter.name.endswith("_frequency"):
            value = 1.0 / (float(rng.uniform(*PERIODS)) * setting.dt)
        values.append(value)
    return np.array([size, *values])
