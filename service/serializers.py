"""What the store and the registry hold, as the JSON documents clients see."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

import engine
from engine.models.registry import source_of
from engine.presentation.model_check import model_check
from engine.statespace.model import Array, MixedModel
from service.db_schema import ITERATIONS
from service.going_on import open_ended
from service.responses import JobStatus, Link, ModelOut, Trace
from service.schemas import ModelReference
from service.strict_json import dumps, finite

AFTER_ITERATIONS = 70  # per cent
CHECK, EXAMPLE = "check", "example"  # what is kept with a model of its document


def labels(row: Any) -> dict[str, Any]:
    """What tells a job from others: its name, its tags, its files of data."""
    lines = {name: getattr(row, name).split("\n")[1:-1] for name in ("tags", "data")}
    return {"name": row.name, **lines}


def labelled(result: bytes, row: Any) -> bytes:
    """The text of a result with what tells it from others, as the shell writes it; it may be long."""
    told = dumps({**labels(row), "created": _time(row.created)}).encode()
    return told[:-1] + b"," + result.lstrip()[1:]


def job_status(row: Any, has_estimates: bool = False) -> JobStatus:
    """The status document of a row of ``jobs``; ``has_estimates`` before the job is successful, or has not."""
    here = f"/jobs/{row.id}"
    links = [Link(href=here, rel="self"), Link(href=f"{here}/trace", rel="trace")]
    if has_estimates or (row.status == "successful" and not row.removed):
        links.append(Link(href=f"{here}/results", rel="results"))
        links.append(Link(href=f"{here}/report", rel="report"))
    if row.status in ("accepted", "running"):
        links.append(Link(href=f"{here}/stop", rel="stop"))
    if not row.removed and (row.status in ("failed", "dismissed") or open_ended(row)):
        links.append(Link(href=f"{here}/resume", rel="resume"))
    found = json.loads(row.found or "{}")
    return JobStatus(
        jobID=row.id,
        **labels(row),
        kind=row.kind,
        model=row.model,
        status=row.status,
        progress=_progress(row),
        stage=row.stage if row.status == "running" else "",
        iteration=row.iteration,
        iterations=row.iterations,
        created=_time(row.created),
        started=row.started and _time(row.started),
        updated=_time(row.updated),
        finished=row.finished and _time(row.finished),
        estimated_end=_estimated_end(row),
        message=row.message,
        estimate=row.estimate and json.loads(row.estimate),
        log_likelihood=row.log_likelihood,
        outcome=row.outcome,
        cause=row.cause,
        causes=found.get("causes", []),
        values=found.get("values", []),
        links=links,
    )


# Of an estimation: per cent at which what follows the iterations begins, and how much of it there is.
AFTER = {
    "smoothing the states at the estimate": (70, 5),
    "standard errors": (75, 10),
    "intervals": (85, 10),
    "comparing simulation and prediction with the data": (95, 5),
}


def _progress(row: Any) -> int:
    """Per cent; 100 only of what has succeeded."""
    if row.status == "successful":
        return 100
    done = row.iteration / max(row.iterations, 1)
    if row.kind != "estimate" or row.stage.startswith("fitting"):
        return min(int(100 * done), 99)
    if len(json.loads(row.stages)) > 2:  # with a bootstrap: most of it are iterations
        return min(int(95 * done), 99)
    begin, width = AFTER.get(row.stage, (0, 0))
    if not width:
        return int(AFTER_ITERATIONS * min(done, 1.0))
    return min(int(begin + width * (row.stage_share or 0.0)), 99)


def _estimated_end(row: Any) -> str | None:
    """When the present stage will be done by its rate since it began; None where that is not known."""
    share = row.stage_share
    if row.stage == ITERATIONS:
        share = row.iteration / max(row.iterations, 1)
    if row.status != "running" or share is None or row.stage_from is None:
        return None
    gone, since = share - row.stage_from, row.updated - row.stage_begun
    if gone <= 0.0 or since <= 0.0:
        return None
    return _time(row.updated + since / gone * max(1.0 - share, 0.0))


def _time(seconds: float) -> str:
    text = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


def trace(names: list[str], ks: list[int], rows: Array) -> Trace:
    """Iterations k with their rows (n, n_theta + 4), see ``db_schema.iterations``."""
    if rows.size and rows.shape[1] != len(names) + 4:  # nobody can say any more what they are
        names = [f"parameter {i + 1}" for i in range(rows.shape[1] - 4)]
    n = len(names)
    columns = [_numbers(column) for column in rows.reshape(len(ks), n + 4).T]
    return Trace(
        iteration=ks,
        theta=dict(zip(names, columns, strict=False)),
        log_likelihood=columns[n],
        ess=columns[n + 1],
        seconds=columns[n + 2],
    )


def _numbers(column: Array) -> list[float | None]:
    return [finite(x) for x in column.tolist()]


def model(model: MixedModel, reference: ModelReference | None = None) -> ModelOut:
    """The document of a registered model, or of the one that ``reference`` makes of it."""
    name = reference.name if reference else model.name
    with_effects = {"model": reference.model_dump()} if reference else {}
    link = Link(href=f"/models/{name}", rel="self" if reference is None else "base")
    shown = example(engine.get_model(name)) | with_effects
    return ModelOut(
        **{**members(model), "name": name},
        own=source_of(name) is not None,
        check=list(check(model)),
        example=shown,
        links=[link],
    )


def check(model: MixedModel) -> Sequence[str]:
    """What the check of the model says, looked at once."""
    if CHECK not in model.derived:
        model.derived[CHECK] = model_check(model)
    found: Sequence[str] = model.derived[CHECK]
    return found


def members(model: MixedModel) -> dict[str, Any]:
    """A model as JSON; an infinite bound is null."""
    return {
        "name": model.name,
        "description": model.description,
        "equations": list(model.equations),
        "nonlinear": dict(model.nonlinear),
        "linear": dict(model.linear),
        "inputs": dict(model.inputs),
        "outputs": dict(model.outputs),
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "default": float(p.default),
                "bounds": [finite(float(bound)) for bound in p.bounds],
                "description": p.description,
            }
            for p in model.parameters
        ],
    }


def example(model: MixedModel) -> dict[str, Any]:
    """An estimation on simulated data, made once."""
    if EXAMPLE in model.derived:
        return dict(model.derived[EXAMPLE])
    T = 20
    u = np.ones((T, model.nu)) if model.nu else None
    try:
        y = engine.simulate(model, None, T, np.random.default_rng(0), u=u).y
    except Exception:  # noqa: BLE001 - a stranger's model; its document is shown all the same
        y = np.zeros((T, model.ny))
    series = {"y": np.round(y, 6).tolist(), "dt": 1.0}
    model.derived[EXAMPLE] = {
        "kind": "estimate",
        "model": model.name,
        "series": [series | ({"u": u.tolist()} if u is not None else {})],
        "parameters": {"start": model.theta().asdict()},
        "options": {"particles": 50, "iterations": 20, "seed": 1},
    }
    return dict(model.derived[EXAMPLE])
