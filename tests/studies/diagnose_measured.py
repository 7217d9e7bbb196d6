"""Diagnosis of models on measured data: what is known to be missing, and what is found.

Data sets other than the Nile flows are read from the folder in the environment variable RBPS_DATA
(else ``shared/data`` beside the repository); those that are not there are skipped. Each model is fitted
on the data's estimation part and judged on its test part.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from engine.data import nile
from engine.data.files import read_series
from engine.data.series import Series
from engine.diagnose import diagnose
from engine.diagnose.diagnosis import Diagnosis
from engine.errors import EngineError
from engine.models.registry import get_model
from engine.simulation.fit import fit_simulation
from engine.simulation.free_run import free_run
from engine.statespace.model import Array
from tests.studies.measured_text import ANALYSIS, KNOWN
from tests.studies.plots import axes, save
from tests.studies.report import made_with, markdown
from tests.studies.study import Arm, Row, Study, Tables

DATA = Path(os.environ.get("RBPS_DATA") or Path(__file__).parents[3] / "shared" / "data")
POINTS = 300  # of each curve that is kept for the picture
SHOWN = 8  # candidates in the picture
STRETCH = 300  # samples of silverbox, half a second, 33 periods of its resonance
NOTE = "Seconds were taken while other work used the same two cores.\n"
THINNED = 80  # samples of 1 ms of emps that become one


@dataclass(frozen=True)
class Case:
    """One data set and the model that is diagnosed on it, as ``load`` gives them."""

    name: str
    folder: str
    load: Callable[[Path], tuple[str, Series, Series | None, dict[str, Any]]]
    cut: str = ""  # which part of the data

    @property
    def there(self) -> bool:
        """Whether its data are."""
        return not self.folder or (DATA / self.folder).is_dir()


def _nile(folder: Path) -> tuple[str, Series, Series | None, dict[str, Any]]:
    """All 100 flows; there is no other record of them, so the last fifth or blocks judge."""
    return "local-level", nile(), None, {}


def _tanks(folder: Path) -> tuple[str, Series, Series | None, dict[str, Any]]:
    parts = [read_series(folder / f"{part}.csv", dt=4.0) for part in ("estimation", "test")]
    return "tanks", parts[0], parts[1], {}


def _silverbox(folder: Path) -> tuple[str, Series, Series | None, dict[str, Any]]:
    """A stretch of the estimation part, and one of the multisine test part (row 65062 on)."""
    record = read_series(folder / "multisine.csv", dt=2**14 / 1e7)
    start = {"omega": 430.0, "zeta": 0.05, "gain": 1.0, "sigma_v": 10.0, "sigma_y": 1e-3}
    options = {"theta": start}
    return (
        "oscillator",
        record.part(1000, 1000 + STRETCH),
        record.part(65062, 65062 + STRETCH),
        options,
    )


def _emps(folder: Path) -> tuple[str, Series, Series | None, dict[str, Any]]:
    """One sample in so many; the input is averaged over the time that it is held for."""
    parts = [
        thinned(read_series(folder / f"{name}.csv", y=["y_m"], u=["u_V"], dt=1e-3), THINNED)
        for name in ("estimation", "test_pulses")
    ]
    options = {
        "theta": {"Fc": 0.0, "offset": 0.0},
        "free": ["M", "Fv", "sigma_v", "sigma_load", "sigma_y"],
    }
    return "servo", parts[0], parts[1], options


CASES = {
    case.name: case
    for case in (
        Case("nile", "", _nile),
        Case("tanks", "cascaded_tanks", _tanks),
        Case("silverbox", "silverbox", _silverbox, f"{STRETCH} samples"),
        Case("emps", "emps", _emps, f"1 sample in {THINNED}"),
    )
}


def thinned(series: Series, n: int) -> Series:
    """Every n-th reading, with the mean of the inputs until the next one."""
    T = len(series) // n * n
    u = series.u[:T].reshape(-1, n, series.u.shape[1]).mean(axis=1)
    return Series(series.y[:T:n], u, t=series.t[:T:n])


def work(name: str, seed: int, run: int) -> Row:
    """One diagnosis; what stops it is a row too."""
    case = CASES[name]
    model, train, test, options = case.load(DATA / case.folder)
    began = time.perf_counter()
    try:
        found = diagnose(get_model(model), train, test=test, seed=seed, **options)
    except EngineError as error:
        row: Row = {"model": model, "verdict": "error", "causes": str(error), "seconds": 0.0}
        return row | {"simulation": "{}", "document": "{}", "curves": "{}"}
    document = found.to_dict()
    del document["rounds"]
    return {
        "model": model,
        "verdict": found.verdict.value,
        "causes": " ".join(cause.effect for cause in found.causes),
        "seconds": time.perf_counter() - began,
        "simulation": json.dumps(simulated(found, train, test, options.get("free"))),
        "document": json.dumps(document),
        "curves": json.dumps(curves(found)),
    }


def simulated(
    found: Diagnosis, train: Series, test: Series | None, free: list[str] | None
) -> dict[str, float | None]:
    """RMSE of free runs on the test part, of both models fitted by likelihood and by simulation error.

    First states are estimated on the first 50 samples. None where a run or a fit fails.
    """
    judge = train if test is None else test
    names = list(found.model.parameter_names) if free is None else free
    own = list(found.extended.parameter_names[len(found.model.parameter_names) :])
    out: dict[str, float | None] = {}
    for model, theta, which, label in (
        (found.model, found.base_theta, names, "as given"),
        (found.extended, found.theta, [*names, *own], "extended"),
    ):
        for by in ("likelihood", "simulation error"):
            try:
                best = theta
                if by != "likelihood":
                    best = fit_simulation(model, train, theta, which, n_starts=4).theta
                rmse = free_run(model, best, judge, initial_rows=50).rmse
                out[f"{label}, {by}"] = float(f"{rmse:.5g}")
            except (EngineError, ValueError, np.linalg.LinAlgError):
                out[f"{label}, {by}"] = None
    return out


def curves(found: Diagnosis) -> dict[str, Any]:
    """What the picture shows of the first output, thinned: training part, candidates, test part."""
    symptoms, gain = found.symptoms, found.gain
    out: dict[str, Any] = {"train": {"t": _thin(symptoms.series.t), "y": _thin(symptoms.series.y)}}
    if symptoms.free_run is not None:
        run = symptoms.free_run
        out["train"] |= {"run": _thin(run.y), "lower": _thin(run.lower), "upper": _thin(run.upper)}
    ranked = [r for found_round in found.rounds[:1] for r in found_round.refits]
    bars = [(r.effect.name, r.score) for r in ranked]
    generic = found.rounds[0].generic
    if generic is not None:
        bars.append(("unnamed force", generic.score))
    out["candidates"] = sorted(bars, key=lambda bar: -bar[1])[:SHOWN]
    if gain is not None:
        out["test"] = {"t": _thin(gain.t), "y": _thin(gain.y)}
        for name, values in (("before", gain.before), ("after", gain.after)):
            if values is not None:
                out["test"][name] = _thin(values)
    return out


def _thin(values: Array) -> list[float | None]:
    column = values if values.ndim == 1 else values[:, 0]
    rows = np.unique(np.linspace(0, len(column) - 1, min(POINTS, len(column))).astype(int))
    return [float(f"{x:.8g}") if np.isfinite(x) else None for x in column[rows].tolist()]


def report(tables: Tables) -> str:
    """A summary, then each data set: what is known to be missing, the page, why."""
    rows, pages = [], []
    for case in CASES.values():
        table = tables.get(f"measured.{case.name}")
        if table is None:
            pages.append(f"## {case.name}\n\nSkipped: the data are not there.\n")
            continue
        row = table.rows[0]
        document = json.loads(str(row["document"]))
        rows.append([case.name, str(row["model"]), *_summary(document, row)])
        page = document.get("page", str(row["causes"]))
        pages.append(
            f"## {case.name}\n\nKnown to be missing: {KNOWN[case.name]}\n\n{ANALYSIS[case.name]}\n\n"
            f"{_simulations(row)}\n"
            f"```\n{page.rstrip()}\n```\n"
        )
    head = [
        "data",
        "model",
        "verdict",
        "found",
        "free run on the test part",
        "log-density",
        "seconds",
    ]
    return "\n".join([markdown(head, rows), NOTE, *pages, made_with(tables)])


def _simulations(row: Row) -> str:
    """The table of free-run errors."""
    values = json.loads(str(row["simulation"]))
    rows = [
        [
            label,
            *(_number(values.get(f"{label}, {by}")) for by in ("likelihood", "simulation error")),
        ]
        for label in ("as given", "extended")
    ]
    head = ["free run on the test part, RMSE", "fitted by likelihood", "fitted by simulation error"]
    return markdown(head, rows) if values else ""


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _summary(document: dict[str, Any], row: Row) -> list[str]:
    gain = document.get("gain")
    before_after, density = "-", "-"
    if gain and gain["outputs"]:
        o = gain["outputs"][0]
        before_after = f"{o['rmse_before']:.4g} -> {o['rmse_after']:.4g} {o['unit']}"
    if gain and gain["log_density"] is not None:
        density = f"{gain['log_density']:+.1f} (p = {gain['p_value']:.2g})"
    return [
        str(row["verdict"]),
        str(row["causes"]) or "-",
        before_after,
        density,
        f"{float(row['seconds']):.0f}",
    ]


def plot(tables: Tables, path: Path) -> None:
    """A row per data set: training part with the free run, candidates, test part before and after."""
    names = [case.name for case in CASES.values() if f"measured.{case.name}" in tables]
    figure, panels = axes(len(names), 3, (15.0, 3.4 * len(names)))
    for k, name in enumerate(names):
        drawn = json.loads(str(tables[f"measured.{name}"].rows[0]["curves"]))
        _row(panels[3 * k : 3 * k + 3], name, drawn)
    save(figure, path)


def _row(panels: list[Any], name: str, drawn: dict[str, Any]) -> None:
    left, middle, right = panels
    train, test = ({k: _column(v) for k, v in drawn.get(p, {}).items()} for p in ("train", "test"))
    left.set_title(f"{name}: free run of the model as given", fontsize=9)
    if "run" in train:
        left.fill_between(train["t"], train["lower"], train["upper"], color="#c44e52", alpha=0.18)
        left.plot(train["t"], train["run"], color="#c44e52", linewidth=1.0, label="free run")
    if train:
        left.plot(train["t"], train["y"], ".", color="#222222", markersize=2.5, label="measured")
        left.legend(fontsize=7)
    bars = drawn.get("candidates", [])
    middle.barh([bar[0] for bar in bars], [bar[1] for bar in bars], color="#9a9a9a")
    middle.invert_yaxis()
    middle.tick_params(labelsize=7)
    middle.set_title("first round: 2 x log-likelihood gained, less costs", fontsize=9)
    right.set_title("held-out data: free run before and after", fontsize=9)
    if test:
        right.plot(test["t"], test["y"], ".", color="#222222", markersize=2.5, label="measured")
        for key, color in (("before", "#c44e52"), ("after", "#2a7f5f")):
            if key in test:
                right.plot(test["t"], test[key], color=color, linewidth=1.0, label=key)
        right.legend(fontsize=7)


def _column(values: list[float | None]) -> Array:
    return np.array(values, dtype=float)


def _settings(case: Case) -> dict[str, str]:
    return {"data": case.folder or case.name} | ({"cut": case.cut} if case.cut else {})


MEASURED = Study(
    "diagnose-measured",
    "Diagnosis of models on measured data",
    {
        Arm(f"measured.{case.name}", partial(work, case.name), _settings(case)): 1
        for case in CASES.values()
        if case.there
    },
    report,
    plot,
)
