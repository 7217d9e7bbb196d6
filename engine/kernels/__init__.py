"""Numba kernels: arrays in, arrays out, no model inside."""

from pathlib import Path

from engine.kernels.categorical import pick_each
from engine.kernels.stale import discard_stale

_stats = getattr(pick_each, "stats", None)  # None where Numba is switched off
if _stats is not None and _stats.cache_path:
    discard_stale(Path(__file__).parent, Path(_stats.cache_path))  # before any kernel is called
