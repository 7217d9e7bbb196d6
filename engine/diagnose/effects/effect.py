"""What an effect is: something real that a model leaves out, and how to put it in.

An effect extends a model into another ordinary model with one or more parameters of its own, the
first of them its *size*. At size zero the extended model is the model itself. Everything the
diagnosis needs follows from that: the footprint of a small effect on the one-step predictions is
the difference of two filters, its size is an estimated parameter, its gain a likelihood ratio.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from engine.diagnose.effects.rate_readings import felt_by_readings, readings_of_rate
from engine.diagnose.effects.traits import USUAL, Course, Traits
from engine.errors import OptionError
from engine.statespace.evaluation import hands_rows_on
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.statespace.reads import reading
from engine.statespace.rows import with_input
from engine.statespace.split import Split as Split

NEARBY = 1e-6  # of a state's way over the step, on either side: there the slope of a term is taken
ROUNDED = 1e-9  # of a state's value: no nearer than that, wherever it counts from
# Of a state's way, value and size: so near the slope of a step is taken, and so far that rounding is little.
SHORT, LEAST, AT_REST = 0.1, 1e-6, 1e-4
STEEP = 2.0  # times a push, which no step that is short makes of it: there it jumps, as at rest with friction
MOST_GROWTH = 100.0  # logarithm of a growth within a step beyond which a run is lost anyway


@dataclass(frozen=True)
class Effect:
    """One candidate cause.

    ``name`` is ``kind:channel``; ``family`` where it enters (state, measurement, noise, input, time); ``title``
    its physical name; ``equation`` what it adds, as text; ``parameters`` its own, the size first, with units;
    ``extend`` the extension; ``probes`` values of the other parameters at which the screen looks (one row
    each); ``look_alikes`` kinds that leave similar traces, with what tells them apart; ``one_sided`` whether
    only a positive size makes sense (a variance); ``held`` those of its parameters that are a reference, not to
    be estimated; ``manners`` those of them that are 0 or 1, both of which are tried at a refit; ``zero`` the
    one among them that is the zero the effect counts from, where nothing declares or tells it: it may be
    estimated after all, where the data can tell; ``spread`` the one that is 0 where a memory begins at rest,
    which is tried, too; ``before`` the one that is what an input was until the record, where it may have been
    off, as is tried as well; ``readings(y, size)`` what it does to a channel's finished readings (T,), where
    the extension only stands for that (rounding as noise); ``shown`` the size that the readings themselves
    show, if they do: it is known then, and no parameter; ``runs(t, u, own)`` what is added to the parameter of
    the model that it changes, with the state on which it depends for u where it depends on one; ``traits``
    what the search must know of its kind.
    """

    kind: str
    channel: str
    family: str
    title: str
    equation: str
    parameters: tuple[Parameter, ...]
    extend: Callable[[MixedModel], MixedModel]
    probes: tuple[tuple[float, ...], ...] = ((),)
    look_alikes: dict[str, str] = field(default_factory=dict)
    one_sided: bool = False
    held: tuple[str, ...] = ()
    manners: tuple[str, ...] = ()
    zero: str | None = None
    spread: str | None = None
    before: str | None = None
    readings: Callable[[Array, float], Array] | None = None
    shown: float | None = None
    runs: Callable[[Any, Any, Sequence[Any]], Any] | None = None
    traits: Traits = USUAL

    @property
    def name(self) -> str:
        """``kind:channel``, as in ``"coulomb:velocity"``."""
        return f"{self.kind}:{self.channel}"

    @property
    def size(self) -> Parameter:
        """The parameter that is zero when the effect is absent."""
        return self.parameters[0]

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """The size, and of a wave the amplitude of its sine; what follows says when, or how often."""
        return self.parameters[: 2 if self.traits.course is Course.HARMONIC else 1]

    @property
    def timing(self) -> Parameter:
        """The time or the frequency of what runs over time."""
        return self.parameters[len(self.amplitudes)]

    @property
    def sought(self) -> tuple[str, ...]:
        """Times at which the likelihood jumps: sought on rows, not by slopes."""
        if self.traits.course is Course.EPISODE:
            return self.timing.name, self.parameters[len(self.amplitudes) + 1].name
        jumps = self.traits.course in (Course.STEP, Course.PULSE)
        return (self.timing.name,) if jumps else ()

    def from_elsewhere(self, at: Sequence[float] | Array) -> bool:
        """Whether ``at``, one of the probes, counts from elsewhere than where its zero is held."""
        return self.zero in self.held and bool(at[-1] != self.probes[0][-1])

    def with_free_zero(self) -> Effect:
        """The same effect with the zero it counts from estimated too."""
        return replace(self, held=tuple(name for name in self.held if name != self.zero))

    def apply(self, model: MixedModel) -> MixedModel:
        """The extended model, named ``model+kind:channel``, its parameters after the model's own."""
        taken = set(model.parameter_names) & {p.name for p in self.parameters}
        if taken:
            raise OptionError(
                f"model '{model.name}' already has the effect '{self.name}' (parameter {taken.pop()})",
                "effects",
            )
        extended = self.extend(model)
        for function in (extended.dynamics, extended.measurement):
            if _is_own(self.extend) and _is_own(function):
                hands_rows_on(function)
        return replace(
            extended,
            name=f"{model.name}+{self.name}",
            parameters=(*model.parameters, *self.parameters),
            equations=(*model.equations, f"{self.name}: {self.equation}"),
            description=f"{model.description} With {self.title}.".strip(),
        )


