"""Whether the parameters of a model that makes its own steps are those of a step so long.

A model that is written by Euler's rule fits a linear record as well as the differential equation does, at other
parameters: of a lag of 0.25 s, sampled every 0.15 s, it makes one of 0.33 s. Nothing is wrong with its
predictions, so nothing is found; and its standard errors know nothing of it.
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.time_step import KIND
from engine.diagnose.search.rounds import MARGIN
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.words import enumerated, with_unit

MOVED = 2.0  # standard errors
SHOWN = 3  # parameters that are told, those first that move most
TWO_HALVES = 1.0  # size of the effect with which a step is two of half its length


def about_own_steps(base: QuasiFit, series: Series, setting: Setting) -> str:
    """A sentence where steps of half the length fit as well, with parameters beyond their errors; else "".

    ``base`` is a fit of the setting's model, or of an extension. Of models whose dt is a real time step and
    that make no finer ones by themselves, as ``continuous`` ones do.
    """
    model = base.model
    effects = [] if model.continuous or model.steps_counted else all_effects(setting, [KIND])
    if not effects or effects[0].size.name in model.parameter_names:
        return ""  # what was found says so itself
    extended = effects[0].apply(model)
    try:
        halves = quasi_ml(extended, series, [*base.theta, TWO_HALVES], base.free)
    except (EngineError, np.linalg.LinAlgError):
        return ""
    if 2.0 * (halves.log_likelihood - base.log_likelihood) < -MARGIN:
        return ""  # the record tells the steps, and these are its own
    moves = {
        name: abs(halves.theta[name] - base.theta[name]) / error
        for name, error in zip(base.free, base.standard_errors, strict=True)
        if error > 0.0
    }
    moved = [name for name in sorted(moves, key=lambda name: -moves[name]) if moves[name] > MOVED]
    if not moved:
        return ""
    told = [
        f"{name} would be {with_unit(halves.theta[name], unit)} instead of "
        f"{with_unit(base.theta[name], unit)}"
        for name in moved[:SHOWN]
        for unit in [model.parameters[model.index(name)].unit]
    ]
    return (
        "The parameters are those of steps as long as the model makes them: with two steps of half the length "
        f"the record is explained as well, and {enumerated(told)}. Their errors do not say so. Where the model "
        "stands for differential equations, write these with engine.continuous, which makes exact or shorter "
        "steps, or make several steps in its dynamics."
    )
