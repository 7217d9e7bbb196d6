"""A registered model by name, with effects of the catalogue put in."""

from __future__ import annotations

from collections.abc import Sequence

from engine import registry
from engine.diagnose.catalogue import extend
from engine.model import MixedModel


def get_model(name: str, effects: Sequence[str] | None = None) -> MixedModel:
    """The registered model ``name``, extended by ``effects`` such as ``["coulomb:velocity"]``.

    What a diagnosis adopted is an ordinary model like any other. Raises OptionError naming the
    models, or the effects and channels, there are.
    """
    return extend(registry.get_model(name), effects or ())