def worded_for(model: MixedModel, effect: Effect) -> Effect:
    """The effect, its equation meant as those of the model are.

    In differential equations x' is the derivative: ``x' = ... + dt * c`` of a step is ``x' = ... + c`` there.
    """
    if not model.continuous:
        return effect
    text = re.sub(r"\b(\w+)' = \1 \+ dt ", r"\1' = ", effect.equation)  # of a state of its own
    text = re.sub(r"^([^=']+) = \.\.\. ([+-]) dt \* ", r"\1' = ... \2 ", text)
    return replace(effect, equation=re.sub(r"(?<=[+-] )dt \* ", "", text))


def _is_own(function: Any) -> bool:
    """Whether a function was written here, and so keeps the rows of its arguments apart."""
    return getattr(function, "__module__", "").startswith("engine.diagnose")


# theta -> what the model's own functions take, and the effect's own values, as :class:`Split`
Parts: TypeAlias = Callable[[Any], tuple[Any, Any]]


@dataclass(frozen=True)
class Values:
    """Named signals at the points where a model is evaluated: ``v["velocity"]`` is (M,) or a number.

    ``t`` and ``dt`` in seconds; ``read`` are the names that were asked for.
    """

    signals: dict[str, Any]
    t: Any
    dt: Any
    read: set[str] = field(default_factory=set)

    def __getitem__(self, name: str) -> Any:
        self.read.add(name)
        return self.signals[name]


def signals(model: MixedModel, a: Array, u: Any) -> dict[str, Any]:
    """The nonlinear states and the inputs by name."""
    out: dict[str, Any] = {name: a[:, i] for i, name in enumerate(model.nonlinear)}
    out.update({name: u[i] for i, name in enumerate(model.inputs)})
    return out


def add_to_state(
    model: MixedModel,
    target: str,
    term: Callable[[Values, Sequence[Any]], Any],
    needs: Sequence[str] = (),
) -> MixedModel:
    """``target``' = ... + dt * term(signals, own parameters); linear states in ``needs`` are promoted.

    Of a continuous model half of it comes before the step and half after it (Strang 1968), each midway of its
    own push.
    """
    base = promote(model, needs)
    split = Split(model)
    row = [*base.nonlinear, *base.linear].index(target)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        read: set[str] = set()

        def rate(a: Array) -> Any:
            return term(Values(signals(base, a, u), t, dt, read), own)

        if not base.continuous:
            return pushed(base, {row: dt * rate(a)}, a, u, t, dt, own_base)
        half = 0.5 * dt
        push = half * _midway(rate, a, half, row)
        f, A, Q = pushed(base, {row: push}, a, u, t, dt, own_base)
        columns = [i for i, name in enumerate(base.nonlinear) if name in read]
        moved = np.broadcast_to(A[..., columns, :].any(axis=(-2, -1)), (len(a),))
        after = half * _midway(rate, f[:, : base.na], half, row)
        if moved.any():
            linear, A = _pushed_linearly(rate, f, A, a, half, row, columns)
            after = np.where(moved, linear, after)
        f[:, row] += after
        return f, A, Q

    def felt(a: Array, u: Any, t: Any, own: Any) -> Any:
        return term(Values(signals(base, a, u), t, None), own)

    functions = {"dynamics": dynamics} | felt_by_readings(base, split, target, felt)
    return on_base(base, split, **functions)


