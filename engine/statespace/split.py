"""The parameters of an extended model, apart: those of the model it was made of and its own."""

from __future__ import annotations

from typing import Any

from engine.statespace.base import BaseModel


class Split:
    """Separates a record of the extended model into the base's record and the extension's values.

    The same record gives the same parts: a model's function knows its last one again.
    """

    def __init__(self, model: BaseModel) -> None:
        self.n = len(model.parameters)
        self.base = model.record
        self.last: tuple[Any, Any, Any] = (None, None, None)

    def __call__(self, theta: Any) -> tuple[Any, Any]:
        """(base record, the extension's own values)."""
        known, record, own = self.last
        if known is not theta:
            record, own = self.base(theta[: self.n]), theta[self.n :]
            self.last = (theta, record, own)
        return record, own
