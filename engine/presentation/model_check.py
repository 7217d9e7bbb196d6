"""What the check of a model says, in sentences."""

from __future__ import annotations

import numpy as np

from engine.errors import EngineError
from engine.filters.linearity import why_not_linear
from engine.statespace.checks import Tried, check_model
from engine.statespace.model import MixedModel
from engine.words import enumerated

TRIED_ROWS = 2  # parameter vectors, and times, that a function is asked about at once


def model_check(model: MixedModel) -> list[str]:
    """What can be said of a model at its default parameters, with inputs of 0 and dt = 1 s.

    Where it cannot be calculated with these, other inputs and shorter steps are tried.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).

    Returns
    -------
    list of str
        Sentences: whether its functions can be used, which methods fit it, what is missing.
    """
    try:
        tried = check_model(model)
    except EngineError as error:
        return [f"Cannot be used: {error}"]
    inputs = enumerated([f"{one:g}" for one in np.unique(tried.u)]) or "0"
    said = [
        "Shapes, values and covariances are right at the default parameters, with inputs of "
        f"{inputs} and a step of {tried.dt:g}, in the unit of its times.",
        _method(model),
        *_calls(model, tried),
    ]
    if not model.continuous:
        said.append(
            "It is a model of steps from one sample to the next: a diagnosis makes one step a sample. One of "
            "differential equations (engine.continuous) is integrated as finely as the effects need."
        )
    endless = [p.name for p in model.parameters if not np.isfinite(p.bounds).all()]
    if endless:
        said.append(f"Without bounds on both sides: {enumerated(endless)}.")
    if not model.equations:
        said.append(
            "It lists no equations: MixedModel(equations=[...]) shows them on pages and reports."
        )
    return said


def _method(model: MixedModel) -> str:
    why = why_not_linear(model)
    if not why:
        return (
            "Linear and Gaussian where it was looked at, with three inputs: there the method rts-em "
            "is exact, without random numbers; on data it says where it is not. Where it does not settle, as "
            "with little noise, the default method may."
        )
    reason = why.partition("Gaussian: ")[2] or why
    return (
        f"Not linear and Gaussian ({reason}), so particles are needed: the methods quasi-newton and rbps-em "
        "apply, the exact rts-em does not."
    )


def _calls(model: MixedModel, tried: Tried) -> list[str]:
    """Which functions need a call for each parameter vector."""
    theta = model.theta()
    second = np.where(theta == 0.0, 0.5, 0.9 * theta).clip(model.lower, model.upper)
    record = model.records(np.array([theta, second]))
    start = model.start(model.record(theta))
    a = np.asarray(start.density.sample(np.random.default_rng(0), TRIED_ROWS), dtype=float)
    slow = []
    for name, function in (("dynamics", model.transitions), ("measurement", model.observations)):
        try:
            if not function.takes(a, tried.u, 0.0, tried.dt, record):
                slow.append(name)
        except EngineError:  # at the second vector it cannot be calculated
            continue
    if not slow:
        return []
    take = "takes" if len(slow) == 1 else "take"
    return [f"{enumerated(slow)} {take} one parameter vector in a call: as right, and slower."]