Rate: TypeAlias = Callable[[Array], Any]


def _midway(rate: Rate, a: Array, half: Any, row: int) -> Any:
    """The rate (M,) at states a (M, na), midway of its own push on a row of them."""
    there = rate(a)
    if row >= a.shape[1]:
        return there
    a = a.copy()
    a[:, row] += 0.5 * half * there
    return rate(a)


def _pushed_linearly(
    rate: Rate, f: Array, A: Array, a: Array, half: Any, row: int, columns: Sequence[int]
) -> tuple[Array, Array]:
    """A push (M,) at the step's end, and A after it, where linear states move what it depends on.

    There the rate is that at the step's beginning and its slopes by the ``columns`` of a times their way.
    """
    there, own = rate(a), 0.0
    ways = f[:, : a.shape[1]] - a
    slopes = np.zeros((len(columns), len(a)))
    for k, i in enumerate(columns):
        ahead, behind = a.copy(), a.copy()
        near = np.maximum(NEARBY * np.abs(ways[:, i]), ROUNDED * np.abs(a[:, i])) + 1e-300
        ahead[:, i] += near
        behind[:, i] -= near
        slopes[k] = (rate(ahead) - rate(behind)) / (ahead[:, i] - behind[:, i])
        own = slopes[k] if i == row else own
    share = np.reshape(half * (1.0 + 0.5 * half * own), (-1, 1))  # midway of its own push
    push = share[:, 0] * (there + np.einsum("km,mk->m", slopes, ways[:, columns]))
    A = np.array(np.broadcast_to(A, (len(a), *A.shape[-2:])))
    A[:, row] += share * np.einsum("km,mkz->mz", slopes, A[:, columns])
    return push, A


def pushed(
    model: MixedModel, pushes: Mapping[int, Any], a: Array, u: Any, t: Any, dt: Any, record: Any
) -> LinearGaussian:
    """One step of ``model`` with ``pushes``, row -> a number or (M,), added to its states.

    After the step; of a continuous model before it, so that they move the other states within the step. Where
    that is all, a chain of such steps is Strang's splitting, of second order, seen half a push early.
    """
    if model.continuous:
        a = a.copy()
        for row in (row for row in pushes if row < model.na):
            a[:, row] += pushes[row]
    f, A, Q = model.transition(a, u, t, dt, record)
    f = f.copy()
    for row, push in pushes.items():
        if not model.continuous:
            f[:, row] += push
        elif row >= model.na:
            f += A[..., row - model.na] * np.reshape(push, (-1, 1))
    return f, A, Q


def carried(
    model: MixedModel,
    row: int,
    step: LinearGaussian,
    a: Array,
    u: Any,
    t: Any,
    dt: Any,
    record: Any,
) -> Array | None:
    """What a ``step`` of a continuous model makes of one unit put on a state before it, (M, nx) or (nx,).

    So linear states can push a nonlinear one within the step: their push is small, and its slope is enough.
    Where that jumps the push is left as it is. None for other models.
    """
    f, A, _ = step
    if not model.continuous:
        return None
    if row >= model.na:
        return A[..., row - model.na].copy()
    moves = SHORT * np.abs(f[:, row] - a[:, row]) + LEAST * np.abs(a[:, row])
    near = moves + AT_REST * model.start_sizes[row] + 1e-300
    ends = []
    for way in (near, -near):
        moved = a.copy()
        moved[:, row] += way
        ends.append((model.transition(moved, u, t, dt, record)[0], moved[:, row]))
    (ahead, above), (behind, below) = ends
    slope = (ahead - behind) / np.reshape(above - below, (-1, 1))
    jumps = np.reshape(np.abs(slope[:, row]) > STEEP, (-1, 1))
    return np.where(jumps, np.eye(model.nx)[row], slope)


