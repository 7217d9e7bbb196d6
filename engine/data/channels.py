"""Whether the channels of a series are those of a model: their number, names, order and units."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from engine.errors import SeriesError
from engine.units import Suffix, differ, same_kind, unit_behind

if TYPE_CHECKING:
    from engine.data.series import Series
    from engine.statespace.base import BaseModel


def default_names(n: int, prefix: str) -> tuple[str, ...]:
    """Names of n channels that nobody named: y, or y1, y2, ..."""
    return tuple(f"{prefix}{i + 1}" if n > 1 else prefix for i in range(n))


def check_channels(series: Series, model: BaseModel) -> None:
    """Raise SeriesError unless the channels are the model's, in their order.

    Names are free, but for those of the model's own channels: these belong where the model has them, and so
    does a name with one of them in it, as ``speed_measured`` has it.
    """
    for names, own, what in _kinds(series, model):
        if len(names) != len(own):
            hint = (
                "; give those that it does not use apart, as extra=, and a diagnosis tests whether they belong"
                if what == "u" and len(names) > len(own)
                else ""
            )
            raise SeriesError(
                f"{what} has {len(names)} channels; model '{model.name}' needs "
                f"{len(own)} ({', '.join(own) or 'none'}){hint}"
            )
        check_order(names, own, what, model)
    check_units(series, model)


def check_order(
    names: tuple[str, ...], own: Mapping[str, str], what: str, model: BaseModel
) -> None:
    """Raise SeriesError where one of the names, as many as the ``own`` channels, is that of another channel."""
    if names == default_names(len(names), what):
        return
    for name, channel in zip(names, own, strict=True):
        elsewhere = name != channel and name in {**model.outputs, **model.inputs}
        if elsewhere or _meant(name, own) not in (None, channel):
            raise SeriesError(
                f"{what} has channels {', '.join(names)}; model '{model.name}' takes {', '.join(own)}, in "
                f"this order, and '{name}' would be used as '{channel}': reorder the columns or rename them"
            )


def _meant(name: str, own: Mapping[str, str]) -> str | None:
    """The model's channel that a name has in it as a word; None where it has none, or several."""

    def has(channel: str) -> bool:
        word = rf"(?<![^\W_]){re.escape(channel)}(?![^\W_])"
        return re.search(word, name, re.IGNORECASE) is not None

    found = [channel for channel in own if has(channel)]
    return found[0] if len(found) == 1 else None


def check_units(series: Series, model: BaseModel) -> None:
    """Raise SeriesError where a channel's unit is surely not that of the model, see :func:`differ`.

    The series may lack channels; those that have the model's names are told by these. A name with a unit behind
    that of the channel tells it, too, ``y_mm``, if it is of the same kind: ``T_h`` may be the hot one.
    """
    for names, own, what in _kinds(series, model):
        for name, placed in zip(names, own, strict=False):
            channel = name if name in own else placed
            unit = own[channel]
            told = series.units.get(name, unit_behind(name, channel) or unit)
            part_of_name = isinstance(told, Suffix) and not same_kind(told, unit)
            if unit and not part_of_name and differ(told, unit):
                raise SeriesError(
                    f"channel '{name}' is in {told or '1'}; model '{model.name}' takes {what} "
                    f"channel '{channel}' in {unit}: convert the values, or leave the unit away"
                )


def _kinds(
    series: Series, model: BaseModel
) -> Iterator[tuple[tuple[str, ...], Mapping[str, str], str]]:
    """Names in the series, {channel: unit} of the model, and what they are, of outputs and of inputs."""
    yield series.y_names, model.outputs, "y"
    yield series.u_names, model.inputs, "u"
