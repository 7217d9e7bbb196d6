"""What the answers mean, where they are not what is documented."""

from __future__ import annotations

LOOKED_AT: dict[str, str] = {}
