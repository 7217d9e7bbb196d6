"""Where kinds of effects enter: the channels each is tried on, and its effect at one of them."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from typing import TypeAlias

from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting

# A maker: (setting, channel) -> the effect, or None where the channel is not of its sort.
Maker: TypeAlias = Callable[[Setting, str], Effect | None]


# Which channels a maker is tried on when all effects of a model are listed.
Channels: TypeAlias = Callable[[Setting], Iterable[str]]


# A kind as the shipped modules list it.
Kind: TypeAlias = tuple[str, Maker, Channels]


def each_state(setting: Setting) -> list[str]:
    """Every state whose equation may be wrong."""
    return setting.targets


def each_output(setting: Setting) -> list[str]:
    """Every output."""
    return list(setting.model.outputs)


def each_input(setting: Setting) -> list[str]:
    """Every input that the model uses."""
    return [name for name in setting.model.inputs if name not in setting.extra]


def each_signal(setting: Setting) -> list[str]:
    """Every output, and every state whose equation may be wrong."""
    return [*each_output(setting), *each_state(setting)]


def each_terminal(setting: Setting) -> list[str]:
    """Every input that the model uses, and every output."""
    return [*each_input(setting), *each_output(setting)]


def each_moved(setting: Setting) -> list[str]:
    """Every state that is no disturbance of its own and whose equation may be wrong."""
    return [name for name in setting.moved if name in setting.targets]


def each_pair(setting: Setting) -> Iterator[str]:
    """A state in its own equation, and ``source->target`` where one already feeds the other."""
    states = list(setting.states)
    feeds, _ = setting.feeds
    for i, source in enumerate(states):
        if source in setting.targets:
            yield source
        for j, target in enumerate(states):
            if i != j and target in setting.targets and (feeds[j, i] or feeds[i, j]):
                yield f"{source}->{target}"


def each_path(setting: Setting) -> Iterator[str]:
    """``input->state`` where the input moves the state at once."""
    _, moved = setting.feeds
    inputs = list(setting.model.inputs)
    for i, target in enumerate(setting.states):
        for j, source in enumerate(inputs):
            if moved[i, j] and target in setting.targets and source not in setting.extra:
                yield f"{source}->{target}"


# A maker of a kind that enters at single channels: (setting, channel, name of the size) -> the effect.
ByName: TypeAlias = Callable[[Setting, str, str], Effect | None]


def at_outputs(kind: str, make: ByName, channels: Channels = each_output) -> Kind:
    """A kind that enters at outputs."""
    return at_any(kind, make, channels, lambda setting: setting.model.outputs)


def at_inputs(kind: str, make: ByName) -> Kind:
    """The same for inputs."""
    return at_any(kind, make, each_input, lambda setting: setting.model.inputs)


def at_states(kind: str, make: ByName) -> Kind:
    """The same for states."""
    return at_any(kind, make, each_state, lambda setting: setting.states)


def at_signals(kind: str, make: ByName, channels: Channels = each_signal) -> Kind:
    """The same for outputs and states."""
    return at_any(kind, make, channels, lambda s: {**s.model.outputs, **s.states})


def at_parameters(kind: str, make: ByName, channels: Channels) -> Kind:
    """The same for parameters."""
    return at_any(kind, make, channels, lambda setting: setting.model.parameter_names)


def at_terminals(kind: str, make: ByName) -> Kind:
    """The same for inputs and outputs."""
    return at_any(kind, make, each_terminal, lambda s: {**s.model.inputs, **s.model.outputs})


def at_pairs(
    kind: str, make: Callable[[Setting, str, str, str, str], Effect | None], channels: Channels
) -> Kind:
    """A kind by which one state acts on another, or on itself: ``source->target``, or the state.

    ``make(setting, channel, name of the size, source, target)``.
    """

    def maker(setting: Setting, channel: str) -> Effect | None:
        source, _, target = channel.partition("->")
        target = target or source
        if not {source, target} <= set(setting.states):
            return None
        return make(setting, channel, setting.identifier(kind, channel), source, target)

    return kind, maker, channels


def at_any(
    kind: str, make: ByName, channels: Channels, there: Callable[[Setting], Container[str]]
) -> Kind:
    """The same for those channels that are ``there``; ``channels`` are those it is tried on."""

    def maker(setting: Setting, channel: str) -> Effect | None:
        if channel not in there(setting):
            return None
        return make(setting, channel, setting.identifier(kind, channel))

    return kind, maker, channels
