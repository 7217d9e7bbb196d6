"""Two results side by side: parameters with errors, log-likelihoods, held-out errors, curves; as data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from engine.errors import OptionError
from engine.units import SECOND

Document = Mapping[str, Any]
Curve = Sequence[float | None]
SAME = 1e-6  # relative difference of numbers that were rounded for documents


def compare_results(one: Document, other: Document) -> dict[str, Any]:
    """Two result documents of any kind as one.

    ``parameters`` holds each parameter of either, with ``values`` [one, other], None where it has none,
    their ``difference`` and that in units of the larger standard error, ``in_errors``. ``same_data`` and
    ``same_held_out`` say whether readings are the same (None: not known); numbers that depend on them are
    only comparable where they are. ``curves`` holds, for each series and output or state, what was measured
    and what each result says. Raises OptionError for a document that holds no result.
    """
    both = [_numbers(document) for document in (one, other)]
    clocks = {each["time_unit"] for each in both}
    if len(clocks) > 1:
        raise OptionError(
            f"times of one result are in {', of the other in '.join(sorted(clocks))}", "result"
        )

    def beside(key: str) -> list[Any]:
        return [each[key] for each in both]

    curves, numbers = beside("curves"), ("outputs", "samples", "log_density")
    return {
        "time_unit": clocks.pop(),
        "models": beside("model"),
        "outcome": beside("outcome"),
        "methods": beside("method"),
        "parameters": list(_parameters(beside("parameters"))),
        "free_parameters": beside("free"),
        "same_data": _same_readings(curves, "simulation"),
        "log_likelihood": beside("log_likelihood"),
        "same_held_out": _same_readings(curves, "held-out"),
        "held_out": [one and {key: one[key] for key in numbers} for one in beside("held_out")],
        "curves": list(_beside(curves)),
    }


def likelihood_difference(c: Document) -> tuple[float, float | None] | None:
    """How much larger the other's log-likelihood is, and the Monte Carlo error of that, if there is one.

    None where they are not known, or not known to be of the same data.
    """
    pair = c["log_likelihood"]
    if not c["same_data"] or None in pair or None in [one["value"] for one in pair]:
        return None
    error = math.hypot(*(one.get("standard_error") or 0.0 for one in pair))
    return pair[1]["value"] - pair[0]["value"], error or None


def _numbers(document: Document) -> dict[str, Any]:
    """The few figures by which results of any kind are compared."""
    if diagnosis := document.get("diagnosis"):
        return _of_diagnosis(diagnosis)
    if not any(document.get(name) for name in ("estimate", "parameters", "states", "simulation")):
        raise OptionError(
            "there is no estimate, diagnosis, simulation or state to compare", "result"
        )
    estimate = document.get("estimate")
    parameters = estimate or {
        name: {"value": value, "fixed": True}
        for name, value in (document.get("parameters") or {}).items()
    }
    held = document.get("held_out") or {}
    return {
        "model": (document.get("model") or {}).get("name", ""),
        "parameters": parameters,
        "free": sum(not one.get("fixed") for one in parameters.values()) if estimate else None,
        "time_unit": document.get("time_unit") or SECOND,
        "log_likelihood": document.get("log_likelihood"),
        "outcome": document.get("outcome"),
        "method": document.get("method"),
        "held_out": held or None,
        "curves": [*_curves_of(document), *_held_out_curves(held)],
    }


def _of_diagnosis(d: Document) -> dict[str, Any]:
    """The extended model; its gain on held-out data."""
    extension, gain, outputs = d["extension"], d.get("gain") or {}, d["channels"]["outputs"]
    errors = extension["standard_errors"]
    parameters = {
        name: {
            "value": value,
            "standard_error": errors.get(name),
            "unit": extension["units"].get(name, ""),
            "fixed": name not in errors,
        }
        for name, value in extension["theta"].items()
    }
    seen = d["symptoms"]["one_step"]["curves"]
    run = (d["symptoms"]["free_run"] or {}).get("curves") or {}
    held = gain.get("curves") or {"measured": {}}
    curves = [
        _curve("simulation", 0, name, outputs, seen["t"], run.get("y", {}).get(name), measured)
        for name, measured in seen["measured"].items()
    ] + [
        _curve("held-out", 0, name, outputs, held["t"], (held["after"] or {}).get(name), measured)
        for name, measured in held["measured"].items()
    ]
    found = [
        {"output": o["output"], "unit": o["unit"], "rmse": o["rmse_after"], "fit": o["fit_after"]}
        for o in gain.get("outputs", ())
    ]
    reference = extension["model"]
    return {
        "model": "+".join([reference["name"], *reference["with"]]),
        "parameters": parameters,
        "free": len(errors),
        "time_unit": d.get("time_unit") or SECOND,
        "log_likelihood": None,
        "outcome": d["verdict"],
        "method": None,
        "held_out": {"samples": gain["samples"], "log_density": None, "outputs": found}
        if found
        else None,
        "curves": curves,
    }


# ---- parameters -----------------------------------------------------------------------------------


def _parameters(both: Sequence[Document]) -> Iterator[dict[str, Any]]:
    for name in dict.fromkeys([*both[0], *both[1]]):
        pair = [each.get(name) for each in both]
        units = [one.get("unit", "") for one in pair if one]
        row: dict[str, Any] = {
            "name": name,
            "unit": next(filter(None, units), ""),
            "values": [one and one["value"] for one in pair],
            "standard_errors": [one and one.get("standard_error") for one in pair],
            "held": [bool(one and one.get("fixed")) for one in pair],
            "silent": [bool(one and one.get("silent")) for one in pair],
            "difference": None,
            "in_errors": None,
        }
        if None not in row["values"]:
            row["difference"] = row["values"][1] - row["values"][0]
            errors = [e for e in row["standard_errors"] if e is not None and e > 0.0]
            compared = errors and not any(
                row["silent"]
            )  # a start that nothing moved is no estimate
            row["in_errors"] = row["difference"] / max(errors) if compared else None
        yield row


# ---- curves ---------------------------------------------------------------------------------------


def _curve(
    what: str,
    series: int,
    name: str,
    units: Mapping[str, str],
    t: list[float],
    y: Curve | None,
    measured: Curve | None = None,
) -> dict[str, Any]:
    """What a result says of a channel of a series over times t (n,), and what was measured."""
    unit = units.get(name, "")
    key = (what, series, name)
    return {"key": key, "unit": unit, "t": t, "y": y, "measured": measured}


def _curves_of(document: Document) -> Iterator[dict[str, Any]]:
    """Simulations, then smoothed states."""
    units = (document.get("model") or {}).get("outputs", {})
    for i, one in enumerate((document.get("examination") or {}).get("series", ())):
        run = (one.get("free_run") or {}).get("curves")
        seen = run or (one.get("one_step") or {}).get("curves") or {"measured": {}}
        for name, measured in seen["measured"].items():
            y = run["y"][name] if run else None
            yield _curve("simulation", i, name, units, seen["t"], y, measured)
    for i, one in enumerate((document.get("simulation") or {}).get("series", ())):
        for name, y in one["y"].items():
            measured = (one.get("measured") or {}).get(name)
            yield _curve("simulation", i, name, units, one["t"], y, measured)
    states = document.get("states") or {}
    for i, one in enumerate(states.get("series", ())):
        for name, mean in one["mean"].items():
            yield _curve("state", i, name, states["units"], one["t"], mean)


def _held_out_curves(held: Document) -> Iterator[dict[str, Any]]:
    units = {one["output"]: one["unit"] for one in held.get("outputs", ())}
    for i, one in enumerate(held.get("series", ())):
        for name, y in one["y"].items():
            yield _curve("held-out", i, name, units, one["t"], y, one["measured"][name])


def _beside(both: Sequence[Sequence[Document]]) -> Iterator[dict[str, Any]]:
    """Both results' curves of each channel over all of their times."""
    known = [{one["key"]: one for one in curves} for curves in both]
    for key in dict.fromkeys([*known[0], *known[1]]):
        pair = [each.get(key) for each in known]
        there = [one for one in pair if one is not None]
        if all(one["y"] is None for one in there):
            continue
        t = sorted({time for one in there for time in one["t"]})
        measured = [one and one["measured"] and _at(t, one["t"], one["measured"]) for one in pair]
        what, series, name = key
        yield {
            "what": what,
            "series": series,
            "name": name,
            "unit": next(filter(None, (one["unit"] for one in there)), ""),
            "t": t,
            "measured": measured,
            "values": [one and one["y"] and _between(t, one["t"], one["y"]) for one in pair],
        }


def _at(t: list[float], own: list[float], values: Curve) -> Curve:
    """Values at their own times among all times; None elsewhere."""
    if own == t:
        return values
    at = dict(zip(own, values, strict=True))
    return [at.get(time) for time in t]


def _between(t: list[float], own: list[float], values: Curve) -> Curve:
    """Values on straight lines between their own times; None outside."""
    if own == t:
        return values
    found = np.interp(t, own, np.array(values, dtype=float), left=np.nan, right=np.nan)
    return [None if x != x else x for x in found.tolist()]


def _same_readings(both: Sequence[Sequence[Document]], what: str) -> bool | None:
    """Whether two results are of the same readings; None where one of them does not show its own."""
    one, other = (
        {c["key"]: c["measured"] for c in curves if c["key"][0] == what and c["measured"]}
        for curves in both
    )
    if not one or not other:
        return None
    return one.keys() == other.keys() and all(_close(one[key], other[key]) for key in one)


def _close(one: Curve, other: Curve) -> bool:
    a, b = (np.array(values, dtype=float) for values in (one, other))
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=0.0, equal_nan=True))