def add_linear_coupling(
    model: MixedModel,
    target: str,
    source: str,
    zero: Callable[[Sequence[Any]], Any] = lambda own: 0.0,
) -> MixedModel:
    """``target``' = ... + dt * size * (source - zero), for a linear state ``source``.

    The source at the step's start. Of a continuous model half of it comes before the step and half after it
    (Strang 1968).
    """
    split = Split(model)
    row = [*model.nonlinear, *model.linear].index(target)
    column = list(model.linear).index(source)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        step = model.transition(a, u, t, dt, own_base)
        on = carried(model, row, step, a, u, t, dt, own_base)
        f, A, Q = step
        A, f, size = per_point(A, len(a), dt, own[0]), f.copy(), dt * own[0]
        if on is None:
            f[:, row] -= size * zero(own)
            A[..., row, column] += size
            return f, A, Q
        size *= 0.5
        if target == source:
            size = np.expm1(np.minimum(size, MOST_GROWTH))
        each = np.reshape(size, (-1, 1) if np.ndim(size) else ())
        A = per_point(A, len(a), on[..., 0])
        A[..., column] += each * on
        f -= np.reshape(size * zero(own), (-1, 1)) * on
        f[:, row] += size * (f[:, model.na + column] - zero(own))
        A[..., row, :] += each * A[..., model.na + column, :]
        return f, A, Q

    rows = readings_of_rate(model, target)

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        h, C, R = model.observation(a, u, t, own_base)
        h, C = h.copy(), per_point(C, len(a), own[0])
        for output, factor in rows.items():
            h[:, output] -= factor * own[0] * zero(own)
            C[..., output, column] += factor * own[0]
        return h, C, R

    felt = {"measurement": measurement} if rows else {}
    return on_base(model, split, dynamics=dynamics, **felt)


def add_to_output(
    model: MixedModel,
    output: str,
    term: Callable[[Values, Sequence[Any]], Any],
) -> MixedModel:
    """``output`` = ... + term(signals, own parameters)."""
    row = list(model.outputs).index(output)

    def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
        h = h.copy()
        h[:, row] += term(Values(signals(model, a, u), t, None), own)
        return h, C, R

    return change_output(model, Split(model), change)


def change_output(model: MixedModel, split: Split, change: Callable[..., Any]) -> MixedModel:
    """The model with ``change(a, u, t, h, C, R, own)`` for its h, C, R, which it must not write into."""

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = change(a, u, t, *model.observation(a, u, t, record), own)
        return h, C, R

    return on_base(model, split, measurement=measurement)


def change_step(model: MixedModel, split: Split, change: Callable[..., Any]) -> MixedModel:
    """The model with ``change(a, u, t, f, A, Q, own)`` for its f, A, Q, which it must not write into."""

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        f, A, Q = change(a, u, t, *model.transition(a, u, t, dt, record), own)
        return f, A, Q

    return on_base(model, split, dynamics=dynamics)


def change_inputs(
    model: MixedModel, name: str, change: Callable[[Any, Sequence[Any], Any], Any]
) -> MixedModel:
    """The model driven by change(u, own parameters, t) instead of the input ``name``."""
    split = Split(model)
    index = list(model.inputs).index(name)

    def changed(u: Any, own: Sequence[Any], t: Any) -> Any:
        return with_input(u, index, change(u[index], own, t))

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        return model.transition(a, changed(u, own, t), t, dt, own_base)

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        return model.observation(a, changed(u, own, t), t, own_base)

    return on_base(model, split, dynamics=dynamics, measurement=measurement)


def on_base(model: MixedModel, split: Parts, **functions: Any) -> MixedModel:
    """``model`` with some functions replaced; the others see the base's part of theta only."""

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return model.transition(a, u, t, dt, split(theta)[0])

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return model.observation(a, u, t, split(theta)[0])

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return model.initial(split(theta)[0])

    passing = {"dynamics": dynamics, "measurement": measurement, "initial": initial}
    if isinstance(split, Split):  # others may change the base's part
        passing = {name: reading(split.n, function) for name, function in passing.items()}
    return replace(model, **{**passing, **functions})


def per_point(matrix: Array, M: int, *factors: Any) -> Array:
    """A copy of a matrix that may be changed: per point where a factor is an array (M,)."""
    if matrix.ndim == 2 and any(np.ndim(factor) > 0 for factor in factors):
        return np.repeat(matrix[None], M, axis=0)
    return matrix.copy()
