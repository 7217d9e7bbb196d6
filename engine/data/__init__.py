"""Data sets that come with the engine."""

from __future__ import annotations

from importlib import resources

from engine.data.files import read_table, series_from
from engine.data.series import Series


def nile() -> Series:
    """Annual discharge of the Nile at Aswan, 1871-1970, in 1e8 m^3; 100 values, public domain.

    Times count years: t = 1871, 1872, ... Nothing in ``local-level`` depends on the time step.
    """
    data = (resources.files("engine.data") / "nile.csv").read_bytes()
    return series_from(read_table(data, "nile.csv"), y=["flow"], t="year")
