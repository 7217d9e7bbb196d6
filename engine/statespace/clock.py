"""Whether a model's units count time as a record does."""

from __future__ import annotations

from collections.abc import Sequence

from engine.data.series import Series
from engine.statespace.model import MixedModel
from engine.units import SECOND, is_per, product, rate_of


def about_clock(model: MixedModel, all_series: Sequence[Series]) -> str:
    """A sentence where a unit of the model counts time otherwise than the records; "" where none does."""
    clock, parameters = all_series[0].time_unit, {p.name: p.unit for p in model.parameters}
    channels = {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}
    rates = list(parameters.values())
    own = any(is_per(unit, clock) for unit in rates)
    inputs = [unit for unit in model.inputs.values() if is_per(unit, SECOND)]
    other = any(is_per(unit, SECOND) and not _cancels(unit, inputs) for unit in rates)
    if own and not other:
        return ""  # its rates are the record's; a channel may well be counted per second
    found = {k: unit for k, unit in (channels | parameters).items() if is_per(unit, SECOND)}
    counted = SECOND
    if clock == SECOND and found:
        return ""
    if not found:  # a channel may well be counted per minute by equations in seconds
        found = {k: unit for k, unit in parameters.items() if rate_of(unit)}
        counted = next(map(rate_of, found.values()), "")
    if not found:
        return ""
    name, unit = next(iter(found.items()))
    return (
        f"Times are in {clock}, and model '{model.name}' has {name} in {unit}: its numbers are right only if "
        f"its equations convert, or give the times in {counted}."
    )


def _cancels(unit: str, inputs: Sequence[str]) -> bool:
    """Whether a coefficient has its seconds from an input, as a loss per wind speed has them in W s/m^3/K.

    What it multiplies the input to counts no seconds, so it says nothing of what the equations count.
    """
    return any(not is_per(product(unit, of), SECOND) for of in inputs)
