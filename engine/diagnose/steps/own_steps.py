"""Whether parameters of a diagnosed model are those of long steps, see :mod:`engine.simulation.own_steps`."""

from __future__ import annotations

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.kinds.time_step import KIND
from engine.diagnose.effects.setting import Setting
from engine.estimation.own_steps import of_fit
from engine.estimation.quasi_ml import QuasiFit


def about_own_steps(base: QuasiFit, series: Series, setting: Setting) -> str:
    """A sentence where steps of half the length fit as well, with parameters beyond their errors; else "".

    ``base`` is a fit of the setting's model, or of an extension. Of models whose dt is a real time step and
    that make no finer ones by themselves, as ``continuous`` ones do.
    """
    model = base.model
    effects = [] if model.continuous or model.steps_counted else all_effects(setting, [KIND])
    if not effects or effects[0].size.name in model.parameter_names:
        return ""  # what was found says so itself
    return of_fit(base, [series])
