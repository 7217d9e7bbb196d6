"""The model's own time step as a cause: two half-steps in place of one.

With F_h the mean of the model's step over h, F_(h/2) o F_(h/2) is the same step with an error about half
as large for a scheme of first order, and F_h + 2 (F_(h/2) o F_(h/2) - F_h) its limit up to second order
(Richardson 1911). A size between one and two says that the model is right and its step too long.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_any
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.half_steps import halving_changes, two_halves
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote

KIND, CHANNEL = "time-step", "dt"
SIZES = (0.8, 2.4)  # 2 of a scheme of first order, 4/3 of second order, 16/15 of fourth


def _time_step(setting: Setting, channel: str, name: str) -> Effect:
    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, list(model.linear))
        split = Split(model)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            f, A, Q = base.transition(a, u, t, dt, record)
            twice = two_halves(base, a, u, t, dt, record)
            return f + np.reshape(own[0], (-1, 1)) * (twice - f), A, Q

        return on_base(base, split, dynamics=dynamics)

    return Effect(
        KIND,
        channel,
        "state",
        "time step of the model that is too long",
        f"F_dt(x) + {name} (F_dt/2(F_dt/2(x)) - F_dt(x))",
        (Parameter(name, 0.0, "1", (0.0, 4.0), "1: two half-steps, 2: the limit of short ones"),),
        extend,
        look_alikes={
            "pole": "remembers",
            "hysteresis": "remembers",
            "linear": "grows with the state",
        },
        one_sided=True,
        traits=Traits(foreseen=SIZES),
    )


def _where(setting: Setting) -> Iterator[str]:
    """Where dt is a real time step, and halving it changes something."""
    points, theta = setting.points(setting.model)
    dt = points.dt / setting.substeps
    if halving_changes(setting.model, theta, points.x, points.u, points.t, dt):
        yield CHANNEL


KINDS: list[Kind] = [at_any(KIND, _time_step, _where, lambda setting: (CHANNEL,))]
