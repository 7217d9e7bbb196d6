"""Smoothed moments of any smoother, as an E step takes them."""

from __future__ import annotations

from dataclasses import dataclass

from engine.statespace.model import Array


@dataclass(frozen=True, eq=False)
class Moments:
    """Smoothed moments from any E step; the same fields as :class:`engine.smoothers.rb_ffbsi.Smoothed`."""

    a: Array
    z: Array
    cov: Array
    cross: Array
