"""The model's own time step as a cause: four quarter-steps in place of one.

With F_h the mean of the model's step over h, G_h that of four over h/4 has a quarter of its error, for a
scheme of first order, and F_h + 4/3 (G_h - F_h) is the limit up to second order (Richardson 1911). A size
between one and 4/3 says that the model is right and its step too long. Two half-steps would do where a step is
smooth; where a drive comes to rest within it they leave so much that another friction explains more.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_any
from engine.diagnose.effects.effect import Effect, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.half_steps import halving_changes, in_parts
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote

KIND, CHANNEL = "time-step", "dt"
ROWS = 1000  # at which halving is looked at: a drive with friction may turn in one of a hundred
PARTS = 4
SIZES = (0.8, 1.6)  # 4/3 of a scheme of first order, 16/15 of second, 256/255 of fourth


def _time_step(setting: Setting, channel: str, name: str) -> Effect:
    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, list(model.linear))
        split = Split(model)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            f, A, Q = base.transition(a, u, t, dt, record)
            finer = in_parts(base, a, u, t, dt, record, PARTS)
            return f + np.reshape(own[0], (-1, 1)) * (finer - f), A, Q

        return on_base(base, split, dynamics=dynamics)

    return Effect(
        KIND,
        channel,
        "state",
        "time step of the model that is too long",
        f"F_dt(x) + {name} (G_dt(x) - F_dt(x)), G_dt: F_dt/4 four times",
        (
            Parameter(
                name, 0.0, "1", (0.0, 4.0), "1: four quarter-steps, 4/3: the limit of short ones"
            ),
        ),
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
    points, theta = setting.points(setting.model, ROWS)
    dt = points.dt / setting.substeps
    if halving_changes(setting.model, theta, points.x, points.u, points.t, dt):
        yield CHANNEL


KINDS: list[Kind] = [at_any(KIND, _time_step, _where, lambda setting: (CHANNEL,))]
