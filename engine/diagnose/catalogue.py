"""All effects that can be asked of a model, and how to get one by its name.

An effect is written ``kind:channel``. A channel is the name of a state, input, output or parameter of
the model; ``source->target`` puts a function of one state into the equation of another. Kinds come
from makers registered with :func:`register_effect`, those shipped and anybody's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from engine.diagnose.effect import Effect
from engine.errors import OptionError
from engine.model import MixedModel


@dataclass(frozen=True)
class Setting:
    """The model for which effects are made, with what its data tell about sizes.

    ``scale`` maps a channel to its typical size (standard deviation) in its unit, 1 where unknown;
    ``span`` is the first and last time in seconds; ``dt`` the median time step.
    """

    model: MixedModel
    scale: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 100.0)
    dt: float = 1.0

    def limits(self, low: float, high: float, least: float = 0.0) -> tuple[float, float]:
        """Bounds (low, high) taken from the data, (least, inf) where nothing is known of them."""
        return (low, high) if self.scale else (least, float("inf"))

    def size(self, channel: str) -> float:
        """The channel's typical size, 1 where unknown."""
        value = float(self.scale.get(channel, 1.0))
        return value if value > 0.0 else 1.0

    @property
    def states(self) -> dict[str, str]:
        """All states with their units."""
        return {**self.model.nonlinear, **self.model.linear}

    def unit(self, channel: str) -> str:
        """Unit of a state, input or output."""
        model = self.model
        return {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}[channel]


# A maker: (setting, channel) -> the effect, or None where the channel is not of its sort.
Maker: TypeAlias = Callable[[Setting, str], Effect | None]
# Which channels a maker is tried on when all effects of a model are listed.
Channels: TypeAlias = Callable[[Setting], Iterator[str]]
# A kind as the shipped modules list it.
Kind: TypeAlias = tuple[str, Maker, Channels]

_makers: dict[str, tuple[Maker, Channels]] = {}


def register_effect(kind: str, maker: Maker, channels: Channels, replace: bool = False) -> None:
    """Make a kind of effect known; ``channels`` lists where it may enter a given model."""
    if kind in _makers and not replace:
        raise OptionError(f"an effect of kind '{kind}' is already registered", "effects")
    _makers[kind] = (maker, channels)


def effect_kinds() -> list[str]:
    """The kinds there are, sorted."""
    _load()
    return sorted(_makers)


def make_effect(name: str, setting: Setting) -> Effect:
    """The effect ``kind:channel`` for a model. Raises OptionError naming what there is."""
    _load()
    kind, _, channel = name.partition(":")
    if kind not in _makers:
        raise OptionError(
            f"effect '{name}' is not known; kinds are {', '.join(sorted(_makers))}", "effects"
        )
    effect = _makers[kind][0](setting, channel)
    if effect is None:
        there = ", ".join(_makers[kind][1](setting)) or "none"
        raise OptionError(
            f"effect '{kind}' cannot enter model '{setting.model.name}' at '{channel}'; "
            f"channels are {there}",
            "effects",
        )
    return effect


def all_effects(setting: Setting, kinds: Sequence[str] | None = None) -> list[Effect]:
    """Every effect of the catalogue for a model; ``kinds`` restricts to kinds or full names."""
    _load()
    out: list[Effect] = []
    for kind, (maker, channels) in _makers.items():
        for channel in channels(setting):
            if kinds is not None and kind not in kinds and f"{kind}:{channel}" not in kinds:
                continue
            effect = maker(setting, channel)
            if effect is not None:
                out.append(effect)
    return out


def extend(model: MixedModel, effects: Sequence[str], setting: Setting | None = None) -> MixedModel:
    """The model with effects applied one after the other, by name."""
    for name in effects:
        known = setting or Setting(model)
        model = make_effect(name, Setting(model, known.scale, known.span, known.dt)).apply(model)
    return model


# ---- channels ------------------------------------------------------------------------------


def each_state(setting: Setting) -> Iterator[str]:
    """Every state."""
    yield from setting.states


def each_output(setting: Setting) -> Iterator[str]:
    """Every output."""
    yield from setting.model.outputs


def each_input(setting: Setting) -> Iterator[str]:
    """Every input."""
    yield from setting.model.inputs


def each_parameter(setting: Setting) -> Iterator[str]:
    """Every parameter of the model."""
    yield from setting.model.parameter_names


def each_pair(setting: Setting) -> Iterator[str]:
    """A state in its own equation, and ``source->target`` where one already feeds the other."""
    states = list(setting.states)
    F = np.abs(_structure(setting.model))
    for i, source in enumerate(states):
        yield source
        for j, target in enumerate(states):
            if i != j and (F[j, i] > 0.0 or F[i, j] > 0.0):
                yield f"{source}->{target}"


def pair(setting: Setting, channel: str) -> tuple[str, str] | None:
    """(source, target) of a channel, None where they are not states of the model."""
    source, _, target = channel.partition("->")
    target = target or source
    return (source, target) if {source, target} <= set(setting.states) else None


def _structure(model: MixedModel) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Size of d x_{t+1} / d x_t at some points: which state feeds which."""
    rng = np.random.default_rng(5)
    record = model.record(model.theta())
    na = model.na
    density = model.start(record).density
    a = np.asarray(density.sample(rng, 16), dtype=float) + 0.1 * rng.standard_normal((16, na))
    u = rng.standard_normal(model.nu)
    F = np.zeros((model.nx, model.nx))
    with np.errstate(all="ignore"):
        f, A, _ = model.transition(a, u, 0.0, 1.0, record)
        F[:, na:] = np.abs(A if A.ndim == 2 else A.max(axis=0))
        for i in range(na):
            moved = a.copy()
            moved[:, i] += 1e-3
            g, B, _ = model.transition(moved, u, 0.0, 1.0, record)
            change = np.abs(g - f).max(axis=0)
            if A.ndim == 3:
                change = change + np.abs(B - A).max(axis=(0, 2))
            F[:, i] = np.where(change > 1e-9, change, 0.0)
    return np.nan_to_num(F)


def _load() -> None:
    """Register the shipped kinds once."""
    from engine.diagnose.inputs import KINDS as INPUT
    from engine.diagnose.measurement import KINDS as MEASUREMENT
    from engine.diagnose.noise import KINDS as NOISE
    from engine.diagnose.state import KINDS as STATE
    from engine.diagnose.tails import KINDS as TAILS
    from engine.diagnose.timed import KINDS as TIME

    for kind, maker, channels in (*STATE, *MEASUREMENT, *NOISE, *TAILS, *INPUT, *TIME):
        _makers.setdefault(kind, (maker, channels))
