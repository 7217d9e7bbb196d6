"""What comes late: a sensor that lags or delays, an input that arrives later than it was recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import (
    WithMemory,
    add_linear_states,
    add_memory,
    beside,
    spread_at_first,
)
from engine.diagnose.effects.channels import Kind, at_outputs, at_terminals
from engine.diagnose.effects.effect import Effect, Split, per_point
from engine.diagnose.effects.noise_inside import noise_inside, noise_too
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.statespace.rows import with_input

LONGEST_DELAY = 12  # samples
AFFINE = 1e-9  # share of its change by which a function may bend and count as straight


def _lag(setting: Setting, channel: str, name: str) -> Effect:
    """A share of the reading comes one sample late."""
    noise = noise_too(name)
    return Effect(
        "lag",
        channel,
        "measurement",
        f"lag of the sensor {channel}",
        f"{channel} = (1 - {name}) y_t + {name} y_(t-1)",
        (Parameter(name, 0.0, "1", (0.0, 1.0), "share that comes one sample late"), noise),
        lambda model: _late_reading(model, setting, channel, 1, lambda own: [own[0]]),
        probes=((0.0,),),
        one_sided=True,
        look_alikes={
            "delay": "delays the input, or the reading by several samples",
            "colored": "is not driven by y",
            "slow-sensor": "goes on fading after one sample",
        },
        held=(noise.name,),
        manners=(noise.name,),
    )


def _sensor_delay(setting: Setting, channel: str, name: str) -> Effect:
    """A reading that arrives some samples late, or a part of it does; sized as that of an input is.

    Delays of the two are the same on a linear plant that begins at rest. So neither may be more free than the
    other: a share that comes late, up to one and a half, once fitted the noise and gave the sensor the name.
    A lag ends at one sample, which an input's delay does not, so the latest part may be one sample late, too.
    All parts up to the latest may come alike: a moving average.
    """
    evenly = Parameter(f"{name}_evenly", 0.0, "1", (0.0, 1.0), "1: a moving average until then")
    noise = noise_too(name)

    def weights(own: Any) -> list[Any]:
        apart = _parts(own, LONGEST_DELAY)
        size, latest = np.reshape(own[0], (-1, 1)), np.reshape(own[1], (-1, 1))
        each = np.minimum(2.0 * size / (latest + 1.0), 1.0) / latest
        alike = each * (np.arange(1, LONGEST_DELAY + 1) <= latest)
        parts = apart + np.reshape(own[2], (-1, 1)) * (alike - apart)
        return list(parts[0] if len(parts) == 1 else parts.T)

    return Effect(
        "delay",
        channel,
        "measurement",
        f"delay of the sensor {channel}",
        f"{channel} = y_t + {name} / d (y_(t-d) - y_t),  d = {name}_samples; y_(t-{name}) where that is more; "
        f"where {evenly.name} is 1 a moving average over d + 1 samples",
        (
            Parameter(name, 0.0, "samples", (0.0, float(LONGEST_DELAY)), "mean delay"),
            Parameter(
                f"{name}_samples", 2.0, "samples", (1.0, float(LONGEST_DELAY)), "latest part"
            ),
            evenly,
            noise,
        ),
        lambda model: _late_reading(model, setting, channel, LONGEST_DELAY, weights),
        probes=tuple((float(d), 0.0, 0.0) for d in range(1, LONGEST_DELAY + 1)),
        look_alikes={"lag": "is over after one sample", "pole": "changes the motion itself"},
        held=(f"{name}_samples", evenly.name, noise.name),
        manners=(evenly.name, noise.name),
        one_sided=True,
        traits=Traits(whole=True, contains=("lag",)),  # of a sample or less, it is one
    )


def _late_reading(
    base: MixedModel,
    setting: Setting,
    channel: str,
    depth: int,
    weights: Callable[[Any], list[Any]],
) -> MixedModel:
    """The reading (1 - sum w_k) y_t + sum w_k y_(t-k); the last ``depth`` values of y are states.

    They are y_1 at first, as of a sensor that has settled, and pass on from sample to sample.
    """

    def kept(own: Any) -> Any:
        """What is left of the variance of noise on y."""
        late = weights(own)
        return (1.0 - sum(late)) ** 2 + sum(weight**2 for weight in late)

    model, split = noise_inside(base, setting, channel, kept), Split(base)
    row, nx, nz = list(model.outputs).index(channel), model.nx, model.nz
    shift, hold = np.eye(depth, k=-1), np.eye(depth)
    u1 = np.array([setting.first(name) for name in model.inputs])

    def parts(theta: Any) -> tuple[Any, Any]:
        return theta, split(theta)[1]  # the inner model takes the effect's values too

    def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
        h, C, _ = model.observation(a, u1, setting.span[0], record)
        ones = np.ones((depth, 1))
        return np.repeat(h[:, row, None], depth, axis=1), ones * C[..., row, None, :], 0.0

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, _ = model.observation(a, u, t, theta)
        now = setting.at_sample(t)
        f, A, Q = beside(
            model.transition(a, u, t, dt, theta), len(a), _blocks(now, shift, hold), 0.0
        )
        f[:, nx] = now * h[:, row]
        if C.ndim == 3 and A.ndim == 2:
            A = np.repeat(A[None], len(a), axis=0)
        A[..., nx, :nz] = np.reshape(now, (-1, 1) if np.ndim(now) else ()) * C[..., row, :]
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = model.observation(a, u, t, theta)
        late = weights(split(theta)[1])
        now = 1.0 - sum(late)
        h = h.copy()
        C = np.concatenate([C, np.zeros((*C.shape[:-1], depth))], axis=-1)
        C = per_point(C, len(a), *late)
        h[:, row] *= now
        C[..., row, :] *= np.reshape(now, (-1, 1)) if np.ndim(now) else now
        for k, weight in enumerate(late):
            C[..., row, nz + k] = weight
        return h, C, R

    states = _register(setting, channel, depth)
    late = add_linear_states(model, parts, states, dynamics, begin, measurement=measurement)
    return replace(late, steps_counted=setting.substeps)


def _blocks(now: Any, shift: Array, hold: Array) -> Any:
    """``shift`` where ``now``, True or an array (M,), else ``hold``; without a branch, which no tape takes."""
    if now is True:
        return shift
    return hold + np.reshape(now, (-1, 1, 1) if np.ndim(now) else ()) * (shift - hold)


def _input_delay(setting: Setting, channel: str, name: str) -> Effect:
    """An input that arrives some samples late, or a part of it does."""
    unit, before = setting.unit(channel), setting.first(channel)
    spread = spread_at_first(setting, name, channel)

    def extend(model: MixedModel) -> MixedModel:
        late = _late_input if adds(setting, model, channel) else _late_input_by_memory
        return late(model, setting, channel)

    return Effect(
        "delay",
        channel,
        "input",
        f"delay of the input {channel}",
        f"{channel} -> {channel}_t + {name} / d ({channel}_(t-d) - {channel}_t),  d = {name}_samples; "
        f"{channel}_(t-{name}) where that is longer",
        (
            Parameter(name, 0.0, "samples", (0.0, float(LONGEST_DELAY)), "mean delay"),
            Parameter(
                f"{name}_samples", 1.0, "samples", (1.0, float(LONGEST_DELAY)), "latest part"
            ),
            Parameter(f"{name}_before", before, unit, description="input before the first sample"),
            spread,
        ),
        extend,
        probes=tuple((float(d), before, spread.default) for d in range(1, LONGEST_DELAY + 1)),
        look_alikes={
            "lag": "delays the reading, not the input",
            "hold": "looks half a sample ahead, not back",
        },
        held=(f"{name}_samples", f"{name}_before", spread.name),
        spread=spread.name,
        before=f"{name}_before" if setting.may_be_off(channel) else None,
        one_sided=True,
        traits=Traits(whole=True),
    )


def adds(setting: Setting, model: MixedModel, channel: str) -> bool:
    """Whether f and h are affine in an input, and A, Q, C, R do not depend on it, on the record.

    But for rounding, as of slopes that were differenced.
    """
    index, step = list(model.inputs).index(channel), setting.size(channel)
    points, theta = setting.points(model)
    record = model.record(theta)
    size_z = points.scale[model.na :]
    with np.errstate(all="ignore"):
        for x, u, t, dt in zip(points.x, points.u, points.t, points.dt, strict=True):
            at, ways = (x[None, : model.na],), []
            for way in (0.0, step, -step, 0.3 * step):
                moved = u.copy()
                moved[index] += way
                here = (*at, moved, float(t))
                ways.append(
                    (model.transition(*here, float(dt), record), model.observation(*here, record))
                )
            steps, readings = zip(*ways, strict=True)
            if not (_is_affine(steps, size_z) and _is_affine(readings, size_z)):
                return False
    return True


def _is_affine(moments: Sequence[LinearGaussian], size_z: Array) -> bool:
    """Whether f of these (f, A, Q), at 0, 1, -1 and 0.3 of a change, lies on a line, and A and Q stay.

    ``size_z`` (nz,) are sizes of the linear states, which tell what of A matters.
    """
    here, up, down, some = moments
    f, A, Q = (np.asarray(part) for part in here)
    change = up[0] - f
    bent = np.maximum(np.abs(down[0] - f + change), np.abs(some[0] - f - 0.3 * change))
    if (bent > AFFINE * (np.abs(change) + np.abs(f))).any():
        return False
    moved = np.abs(A) @ size_z + np.abs(f) + np.abs(change)
    noise = np.sqrt(np.abs(np.diagonal(Q, axis1=-2, axis2=-1)))
    limits = AFFINE * moved, AFFINE * noise[..., :, None] * noise[..., None, :]
    for other in (up, down):
        if (np.abs(other[1] - A) @ size_z > limits[0]).any():
            return False
        if (np.abs(other[2] - Q) > limits[1]).any():
            return False
    return True


def _parts(own: Any, depth: int, begin: Any = 0.0, end: Any = 1.0) -> Array:
    """What share of a step comes k = 1, 2, ... samples late, (M or 1, depth)."""
    done, first, rest = _courses(own, depth, begin, end)
    shares: Array = done * first + (1.0 - done) * rest
    return shares


def _courses(own: Any, depth: int, begin: Any = 0.0, end: Any = 1.0) -> tuple[Array, Array, Array]:
    """The share of a step (M or 1, 1) until which one mix of late inputs acts, and another one from then on.

    Both as shares of what comes k = 1, 2, ... samples late, (M or 1, depth). The step is the part of a sample
    from ``begin`` to ``end``, numbers or (M,). What comes later than the rest comes first in a sample: in its
    first s / d the input of d samples before; of a delay s > d that of floor(s) + 1, then of floor(s).
    """
    size, late = np.reshape(own[0], (-1, 1)), np.reshape(own[1], (-1, 1))
    begin, end = np.reshape(begin, (-1, 1)), np.reshape(end, (-1, 1))
    whole = np.floor(size)
    beyond = size > late
    later, earlier = np.where(beyond, whole + 1.0, late), np.where(beyond, whole, 0.0)
    first = np.where(beyond, size - whole, size / late)  # of the sample
    done = np.clip((first - begin) / (end - begin), 0.0, 1.0)
    k = np.arange(1, depth + 1)

    def at(d: Array) -> Array:
        return np.maximum(1.0 - np.abs(d - k), 0.0)  # linear between whole numbers

    return done, at(later), at(earlier)


def _late_input(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    """With g the gain of the input, f and h move by g sum w_k (u_(t-k) - u_t); past inputs are states.

    What comes late for a part of a step acts for that part: its gain is that of the step less that of the rest.
    The states are linear ones, known but for the first: before the record the input may have been anything.
    """
    split, depth, nz = Split(model), LONGEST_DELAY, model.nz
    index, scale = list(model.inputs).index(channel), setting.size(channel)
    shift, hold = np.eye(depth, k=-1), np.eye(depth)

    def begin(a: Array, record: Any, own: Any) -> tuple[Array, Array, Any]:
        return np.full((len(a), depth), float(own[2])), np.zeros((depth, nz)), own[3] ** 2

    def gain(function: Any, here: Array, a: Array, u: Any, *at: Any) -> Array:
        more = with_input(u, index, u[index] + scale)
        return np.asarray((function(a, more, *at)[0] - here) / scale)

    def moved(f: Array, A: Array, courses: Sequence[tuple[Array, Array]], u: Any) -> None:
        """Puts g sum w_k (u_(t-k) - u_t) into the first rows of f + A z, in place, for each g and w."""
        rows = courses[0][0].shape[1]
        for g, parts in courses:
            f[:, :rows] -= g * np.reshape(parts.sum(axis=1) * u[index], (-1, 1))
        A[..., :rows, nz:] = sum(g[:, :, None] * parts[:, None, :] for g, parts in courses)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        M = len(a)
        step = model.transition(a, u, t, dt, record)
        g = gain(model.transition, step[0], a, u, t, dt, record)
        ends = setting.at_sample(t + dt)
        f, A, Q = beside(step, M, _blocks(ends, shift, hold), 0.0)
        A = np.broadcast_to(A, (M, *A.shape[-2:])).copy()
        done, first, rest = _courses(own, depth, *setting.part_of_sample(t, dt))
        after = (1.0 - done) * g  # of what acts in the second part of the step
        within = (done > 0.0) & (done < 1.0)
        if model.continuous and (setting.substeps > 1 or within.any()):  # no branch by times
            left = np.where(within, 1.0 - done, 1.0)[:, 0] * dt
            left = left if left.size == M > 1 else left[0]
            here = model.transition(a, u, t, left, record)[0]
            after = np.where(within, gain(model.transition, here, a, u, t, left, record), after)
        moved(f, A, [(g - after, first), (after, rest)], u)
        f[:, model.nx] += ends * u[index]
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = model.observation(a, u, t, record)
        g = gain(model.observation, h, a, u, t, record)
        C = np.concatenate([C, np.zeros((*C.shape[:-1], depth))], axis=-1)
        if g.any():
            h, C = h.copy(), np.broadcast_to(C, (len(a), *C.shape[-2:])).copy()
            moved(h, C, [(g, _parts(own, depth))], u)
        return h, C, R

    states = _register(setting, channel, depth)
    late = add_linear_states(model, split, states, dynamics, begin, measurement=measurement)
    return replace(late, steps_counted=setting.substeps)


def _register(setting: Setting, channel: str, depth: int) -> dict[str, str]:
    """States for the last values of a channel, with their unit."""
    names = [f"last_{channel}", *(f"last_{channel}_{k}" for k in range(2, depth + 1))]
    return dict.fromkeys(names, setting.unit(channel))


def _late_input_by_memory(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    """For an input that does not simply add: the last ones as nonlinear states."""
    split, index, depth = Split(model), list(model.inputs).index(channel), LONGEST_DELAY

    def driven(last: Array, u: Any, parts: Array) -> Any:
        late = (parts.T * (last - u[index])).sum(axis=0)
        return with_input(u, index, u[index] + late)

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        parts = _parts(own, depth, *setting.part_of_sample(t, dt))
        f, A, Q = model.transition(a, driven(last, u, parts), t, dt, record)
        now = np.broadcast_to(u[index], (1, len(a)))
        shifted = np.concatenate([now, last[:-1]])
        return f, A, Q, np.where(setting.at_sample(t + dt), shifted, last)

    def observe(a: Array, last: Array, u: Any, t: Any, record: Any, own: Any) -> LinearGaussian:
        return model.observation(a, driven(last, u, _parts(own, depth)), t, record)

    def begin(own: Any) -> tuple[float, float]:
        return float(own[2]), own[3] ** 2

    states = _register(setting, channel, depth)
    late = add_memory(model, split, states, step, begin, observe)
    return replace(late, steps_counted=setting.substeps)


def _delay(setting: Setting, channel: str, name: str) -> Effect:
    """Of an input, or of a sensor."""
    make = _input_delay if channel in setting.model.inputs else _sensor_delay
    return make(setting, channel, name)


KINDS: list[Kind] = [at_outputs("lag", _lag), at_terminals("delay", _delay)]
