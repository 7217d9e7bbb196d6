"""Drawing with matplotlib, imported only here and only when something is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.studies.study import StudyError


def axes(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, list[Any]]:
    """A figure and its panels in reading order. Raises StudyError without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise StudyError("plots need matplotlib: pip install 'rbps[plot]'") from error
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False)
    return figure, list(panels.ravel())


def save(figure: Any, path: Path) -> None:
    """Write a PNG that is the same file for the same figure."""
    figure.savefig(path, dpi=110, metadata={"Software": None})
