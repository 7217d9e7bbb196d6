"""Data in which effects are hidden at given sizes: what every claim of finding them is tested on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from engine.diagnose.catalogue import make_effect
from engine.diagnose.setting import Setting
from engine.errors import OptionError
from engine.model import MixedModel, ThetaLike
from engine.series import Series
from engine.simulate import Simulation, simulate


def hide(
    model: MixedModel,
    effects: Sequence[str],
    values: dict[str, float],
    n_samples: int,
    rng: np.random.Generator,
    *,
    theta: ThetaLike = None,
    u: ArrayLike | None = None,
    dt: float = 1.0,
) -> Simulation:
    """A simulation of ``model`` at ``theta`` with effects such as ``"coulomb:velocity"`` in it.

    ``values`` gives the effects' own parameters by name, sizes among them; what is left out keeps its
    default. Effects that change readings once they are taken (rounding) do just that, instead of
    adding the noise that stands for it in the extended model. Raises OptionError for an unknown
    name, ModelError where the simulation runs away.
    """
    setting = Setting(model, span=(0.0, dt * (n_samples - 1)), dt=dt)
    setting = replace(setting, zeros=setting.known_zeros)
    extended, changes = model, []
    own = dict(values)
    for name in effects:
        effect = make_effect(name, replace(setting, model=extended))
        extended = effect.apply(extended)
        if effect.readings is not None:
            size = own.pop(effect.size.name, 0.0)
            changes.append((list(model.outputs).index(effect.channel), effect.readings, size))
    unknown = set(own) - set(extended.parameter_names)
    if unknown:
        raise OptionError(f"'{unknown.pop()}' is no parameter of {', '.join(effects)}", "values")
    start: dict[str, Any] = {**model.theta(theta).asdict(), **own}
    run = simulate(extended, start, n_samples, rng, u=u, dt=dt)
    if not changes:
        return run
    y = run.y.copy()
    for column, change, size in changes:
        y[:, column] = change(y[:, column], size)
    frame = run.series
    series = Series(y, frame.u, t=frame.t, y_names=frame.y_names, u_names=frame.u_names)
    return replace(run, y=y, series=series)
