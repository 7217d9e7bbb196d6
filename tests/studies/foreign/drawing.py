"""A series of a cell, and what is true of it in the catalogue's words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from tests.studies.foreign.cells import Cell
from tests.studies.foreign.plant import Array, simulate

TEST_SHARE = 0.25  # held-out rows for each row of the training part
DRAWS = 5  # a draw in which the plant runs away is not a record; another one is made


def series_of(
    cell: Cell, size: float, seed: Sequence[int]
) -> tuple[Series, Series, dict[str, float]]:
    """Training part, the held-out part that follows it, and the fault's drawn values.

    Raises OverflowError where the plant runs away in every draw.
    """
    plan = cell.plan
    more = int(TEST_SHARE * plan.rows)
    for draw in range(DRAWS):
        own_seed = [*seed, draw] if draw else seed
        try:
            drawn = simulate(plan.plant, plan.rows, own_seed, cell.level, cell.what, size, more)
            break
        except OverflowError:
            if draw == DRAWS - 1:
                raise
    whole = Series(
        drawn.y, drawn.u, t=drawn.t, y_names=plan.plant.outputs, u_names=plan.plant.inputs_named
    )
    return whole.part(0, plan.rows), whole.part(plan.rows, plan.rows + more), drawn.own


def true_values(cell: Cell, effect: Effect, size: float, own: Mapping[str, float]) -> Array:
    """The effect's parameters, its size first, as the truth has them; the rest at their defaults."""
    assert cell.what is not None
    told = cell.what.told(size, own)
    values = []
    for k, parameter in enumerate(effect.parameters):
        ending = "" if k == 0 else parameter.name.rpartition("_")[2]
        values.append(told.get(ending, parameter.default))
    return np.array(values)
