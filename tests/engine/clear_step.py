"""The Nile's flows with a step that nobody could miss.

That of the real ones is near the level of the test, so that sixty simulations are searched to tell its p-value.
"""

from __future__ import annotations

from engine.data import nile
from engine.data.series import Series


def clear_flows(more: float = 200.0) -> Series:
    """Flows from 1899 on lower by as many 1e8 m^3 more."""
    flows = nile()
    return flows.replace(y=flows.y - more * (flows.t >= 1899.0)[:, None])
