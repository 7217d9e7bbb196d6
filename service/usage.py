"""What ``python -m service --help`` prints: the settings as their class has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, Field, fields
from typing import Any

from service.settings import Settings

USAGE = "usage: python -m service [--help]"
HELP = ("-h", "--help")


def told(arguments: Sequence[str]) -> str | None:
    """The help where it is asked for, None where nothing is. Raises ValueError at any other argument."""
    if not arguments:
        return None
    if all(one in HELP for one in arguments):
        return text()
    wrong = next(one for one in arguments if one not in HELP)
    raise ValueError(f"unknown argument '{wrong}'; settings are environment variables\n{USAGE}")


def text() -> str:
    """The usage, and all settings with what they are by default."""
    lines = [f"  RBPS_{one.name.upper()}={_default(one)}" for one in fields(Settings)]
    said = "Serves jobs and pages over HTTP until a signal comes. Settings, which are environment variables:"
    return "\n".join([USAGE, "", said, "", *lines])


def _default(one: Field[Any]) -> str:
    value = one.default
    if value is MISSING and one.default_factory is not MISSING:
        value = one.default_factory()
    return "" if value is None else str(value)
