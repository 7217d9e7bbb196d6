"""Parameters that depend on an input, on a state or on how far two are apart, from the middle of it on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.diagnose.effects.channels import Kind
from engine.diagnose.effects.differences import parts_of, value_of, weighed_differences
from engine.diagnose.effects.effect import Effect, Split, on_base, signals
from engine.diagnose.effects.kinds.odds import only_drives
from engine.diagnose.effects.kinds.parameters import ONTO, running_parameter, unit_of
from engine.diagnose.effects.rates import ROUNDING_SHARE, Points, slopes_by
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import ANY, Traits
from engine.errors import EngineError
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.units import product

MOVED = 1e-2  # of what a parameter moves most, in the sizes of the states: less comes of a step that is finite
ALIKE = 0.02  # of it: what a function of one channel may leave, and be all of it


def _slope(setting: Setting, channel: str) -> Effect | None:
    """``signal->parameter``: a loss that grows with the wind, a resistance that depends on the temperature."""
    source, _, target = channel.partition(ONTO)
    parts = parts_of(source, [*setting.states, *setting.model.inputs])
    of_state = any(part in setting.states for part in parts)
    if not parts or (len(parts) > 1 and not of_state):
        return None
    if target not in setting.model.parameter_names:
        return None
    joined = ",".join(parts) + ONTO + target
    name = setting.identifier("parameter-slope", joined)
    unit = setting.unit(parts[0])
    # counted from the middle of the record, the parameter itself stays what it is on the whole
    middle = Parameter(
        f"{name}_middle",
        setting.quantile(source, 0.5) if len(parts) == 1 else _usually_apart(setting, source),
        unit,
        description=f"{source} where it is zero",
    )
    slope = Parameter(
        name,
        0.0,
        product(unit_of(setting, target), (unit, -1.0)),
        description=f"{target} per {source}",
    )
    left_out = ", which the model leaves out" if source in setting.extra else ""
    own: dict[str, Any] = _of_state(setting, source, parts, target) if of_state else {}
    return Effect(
        "parameter-slope",
        channel,
        "state" if of_state else "input",
        f"dependence of the parameter {target} on {source}{left_out}",
        f"{target} -> {target} + {name} * ({source} - {middle.name})",
        (slope, middle),
        probes=((middle.default,),),
        held=(middle.name,),
        **(own or _of_input(setting, source, target)),
    )


def _of_input(setting: Setting, source: str, target: str) -> dict[str, Any]:
    """Members of the effect of an input."""
    row = list(setting.model.inputs).index(source)

    def course(t: Any, u: Any, own: Sequence[Any]) -> Any:
        return own[0] * (u[row] - own[1])

    return {
        "extend": running_parameter(setting, target, course, within_steps=False),
        "look_alikes": {
            "product": "is one of its terms only",
            "parameter-drift": "changes with time, whatever the input",
            "input-gain": "is the same at any size of the input",
        },
        "runs": course,
        "traits": Traits(of_parameter=True, plainness=ANY + 1, odd=only_drives(setting, source)),
    }


def _usually_apart(setting: Setting, source: str) -> float:
    """The middle of how far two channels are apart in the record, 0 without one."""
    if setting.record is None:
        return 0.0
    return float(np.nanmedian(value_of(source, setting.record.values)))


def _of_state(setting: Setting, source: str, parts: Sequence[str], target: str) -> dict[str, Any]:
    """Members of the effect of a state, at the step's beginning, of differential equations midway of the step.

    Midway is where half a step leads. So those states that feed the source are no linear ones, either.
    """
    index = setting.model.parameter_names.index(target)
    bounds = setting.model.parameters[index].bounds
    states = [part for part in parts if part in setting.states]
    fed = [setting.feeding(state) for state in states] if setting.model.continuous else []
    needs = list(dict.fromkeys([*states, *chain.from_iterable(fed)]))

    def course(t: Any, x: Any, own: Sequence[Any]) -> Any:
        return own[0] * (x - own[1])

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, needs)
        split = Split(model)

        def at(x: Array, u: Any, theta: Any) -> Any:
            record, own = split(theta)
            signal = value_of(source, signals(base, x, u))
            value = np.clip(record[index] + course(None, signal, own), *bounds)
            return record._replace(**{target: value})

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            record = at(a, u, theta)
            if base.continuous:
                record = at(base.transition(a, u, t, 0.5 * dt, record)[0], u, theta)
            return base.transition(a, u, t, dt, record)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            return base.observation(a, u, t, at(a, u, theta))

        return on_base(base, split, dynamics=dynamics, measurement=measurement)

    return {
        "extend": extend,
        "look_alikes": {
            "product": "is one of its terms only",
            "quadratic": "is one of its terms only",
            "parameter-slope": "depends on another signal",
            "parameter-drift": "changes with time, whatever the state",
        },
        "runs": course,
        # a speed is no condition, as a temperature is, or a charge: what depends on it is friction
        "traits": Traits(
            of_parameter=True, plainness=ANY + 2, odd=len(parts) == 1 and setting.is_rate(source)
        ),
    }


def _each_slope(setting: Setting) -> Iterator[str]:
    """Each parameter but those of noise with each input, also with one that the model leaves out.

    And with each state that moves, where no plainer effect says just that, and each difference that it weighs.
    """
    for target in setting.steering:
        yield from (f"{source}{ONTO}{target}" for source in setting.model.inputs)
    for target in setting.steering:
        weighed, _ = weighed_by(setting, target) or (None, "")
        for source in setting.moved:
            if weighed is None:
                asked = not setting.once(_bends, target, source)
            else:  # a product, which is added after a step that no other follows within the sample
                asked = weighed not in ("", source) and setting.once(_reaches_further, target)
            if asked:
                yield f"{source}{ONTO}{target}"
        yield from (f"{apart}{ONTO}{target}" for apart in setting.once(_differences, target))


def weighed_by(setting: Setting, parameter: str) -> tuple[str, str] | None:
    """The channel that is all that a parameter weighs, "" for none, and the state in whose equation it does.

    None where it does more. Else its slope is called what it is: a product with that channel, a square, or a
    coupling.
    """
    known: tuple[str, str] | None = setting.once(_weighed_by, parameter)
    return known


def _weighed_by(setting: Setting, parameter: str) -> tuple[str, str] | None:
    points, _ = setting.points(setting.model)
    try:
        moves, readings = setting.once(_slopes, parameter)
    except (EngineError, np.linalg.LinAlgError):
        return "", ""  # nor can the model be used with a parameter that changes
    rows = _moved_most(moves, points)
    if readings.any() or len(rows) != 1 or list(setting.states)[rows[0]] not in setting.targets:
        return None
    column, target = moves[:, rows[0]], list(setting.states)[rows[0]]
    if np.ptp(column) <= ALIKE * np.abs(column).max():
        return "", target
    channels = zip(
        [*setting.states, *setting.model.inputs], np.hstack([points.x, points.u]).T, strict=True
    )
    known = {*setting.moved, *setting.model.inputs} - {*setting.extra}
    for name, values in channels:
        affine = np.column_stack(
            [np.ones(len(values)), (values - values[0]) / (np.ptp(values) or 1.0)]
        )
        left = column - affine @ np.linalg.lstsq(affine, column)[0]
        if name in known and np.linalg.norm(left) <= ALIKE * np.linalg.norm(column):
            return name, target
    return None


def _differences(setting: Setting, parameter: str) -> list[str]:
    """How far two channels are apart, where that is what a parameter weighs, in all equations that it enters.

    As a stiffness does a twist, or an exchange of heat a fall of temperature: a spring that stiffens, and what
    radiates, do not weigh it in proportion. A curve of one of the two is no law of their difference.
    """
    points, _ = setting.points(setting.model)
    try:
        moves, readings = setting.once(_slopes, parameter)
    except (EngineError, np.linalg.LinAlgError):
        return []
    rows = _moved_most(moves, points)
    names = list(setting.states)
    if readings.any() or not rows.size or not {names[row] for row in rows} <= set(setting.targets):
        return []
    used = [name for name in setting.model.inputs if name not in setting.extra]
    columns = dict(
        zip([*names, *setting.model.inputs], np.hstack([points.x, points.u]).T, strict=True)
    )
    channels = {name: (setting.unit(name), columns[name]) for name in [*names, *used]}
    return [
        source
        for source in weighed_differences(moves[:, rows], channels)
        if any(part in setting.moved for part in parts_of(source, list(channels)))
    ]


def _bends(setting: Setting, parameter: str, source: str) -> bool:
    """Whether all that a parameter does is a curve of the state ``source`` in one equation.

    As an outflow that is a root of the level does. With a dependence on it this is another curve, and there are
    plainer ones. Where the model refuses other states beside that one nobody knows.
    """
    points, theta = setting.points(setting.model)
    at = list(setting.states).index(source)
    x = np.roll(points.x, 1, axis=0)
    x[:, at] = points.x[:, at]
    others = replace(points, x=x, u=np.roll(points.u, 1, axis=0))
    try:
        here, there = (
            np.hstack([moves[:, _moved_most(moves, points)], readings[:, readings.any(axis=0)]])
            for moves, readings in (
                setting.once(_slopes, parameter),
                slopes_by(setting.model, theta, others, parameter),
            )
        )
    except (EngineError, np.linalg.LinAlgError):
        return False
    if here.shape[1] != 1 or there.shape[1] != 1:
        return False
    return bool(np.linalg.norm(there - here) <= ALIKE * np.linalg.norm(here))


def _slopes(setting: Setting, parameter: str) -> tuple[Array, Array]:
    points, theta = setting.points(setting.model)
    return slopes_by(setting.model, theta, points, parameter)


def _reaches_further(setting: Setting, parameter: str) -> bool:
    """Whether a parameter moves several states within a whole step, of a model that is not stepped more finely.

    As a brake does a speed, and half a step's way: what is added to the speed after the step does not.
    """
    if setting.model.continuous:
        return False
    points, theta = setting.points(setting.model)
    try:
        moves, _ = slopes_by(setting.model, theta, points, parameter, 1.0)
    except (EngineError, np.linalg.LinAlgError):
        return False
    felt = np.abs(moves / points.scale).max(axis=0)
    return bool(np.count_nonzero(felt > ROUNDING_SHARE * felt.max()) > 1)


def _moved_most(moves: Array, points: Points) -> NDArray[np.intp]:
    """The states that a parameter moves, by ``moves`` (n, nx); what else does is a step that is finite."""
    felt = np.abs(moves / points.scale).max(axis=0)
    return np.flatnonzero(felt > MOVED * felt.max())


KINDS: list[Kind] = [("parameter-slope", _slope, _each_slope)]
