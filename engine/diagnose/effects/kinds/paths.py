"""A further way of an input into the system: straight to an output, or through a lag of first order."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import add_linear_states, beside, spread_at_first
from engine.diagnose.effects.channels import Kind, each_input, each_output, each_path
from engine.diagnose.effects.effect import (
    Effect,
    Split,
    add_to_output,
    carried,
    per_point,
)
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import SLOWEST_PROBE, Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.units import product


def _each_reading(setting: Setting) -> list[str]:
    """``input->output``."""
    return [f"{u}->{y}" for u in each_input(setting) for y in each_output(setting)]


def _each_direct(setting: Setting) -> list[str]:
    """To every output, from channels that the model leaves out, too: the reading alone may depend on them."""
    return _each_reading(setting) + [
        f"{u}->{y}" for u in setting.extra for y in each_output(setting)
    ]


def _ends(setting: Setting, channel: str) -> tuple[str, str, bool] | None:
    """Source, target and whether that is an output; None where the channel is not ``input->...``."""
    source, _, target = channel.partition("->")
    at_output = target in setting.model.outputs
    if source not in setting.model.inputs or not (at_output or target in setting.states):
        return None
    return source, target, at_output


def _size(setting: Setting, name: str, source: str, target: str, at_output: bool) -> Parameter:
    """What one unit of the source adds to the target."""
    unit = setting.unit(source)
    both = product(setting.unit(target), (unit, -1.0)) if at_output else setting.rate(target, unit)
    return Parameter(name, 0.0, both, description=f"{source} in {target}")


def _direct(setting: Setting, channel: str) -> Effect | None:
    ends = _ends(setting, channel)
    if ends is None or not ends[2]:
        return None
    source, target, _ = ends
    name = setting.identifier("direct", channel)
    origin = Origin(setting, name, source)
    unused = source in setting.extra
    whose = (
        f"the channel {source}, which the model leaves out," if unused else f"the input {source}"
    )
    return Effect(
        "direct",
        channel,
        "measurement",
        f"direct path from {whose} to the reading {target}",
        f"{target} = ... + {name} * {origin.text(source)}",
        extend=lambda model: add_to_output(
            model, target, lambda v, own: own[0] * (v[source] - origin.of(own))
        ),
        look_alikes={"path": "follows the input with a lag", "gain": "grows with the reading"},
        **origin.proportional(_size(setting, name, *ends)),
    )


def _path(setting: Setting, channel: str) -> Effect | None:
    """l' = (u - l) / tau, exact for an input held over the step; the target gets size l.

    What a state gets over the step is the integral of l. Before the record the input was what it is first,
    as far as anybody knows.
    """
    ends = _ends(setting, channel)
    if ends is None:
        return None
    source, target, at_output = ends
    name = setting.identifier("path", channel)
    origin = Origin(setting, name, source)
    first, until = setting.first(source), f"{source} until the record"
    before = Parameter(f"{name}_first", first, setting.unit(source), description=until)
    spread = spread_at_first(setting, name, source)
    members = origin.counted(
        _size(setting, name, *ends),
        setting.time_constant(f"{name}_time", "time constant"),
        before,
        spread,
        probes=[(samples * setting.dt, first, spread.default) for samples in (5.0, SLOWEST_PROBE)],
    )
    alike = {
        "direct": "follows the input at once",
        "pole": "follows a state, not the input",
        "delay": "comes late as a whole",
        "latent": "does not follow the input",
    }
    return Effect(
        "path",
        channel,
        "measurement" if at_output else "state",
        f"path of first order from the input {source} to {target}",
        f"l' = l + dt ({source} - l) / {name}_time,  {target}{'' if at_output else chr(39)} = ... + "
        f"{'' if at_output else 'dt * '}{name} * {origin.text('l')}",
        extend=lambda model: _with_path(model, setting, source, target, origin),
        look_alikes=alike,
        traits=Traits(contains=("direct", "extra-input", "input-gain")),
        spread=spread.name,
        before=before.name if setting.may_be_off(source) else None,
        **{**members, "held": (before.name, spread.name, *members["held"])},
    )


def _with_path(
    model: MixedModel, setting: Setting, source: str, target: str, origin: Origin
) -> MixedModel:
    split, nx, nz = Split(model), model.nx, model.nz
    index, states = list(model.inputs).index(source), [*model.nonlinear, *model.linear]
    row = states.index(target) if target in states else None

    def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
        return np.full((len(a), 1), float(own[2])), np.zeros((1, nz)), own[3] ** 2

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        M, gone = len(a), -np.expm1(-dt / own[1])
        keep = np.broadcast_to(1.0 - gone, (M,))
        step = model.transition(a, u, t, dt, record)
        f, A, Q = beside(step, M, [[keep]], 0.0)
        f[:, nx] = gone * u[index]
        if row is not None:
            push, mean = dt * own[0], gone * own[1] / dt  # of l over the step, as a share of l
            by_lag, rest = push * mean, push * ((1.0 - mean) * u[index] - origin.of(own))
            on = carried(model, row, step, a, u, t, dt, record)
            if on is not None:  # half before the step, half after it (Strang)
                by_lag, rest = 0.5 * by_lag, 0.5 * rest
                A[:, :nx, nz] += np.reshape(by_lag, (-1, 1)) * on
                f[:, :nx] += np.reshape(rest, (-1, 1)) * on
            A[:, row, nz] += by_lag
            f[:, row] += rest
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = model.observation(a, u, t, record)
        C = np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1)
        if row is None:
            output = list(model.outputs).index(target)
            h, C = h.copy(), per_point(C, len(a), own[0])
            h[:, output] -= own[0] * origin.of(own)
            C[..., output, nz] = own[0]
        return h, C, R

    lagged = {f"path_{source}": setting.unit(source)}
    return add_linear_states(model, split, lagged, dynamics, begin, measurement=measurement)


def _each_way(setting: Setting) -> list[str]:
    """To every output, and to the states that the input moves already: beside the direct way."""
    return [*each_path(setting), *_each_reading(setting)]


KINDS: list[Kind] = [
    ("direct", _direct, _each_direct),
    ("path", _path, _each_way),
]
