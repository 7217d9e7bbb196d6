"""All effects that can be asked of a model, and how to get one by its name.

An effect is written ``kind:channel``. A channel is the name of a state, input, output or parameter of
the model; ``source->target`` puts a function of one state into the equation of another. Kinds come
from makers registered with :func:`register_effect`, those shipped and anybody's own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from engine.diagnose.effects.channels import Channels, Kind, Maker
from engine.diagnose.effects.effect import Effect, worded_for
from engine.diagnose.effects.kinds.bend import KINDS as BEND
from engine.diagnose.effects.kinds.bend import straight_of
from engine.diagnose.effects.kinds.cogging import KINDS as COGGING
from engine.diagnose.effects.kinds.colored import KINDS as COLORED
from engine.diagnose.effects.kinds.delays import KINDS as LATE
from engine.diagnose.effects.kinds.dynamic import KINDS as MEMORY
from engine.diagnose.effects.kinds.first_state import KINDS as FIRST_STATE
from engine.diagnose.effects.kinds.gain_steps import KINDS as GAIN_STEPS
from engine.diagnose.effects.kinds.held import KINDS as HELD
from engine.diagnose.effects.kinds.hysteresis import KINDS as HYSTERESIS
from engine.diagnose.effects.kinds.input_friction import KINDS as INPUT_FRICTION
from engine.diagnose.effects.kinds.inputs import KINDS as INPUT
from engine.diagnose.effects.kinds.measurement import KINDS as MEASUREMENT
from engine.diagnose.effects.kinds.noise import KINDS as NOISE
from engine.diagnose.effects.kinds.overflow import KINDS as OVERFLOW
from engine.diagnose.effects.kinds.parameters import KINDS as OF_PARAMETERS
from engine.diagnose.effects.kinds.paths import KINDS as PATHS
from engine.diagnose.effects.kinds.play import KINDS as PLAY
from engine.diagnose.effects.kinds.products import KINDS as PRODUCTS
from engine.diagnose.effects.kinds.slopes import KINDS as SLOPES
from engine.diagnose.effects.kinds.slow_input import KINDS as SLOW_INPUT
from engine.diagnose.effects.kinds.slow_sensor import KINDS as SLOW_SENSOR
from engine.diagnose.effects.kinds.state import KINDS as STATE
from engine.diagnose.effects.kinds.tails import KINDS as TAILS
from engine.diagnose.effects.kinds.time import KINDS as TIME
from engine.diagnose.effects.kinds.time_step import KINDS as TIME_STEP
from engine.diagnose.effects.setting import Setting
from engine.errors import OptionError
from engine.statespace.model import MixedModel
from engine.words import meant

SHIPPED: tuple[Kind, ...] = (
    *STATE,
    *PRODUCTS,
    *OVERFLOW,
    *COGGING,
    *MEMORY,
    *HYSTERESIS,
    *MEASUREMENT,
    *LATE,
    *SLOW_SENSOR,
    *SLOW_INPUT,
    *PLAY,
    *NOISE,
    *COLORED,
    *TAILS,
    *INPUT,
    *INPUT_FRICTION,
    *PATHS,
    *TIME,
    *OF_PARAMETERS,
    *SLOPES,
    *BEND,
    *GAIN_STEPS,
    *TIME_STEP,
    *FIRST_STATE,
    *HELD,
)

COUNTING = ("lag", "delay", "play")  # kinds that count samples, and so have to know them

_makers: dict[str, tuple[Maker, Channels]] = {kind: (make, where) for kind, make, where in SHIPPED}


def register_effect(kind: str, maker: Maker, channels: Channels, replace: bool = False) -> None:
    """Make a kind of effect known to the catalogue.

    Parameters
    ----------
    kind : str
        The name before the colon in ``kind:channel``.
    maker : callable
        ``maker(setting, channel)`` returns an :class:`engine.diagnose.Effect`, or None where the effect cannot
        enter that channel.
    channels : callable
        ``channels(setting)`` lists the channels that the effect may enter, for the model in ``setting``.
    replace : bool
        Whether a kind of that name may be replaced.

    Raises
    ------
    OptionError
        The kind is registered already.
    """
    if kind in _makers and not replace:
        raise OptionError(f"an effect of kind '{kind}' is already registered", "effects")
    _makers[kind] = (maker, channels)


def effect_kinds() -> list[str]:
    """The kinds there are, sorted."""
    return sorted(_makers)


def make_effect(name: str, setting: Setting) -> Effect:
    """The effect ``kind:channel`` for a model. Raises OptionError naming what there is."""
    kind, _, channel = name.partition(":")
    if kind not in _makers:
        raise OptionError(
            f"effect '{name}' is not known{meant(name, _makers)}; kinds are {', '.join(sorted(_makers))}",
            "effects",
        )
    if kind in COUNTING and not setting.tells_samples:
        raise OptionError(
            f"effect '{name}' counts samples, which are at no common step here and have {setting.substeps} "
            "steps each; it needs samples at a common step, or about such, and one step each",
            "effects",
        )
    effect = _made(kind, setting, channel)
    if effect is None:
        there = ", ".join(_makers[kind][1](setting)) or "none"
        raise OptionError(
            f"effect '{kind}' cannot enter model '{setting.model.name}' at '{channel}'; "
            f"channels are {there}",
            "effects",
        )
    return effect


def _made(kind: str, setting: Setting, channel: str) -> Effect | None:
    key = _makers[kind][0], channel
    if key not in setting.made:  # the steps of a search ask for the same ones
        effect = key[0](setting, channel)
        setting.made[key] = effect and worded_for(setting.model, effect)
    made: Effect | None = setting.made[key]
    return made


def all_effects(setting: Setting, kinds: Sequence[str] | None = None) -> list[Effect]:
    """Every effect of the catalogue for a model but those it has; ``kinds`` restricts to kinds or names.

    None of a state that only scales noise: nothing physical acts on it.
    """
    there = set(setting.model.parameter_names)
    return [e for e in _every(setting, kinds) if there.isdisjoint(p.name for p in e.parameters)]


def shadowed(setting: Setting, kinds: Sequence[str] | None = None) -> list[str]:
    """Names of effects that the model lacks, and that are not looked for as its parameters have their names."""
    there = set(setting.model.parameter_names)
    has = {
        line.partition(": ")[0] for line in setting.model.equations
    }  # as those it was extended by
    return [
        e.name
        for e in _every(setting, kinds)
        if e.name not in has and not there.isdisjoint(p.name for p in e.parameters)
    ]


def _every(setting: Setting, kinds: Sequence[str] | None) -> Iterator[Effect]:
    """The effects of these kinds, also those that the model has.

    And those asked for by name that no kind lists, as a product of two inputs.
    """
    scales, seen = set(setting.model.scale_states), set[str]()
    families = {name.partition(":")[0] for name in kinds or _makers}
    for kind, (_, channels) in _makers.items():
        if kind in COUNTING and not setting.tells_samples:
            continue
        if families.isdisjoint({kind, *straight_of(kind, "")}):
            continue  # before its channels, some of which are found by evaluating the model
        for channel in dict.fromkeys([*channels(setting), *_channels_named(kind, kinds)]):
            asked = {kind, f"{kind}:{channel}", *straight_of(kind, channel)}
            if kinds is not None and asked.isdisjoint(kinds):
                continue
            if not scales.isdisjoint(re.split(r"->|,|\*", channel)):
                continue
            effect = _made(kind, setting, channel)
            if effect is not None and effect.name not in seen:
                seen.add(effect.name)
                yield effect


def _channels_named(kind: str, kinds: Sequence[str] | None) -> list[str]:
    """The channels of a kind among names ``kind:channel``."""
    names = (name.partition(":") for name in kinds or ())
    return [channel for one, sign, channel in names if sign and one == kind]


def unmade(setting: Setting, kinds: Sequence[str] | None) -> list[str]:
    """Names ``kind:channel`` among these that no effect of this model has."""
    return [
        name
        for name in kinds or ()
        if (kind := name.partition(":")[0]) != name
        and _made(kind, setting, name.partition(":")[2]) is None
    ]


def extend(model: MixedModel, effects: Sequence[str], setting: Setting | None = None) -> MixedModel:
    """The model with effects applied one after the other, by name."""
    if not effects:  # to look where channels have their zeros would take calls of the model
        return model
    known = (setting or Setting(model)).keeping_zeros()
    for name in effects:
        model = make_effect(name, replace(known, model=model)).apply(model)
    return model
