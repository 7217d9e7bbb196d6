"""What is to be said of an estimate next to where the model cannot be had."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.expectation import parameter_scale
from engine.statespace.checks import failure, with_least_noise
from engine.statespace.model import MixedModel, Theta
from engine.words import enumerated, number

BESIDE = 1e-3  # of a parameter's size: so near an edge is what stopped it


def about_edges(
    model: MixedModel, theta: Theta, free: Sequence[str], all_series: Sequence[Series]
) -> str:
    """A sentence with the function's error where free parameters are next to values it fails at, else ""."""
    places, first = [], ""
    indices = model.free_indices(free)
    # that bound is told
    model = with_least_noise(model, np.asarray(theta), indices, all_series)
    for k in indices.tolist():
        reach = BESIDE * parameter_scale(model, np.asarray(theta), k)
        for there in (max(theta[k] - reach, model.lower[k]), min(theta[k] + reach, model.upper[k])):
            tried = np.array(theta)
            tried[k] = there
            try:
                failed = failure(model, tried, all_series)
            except ModelError as error:
                failed = error
            if failed is not None:
                places.append(f"{theta.names[k]} = {number(there, 4)}")
                first = first or str(failed)
    if not places:
        return ""
    return (
        f"The estimate is next to where the model cannot be had, at {enumerated(places)}, and the maximum may "
        f"lie there. {first[0].upper()}{first[1:]}."
    )
