"""The options that an estimation and a diagnosis share: the model, its parameters, where the data are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from engine.data.given import check_apart, same_clock
from engine.data.series import Series
from engine.diagnose.records import on_one_clock
from engine.statespace.model import MixedModel, Theta
from service.cli.files import Columns, series_of
from service.cli.meter import Meter
from service.cli.options import PATHS, full
from service.cli.references import absolute, model_of, with_effects
from service.cli.state_file import Asked, Run
from service.cli.values import free_of, names, numbers, pairs, theta_of


@dataclass(frozen=True)
class Job:
    """What is computed with; ``name`` is that of the registered model, ``free`` None for all parameters."""

    name: str
    model: MixedModel
    series: list[Series]
    test: list[Series]
    theta: Theta
    free: list[str] | None


@dataclass(kw_only=True)
class Experiment(Run):
    """What an estimation and a diagnosis have in common."""

    data: list[str]
    test: list[str] = field(default_factory=list)
    effects: list[str] = field(default_factory=list)
    start: dict[str, float] = field(default_factory=dict)
    fixed: dict[str, float] = field(default_factory=dict)
    columns: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    by: list[str] = field(default_factory=list)
    time_unit: str | None = None
    hold: str | None = None
    name: str = ""
    tags: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # of how the data were read

    def job(self, shown: Meter, extra: Sequence[str] = (), substeps: int = 1) -> Job:
        """The model and the data, read from their files; what was read as what is shown, and noted.

        With so many steps a sample, for which effects that count them are made.
        """
        base = model_of(self.model)
        clock = self.hold, self.time_unit, self.by
        columns = Columns(self.columns, self.time, self.dt, extra, *clock)
        every, self.notes = list[list[Series]](), []
        for name in (*self.data, *self.test):
            series, said, notes = series_of(Path(name), base, columns)
            shown.note(said)
            self.notes += notes
            every.append([one.refined(substeps) if base.continuous else one for one in series])
        for note in self.notes:
            shown.warn(note)
        n = len(self.data)
        given, test = [*chain(*every[:n])], [*chain(*every[n:])]
        same_clock([*given, *test])
        check_apart(given, test)
        if self.effects:
            given, _ = on_one_clock(base, given)
        model = with_effects(base, self.effects, given)
        theta = theta_of(model, self.start, self.fixed)
        free = free_of(model, self.free, list(self.fixed))
        return Job(base.name, model, given, test, theta, free)

    def with_notes(self, document: dict[str, Any]) -> dict[str, Any]:
        """The document with what is to be known of how the data were read."""
        return {**document, "notes": self.notes} if self.notes else document

    def labelled(self, document: dict[str, Any]) -> dict[str, Any]:
        """The document with what tells it apart from others."""
        return {
            "name": self.name,
            "tags": self.tags,
            "data": [Path(one).name for one in self.data],
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            **document,
        }


# How the values of options become members; all others stay as they are.
_READ: dict[str, Callable[[Any], Any]] = {
    "model": absolute,
    "start": partial(numbers, "--set"),
    "fixed": partial(numbers, "--fix"),
    "columns": partial(pairs, "--map"),
    **dict.fromkeys(("free", "tags", "extra", "by", "consider"), names),
    **dict.fromkeys(("data", "test"), lambda paths: [full(path) for path in paths]),
    **dict.fromkeys(PATHS, full),
}


def asked_of(kind: type[Asked], options: Mapping[str, Any]) -> Asked:
    """What a command was asked, from the values of those options that have a member's name.

    Errors name the option.
    """
    members: dict[str, Any] = {}
    for name in (one.name for one in fields(kind)):
        if (value := options.get(name)) is not None:
            members[name] = _READ[name](value) if name in _READ else value
    return kind(**members)
