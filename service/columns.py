"""Which column of a file is which channel of a model: one answer for command line, upload and page.

In this order: a column of the channel's name; of that name with ``y_`` or ``u_`` before it, as written
files have it; of that name with a unit behind it (``voltage_V``), where there is only one; the columns
called y... or u..., where they are as many as the channels; the only column of numbers that is left, for
the only output that is left. A column that is called as times are is a channel only of exactly that name. The
page does the same in ``static/start/match.js``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from engine.data.by_column import names_and_times
from engine.data.files import is_channel
from engine.data.series import Series
from engine.data.stamps import candidates, column_counts, like_times
from engine.data.table import Table
from engine.statespace.base import BaseModel
from engine.units import alike, unknown_unit

Test = Callable[[str, str, str], bool]  # column, channel, y or u


def match(
    table: Table,
    outputs: Iterable[str],
    inputs: Iterable[str],
    given: Mapping[str, str],
    other: Collection[str] = (),
) -> dict[str, str]:
    """{channel: column}, with what is ``given``, for all channels that have a column.

    ``other`` are columns that are something else.
    """
    found = dict(given)
    roles = {"y": list(outputs), "u": list(inputs)}
    taken = {*found.values(), *other}
    times = candidates(table, [*roles["y"], *roles["u"]])
    left = [name for name in table.columns if name not in taken and name not in times]

    def take(channel: str, column: str) -> None:
        found[channel] = column
        left.remove(column)

    for test in _BY_NAME:
        for prefix, channels in roles.items():
            for channel in channels:
                named = [column for column in left if test(column, channel, prefix)]
                if channel not in found and len(named) == 1:
                    take(channel, named[0])
    for prefix, channels in roles.items():
        open_ = [channel for channel in channels if channel not in found]
        array = table.groups.get(prefix, [])
        called = [
            name for name in left if (name in array if len(array) > 1 else is_channel(name, prefix))
        ]
        if len(called) == len(open_):
            for channel, column in zip(open_, called, strict=True):
                take(channel, column)
    open_ = [channel for channels in roles.values() for channel in channels if channel not in found]
    if len(open_) == 1 and open_[0] in roles["y"]:
        numbers = [column for column in left if column_counts(table, column) is False]
        if len(numbers) == 1:
            take(open_[0], numbers[0])
    return found


_BY_NAME: Sequence[Test] = (
    lambda column, channel, prefix: column == channel,
    lambda column, channel, prefix: column.lower() == channel.lower(),
    lambda column, channel, prefix: column.lower() == f"{prefix}_{channel}".lower(),
    lambda column, channel, prefix: (
        column.lower().startswith(channel.lower()) and not column[len(channel) :][:1].isalnum()
    ),
)


def noted(
    table: Table,
    series: Series,
    model: BaseModel,
    read: Mapping[str, str],
    clock: tuple[bool, Collection[str]],
    advice: tuple[str, str, str],
    first: Table,
) -> list[str]:
    """What the reader of a file should know of how it was read, {channel: column}.

    ``clock`` tells whether times or a step were asked for, and which other columns were. The ``advice`` is how
    to give a step, a column of times as ``{}``, and one that tells records apart. ``first`` is the part of the
    table that is the first record, or all of it.
    """
    found = list(table.notes)
    asked, other = clock
    taken = {*read.values(), *other}
    if not asked and table.dt is None and not candidates(table, taken):
        column, why = like_times(first, taken)
        said = f"no column of times: a step of 1 {series.time_unit} is assumed; else {advice[0]}"
        if column:
            said += f", or, as '{column}' {why}, {advice[1].format(column)}"
        elif first is table and (names := names_and_times(table, taken))[0]:
            said += ", or, as '{1}' rises in each record if '{0}' names them, ".format(*names)
            said += f"{advice[2].format(names[0])} and {advice[1].format(names[1])}"
        found.append(f"{said}.")
    units = {**model.outputs, **model.inputs}
    unknown = [
        f"'{unit}' of column '{column}' is taken for {units[channel]}"
        for channel, column in read.items()
        if (unit := unknown_unit(column)) and units[channel] and not alike(unit, units[channel])
    ]
    if unknown:
        found.append(f"units that are not known are compared with none: {', '.join(unknown)}.")
    return found
