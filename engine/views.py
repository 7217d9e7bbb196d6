"""Tables and pictures of results, found when they are asked for.

A result has ``plot()`` and shows itself in a notebook, but nothing that computes imports what draws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.errors import OptionError

if TYPE_CHECKING:
    from engine.presentation.display import View as View
    from engine.presentation.plots import Figures as Figures
else:
    Figures = View = Any


def view(name: str) -> Any:
    """A module of :mod:`engine.presentation` by its name."""
    return import_module(f"engine.presentation.{name}")


def plots() -> Any:
    """The module :mod:`engine.presentation.plots`; drawing needs the extra ``plot``."""
    return view("plots")


def tables() -> Any:
    """The module :mod:`engine.presentation.display`, whose parts :func:`sheet` puts together."""
    return view("display")


def figures(*groups: Any, **named: Any) -> Figures:
    """Figures by their names, as ``plot()`` returns them."""
    out: Figures = plots().Figures(*groups, **named)
    return out


def sheet(title: str, *parts: Any) -> View:
    """A heading and what follows it, as a result shows itself."""
    out: View = tables().show(title, *parts)
    return out


def html(title: str, *parts: Any) -> str:
    """The same for a notebook."""
    return sheet(title, *parts).html()


def frame(columns: dict[str, Any], index: dict[str, Any]) -> Any:
    """A pandas table of columns (n,) over one named index. Raises OptionError without pandas."""
    try:
        pandas = import_module("pandas")
    except ImportError:
        raise OptionError(
            "to_frame() needs pandas, which is not installed: pip install pandas", "to_frame"
        ) from None
    ((name, values),) = index.items()
    return pandas.DataFrame(columns, index=pandas.Index(values, name=name))


def save(found: Any, path: str | Path) -> Path:
    """Write a result with its model, see :mod:`engine.saved`."""
    written: Path = import_module("engine.saved").save(found, path)
    return written


class Shown:
    """A result that shows itself: by ``print`` and in a notebook as a short table, in a list as one line."""

    def _view(self) -> View:
        """What is shown; here the members with their shapes."""
        rows = [(name, _what(value)) for name, value in vars(self).items() if name[0] != "_"]
        return sheet(type(self).__name__, tables().table(("member", ""), rows))

    def __str__(self) -> str:
        return self._view().text()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._view().title}>"

    def _repr_html_(self) -> str:
        return self._view().html()

    def __init_subclass__(cls) -> None:
        # A dataclass would write all its arrays into its own.
        cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]


def _what(value: Any) -> str:
    """A member of a result in a few words."""
    shape = getattr(value, "shape", None)
    if shape:
        return f"array {tuple(shape)}"
    if isinstance(value, (list, tuple, dict)) and value:
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)[:60]
