"""Sizes."""

from __future__ import annotations

from engine.studies.foreign.cells import Cell


def size_of(cell: Cell) -> float:
    """The size."""
    return 0.0 if cell.what is None else cell.what.first
