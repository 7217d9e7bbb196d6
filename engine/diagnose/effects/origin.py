"""Where an effect counts from: a zero that is known, or a parameter of the effect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Parameter


class Origin:
    """The zero of ``channel`` for the effect whose size is ``name``.

    Where the setting does not know it, the effect gets the last parameter ``<name>_zero``, held at
    ``start`` (default: :meth:`Setting.zero`) until a search frees it; of an effect that counts ``of_several``
    channels ``<name>_zero_<channel>``. Where it may be anywhere, an effect that is proportional to the distance
    from it is looked at from ``outside`` of the record's range, too; one with a shape of its own, from other
    places ``inside``.
    """

    def __init__(
        self,
        setting: Setting,
        name: str,
        channel: str,
        start: float | None = None,
        of_several: bool = False,
    ) -> None:
        self.value = setting.zero(channel) if start is None else start
        self.parameters: tuple[Parameter, ...] = ()
        self.outside: tuple[float, ...] = ()
        self.inside: tuple[float, ...] = ()
        if channel not in setting.known_zeros:
            low, high = setting.inside(channel)
            if start is None:
                self.outside = setting.zeros_outside(channel)
                self.inside = setting.zeros_inside(channel)
            bounds = min((low, self.value, *self.outside)), max((high, self.value, *self.outside))
            what = f"zero of {channel} that it counts from"
            named = f"{name}_zero_{setting.identifier(channel)}" if of_several else f"{name}_zero"
            zero = Parameter(named, self.value, setting.unit(channel), bounds, what)
            self.parameters = (zero,)

    @property
    def name(self) -> str | None:
        """The parameter's name, None where the zero is known."""
        return self.parameters[0].name if self.parameters else None

    def counted(
        self, *parameters: Parameter, probes: Sequence[tuple[float, ...]] = ((),)
    ) -> dict[str, Any]:
        """Members of an :class:`Effect` with these parameters that counts from here."""
        return self.counted_from(*parameters, probes=[(*probe, *self.probe) for probe in probes])

    def counted_from(
        self, *parameters: Parameter, probes: Sequence[tuple[float, ...]]
    ) -> dict[str, Any]:
        """The same with probes that say where each counts from."""
        return {
            "parameters": (*parameters, *self.parameters),
            "probes": tuple(probes),
            "held": tuple(p.name for p in self.parameters),
            "zero": self.name,
        }

    def proportional(self, size: Parameter) -> dict[str, Any]:
        """Members of an effect that is ``size`` times the distance from here."""
        places = [(place,) for place in self.outside]
        return self.counted_from(size, probes=[self.probe, *places])

    @property
    def probe(self) -> tuple[float, ...]:
        """What each probe has for it."""
        return tuple(p.default for p in self.parameters)

    def of(self, own: Sequence[Any]) -> Any:
        """The zero, from the effect's own values."""
        return own[-1] if self.parameters else self.value

    def text(self, channel: str) -> str:
        """The channel counted from its zero, for an equation."""
        if self.parameters:
            return f"({channel} - {self.name})"
        return channel if self.value == 0.0 else f"({channel} - {self.value:g})"
