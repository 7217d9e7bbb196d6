"""Data in which effects are hidden at given sizes: what every claim of finding them is tested on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from engine.data.series import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.errors import OptionError
from engine.simulation.simulate import Simulation, simulate
from engine.statespace.model import MixedModel, ThetaLike
from engine.units import SECOND

FINE_STEPS = 16  # steps a sample of a continuous model


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
    hold: str = "zoh",
    time_unit: str = SECOND,
) -> Simulation:
    """A simulation of ``model`` at ``theta`` with effects such as ``"coulomb:velocity"`` in it.

    ``values`` gives the effects' own parameters by name, sizes among them; what is left out keeps its
    default. ``u``, ``dt``, ``hold`` and ``time_unit`` are as in :func:`engine.simulate`; the last says what
    the model's times count, which labels rates and times. A continuous model makes FINE_STEPS steps a
    sample, so that effects act within it. Effects that change readings once they are taken (rounding) do
    just that, instead of adding the noise that stands for it in the extended model. Raises OptionError for
    an unknown name, ModelError where the simulation runs away.
    """
    fine = FINE_STEPS if model.continuous else 1
    span = (0.0, dt * (n_samples - 1))
    setting = Setting(model, span=span, dt=dt, substeps=fine, time_unit=time_unit).keeping_zeros()
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
    blank = np.zeros((n_samples, extended.ny))
    uncounted = replace(extended, steps_counted=0)  # its steps are made further down
    frame = Series(blank, u, dt=dt, hold=hold, time_unit=time_unit).check(uncounted)
    run = _sampled(extended, start, frame, rng, fine)
    if not changes:
        return run
    y = run.y.copy()
    for column, change, size in changes:
        y[:, column] = change(y[:, column], size)
    return replace(run, y=y, series=run.series.replace(y=y))


def _sampled(
    model: MixedModel,
    theta: ThetaLike,
    frame: Series,
    rng: np.random.Generator,
    k: int,
) -> Simulation:
    """A simulation of k steps a sample over a frame's inputs and times, seen at the samples."""
    fine = frame.refined(k)
    clock = fine.time_unit
    run = simulate(
        model, theta, len(fine), rng, u=fine.u, t=fine.t, hold=fine.hold, time_unit=clock
    )
    rows = fine.samples
    names = {"y_names": tuple(model.outputs), "u_names": tuple(model.inputs)}
    series = frame.replace(y=run.y[rows], **names)
    return Simulation(run.y[rows], run.a[rows], run.z[rows], series, model)
