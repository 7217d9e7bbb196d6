"""Tables and pictures of results, found when they are asked for.

A result has ``plot()`` and shows itself in a notebook, but nothing that computes imports what draws.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.presentation.plots import Figures as Figures
else:
    Figures = Any


def view(name: str) -> Any:
    """A module of :mod:`engine.presentation` by its name."""
    return import_module(f"engine.presentation.{name}")


def plots() -> Any:
    """The module :mod:`engine.presentation.plots`; drawing needs the extra ``plot``."""
    return view("plots")


def tables() -> Any:
    """The module :mod:`engine.presentation.display`, whose parts :func:`html` puts together."""
    return view("display")


def figures(*groups: Any, **named: Any) -> Figures:
    """Figures by their names, as ``plot()`` returns them."""
    out: Figures = plots().Figures(*groups, **named)
    return out


def html(title: str, *parts: str) -> str:
    """A heading and what follows it, for a notebook."""
    out: str = tables().show(title, *parts)
    return out
