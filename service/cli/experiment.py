"""The options that an estimation and a diagnosis share: the model, its parameters, where the data are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from service.cli.references import absolute
from service.cli.state_file import Sealed
from service.cli.values import names, numbers, pairs


@dataclass(kw_only=True)
class Experiment(Sealed):
    """As it was asked for; paths are absolute."""

    model: str
    effects: list[str] = field(default_factory=list)
    start: dict[str, float] = field(default_factory=dict)
    fixed: dict[str, float] = field(default_factory=dict)
    free: list[str] = field(default_factory=list)
    columns: dict[str, str] = field(default_factory=dict)
    time: str | None = None
    dt: float | None = None
    seed: int = 0
    out: str | None = None
    report: str | None = None
    plot: str | None = None
    keep: bool = False  # the state file, when there is nothing to go on with any more


def parsed(
    model: str,
    effects: list[str],
    values: Sequence[str],
    fixed: Sequence[str],
    free: Sequence[str],
    columns: Sequence[str],
    time: str | None,
    dt: float | None,
    seed: int,
    outputs: Mapping[str, str],
) -> dict[str, Any]:
    """Members of :class:`Experiment` from the texts of options; errors name the option."""
    return {
        "model": absolute(model),
        "effects": effects,
        "start": numbers("--set", values),
        "fixed": numbers("--fix", fixed),
        "free": names(free),
        "columns": pairs("--map", columns),
        "time": time,
        "dt": dt,
        "seed": seed,
        **outputs,
    }
