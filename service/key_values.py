"""What a result says in a few numbers: its verdict or outcome, the causes, the values that matter."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from engine.json_values import plain

MOST_VALUES = 30  # of a job
MOST_SUSPECTS = 3  # of a first screen


def found_by(result: Mapping[str, Any]) -> dict[str, str | None]:
    """The columns ``outcome`` and ``found`` of ``db_schema.jobs``, from a result document."""
    diagnosis = result.get("diagnosis") or {}
    causes = [one["effect"] for one in diagnosis.get("causes", ())]
    early = result.get("early") or {}
    of_kind = _of_diagnosis(diagnosis) if diagnosis else _of_early(early) if early else None
    values = list(of_kind or _of_estimate(result))
    return {
        "outcome": diagnosis.get("verdict") or result.get("outcome"),
        "found": json.dumps(plain({"causes": causes, "values": values[:MOST_VALUES]})),
    }


def reached_by(result: Mapping[str, Any]) -> dict[str, Any]:
    """The columns ``estimate`` and ``log_likelihood`` of an estimation that is done; none of other results.

    Iterates may have ended elsewhere than at the estimate, and their likelihoods are those of one filter each.
    """
    estimate, likelihood = result.get("estimate"), result.get("log_likelihood")
    if not (estimate and likelihood and "trace" in result):
        return {}
    values = {name: one["value"] for name, one in estimate.items()}
    return {"estimate": json.dumps(plain(values)), "log_likelihood": plain(likelihood["value"])}


def _of_diagnosis(d: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for one in d.get("causes", ()):
        if (amplitude := one.get("amplitude")) is not None:  # of a wave, whose size is its cosine's
            yield _value(
                f"amplitude of {one['effect']}", amplitude, one["amplitude_error"], one["unit"]
            )
        else:
            yield _value(one["effect"], one["size"], one["standard_error"], one["unit"])
    for one in (d.get("gain") or {}).get("outputs", ()):
        for when in ("before", "after"):
            name = f"held-out error of {one['output']} {when}"
            yield _value(name, one[f"rmse_{when}"], None, one["unit"])


def _of_early(d: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of a diagnosis that goes on."""
    for one in (d["symptoms"]["free_run"] or {}).get("fits", ()):
        yield _value(f"error of the simulation of {one['output']}", one["rmse"], None, one["unit"])
    yield _value("log-likelihood", d["log_likelihood"], None)
    for one in (d["screen"] or {}).get("scores", ())[:MOST_SUSPECTS]:
        name = f"first screen: {one['effect']}"
        yield _value(name, one["size"], one["standard_error"], one["unit"])
    for name, one in d["estimate"].items():
        if not one["fixed"]:
            yield _value(name, one["value"], one["standard_error"], one["unit"])


def _of_estimate(result: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Of an estimation, a smoothing or a simulation."""
    if likelihood := result.get("log_likelihood"):
        yield _value("log-likelihood", likelihood["value"], likelihood["standard_error"])
    for one in (result.get("held_out") or {}).get("outputs", ()):
        yield _value(f"held-out error of {one['output']}", one["rmse"], None, one["unit"])
    runs = (result.get("simulation") or {}).get("series", ())
    errors = [one["rmse"] for one in runs if one.get("rmse") is not None]
    error = result.get("rmse", errors[0] if len(errors) == 1 else None)
    if error is not None:
        units = set((result.get("model") or {}).get("outputs", {}).values())
        unit = units.pop() if len(units) == 1 else ""
        yield _value("error of the simulation", error, None, unit)
    for name, one in (result.get("estimate") or {}).items():
        if not one.get("fixed"):
            yield _value(name, one["value"], one["standard_error"], one["unit"])


def _value(name: str, value: Any, error: Any, unit: str = "") -> dict[str, Any]:
    return {"name": name, "value": value, "standard_error": error, "unit": unit}
